"""The `torchprt` command."""

from .command import app as app
from .command import main as main

__all__ = ["app", "main"]
