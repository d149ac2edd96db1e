"""Against mpmath with 50 digits: the accuracy that the documentation promises, poles included."""

import pytest
import torch

from torchprt import sh

mpmath = pytest.importorskip("mpmath")


def exact(direction, order):
    """Q_l^m(z) Re or Im (x + iy)^m from the textbook recurrence of P_l^m, for the very numbers given, 50 digits."""
    with mpmath.workdps(50):
        x, y, z = (mpmath.mpf(value) for value in direction)
        values = {}
        power = mpmath.mpc(1)
        for m in range(order):
            # P_m^m / sin^m, then upward in l: (l - m) P_l = (2l - 1) z P_(l-1) - (l + m - 1) P_(l-2).
            last, p = mpmath.mpf(0), (-1) ** m * mpmath.fac2(2 * m - 1)
            for l in range(m, order):
                if l > m:
                    last, p = p, ((2 * l - 1) * z * p - (l + m - 1) * last) / (l - m)
                scale = mpmath.sqrt((2 * l + 1) / (4 * mpmath.pi) * mpmath.factorial(l - m) / mpmath.factorial(l + m))
                scale *= mpmath.sqrt(2) if m else 1
                values[l, m], values[l, -m] = scale * p * power.real, scale * p * (power.imag if m else power.real)
            power *= mpmath.mpc(x, y)
        return [values[l, m] for l in range(order) for m in range(-l, l + 1)]


@pytest.mark.parametrize(("order", "double", "single"), [(6, 1.2e-14, 6e-7), (33, 6.6e-14, 1.4e-5), (65, 3e-13, 1e-4)])
def test_keeps_the_promised_accuracy(order, double, single):
    directions = torch.tensor(
        [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1e-9, 0, 1], [1e-4, -2e-4, -1], [3, -4, 12], [-5, 2, 0.3]],
        dtype=torch.float64,
    )
    directions = torch.nn.functional.normalize(directions, dim=-1)
    for dtype, bound in ((torch.float64, double), (torch.float32, single)):
        rounded = directions.to(dtype)
        reference = [exact(d, order) for d in rounded.tolist()]
        ours = sh.basis(rounded, order).tolist()
        worst = max(
            abs(a - b) for row, true in zip(ours, reference, strict=True) for a, b in zip(row, true, strict=True)
        )
        assert worst < bound
