"""Lights on disk: `.npy` files of SH coefficients."""

from __future__ import annotations

import os

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import write_array
from torchprt.sh import order_of
from torchprt.suffixes import check_readable


def read_coefficients(path: str | os.PathLike[str], order: int | None = None) -> Float[Tensor, "N 3"]:
    """A light `[N, 3]` from a `.npy` file, float32.

    Raises InputError, naming the file, if it is missing, damaged or not a light: N must be a square number, three
    channels, all finite; and of `order`, if one is given.
    """
    check_readable(path, "give an image or an .npy of light coefficients")
    try:
        with open(path, "rb") as stream:
            values = np.lib.format.read_array(stream, allow_pickle=False)
    except Exception as fault:  # Damaged headers end in exceptions of any kind, MemoryError and TokenError among them.
        raise InputError(f"{path} is not a whole .npy file of numbers: write it with `torchprt light`") from fault
    if values.ndim != 2 or values.shape[1] != 3 or values.dtype.kind not in "fiu":
        raise InputError(
            f"{path} holds {values.dtype} {list(values.shape)}: a light is numbers [order^2, 3], "
            "write it with `torchprt light`"
        )
    try:
        found_order = order_of(len(values))
    except InputError as fault:
        raise InputError(
            f"{path} has {len(values)} coefficients, not the square of an order: write it with `torchprt light`"
        ) from fault
    if order is not None and found_order != order:
        raise InputError(
            f"{path} is a light of order {found_order} but the transfer is of order {order}: "
            f"project the light again with --order {order}"
        )
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(values, dtype=np.float32)
    if not np.isfinite(single).all():
        raise InputError(f"{path} holds NaN or infinite coefficients: project the light again")
    return torch.from_numpy(single)


def write_coefficients(light: Float[Tensor, "N 3"], path: str | os.PathLike[str]) -> None:
    """Writes a light as float32 `.npy`. Raises InputError if `path` cannot be written."""
    write_array(path, light.detach().cpu().to(torch.float32).numpy())
