"""A shader as one self-contained ONNX file, and the proof that it computes the same."""

from .clustered import BlockGraph
from .contract import ParityError
from .describe import describe
from .export import ExportReport, export
from .layers import LayerGraph, layer_graph
from .neighbourhood import compare_neighbourhood, export_neighbourhood
from .parity import ParityReport, compare
from .phase import PhaseGraph
from .signal import SignalGraph, arranged, by_channel, signal_graph
from .volume import compare_volume, export_volume
from .zonal import ZonalGraph

__all__ = [
    "BlockGraph",
    "ExportReport",
    "LayerGraph",
    "ParityError",
    "ParityReport",
    "PhaseGraph",
    "SignalGraph",
    "ZonalGraph",
    "arranged",
    "by_channel",
    "compare",
    "compare_neighbourhood",
    "compare_volume",
    "describe",
    "export",
    "export_neighbourhood",
    "export_volume",
    "layer_graph",
    "signal_graph",
]
