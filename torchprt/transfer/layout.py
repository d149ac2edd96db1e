"""What the tensors of a transfer must look like, and the checks of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchprt.errors import InputError

FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


@dataclass(frozen=True)
class Layout:
    """Shape letters and dtypes that a tensor of a transfer must have; equal letters mean equal sizes.

    A letter with alternatives, as `V|1`, also accepts the literal size behind the bar.
    """

    shape: tuple[str, ...]
    dtypes: tuple[torch.dtype, ...] = FLOATS


def tensors(transfer: Any) -> dict[str, Tensor]:
    """The tensors of a transfer by name, in the order of its layouts."""
    return {name: getattr(transfer, name) for name in transfer.layouts}


def check_layouts(transfer: Any) -> dict[str, int]:
    """Size of every shape letter; InputError where a tensor does not have its layout."""
    sizes: dict[str, int] = {}
    for name, layout in transfer.layouts.items():
        value = getattr(transfer, name)
        if value.dtype not in layout.dtypes:
            expected = " or ".join(str(dtype).removeprefix("torch.") for dtype in layout.dtypes)
            found = str(value.dtype).removeprefix("torch.")
            raise InputError(f"tensor '{name}' of the transfer is {found}: it must be {expected}")
        wanted = f"[{', '.join(layout.shape)}]"
        if value.ndim != len(layout.shape):
            raise InputError(f"tensor '{name}' of the transfer has shape {list(value.shape)}: it must be {wanted}")
        for size, letters in zip(value.shape, layout.shape, strict=True):
            options = {int(letter) if letter.isdigit() else sizes.get(letter, size) for letter in letters.split("|")}
            if size not in options:
                known = ", ".join(f"{letter} = {count}" for letter, count in sizes.items())
                raise InputError(
                    f"tensor '{name}' of the transfer has shape {list(value.shape)}: it must be {wanted} with {known}"
                )
            if letters.isalpha():
                sizes[letters] = size
    return sizes


def check_finite(transfer: Any) -> None:
    """InputError naming the first tensor that holds NaN or infinity."""
    for name, value in tensors(transfer).items():
        if value.is_floating_point() and not bool(torch.isfinite(value).all()):
            bad = int((~torch.isfinite(value)).sum())
            raise InputError(f"tensor '{name}' of the transfer holds {bad} NaN or infinite values: bake it again")


def check_signal(transfer: Any) -> dict[str, int]:
    """`check_layouts`, and that there are 1 or 3 channels `C` and the square of an order of light coefficients `N`."""
    sizes = check_layouts(transfer)
    if sizes["C"] not in (1, 3):
        raise InputError(f"transfer has {sizes['C']} channels: it must have 1 or 3")
    if round(sizes["N"] ** 0.5) ** 2 != sizes["N"] or sizes["N"] == 0:
        raise InputError(f"transfer has {sizes['N']} coefficients a vertex: it must be the square of the order")
    return sizes
