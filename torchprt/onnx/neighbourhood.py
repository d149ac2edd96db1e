"""What an object does to the light of receivers around it, as an ONNX graph: the object moves, receivers are inputs."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.onnx.clustered import BlockGraph, BlockSignal
from torchprt.onnx.contract import ParityError, Shapes, check_numbers, check_signature, signature
from torchprt.onnx.describe import INPUTS, metadata
from torchprt.onnx.export import ExportReport, traced
from torchprt.onnx.operators import OPSET, check_operators, count_operators
from torchprt.onnx.parity import HALF_TURNS, SCALES, ParityReport, open_session, ratio, tolerance, worse
from torchprt.onnx.plan import check_weights
from torchprt.onnx.signal import arranged, by_channel
from torchprt.sh import Rotation, bands, basis, clamped_cosine, yaw_pitch_roll
from torchprt.shade import DenseSignal, NeighbourhoodShader, SignalModule
from torchprt.transfer import Transfer

ABOUT = INPUTS | {
    "positions": "Points [R, 3] of the receivers, in the world; the same for all B.",
    "normals": "Unit normals [R, 3] of the receivers, in the world; zero for one without, which is black.",
    "pose": "Rigid motions [B, 4, 4] of the object from its place at rest, for columns (x, y, z, 1).",
    "radiance": "Linear RGB exit radiance [B, R, 3] of the receivers, before exposure, tone map and sRGB.",
}
# Receivers that a comparison is made at, in calls of so many.
_RECEIVERS = (96, 1, 37)


def export_neighbourhood(
    transfer: Transfer,
    path: str | os.PathLike[str],
    *,
    albedo: float | Sequence[float] = 1.0,
    check: bool = True,
) -> ExportReport:
    """Writes what an object does to light around it, for diffuse receivers, to one `.onnx` file.

    Inputs `light [B, N, 3]`, `rotation [B, 3, 3]` of the environment, `positions [R, 3]` and `normals [R, 3]` of the
    receivers in the world, `pose [B, 4, 4]` of the object; output `radiance [B, R, 3]`, times the `albedo`, one number
    or three. float32, any B and any R. It computes what `shade.NeighbourhoodShader` does, dense or clustered.
    Everything else as for `export`.

    Raises InputError if the transfer is no neighbourhood or holds a value that is not finite, the weights exceed 2 GB,
    or `path` or `albedo` cannot be used; ParityError as `export`.
    """
    path = Path(path)
    if path.suffix != ".onnx":
        raise InputError(f"{path} must end in .onnx")
    colour = torch.as_tensor(albedo, dtype=torch.float32).flatten()
    if len(colour) not in (1, 3) or not bool(((colour >= 0) & (colour <= 1)).all()):
        raise InputError(f"albedo is {albedo}: give one number or three, from 0 to 1")
    transfer.check()
    shader = NeighbourhoodShader(transfer, dtype=torch.float32)
    (layer,) = transfer.layers.values()
    check_weights(sum(value.numel() for value in layer.signal.tensors().values()))
    example = {
        "light": torch.zeros(2, shader.order**2, 3),
        "rotation": torch.eye(3).repeat(2, 1, 1),
        "positions": torch.zeros(3, 3),
        "normals": torch.tensor([0.0, 1.0, 0.0]).repeat(3, 1),
        "pose": torch.eye(4).repeat(2, 1, 1),
    }
    batch, receivers = torch.export.Dim("B"), torch.export.Dim("R")
    free: dict[str, dict[int, Any] | None] = {
        name: {0: receivers if name in ("positions", "normals") else batch} for name in example
    }
    about = {"source": "light", "size": None, "albedo": f"applied, {colour.tolist()}"}
    with atomic(path) as temporary:
        model = traced(NeighbourhoodGraph(shader, colour).eval(), example, free, ABOUT, {})
        onnx.helper.set_model_props(model, metadata(transfer, about))
        onnx.save(model, temporary)
        onnx.checker.check_model(temporary, full_check=True)
        model = onnx.load(temporary)
        check_operators(model)
        inputs, outputs = signature(list(model.graph.input)), signature(list(model.graph.output))
        check_signature(f"the graph for {path}", inputs, outputs, promised_of(shader.order))
        check_numbers(f"the graph for {path}", model)
        parity = compare_neighbourhood(temporary, transfer, albedo=albedo) if check else None
        if parity is not None and not parity.passed:
            raise ParityError(f"{path} was not written: ONNX Runtime and torch are {parity}")
    taken, given = ({name: shape for name, (_, shape) in values.items()} for values in (inputs, outputs))
    return ExportReport(path, path.stat().st_size, OPSET, taken, given, count_operators(model), parity)


def promised_of(order: int) -> Shapes:
    """The shape of every input and output of such a file; "B" and "R" are free."""
    return {
        "light": ("B", order**2, 3),
        "rotation": ("B", 3, 3),
        "positions": ("R", 3),
        "normals": ("R", 3),
        "pose": ("B", 4, 4),
        "radiance": ("B", "R", 3),
    }


class NeighbourhoodGraph(nn.Module):
    """What a `NeighbourhoodShader` of diffuse receivers computes, all in float32."""

    albedo: Tensor
    cosine: Tensor

    def __init__(self, shader: NeighbourhoodShader, albedo: Tensor) -> None:
        super().__init__()
        self.order, self.count, self.nodes = shader.order, shader.output_order**2, math.prod(shader.shape)
        self.turn = Rotation(shader.order)
        self.field = field_graph(shader.signal)
        self.lattice = shader.lattice
        cosine = clamped_cosine(shader.order) / math.pi
        self.register_buffer("cosine", cosine[bands(shader.order)].float())
        self.register_buffer("albedo", albedo.float())

    def forward(self, light: Tensor, rotation: Tensor, positions: Tensor, normals: Tensor, pose: Tensor) -> Tensor:
        turned, moved = pose[:, :3, :3], pose[:, :3, 3]
        # In the frame of the object, of plain light too: one turn, and one basis.
        still = self.turn(light, turned.mT @ rotation)
        facing = _turned_back(normals, turned)
        index, weights = self.lattice(_turned_back(positions - moved.unsqueeze(1), turned))
        first = torch.arange(light.shape[0], device=light.device) * self.field.places
        index = self.field.place(index) + first.view(-1, 1, 1)
        rows = basis(facing, self.order) * self.cosine
        plain = rows @ still
        table = self.field(still)
        # Products of a batch of receivers: sums over a batch of none fail.
        read = weights.reshape(-1, 1, 8) @ table.index_select(0, index.flatten()).reshape(-1, 8, 3 * self.count)
        near = rows[..., : self.count].reshape(-1, self.count, 1)
        change = (read.reshape(-1, 3, self.count) @ near).reshape(plain.shape)
        total = weights @ torch.ones(8, 1)
        change = change - total * (rows[..., : self.count] @ still[:, : self.count])
        lit = (normals * normals).sum(-1, keepdim=True) > 0
        return torch.where(lit, plain + change, 0.0) * self.albedo


def _turned_back(vectors: Tensor, turned: Tensor) -> Tensor:
    """`vectors [B or none, R, 3] @ turned [B, 3, 3]`, written out: ONNX Runtime neither broadcasts a batch of none in a
    product nor sums over one."""
    parts = [vectors[..., axis, None] * turned[:, None, axis] for axis in range(3)]
    return parts[0] + parts[1] + parts[2]


class FieldGraph(nn.Module):
    """`light [B, N, 3]` to what it becomes at all nodes, a row each: `[B places, 3 M]`."""

    matrix: Tensor

    def __init__(self, signal: SignalModule) -> None:
        super().__init__()
        self.places, channels, self.rows, columns = signal.shape
        single = torch.eye(self.rows)[:, None].expand(self.rows, self.places, self.rows)
        values = signal.values if isinstance(signal, DenseSignal) else signal.toward(single).permute(0, 3, 2, 1)
        # Columns first: a light reads the matrices as one stream.
        streams = values.detach().reshape(channels, self.places * self.rows, columns).mT
        self.register_buffer("matrix", streams.float().contiguous())

    def place(self, index: Tensor) -> Tensor:
        """Where nodes stand among the rows."""
        return index

    def forward(self, light: Tensor) -> Tensor:
        channels, columns, _ = self.matrix.shape
        if channels == 1:
            sent = (light.mT.reshape(-1, columns) @ self.matrix[0]).reshape(-1, 3, self.places, self.rows)
            return sent.transpose(1, 2).reshape(-1, 3 * self.rows)
        sent = (by_channel(light) @ self.matrix).reshape(3, -1, self.rows)
        return sent.transpose(0, 1).reshape(-1, 3 * self.rows)


class BlockField(nn.Module):
    """The same of a clustered signal, whose nodes are in blocks of one cluster."""

    where: Tensor

    def __init__(self, signal: BlockSignal, order: Tensor) -> None:
        super().__init__()
        self.graph = BlockGraph(signal, None).float()
        self.places, self.rows = len(order), signal.shape[2]
        where = torch.zeros(signal.shape[0], dtype=torch.int64)
        where[order] = torch.arange(len(order))
        self.register_buffer("where", where)

    def place(self, index: Tensor) -> Tensor:
        return self.where.index_select(0, index.flatten()).reshape(index.shape)

    def forward(self, light: Tensor) -> Tensor:
        sent = self.graph.signal.blend(self.graph.table(light))
        return sent.reshape(self.places, -1, 3 * self.rows).transpose(0, 1).reshape(-1, 3 * self.rows)


def field_graph(signal: SignalModule) -> FieldGraph | BlockField:
    """The part of the graph for a signal."""
    held, order = arranged(signal)
    return FieldGraph(signal) if order is None or not isinstance(held, BlockSignal) else BlockField(held, order)


def compare_neighbourhood(
    path: str | os.PathLike[str],
    transfer: Transfer,
    *,
    albedo: float | Sequence[float] = 1.0,
    batches: Sequence[int] = (1, 3, 7, 16),
    seed: int = 0,
) -> ParityReport:
    """Runs the file in ONNX Runtime and `NeighbourhoodShader` in torch in float64, and reports the difference.

    24 random lights, rotations and scales as `compare`, each with a pose of its own, at receivers in the box, on its
    border and outside, one of them without a normal, in calls of 96, 1 and 37.
    """
    session = open_session(Path(path))
    shader = NeighbourhoodShader(transfer, dtype=torch.float64)
    generator = torch.Generator().manual_seed(seed)
    degrees = torch.cat([torch.tensor(HALF_TURNS), 360 * torch.rand(4, 3, generator=generator)])
    rotations = yaw_pitch_roll(degrees.double()).float().repeat(len(SCALES), 1, 1)
    count = len(rotations)
    scales = torch.tensor(SCALES).repeat_interleave(len(degrees)).view(-1, 1, 1)
    decay = (1 + bands(shader.order)) ** -2.0
    light = torch.randn(count, shader.order**2, 3, generator=generator) * decay[:, None] * scales
    low, high = (torch.tensor(corner).float() for corner in transfer.receivers.as_grid().box)
    pose = torch.eye(4).repeat(count, 1, 1)
    pose[:, :3, :3] = rotations.flip(0)
    # So that receivers are at every place of the box, whichever way it has turned.
    middle = (low + high) / 2
    pose[:, :3, 3] = (
        middle - (pose[:, :3, :3] @ middle) + 0.3 * torch.randn(count, 3, generator=generator) * (high - low)
    )
    rms = largest = 0.0
    cases = 0
    for receivers in _RECEIVERS:
        positions = middle + (torch.rand(receivers, 3, generator=generator) - 0.5) * 1.5 * (high - low)
        normals = torch.nn.functional.normalize(torch.randn(receivers, 3, generator=generator), dim=-1)
        if receivers > 1:
            positions[0] = low
            normals[-1] = 0
        still = {"positions": positions, "normals": normals}
        with torch.no_grad():
            wanted = shader(
                light.double(),
                rotations.double(),
                **{name: value.double() for name, value in still.items()},
                pose=pose.double(),
                albedo=torch.as_tensor(albedo, dtype=torch.float64),
            )
        moving = {"light": light, "rotation": rotations, "pose": pose}
        for batch in batches:
            for start in range(0, count, batch):
                chosen = [index % count for index in range(start, start + batch)]
                feed = {name: value[chosen].numpy() for name, value in moving.items()}
                found = session.run(["radiance"], feed | {name: value.numpy() for name, value in still.items()})[0]
                for radiance, index in zip(torch.from_numpy(found), chosen, strict=True):
                    difference = radiance.double() - wanted[index]
                    # Receivers may be few, and dark by chance: relative to the light.
                    size = light[index].double().square().mean().sqrt()
                    rms = worse(rms, ratio(difference.square().mean().sqrt(), size))
                    largest = worse(largest, ratio(difference.abs().max(), size))
                    cases += 1
    return ParityReport(rms, largest, tolerance(shader.order), cases, tuple(batches))
