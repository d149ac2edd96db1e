"""How much every coefficient matters: a signal in which plain distances are weighed ones."""

from __future__ import annotations

import torch
from torch import Tensor

from torchprt.errors import InputError

_STEP = 1 << 15


def root_of(importance: Tensor, data: Tensor) -> Tensor:
    """R `[S, S]` float64 with `importance = R R^T`; raises InputError if there is none that can be inverted."""
    width = data.shape[1]
    if importance.shape not in ((width,), (width, width)):
        raise InputError(
            f"importance has shape {tuple(importance.shape)}: pass [{width}] or [{width}, {width}], as a point of data "
            f"has {width} numbers"
        )
    importance = importance.to(data.device).double()
    if not importance.isfinite().all():
        raise InputError("importance holds a number that is not finite: pass finite ones")
    if importance.ndim == 1:
        if not (importance > 0).all():
            raise InputError("importance is not positive everywhere: add a small part of its mean to all of it")
        return importance.sqrt().diag()
    if not torch.allclose(importance, importance.mT, rtol=1e-5, atol=1e-5 * float(importance.abs().max())):
        raise InputError("importance is not symmetric: pass the second moments of what is to be expected")
    root, fault = torch.linalg.cholesky_ex((importance + importance.mT) / 2)
    diagonal = root.diagonal()
    # A smaller pivot is rounding: what is divided by it would be noise.
    if int(fault) or not diagonal.min() > 1e-7 * diagonal.max():
        raise InputError("importance is not positive definite: add a small part of its mean diagonal to the diagonal")
    return root


def weighed(data: Tensor, root: Tensor) -> Tensor:
    """`data @ root`, of the dtype of `data`: its plain squared distances are the weighed ones of `data`."""
    result = torch.empty_like(data)
    for some, out in zip(data.split(_STEP), result.split(_STEP), strict=True):
        out.copy_(some.double() @ root)
    return result
