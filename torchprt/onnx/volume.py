"""Pictures of a volume as an ONNX graph: its cells shaded, and composited along the rays of a camera."""

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
from torchprt.onnx.contract import ParityError, Shapes, check_numbers, check_signature, signature
from torchprt.onnx.describe import INPUTS, metadata
from torchprt.onnx.export import ExportReport, traced
from torchprt.onnx.graph import ShaderGraph
from torchprt.onnx.operators import OPSET, check_operators, count_operators
from torchprt.onnx.parity import HALF_TURNS, SCALES, ParityReport, open_session, ratio, worse
from torchprt.onnx.plan import check_weights
from torchprt.onnx.toward_eye import scaled
from torchprt.sh import bands, yaw_pitch_roll
from torchprt.shade import VolumeShader
from torchprt.shade.rays import STEEP
from torchprt.transfer import Transfer

ABOUT = INPUTS | {
    "eye": "Points [B, 3] where the camera is, in the frame and unit of the scene; not at its target.",
    "image": (
        "Pictures [B, H, W, 4], first row on top: linear RGB radiance of the volume, before exposure, tone map and "
        "sRGB, and the share of what is behind that it hides; before a background: rgb + (1 - alpha) * background."
    ),
}
# Largest acceptable difference, relative to the picture: a base, and for every cell along the longest side two
# roundings of a distance of 17 sides, which is how far eyes are.
TOLERANCE = 1e-5, 4e-6


def export_volume(
    transfer: Transfer,
    path: str | os.PathLike[str],
    *,
    size: tuple[int, int] = (128, 128),
    field: float | int = 35.0,
    target: Sequence[float] | None = None,
    samples: int | None = None,
    check: bool = True,
) -> ExportReport:
    """Writes what is seen of a volume to one `.onnx` file: pictures of fixed `size` (width, height).

    Inputs `light [B, N, 3]`, `rotation [B, 3, 3]` of the environment and `eye [B, 3]`, a point; output
    `image [B, H, W, 4]`, linear radiance and opacity (premultiplied). float32, any B. It computes what
    `shade.VolumeShader` does with reading "trilinear" and so many `samples` a ray: no graph sorts the planes of
    "exact". The camera looks at `target`, the middle of the grid if omitted, with +y up and the vertical angle of view
    `field` in degrees, which the metadata tell. Everything else as for `export`, which writes the graph of what the
    cells send, `radiance [B, V, 3]`.

    Raises InputError if the transfer is of no volume or holds a value that is not finite, the weights exceed 2 GB,
    or `path`, `size`, `field`, `target` or `samples` cannot be used; ParityError as `export`.
    """
    path = Path(path)
    if path.suffix != ".onnx":
        raise InputError(f"{path} must end in .onnx")
    transfer.check()
    options: dict[str, Any] = {"size": size, "field": field, "target": target, "samples": samples}
    whole = VolumeShader(transfer, reading="trilinear", dtype=torch.float32, **options)
    stored = sum(value.numel() for layer in transfer.layers.values() for value in layer.signal.tensors().values())
    check_weights(stored + 2 * math.prod(each + 2 for each in whole.composite.shape) + 3 * transfer.vertices)
    example = {"light": torch.zeros(2, whole.order**2, 3), "rotation": torch.eye(3).repeat(2, 1, 1)}
    example["eye"] = torch.tensor([[0.0, 0.0, 9.0], [9.0, 1.0, 0.0]])
    batch = torch.export.Dim("B")
    free: dict[str, dict[int, Any] | None] = {name: {0: batch} for name in example}
    width, height = whole.size
    about = {
        "source": "light",
        "size": None,
        "eye": "point",
        "fixed": None,
        "width": width,
        "height": height,
        "field": whole.field,
        "target": whole.target.tolist(),
        "up": [0.0, 1.0, 0.0],
        "reading": "trilinear",
        "samples": whole.composite.samples,
    }
    with atomic(path) as temporary:
        model = traced(VolumeGraph(whole).eval(), example, free, ABOUT, {}, "image")
        onnx.helper.set_model_props(model, metadata(transfer, about))
        onnx.save(model, temporary)
        onnx.checker.check_model(temporary, full_check=True)
        model = onnx.load(temporary)
        check_operators(model)
        inputs, outputs = signature(list(model.graph.input)), signature(list(model.graph.output))
        promised = promised_of(whole.order, width, height)
        check_signature(f"the graph for {path}", inputs, outputs, promised, "image")
        check_numbers(f"the graph for {path}", model)
        parity = compare_volume(temporary, transfer, **options) if check else None
        if parity is not None and not parity.passed:
            raise ParityError(f"{path} was not written: ONNX Runtime and torch are {parity}")
    taken, given = ({name: shape for name, (_, shape) in values.items()} for values in (inputs, outputs))
    return ExportReport(path, path.stat().st_size, OPSET, taken, given, count_operators(model), parity)


def promised_of(order: int, width: int, height: int) -> Shapes:
    """The shape of every input and output of such a file; "B" is free."""
    return {
        "light": ("B", order**2, 3),
        "rotation": ("B", 3, 3),
        "eye": ("B", 3),
        "image": ("B", height, width, 4),
    }


class VolumeGraph(nn.Module):
    """What a `VolumeShader` that reads between cells computes, all in float32.

    A table has a row a cell, an empty one around: extinction, and its product with the source. Rays are rows.
    """

    rows: Tensor
    density: Tensor
    target: Tensor
    middle: Tensor
    extent: Tensor
    step: Tensor
    nothing: Tensor
    pixels: Tensor
    folded: Tensor
    strides: Tensor
    numbers: Tensor
    last: Tensor
    steps: Tensor
    before: Tensor

    def __init__(self, whole: VolumeShader) -> None:
        super().__init__()
        composite = whole.composite
        assert composite.samples is not None
        self.cells = ShaderGraph(whole.shader, "light", 0, "point", None)
        self.seen = "eye" in whole.shader.needs
        self.size, self.samples = whole.size, composite.samples
        # A rim of nothing, on either side.
        self.shape = tuple(count + 2 for count in composite.shape)
        count = len(composite.extinction)
        inside = composite.rows.view(composite.shape).long()
        rows = nn.functional.pad(inside, (1, 1) * 3, value=count).flatten()
        self.register_buffer("rows", rows)
        density = nn.functional.pad(composite.extinction.detach().float(), (0, 1))
        self.register_buffer("density", density[rows].view(1, -1, 1))
        self.register_buffer("nothing", torch.zeros(1, 1, 3))
        self.register_buffer("target", whole.target.float())
        low, high, step = composite.low.double(), composite.high.double(), composite.step.double()
        self.register_buffer("middle", ((low + high) / 2).float())
        self.register_buffer("extent", ((high - low) / (2 * step)).float())
        self.register_buffer("step", step.float())
        width, height = whole.size
        reach = math.tan(math.radians(whole.field) / 2)
        across = (2 * (torch.arange(width).double() + 0.5) / width - 1) * reach * width / height
        up = (1 - 2 * (torch.arange(height).double() + 0.5) / height) * reach
        ahead = torch.ones(height, width, dtype=torch.float64)
        pixels = torch.stack([ahead, across.expand(height, width), up[:, None].expand(height, width)], -1)
        self.register_buffer("pixels", pixels.flatten(0, 1).float().unsqueeze(0))
        # A sum over three axes as a product.
        self.register_buffer("folded", torch.eye(3).repeat(3, 1))
        corners = torch.tensor([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        strides = torch.tensor([self.shape[1] * self.shape[2], self.shape[2], 1])
        self.register_buffer("strides", strides)
        self.register_buffer("numbers", (corners * strides).sum(-1))
        self.register_buffer("last", torch.tensor(self.shape).float() - 1)
        self.register_buffer("steps", ((torch.arange(self.samples).double() + 0.5) / self.samples).float())
        self.register_buffer("before", torch.ones(self.samples, self.samples).triu(1))

    def forward(self, light: Tensor, rotation: Tensor, eye: Tensor) -> Tensor:
        source = self.cells(light, rotation, eye if self.seen else None)
        # The last row is nothing.
        source = torch.cat([source, self.nothing.expand(source.shape[0], 1, 3)], 1).index_select(1, self.rows)
        table = torch.cat([0 * source[..., :1] + self.density, source * self.density], -1)
        place, pace, near, far = self.rays(eye)
        length = (far - near) / self.samples
        read = self.read(table.reshape(-1, 4), place, pace, near, far)
        depth = read[..., 0] * length
        flat = depth.reshape(-1, self.samples)
        behind = (flat @ self.before).reshape(depth.shape)
        # (1 - e^(-x)) / x: graphs lack what is exact where x is small.
        thin = 1 - depth / 2 * (1 - depth / 3 * (1 - depth / 4 * (1 - depth / 5)))
        thick = depth > 0.05
        share = torch.where(thick, (1 - torch.exp(-depth)) / torch.where(thick, depth, 1.0), thin)
        weights = torch.exp(-behind) * share * length
        radiance = weights.reshape(-1, 1, self.samples) @ read[..., 1:].reshape(-1, self.samples, 3)
        hidden = 1 - torch.exp(-(flat @ torch.ones(self.samples, 1)))
        width, height = self.size
        return torch.cat([radiance.reshape(-1, 3), hidden], -1).reshape(-1, height, width, 4)

    def rays(self, eye: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """From where rays are nearest to the middle, in cells from the corner of the rim: places and directions
        `[B, R, 3]`, and where they enter and leave `[B, R, 1]`."""
        forward = _unit(scaled(self.target - eye, -1, 0.0))
        x, y, z = forward.split(1, -1)
        # The cross products of forward with +y and with -z.
        level = x * x + z * z > STEEP**2
        nothing = 0 * x
        right = torch.where(level, torch.cat([-z, nothing, x], -1), torch.cat([-y, x, nothing], -1))
        right = _unit(right)
        above = _turned(right) * _turned(_turned(forward)) - _turned(_turned(right)) * _turned(forward)
        axes = torch.stack([forward, right, above], 1)
        # Not as a product, which does not broadcast a batch of none.
        unit = _unit((self.pixels.unsqueeze(-1) * axes.unsqueeze(1)).flatten(2) @ self.folded)
        start = (eye - self.middle).unsqueeze(1)
        away = -_dot(start, unit)
        slope = unit / self.step
        tiny = torch.finfo(torch.float32).tiny ** 0.5
        slope = torch.where(slope.abs() > tiny, slope, tiny)
        offset = (start + away * unit) / self.step
        reach = self.extent + 0.5
        first, second = (-reach - offset) / slope, (reach - offset) / slope
        near = _most(torch.minimum(first, second))
        far = -_most(-torch.maximum(first, second))
        near = torch.maximum(near, -away)
        return offset + self.extent + 1, slope, near, torch.maximum(near, far)

    def read(self, table: Tensor, place: Tensor, pace: Tensor, near: Tensor, far: Tensor) -> Tensor:
        """Extinction, and its product with the source, `[B, R, S, 4]`, between the middles of cells."""
        at = near + (far - near) * self.steps
        there = place.unsqueeze(2) + at.unsqueeze(-1) * pace.unsqueeze(2) - 0.5
        there = torch.minimum(there.clamp(min=0), self.last)
        low = torch.minimum(there, self.last - 1).long()
        part = (there - low.float()).reshape(-1, 3)
        batch = torch.arange(near.shape[0], device=near.device) * math.prod(self.shape)
        first = low[..., 0] * self.strides[0] + low[..., 1] * self.strides[1] + low[..., 2] + batch.view(-1, 1, 1)
        first = first.reshape(-1)
        x, y, z = (torch.cat([1 - side, side], -1).split(1, -1) for side in part.split(1, -1))
        squares = [y[j] * z[k] for j in (0, 1) for k in (0, 1)]
        # One corner after the other: all at once would be eight times as large.
        total = 0.0 * first.unsqueeze(-1)
        for corner in range(8):
            index = first + self.numbers[corner]
            total = total + x[corner // 4] * squares[corner % 4] * table.index_select(0, index)
        return total.reshape(-1, *at.shape[1:], 4)


def _dot(one: Tensor, other: Tensor) -> Tensor:
    x, y, z = (one * other).split(1, -1)
    return x + y + z


def _turned(vectors: Tensor) -> Tensor:
    """y, z, x."""
    return torch.cat([vectors[..., 1:], vectors[..., :1]], -1)


def _unit(vectors: Tensor) -> Tensor:
    return vectors / torch.sqrt(_dot(vectors, vectors))


def _most(values: Tensor) -> Tensor:
    x, y, z = values.split(1, -1)
    return torch.maximum(torch.maximum(x, y), z)


def compare_volume(
    path: str | os.PathLike[str],
    transfer: Transfer,
    *,
    size: tuple[int, int] = (128, 128),
    field: float | int = 35.0,
    target: Sequence[float] | None = None,
    samples: int | None = None,
    batches: Sequence[int] = (1, 3),
    seed: int = 0,
) -> ParityReport:
    """Runs the file in ONNX Runtime and `shade.VolumeShader` in torch in float64, and reports the difference.

    Six random lights, rotations and scales as `compare`, each with an eye of its own: around the volume, above it,
    inside of it and far away. Radiance relative to the light, opacity as it is.
    """
    session = open_session(Path(path))
    shader = VolumeShader(
        transfer, size=size, field=field, target=target, reading="trilinear", samples=samples, dtype=torch.float64
    )
    generator = torch.Generator().manual_seed(seed)
    degrees = torch.cat([torch.tensor(HALF_TURNS), 360 * torch.rand(2, 3, generator=generator)])
    rotations = yaw_pitch_roll(degrees.double()).float()
    count = len(rotations)
    scales = torch.tensor(SCALES).repeat(2).view(-1, 1, 1)
    light = torch.randn(count, shader.order**2, 3, generator=generator)
    light *= (1 + bands(shader.order))[:, None] ** -2.0 * scales
    low, high = (torch.tensor(corner) for corner in transfer.receivers.as_cells().box)
    reach = (high - low).norm()
    away = torch.tensor([[0.5, 0.3, 1.0], [0.0, 1.5, 0.0], [0.1, -0.05, 0.08], [-2.0, 0.1, 0.3], [-1.0, -1.0, 0.6]])
    eye = (low + high) / 2 + reach * torch.cat([away, 10 * away[:1]])
    rms = largest = 0.0
    cases = 0
    with torch.no_grad():
        wanted = shader(light.double(), rotations.double(), eye=eye.double())
    feeds = {"light": light, "rotation": rotations, "eye": eye}
    for batch in batches:
        for start in range(0, count, batch):
            chosen = [index % count for index in range(start, start + batch)]
            feed = {name: value[chosen].numpy() for name, value in feeds.items()}
            found = torch.from_numpy(session.run(["image"], feed)[0])
            for image, index in zip(found, chosen, strict=True):
                difference = image.double() - wanted[index]
                # Relative to what the light is, and of opacity to one.
                difference[..., :3] /= wanted[index][..., :3].abs().max().clamp(min=torch.finfo(torch.float32).tiny)
                rms = worse(rms, ratio(difference.square().mean().sqrt(), torch.tensor(1.0)))
                largest = worse(largest, ratio(difference.abs().max(), torch.tensor(1.0)))
                cases += 1
    base, slope = TOLERANCE
    return ParityReport(rms, largest, base + slope * max(shader.composite.shape), cases, tuple(batches))
