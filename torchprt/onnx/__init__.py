"""A shader as one self-contained ONNX file, and the proof that it computes the same."""

from .describe import describe as describe
from .export import ExportReport as ExportReport
from .export import export as export
from .parity import ParityError as ParityError
from .parity import ParityReport as ParityReport
from .parity import compare as compare

__all__ = ["ExportReport", "ParityError", "ParityReport", "compare", "describe", "export"]
