"""A baked model as a folder that any static web server shows, with no Python behind it."""

from .environment import samples
from .export import PageReport, export
from .flight import Flight
from .libraries import libraries
from .serve import serve

__all__ = ["Flight", "PageReport", "export", "libraries", "samples", "serve"]
