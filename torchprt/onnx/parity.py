"""Does the file compute what the shader computes? ONNX Runtime against torch."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import onnxruntime
import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.onnx.contract import check_signature, promised
from torchprt.onnx.hard_cases import conditions, eyes_of_all, random_poses, receivers
from torchprt.sh import bands, hemisphere_gram, yaw_pitch_roll
from torchprt.sh.hemisphere import DISCARDED
from torchprt.shade import (
    EnvironmentShader,
    EyeLayerModule,
    FixedLightShader,
    LocalLightShader,
    PhaseLayer,
    Shader,
)
from torchprt.words import count

Module: TypeAlias = Shader | EnvironmentShader | FixedLightShader | LocalLightShader

# What files take beside the light, by what the shader needs.
MORE: dict[frozenset[str], tuple[tuple[str, ...], ...]] = {
    frozenset(): ((),),
    frozenset({"eye"}): (("eye",), ("view",)),
    frozenset({"pose"}): (("frames",), ("positions",)),
    frozenset({"eye", "pose"}): (("eye", "positions"), ("view", "positions"), ("view", "frames")),
}
SCALES = (1.0, 1e-6, 1e6)
HALF_TURNS = ((0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (0.0, 180.0, 0.0), (0.0, 0.0, 180.0))


@dataclass(frozen=True)
class ParityReport:
    """How far ONNX Runtime in float32 is from torch in float64, over all lights, rotations and batch sizes tried.

    - `relative_rms`: the worst light's RMS difference relative to the RMS of its radiance.
    - `max_error`: the worst light's largest difference relative to its largest radiance.
    - `tolerance`: what both must stay below.
    - `cases`: lights (and eyes) shaded, at the batch sizes `batches`.
    """

    relative_rms: float
    max_error: float
    tolerance: float
    cases: int
    batches: tuple[int, ...]

    @property
    def passed(self) -> bool:
        # Written so that NaN fails.
        return self.relative_rms <= self.tolerance and self.max_error <= self.tolerance

    def __str__(self) -> str:
        verdict = "same" if self.passed else "NOT the same"
        return (
            f"{verdict}: relative RMS {self.relative_rms:.1e}, largest {self.max_error:.1e} of the largest radiance, "
            f"tolerance {self.tolerance:.1e}, {count(self.cases, 'light')} in batches of "
            f"{', '.join(map(str, self.batches))}"
        )


def tolerance(order: int, module: Module | None = None) -> float:
    """Largest acceptable relative difference of float32 radiance: 16 rounding errors of float32 times the order.

    Each of the products on the way sums at most 2 n^2 terms, whose rounding errors add up as the square root of
    their number; the basis itself is good to a few rounding errors times the order. For a `module` that depends on
    the eye n is the larger of the orders of light and exit functions, which change that fast with the direction; a
    table of factors, H texels wide, changes as fast as functions of order H. The "reduced" exit functions are far from
    orthogonal on the hemisphere: coefficients are larger than what they sum up to, by up to one over the root of the
    least eigenvalue of their Gram matrix (57 at order 5), and so is the error.
    """
    larger = 1.0
    for layer in _eye_layers(module):
        order = max(order, layer.exit_order)
        if getattr(layer, "projection", None) == "reduced" and layer.exit_order > 1:
            kept = [index for index in range(layer.exit_order**2) if index != DISCARDED]
            least = torch.linalg.eigvalsh(hemisphere_gram(layer.exit_order)[kept][:, kept])[0]
            larger = max(larger, float(least) ** -0.5)
    return 16 * torch.finfo(torch.float32).eps * order * larger


def compare(
    path: str | os.PathLike[str], module: Module, *, batches: Sequence[int] = (1, 3, 7, 16), seed: int = 0
) -> ParityReport:
    """Runs the file in ONNX Runtime on the CPU and `module` in torch in float64, and reports the difference.

    24 random lights (bands fall off as 1 / (l + 1)^2, or cube maps with a contrast of 1 to 1000), scaled by 1, 1e-6
    and 1e6, under the identity, half turns about each axis and random rotations; every light runs in a batch of
    every size in `batches`, none of which is the size that the graph was traced with. Where the file takes an eye,
    each light has its own, for the receivers of every layer in turn: near, far (10 000 times the size of the model), in
    the middle of the model, at a vertex and behind one; or directions of many lengths, along a normal and against it.

    Where the file takes a pose, all lights run in three (`random_poses`).

    Positions count as float32, as the file holds them. A receiver whose tangent plane the eye is below is seen at the
    horizon, in a direction that rounding turns by 1 / sin a of its size, a the angle from straight below: its
    difference counts sin a.

    Raises InputError if the file cannot be run or takes other inputs than `module`, ParityError if names, dtypes or
    shapes are not those of docs/onnx.md: float32, and a batch B of every size, the same for all inputs.
    """
    path = Path(path)
    session = open_session(path)
    names = [value.name for value in session.get_inputs()]
    _check_inputs(path, names, module)
    _check_contract(path, session, module)
    reference = copy.deepcopy(module).double().eval()
    shader = _shader(reference)
    for layer in _eye_layers(reference):
        layer.points = layer.points.float().double()
    feeds = _cases(names, reference, shader, seed)
    count = len(next(iter(feeds.values())))
    posed = isinstance(shader, Shader) and "pose" in shader.needs
    poses: list[dict[str, Tensor]] = random_poses(shader, names[-1], seed) if posed else [{}]
    rms = largest = 0.0
    for pose in poses:
        with torch.no_grad():
            # One at a time: every light is as large as the scene in float64.
            cases = [{name: value[index] for name, value in feeds.items()} for index in range(count)]
            wanted = [_shade(reference, case | pose) for case in cases]
            weights = [_weights(shader, case | pose) for case in cases]
        still = {name: value.numpy() for name, value in pose.items()}
        for batch in batches:
            for start in range(0, count, batch):
                # The last batch wraps around, so that every one has the stated size.
                chosen = [index % count for index in range(start, start + batch)]
                feed = {name: value[chosen].numpy() for name, value in feeds.items()}
                found = torch.from_numpy(session.run(["radiance"], feed | still)[0])
                for radiance, index in zip(found, chosen, strict=True):
                    difference = (radiance.double() - wanted[index]) * weights[index]
                    rms = worse(rms, ratio(difference.square().mean().sqrt(), wanted[index].square().mean().sqrt()))
                    largest = worse(largest, ratio(difference.abs().max(), wanted[index].abs().max()))
    count *= len(batches) * len(poses)
    return ParityReport(rms, largest, tolerance(shader.order, module), count, tuple(batches))


def open_session(path: Path) -> onnxruntime.InferenceSession:
    """A CPU session. Raises InputError if ONNX Runtime cannot read the file."""
    try:
        return onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    except Exception as fault:  # ONNX Runtime has no common base of its exceptions
        raise InputError(f"{path} cannot be opened by ONNX Runtime: export it again") from fault


def _check_inputs(path: Path, names: list[str], module: Module) -> None:
    lights = [] if isinstance(module, FixedLightShader) else ["light", "rotation"]
    if isinstance(module, EnvironmentShader):
        lights[0] = "environment"
    known = [[*lights, *more] for more in MORE[_shader(module).needs]]
    if names not in known:
        taken = " or ".join(", ".join(inputs) for inputs in known)
        raise InputError(f"{path} takes {', '.join(names)} but the module takes {taken}: compare its own")


def _check_contract(path: Path, session: onnxruntime.InferenceSession, module: Module) -> None:
    inputs, outputs = (
        {value.name: (value.type, tuple(value.shape)) for value in values}
        for values in (session.get_inputs(), session.get_outputs())
    )
    shader, size = _shader(module), module.size if isinstance(module, EnvironmentShader) else None
    check_signature(str(path), inputs, outputs, promised(shader.order, shader.vertices, size, _lights(module)))


def _shader(module: Module) -> Shader | FixedLightShader:
    """The shader of transfer inside."""
    return module if isinstance(module, Shader | FixedLightShader) else _shader(module.shader)


def _lights(module: Module) -> int | None:
    """How many lights each entry is blended of; None if it has one and no blend."""
    if isinstance(module, LocalLightShader):
        return module.lights
    return _lights(module.shader) if isinstance(module, EnvironmentShader) else None


def _eye_layers(module: Module | None) -> list[EyeLayerModule | PhaseLayer]:
    """The layers that depend on the eye."""
    layers = [] if module is None else _shader(module).layers.values()
    return [layer for layer in layers if isinstance(layer, EyeLayerModule | PhaseLayer)]


def _shade(module: Module, case: dict[str, Tensor]) -> Tensor:
    """Radiance `[V, 3]` of one case in float64."""
    wide = {name: value.double() for name, value in case.items()}
    lights = [wide.pop(name) for name in ("light", "environment", "rotation") if name in wide]
    return module(*lights, **wide)


def _weights(shader: Shader | FixedLightShader, case: dict[str, Tensor]) -> Tensor:
    """What the difference of each receiver counts, `[V, 1]`: the least that one of its layers lets it."""
    eye, view = (case[name].double() if name in case else None for name in ("eye", "view"))
    weights = torch.ones(shader.vertices, dtype=torch.float64)
    for layer in _eye_layers(shader):
        seen = conditions(receivers(shader, layer, case), eye, view)
        if layer.receivers is None:
            weights = torch.minimum(weights, seen)
        else:
            weights = weights.scatter_reduce(0, layer.receivers, seen, "amin")
    return weights.unsqueeze(-1)


def _cases(names: list[str], module: Module, shader: Shader | FixedLightShader, seed: int) -> dict[str, Tensor]:
    """Every scale under every rotation: 24 of each input that is named, in float32."""
    generator = torch.Generator().manual_seed(seed)
    degrees = torch.cat([torch.tensor(HALF_TURNS), 360 * torch.rand(4, 3, generator=generator)])
    rotations = yaw_pitch_roll(degrees.double()).float().repeat(len(SCALES), 1, 1)
    count = len(rotations)
    scales = torch.tensor(SCALES).repeat_interleave(len(degrees))
    cases: dict[str, Tensor] = {}
    lights = _lights(module)
    blended = () if lights is None else (lights,)
    if isinstance(module, EnvironmentShader):
        shape = (count, *blended, 6, module.size, module.size, 3)
        environments = torch.exp(math.log(1000) * torch.rand(shape, generator=generator))
        cases["environment"] = environments * scales.reshape(-1, *(1,) * (len(shape) - 1))
    elif "light" in names:
        order = shader.order
        decay = (1 + bands(order)) ** -2.0
        shape = (count, *blended, order * order, 3)
        lamps = torch.randn(shape, generator=generator) * decay[:, None]
        cases["light"] = lamps * scales.reshape(-1, *(1,) * (len(shape) - 1))
    if "rotation" in names:
        cases["rotation"] = rotations
    for name in ("eye", "view"):
        if name in names:
            seen = [receivers(shader, layer, {}) for layer in _eye_layers(shader)]
            cases[name] = eyes_of_all(seen, name, count, generator)
    return cases


def ratio(error: Tensor, size: Tensor) -> float:
    # Black must stay black exactly; nothing is relative to zero.
    return float(error / size) if size > 0 else (0.0 if error == 0 else math.inf)


def worse(worst: float, value: float) -> float:
    return value if math.isnan(value) else max(worst, value)
