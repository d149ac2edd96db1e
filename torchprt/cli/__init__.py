"""The `torchprt` command."""

from .verbs import app as app
from .verbs import main as main

__all__ = ["app", "main"]
