"""Against mpmath with 50 digits: the accuracy that the documentation promises, poles included."""

import pytest
import torch
from numerics import exact

from torchprt import sh


@pytest.mark.parametrize(("order", "double", "single"), [(6, 1.2e-14, 6e-7), (33, 6.6e-14, 1.4e-5), (65, 3e-13, 1e-4)])
def test_keeps_the_promised_accuracy(order, double, single):
    directions = torch.tensor(
        [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1e-9, 0, 1], [1e-4, -2e-4, -1], [3, -4, 12], [-5, 2, 0.3]],
        dtype=torch.float64,
    )
    directions = torch.nn.functional.normalize(directions, dim=-1)
    for dtype, bound in ((torch.float64, double), (torch.float32, single)):
        rounded = directions.to(dtype)
        reference = [exact.basis_row(d, order) for d in rounded.tolist()]
        ours = sh.basis(rounded, order).tolist()
        worst = max(
            abs(a - b) for row, true in zip(ours, reference, strict=True) for a, b in zip(row, true, strict=True)
        )
        assert worst < bound
