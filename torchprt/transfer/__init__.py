"""What a bake leaves: the kinds of transfer and one file format."""

from .file import FORMAT as FORMAT
from .file import Transfer as Transfer
from .file import load as load
from .file import save as save
from .kinds import DiffuseTransfer as DiffuseTransfer

__all__ = ["FORMAT", "DiffuseTransfer", "Transfer", "load", "save"]
