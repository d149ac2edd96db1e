"""Does the file compute what the shader computes? ONNX Runtime against torch."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import onnxruntime
import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh import bands, yaw_pitch_roll
from torchprt.shade import DiffuseShader, EnvironmentShader

SCALES = (1.0, 1e-6, 1e6)
HALF_TURNS = ((0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (0.0, 180.0, 0.0), (0.0, 0.0, 180.0))


class ParityError(RuntimeError):
    """An exported graph does not compute what the shader computes: a bug of the exporter or of the runtime."""


@dataclass(frozen=True)
class ParityReport:
    """How far ONNX Runtime in float32 is from torch in float64, over all lights, rotations and batch sizes tried.

    - `relative_rms`: the worst light's RMS difference relative to the RMS of its radiance.
    - `max_error`: the worst light's largest difference relative to its largest radiance.
    - `tolerance`: what both must stay below.
    - `cases`: lights shaded, at the batch sizes `batches`.
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
            f"tolerance {self.tolerance:.1e}, {self.cases} lights in batches of {', '.join(map(str, self.batches))}"
        )


def tolerance(order: int) -> float:
    """Largest acceptable relative difference of float32 radiance: 16 rounding errors of float32 times the order.

    Each of the four products on the way sums at most 2 n^2 terms, whose rounding errors add up as the square root
    of their number; the basis itself is good to a few rounding errors times the order.
    """
    return 16 * torch.finfo(torch.float32).eps * order


def compare(
    path: str | os.PathLike[str],
    module: DiffuseShader | EnvironmentShader,
    *,
    batches: Sequence[int] = (1, 3, 7, 16),
    seed: int = 0,
) -> ParityReport:
    """Runs the file in ONNX Runtime on the CPU and `module` in torch in float64, and reports the difference.

    24 random lights (bands fall off as 1 / (l + 1)^2, or cube maps with a contrast of 1 to 1000), scaled by 1, 1e-6
    and 1e6, under the identity, half turns about each axis and random rotations; every light runs in a batch of
    every size in `batches`, none of which is the size that the graph was traced with.

    Raises InputError if the file cannot be run or takes other inputs than `module`.
    """
    path = Path(path)
    source = "environment" if isinstance(module, EnvironmentShader) else "light"
    session = open_session(path)
    names = [value.name for value in session.get_inputs()]
    if names != [source, "rotation"]:
        raise InputError(f"{path} takes {', '.join(names)} but the module takes {source}, rotation: compare its own")
    order = (module.shader if isinstance(module, EnvironmentShader) else module).order
    inputs, rotations = _cases(module, order, seed)
    reference = copy.deepcopy(module).double().eval()
    with torch.no_grad():
        # One at a time: every light is as large as the scene in float64.
        pairs = zip(inputs.double().split(1), rotations.double().split(1), strict=True)
        wanted = [reference(one, turn)[0] for one, turn in pairs]
    rms = largest = 0.0
    for batch in batches:
        for start in range(0, len(inputs), batch):
            # The last batch wraps around, so that every one has the stated size.
            chosen = [index % len(inputs) for index in range(start, start + batch)]
            feed = {source: inputs[chosen].numpy(), "rotation": rotations[chosen].numpy()}
            found = torch.from_numpy(session.run(["radiance"], feed)[0])
            for radiance, index in zip(found, chosen, strict=True):
                difference = radiance.double() - wanted[index]
                rms = _worse(rms, _ratio(difference.square().mean().sqrt(), wanted[index].square().mean().sqrt()))
                largest = _worse(largest, _ratio(difference.abs().max(), wanted[index].abs().max()))
    return ParityReport(rms, largest, tolerance(order), len(inputs) * len(batches), tuple(batches))


def open_session(path: Path) -> onnxruntime.InferenceSession:
    """A CPU session. Raises InputError if ONNX Runtime cannot read the file."""
    try:
        return onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    except Exception as fault:  # ONNX Runtime has no common base of its exceptions
        raise InputError(f"{path} cannot be opened by ONNX Runtime: export it again") from fault


def _cases(module: DiffuseShader | EnvironmentShader, order: int, seed: int) -> tuple[Tensor, Tensor]:
    """Every scale under every rotation: `[24, ...]` inputs and `[24, 3, 3]` rotations in float32."""
    generator = torch.Generator().manual_seed(seed)
    degrees = torch.cat([torch.tensor(HALF_TURNS), 360 * torch.rand(4, 3, generator=generator)])
    rotations = yaw_pitch_roll(degrees.double()).float().repeat(len(SCALES), 1, 1)
    count = len(rotations)
    if isinstance(module, EnvironmentShader):
        shape = (count, 6, module.size, module.size, 3)
        inputs = torch.exp(math.log(1000) * torch.rand(shape, generator=generator))
    else:
        decay = (1 + bands(order)) ** -2.0
        inputs = torch.randn(count, order * order, 3, generator=generator) * decay[:, None]
    scales = torch.tensor(SCALES).repeat_interleave(len(degrees))
    return inputs * scales.reshape(-1, *(1,) * (inputs.ndim - 1)), rotations


def _ratio(error: Tensor, size: Tensor) -> float:
    # Black must stay black exactly; nothing is relative to zero.
    return float(error / size) if size > 0 else (0.0 if error == 0 else math.inf)


def _worse(worst: float, value: float) -> float:
    return value if math.isnan(value) else max(worst, value)
