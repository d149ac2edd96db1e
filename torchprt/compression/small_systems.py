"""Many small symmetric systems at once, as arrays of their elements: `[n, n, ...]`, the batch last."""

from __future__ import annotations

import torch
from torch import Tensor


def cholesky(matrix: Tensor) -> Tensor:
    """The lower factor of matrices `[n, n, *S]`; NaN where one is not positive definite."""
    rest, factor = matrix.clone(), torch.zeros_like(matrix)
    for k in range(len(matrix)):
        column = rest[k:, k] * torch.rsqrt(rest[k, k])
        factor[k:, k] = column
        rest[k + 1 :, k + 1 :] -= column[1:, None] * column[1:]
    return factor


def forward(factor: Tensor, right: Tensor) -> Tensor:
    """x of `factor x = right`, for `factor [n, n, *S]` and `right [n, *T, *S]`."""
    factor = _shaped(factor, right)
    solved: list[Tensor] = []
    for k in range(len(factor)):
        rest = right[k]
        for j, known in enumerate(solved):
            rest = torch.addcmul(rest, factor[k, j], known, value=-1)
        solved.append(rest / factor[k, k])
    return torch.stack(solved)


def backward(factor: Tensor, right: Tensor) -> Tensor:
    """x of `factor^T x = right`, for `factor [n, n, *S]` and `right [n, *T, *S]`."""
    # The transpose, read from its end, is a lower factor too.
    return forward(factor.transpose(0, 1).flip(0, 1), right.flip(0)).flip(0)


def _shaped(factor: Tensor, right: Tensor) -> Tensor:
    batch = factor.shape[2:]
    return factor.reshape(*factor.shape[:2], *[1] * (right.ndim - 1 - len(batch)), *batch)
