"""Against SciPy, which evaluates complex harmonics from angles."""

import numpy as np
import pytest

from torchprt import sh

special = pytest.importorskip("scipy.special")


@pytest.mark.parametrize("order", [1, 2, 6, 33])
def test_agrees_with_scipy_away_from_the_poles(order):
    directions, _ = sh.fibonacci(200)
    directions = directions[directions[:, 2].abs() < 0.9]
    x, y, z = directions.T.numpy()
    theta, phi = np.arccos(z), np.arctan2(y, x)
    columns = []
    for l in range(order):
        for m in range(-l, l + 1):
            complex_value = special.sph_harm_y(l, abs(m), theta, phi)
            part = complex_value.imag if m < 0 else complex_value.real
            columns.append(part * (np.sqrt(2) if m else 1))
    # arccos away from the poles loses two or three digits of eps, times the order.
    np.testing.assert_allclose(sh.basis(directions, order).numpy(), np.stack(columns, -1), atol=1e-14 * (2 + order))
