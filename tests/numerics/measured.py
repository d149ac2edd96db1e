"""What a kernel loses, in epsilons of its dtype."""

from collections.abc import Iterator

import torch
from numerics.extremes import extremes, plain
from numerics.kernels import Kernel
from torch import Tensor

DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
Arguments = dict[str, Tensor]


def cases(kernel: Kernel, order: int, dtype: torch.dtype) -> Iterator[tuple[str, Arguments]]:
    """Everything plain; then each extreme of each argument, the others plain."""
    usual = {name: plain(kind, order, dtype) for name, kind in kernel.takes.items()}
    yield "plain", usual
    for name, kind in kernel.takes.items():
        for extreme, value in extremes(kind, order, dtype).items():
            if extreme != "plain":
                yield f"{name} {extreme}", usual | {name: value}


def wanted(kernel: Kernel, order: int, arguments: Arguments) -> Tensor:
    """What the very numbers that are given should lead to, float64; of a rotation that was rounded to a narrow type,
    what the rotation does that it is nearest to."""
    wide = {name: value.detach().double() for name, value in arguments.items()}
    for name, kind in kernel.takes.items():
        if kind in ("rotation", "frames") and torch.finfo(arguments[name].dtype).bits < 32:
            left, _, right = torch.linalg.svd(wide[name])
            wide[name] = left @ right
    return (kernel.reference or kernel.call)(order, **wide)


def loss(found: Tensor, exact: Tensor, dtype: torch.dtype) -> float:
    """Largest difference relative to the largest value, in epsilons of `dtype`; below its normal numbers no digits are
    asked for."""
    info = torch.finfo(dtype)
    size = max(float(exact.abs().max()), info.tiny / info.eps)
    return float((found.double() - exact).abs().max()) / size / info.eps


def losses(kernel: Kernel, order: int, dtype: torch.dtype) -> dict[str, float]:
    """Of every case that keeps its digits."""
    made = {}
    for name, arguments in cases(kernel, order, dtype):
        if not any(name == f"{argument} {extreme}" for argument, extreme in kernel.loses):
            made[name] = loss(kernel.call(order, **arguments), wanted(kernel, order, arguments), dtype)
    return made
