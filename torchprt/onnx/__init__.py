"""A shader as one self-contained ONNX file, and the proof that it computes the same."""

from . import clustered as clustered
from . import zonal as zonal
from .describe import describe as describe
from .export import ExportReport as ExportReport
from .export import export as export
from .layers import LayerGraph as LayerGraph
from .layers import layer_graph as layer_graph
from .parity import ParityError as ParityError
from .parity import ParityReport as ParityReport
from .parity import compare as compare
from .signal import SignalGraph as SignalGraph
from .signal import arranged as arranged
from .signal import signal_graph as signal_graph

__all__ = [
    "ExportReport",
    "LayerGraph",
    "ParityError",
    "ParityReport",
    "SignalGraph",
    "arranged",
    "compare",
    "describe",
    "export",
    "layer_graph",
    "signal_graph",
]
