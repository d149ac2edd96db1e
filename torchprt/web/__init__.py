"""A baked model as a folder that any static web server shows, with no Python behind it."""

from .environment import samples as samples
from .export import PageReport as PageReport
from .export import export as export
from .libraries import libraries as libraries
from .serve import serve as serve

__all__ = ["PageReport", "export", "libraries", "samples", "serve"]
