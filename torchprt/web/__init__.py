"""A baked model as a folder that any static web server shows, with no Python behind it."""

from .environment import Environment as Environment
from .environment import from_coefficients as from_coefficients
from .environment import from_image as from_image
from .environment import samples as samples
from .export import PageReport as PageReport
from .export import export as export
from .libraries import libraries as libraries
from .serve import serve as serve

__all__ = ["Environment", "PageReport", "export", "from_coefficients", "from_image", "libraries", "samples", "serve"]
