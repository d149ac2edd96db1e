"""How fast is shading in zonal lobes? Ratios measured side by side on one thread, with the error beside the time.

    python scripts/benchmarks/deform.py

50 000 vertices with 4 lobes each, order 6, a new pose at every call: the shader, the table of the light, ONNX Runtime,
and the straightforward evaluation, in which basis functions are stacked last. Then one pose for many lights, and where
frames come from: triangles (a grid of 50 000 vertices) and joints.
"""

import math
import tempfile
from pathlib import Path

import numpy as np
import onnxruntime
import rich
import torch
from torch.nn.functional import normalize

from torchprt.measure import Table, relative_rms, time_it
from torchprt.onnx import export
from torchprt.pose import DeformedFrames, SkinnedMesh, nearest_rotation
from torchprt.sh import bands, check_rotation, yaw_pitch_roll
from torchprt.shade import shader
from torchprt.transfer import Diffuse, Transfer, Vertices, Zonal, diffuse_transfer

VERTICES, LOBES, ORDER, MANY, JOINTS = 50_000, 4, 6, 64, 24


def grid(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Positions and faces of a wavy square of about `count` vertices."""
    side = math.isqrt(count)
    ticks = torch.linspace(-1, 1, side)
    x, z = torch.meshgrid(ticks, ticks, indexing="ij")
    positions = torch.stack([x, 0.1 * torch.sin(9 * x) * torch.cos(7 * z), z], -1).reshape(-1, 3)
    corner = (torch.arange(side - 1)[:, None] * side + torch.arange(side - 1)).reshape(-1)
    a, b, c, d = corner, corner + 1, corner + side + 1, corner + side
    return positions, torch.cat([torch.stack([a, b, c], -1), torch.stack([a, c, d], -1)])


def random_transfer(exact: bool) -> Transfer:
    positions, faces = grid(VERTICES)
    count, generator = len(positions), torch.Generator().manual_seed(0)
    fall = (1.0 + torch.arange(ORDER)[:, None]) ** -2
    weights = torch.randn(1, LOBES, ORDER, count, generator=generator) * fall
    signal = Zonal(
        axis=normalize(torch.randn(LOBES, 3, count, generator=generator), dim=1)[None],
        coefficients=(weights[:, :, 2:].contiguous() if exact else weights)[:, None],
        exact=torch.randn(1, 4 if exact else 0, count, generator=generator)[:, None],
        squared_error=torch.zeros(count),
    )
    return Transfer(
        receivers=Vertices(positions=positions, normals=torch.zeros(count, 3), faces=faces),
        layers={"diffuse": Diffuse(albedo=torch.full((1, 1), 0.5), signal=signal)},
    )


class Stacked:
    """What one would write first: for every lobe of every vertex a row of basis functions, weighted, summed, lit."""

    def __init__(self, transfer: Transfer) -> None:
        signal = transfer.layers["diffuse"].signal
        assert isinstance(signal, Zonal)
        self.axis = signal.axis[0].permute(2, 0, 1).contiguous()
        self.coefficients = signal.coefficients[0, 0].permute(2, 0, 1)[..., bands(ORDER)].contiguous()
        self.albedo = transfer.albedo

    def __call__(self, light: torch.Tensor, frames: torch.Tensor) -> torch.Tensor:
        axis = (frames[:, None] @ self.axis[..., None])[..., 0]
        vectors = (stacked_basis(axis, ORDER) * self.coefficients).sum(1)
        return self.albedo * (vectors @ light)


def stacked_basis(directions: torch.Tensor, order: int) -> torch.Tensor:
    """`sh.basis` as it is written in textbooks, one function after another, `[..., N]` stacked last."""
    x, y, z = directions.unbind(-1)
    rows: dict[int, torch.Tensor] = {}
    cosine, sine = torch.ones_like(x), torch.zeros_like(x)
    sectoral = math.sqrt(0.25 / math.pi)
    for m in range(order):
        if m:
            cosine, sine = x * cosine - y * sine, x * sine + y * cosine
            sectoral *= -math.sqrt((2 * m + 1) / (2 * m))
        before, last = torch.zeros_like(x), torch.full_like(x, sectoral)
        for l in range(m, order):
            if l > m:
                a = math.sqrt((4 * l * l - 1) / (l * l - m * m))
                b = math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1)) if l > m + 1 else 0.0
                before, last = last, a * (z * last - b * before)
            rows[l * l + l + m] = last * cosine * (math.sqrt(2) if m else 1.0)
            if m:
                rows[l * l + l - m] = last * sine * math.sqrt(2)
    return torch.stack([rows[index] for index in range(order * order)], -1)


def shading(rounds: int) -> None:
    """One light and a new pose at every call."""
    whole, apart = random_transfer(exact=False), random_transfer(exact=True)
    count, generator = whole.vertices, torch.Generator().manual_seed(1)
    frames = yaw_pitch_roll(360 * torch.rand(count, 3, generator=generator).double()).float()
    light, many = (torch.randn(size, ORDER**2, 3, generator=generator) for size in (1, MANY))
    modules = {"lobes": whole, "lobes, bands 0 and 1 apart": apart}
    direct = {name: shader(transfer) for name, transfer in modules.items()}
    tables = {name: shader(transfer, method="table") for name, transfer in modules.items()}
    stacked = Stacked(whole)
    fixed = direct["lobes"].fix_pose(frames)
    static = shader(
        diffuse_transfer(
            fixed.layers["diffuse"].signal.values,
            whole.albedo,
            **{name: getattr(whole, name) for name in ("positions", "normals", "faces")},
        )
    )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    sessions = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, transfer in modules.items():
            report = export(transfer, Path(folder) / "pose.onnx")
            sessions[name] = onnxruntime.InferenceSession(report.path, options, providers=["CPUExecutionProvider"])
    feeds = {
        "light": light.numpy(),
        "rotation": np.eye(3, dtype=np.float32)[None],
        "frames": frames.numpy(),
    }
    wide = {name: shader(transfer, dtype=torch.float64) for name, transfer in modules.items()}
    functions = {
        "stacked": lambda: stacked(light[0], frames),
        "one light, pose fixed": lambda: fixed(light),
        "one light, static transfer": lambda: static(light),
        f"{MANY} lights, one pose": lambda: direct["lobes"](many, frames=frames),
        f"{MANY} lights, static transfer": lambda: static(many),
    }
    for name in modules:
        functions[f"{name}: torch"] = lambda name=name: direct[name](light, frames=frames)
        functions[f"{name}: table"] = lambda name=name: tables[name](light, frames=frames)
        functions[f"{name}: ONNX Runtime"] = lambda name=name: sessions[name].run(None, feeds)[0]
    with torch.no_grad():
        times = time_it(functions, rounds=rounds)
        errors = {}
        for name, module in wide.items():
            wanted = module(light.double(), frames=frames.double())
            for way in ("torch", "table", "ONNX Runtime"):
                found = torch.as_tensor(functions[f"{name}: {way}"]()).double()
                errors[f"{name}: {way}"] = relative_rms(found, wanted)
        exact = wide["lobes"](light.double(), frames=frames.double())[0]
        errors["stacked"] = relative_rms(stacked(light[0], frames).double(), exact)
    table = Table(f"{count} vertices x {LOBES} lobes, order {ORDER}, one thread, median of {rounds} rounds")
    for name, timing in times.items():
        table.add(name, error=errors.get(name), seconds=timing.median)
    rich.print(table)
    ratios = Table("ratios and their targets")
    for name in modules:
        here = times[f"{name}: torch"].median
        ratios.add(f"{name}: stacked / torch", extra={"ratio": times["stacked"].median / here, "target": ">= 3"})
        ratios.add(
            f"{name}: ONNX Runtime / torch",
            extra={"ratio": times[f"{name}: ONNX Runtime"].median / here, "target": "<= 1"},
        )
        ratios.add(f"{name}: table / torch", extra={"ratio": times[f"{name}: table"].median / here, "target": "-"})
    same = times["one light, pose fixed"].median / times["one light, static transfer"].median
    ratios.add("pose unchanged / static", extra={"ratio": same, "target": "<= 2"})
    rich.print(ratios)


def frames(rounds: int) -> None:
    """Where frames come from."""
    positions, faces = grid(VERTICES)
    count, generator = len(positions), torch.Generator().manual_seed(2)
    estimate = DeformedFrames(positions, faces)
    weights = torch.rand(count, JOINTS, generator=generator) ** 8
    mesh = SkinnedMesh(positions, weights / weights.sum(1, keepdim=True))
    transforms = torch.eye(4).repeat(JOINTS, 1, 1)
    transforms[:, :3, :3] = yaw_pitch_roll(40 * torch.rand(JOINTS, 3, generator=generator).double()).float()
    posed, turned = mesh(transforms)
    with torch.no_grad():
        times = time_it(
            {
                "from triangles": lambda: estimate(posed),
                f"skin of {JOINTS} joints": lambda: mesh(transforms),
                "nearest rotation": lambda: nearest_rotation(turned),
                "singular values": lambda: torch.linalg.svd(turned),
                "check of frames": lambda: check_rotation(turned),
            },
            rounds=rounds,
        )
    table = Table(f"frames of {count} vertices, one thread, median of {rounds} rounds")
    for name, timing in times.items():
        table.add(name, seconds=timing.median)
    rich.print(table)


def run(rounds: int = 15) -> None:
    """Prints every table."""
    torch.set_num_threads(1)
    shading(rounds)
    frames(rounds)


if __name__ == "__main__":
    run()
