"""Which operators an exported graph may use."""

from __future__ import annotations

from collections import Counter

import onnx

OPSET = 18

# Plain tensor operators of the default domain that ONNX Runtime runs natively on the CPU, in WebAssembly and in WebGPU
# (js/web/docs/webgpu-operators.md of its sources). Loop, If, Scatter*, Einsum, IsNaN and GridSample are left out:
# a web runtime lacks them, or runs them so slowly that a graph with them is a mistake.
ALLOWED = frozenset({
    "Abs", "Add", "Atan", "Cast", "Clip", "Concat", "Constant", "Cos", "Div", "Equal", "Exp", "Expand",
    "Flatten", "Gather", "Gemm", "Greater", "Identity", "Less", "MatMul", "Max", "Min", "Mul", "Neg",
    "Pow", "Range", "Reciprocal", "ReduceSum", "Reshape", "Shape", "Sigmoid", "Sin", "Slice", "Softmax", "Split",
    "Sqrt", "Squeeze", "Sub", "Tanh", "Tile", "Transpose", "Unsqueeze", "Where",
})  # fmt: skip


def count_operators(model: onnx.ModelProto) -> dict[str, int]:
    """How often the graph uses each operator, most frequent first; other domains as `domain::name`."""
    names = [f"{node.domain}::{node.op_type}" if node.domain else node.op_type for node in model.graph.node]
    return dict(Counter(names).most_common())


def check_operators(model: onnx.ModelProto) -> None:
    """RuntimeError (a bug of ours) if an operator is outside `ALLOWED`, or there is a function or another opset."""
    foreign = sorted(set(count_operators(model)) - ALLOWED)
    if foreign:
        raise RuntimeError(f"the graph uses operators that web runtimes lack: {', '.join(foreign)}")
    if model.functions:
        raise RuntimeError(f"the graph holds local functions: {', '.join(f.name for f in model.functions)}")
    opsets = {entry.domain: entry.version for entry in model.opset_import}
    if opsets != {"": OPSET}:
        raise RuntimeError(
            f"the graph has operator sets {opsets} where only {OPSET} of the default domain was asked for"
        )
