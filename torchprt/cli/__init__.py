"""The `torchprt` command."""

from .command import app, main

__all__ = ["app", "main"]
