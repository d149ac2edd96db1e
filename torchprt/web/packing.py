"""Weights of a graph in 16 bits and fewer, which it unpacks itself: a page is half or a third of the download."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

# Tensors below this many numbers stay as they are: they are no download.
LEAST = 4096
# Numbers that share a step, at least: each row has its own where rows are that long.
ROW = 64
# What three channels together may lose of their RMS; those that would lose more have 16 bits each.
COLOUR_LOSS = 1e-3


def pack(path: str | os.PathLike[str]) -> None:
    """Writes the graph again, its large float32 weights as whole numbers that Cast, Mul and Add make numbers of again.

    Runtimes fold those nodes when they open the file, and then run what they ran before. A row is `low + step k`, k of
    16 bits: its numbers are off by 4e-6 of its range, where float16 would be off by 2e-4 of each number. Three
    channels `[3, K, V]` become their mean, of 16 bits, times a ratio for each column, and what the ratio leaves of two
    of them, in 8 bits: colour bled from other surfaces is a little more than nothing. That is 4 bytes a coefficient
    where float32 has 12.
    Source: affine quantisation; the channels as the predicted luminance and chroma of picture formats.
    """
    model = onnx.load(path)
    kept: list[onnx.TensorProto] = []
    made = _Nodes()
    for tensor in model.graph.initializer:
        if tensor.data_type != onnx.TensorProto.FLOAT or np.prod(tensor.dims) < LEAST:
            kept.append(tensor)
            continue
        values = numpy_helper.to_array(tensor)
        if not (_is_colour(values) and made.colour(tensor.name, values)):
            made.plain(tensor.name, values, 16, tensor.name)
    nodes = [*made.nodes, *model.graph.node]
    del model.graph.node[:], model.graph.initializer[:]
    model.graph.node.extend(nodes)
    model.graph.initializer.extend([*kept, *made.tensors])
    Path(path).write_bytes(model.SerializeToString())


class _Nodes:
    """What is put before the graph: tensors of whole numbers, and the nodes that unpack them."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.tensors: list[onnx.TensorProto] = []

    def plain(self, name: str, values: np.ndarray, bits: int, output: str) -> np.ndarray:
        """Unpacks to `output`; gives the numbers as they will be. 16 bits are two tensors of bytes."""
        packed, step, low = _quantised(values, bits)
        scale, offset = self._tensor(step, f"{name}.step"), self._tensor(low, f"{name}.low")
        whole = self._bytes(packed & 255, f"{name}.bytes")
        if bits > 8:
            high = self._bytes(packed >> 8, f"{name}.high")
            high = self._node("Mul", [high, self._tensor(np.float32(256), f"{name}.base")], f"{name}.above")
            whole = self._node("Add", [high, whole], f"{name}.whole")
        steps = self._node("Mul", [whole, scale], f"{name}.steps")
        self._node("Add", [steps, offset], output)
        return packed.astype(np.float32) * step + low

    def _bytes(self, packed: np.ndarray, name: str) -> str:
        # Of whole numbers, builds of ONNX Runtime for WebGPU cast bytes alone.
        stored = self._tensor(packed.astype(np.uint8), f"{name}.packed")
        return self._node("Cast", [stored], name, to=onnx.TensorProto.FLOAT)

    def colour(self, name: str, values: np.ndarray) -> bool:
        """Unpacks `[3, K, V]` to `name`; false, and nothing done, if that would lose more than `COLOUR_LOSS`."""
        trial = _Nodes()
        mean = trial.plain(f"{name}.mean", values.mean(0), 16, f"{name}.mean")
        energy = (mean * mean).sum(0)
        ratio = np.where(energy > 0, (values * mean).sum(1) / np.where(energy > 0, energy, 1), 0)
        # A column that is nearly nothing in the mean can have any ratio.
        ratio = np.clip(ratio, -1, 4)[:, None].astype(np.float32)
        ratio = trial.plain(f"{name}.ratio", ratio, 8, f"{name}.ratio")
        left = values - ratio * mean
        rest = trial.plain(f"{name}.rest", left[::2], 8, f"{name}.rest")
        # Of green the rest is what makes the mean of the three right again.
        others = 3 * mean - (ratio[::2] * mean + rest).sum(0)
        found = np.stack([ratio[0] * mean + rest[0], others, ratio[2] * mean + rest[1]])
        if np.square(found - values).sum() > COLOUR_LOSS**2 * np.square(values, dtype=np.float64).sum():
            return False
        ends = trial._tensor(np.array([0, 2], np.int64), f"{name}.ends")
        pair = trial._node("Gather", [f"{name}.ratio", ends], f"{name}.pair", axis=0)
        predicted = trial._node("Mul", [pair, f"{name}.mean"], f"{name}.predicted")
        red_blue = trial._node("Add", [predicted, f"{name}.rest"], f"{name}.red_blue")
        halves = trial._tensor(np.array([1, 1], np.int64), f"{name}.halves")
        red, blue = f"{name}.red", f"{name}.blue"
        trial.nodes.append(onnx.helper.make_node("Split", [red_blue, halves], [red, blue], axis=0))
        three = trial._node("Mul", [f"{name}.mean", trial._tensor(np.float32(3), f"{name}.three")], f"{name}.sum")
        without = trial._node("Sub", [three, red], f"{name}.without")
        green = trial._node("Sub", [without, blue], f"{name}.green")
        trial._node("Concat", [red, green, blue], name, axis=0)
        self.nodes += trial.nodes
        self.tensors += trial.tensors
        return True

    def _tensor(self, values: np.ndarray | np.generic, name: str) -> str:
        self.tensors.append(numpy_helper.from_array(np.asarray(values), name))
        return name

    def _node(self, operator: str, inputs: list[str], output: str, **attributes: Any) -> str:
        self.nodes.append(onnx.helper.make_node(operator, inputs, [output], **attributes))
        return output


def _is_colour(values: np.ndarray) -> bool:
    return values.ndim == 3 and values.shape[0] == 3 and values.shape[1] >= 4 and values.shape[2] >= ROW


def _quantised(values: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whole numbers, and the float32 step and lowest number of each row (of all where rows are short)."""
    rows = -1 if values.shape[-1] >= ROW else None
    most = 2**bits - 1
    low = values.min(axis=rows, keepdims=True)
    step = ((values.max(axis=rows, keepdims=True).astype(np.float64) - low) / most).astype(np.float32)
    whole = np.rint((values - low) / np.where(step > 0, step, 1))
    return np.clip(whole, 0, most).astype(np.uint16), step, low
