"""What is promised of every exported file, whatever it computes: names, dtypes and shapes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import onnx

Shapes: TypeAlias = dict[str, tuple[int | str, ...]]
# Of inputs and outputs: dtype as ONNX Runtime writes it, shape with dynamic sizes as names.
Signature: TypeAlias = dict[str, tuple[str, tuple[int | str, ...]]]

FLOAT = "tensor(float)"
# Weights are float32; indices and sizes are int64 (int32 where torch has them so), what a table chooses is bool.
NUMBERS = frozenset({onnx.TensorProto.FLOAT, onnx.TensorProto.INT64, onnx.TensorProto.INT32, onnx.TensorProto.BOOL})


class ParityError(RuntimeError):
    """An exported graph is not what was promised, or does not compute what the shader computes: a bug of the exporter
    or of the runtime."""


def promised(order: int, vertices: int, size: int | None = None, lights: int | None = None) -> Shapes:
    """The shape of every input and output that a file can have, by name; "B" is the batch.

    `size`: width of the cube maps; `lights`: how many lights are blended, None if there is one and no blend.
    """
    blended = () if lights is None else (lights,)
    return {
        "light": ("B", *blended, order**2, 3),
        "environment": ("B", *blended, 6, size or 0, size or 0, 3),
        "rotation": ("B", 3, 3),
        "eye": ("B", 3),
        "view": ("B", 3),
        "frames": (vertices, 3, 3),
        "positions": (vertices, 3),
        "radiance": ("B", vertices, 3),
    }


def check_signature(what: str, inputs: Signature, outputs: Signature, wanted: Shapes, output: str = "radiance") -> None:
    """ParityError unless `output` is the only one, and all have the shapes `wanted` and are float32.

    The size B must have this one name in all of them: a runtime then knows that it is the same.
    """
    if list(outputs) != [output]:
        raise ParityError(f"{what} has the outputs {', '.join(outputs) or 'none'}: '{output}' alone was promised")
    for name, (dtype, shape) in (inputs | outputs).items():
        if name not in wanted:
            raise ParityError(f"{what} has an input '{name}', which is none of {', '.join(wanted)}")
        if dtype != FLOAT:
            raise ParityError(f"{what} has '{name}' as {dtype}: {FLOAT} was promised")
        if shape != wanted[name]:
            raise ParityError(f"{what} has '{name}' of shape {_text(shape)}: {_text(wanted[name])} was promised")


def check_numbers(what: str, model: onnx.ModelProto) -> None:
    """ParityError if the graph holds or makes numbers other than `NUMBERS`, such as float64."""
    for name, dtype in _numbers(model):
        if dtype not in NUMBERS:
            raise ParityError(f"{what} has {onnx.TensorProto.DataType.Name(dtype)} in '{name}': float32 was promised")


def signature(values: list[onnx.ValueInfoProto]) -> Signature:
    """Dtypes and shapes as they stand in a file."""
    found = {}
    for value in values:
        tensor = value.type.tensor_type
        name = onnx.TensorProto.DataType.Name(tensor.elem_type).lower()
        found[value.name] = f"tensor({name})", tuple(size.dim_param or size.dim_value for size in tensor.shape.dim)
    return found


def _numbers(model: onnx.ModelProto) -> Iterator[tuple[str, int]]:
    for tensor in model.graph.initializer:
        yield tensor.name, tensor.data_type
    for node in model.graph.node:
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.TENSOR:
                yield node.output[0], attribute.t.data_type
            if node.op_type == "Cast" and attribute.name == "to":
                yield node.output[0], attribute.i


def _text(shape: tuple[int | str, ...]) -> str:
    return f"[{', '.join(map(str, shape))}]"
