"""Against sphericart: real harmonics without the Condon-Shortley sign."""

import warnings

import pytest
import torch

from torchprt import sh

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    sphericart = pytest.importorskip("sphericart.torch")


# sphericart itself loses float32 at high orders (2e-2 at order 20, where ours keeps 4e-6).
@pytest.mark.parametrize(
    ("order", "dtype"),
    [(1, torch.float32), (2, torch.float32), (6, torch.float32), (6, torch.float64), (20, torch.float64)],
)
def test_the_sign_free_light_is_sphericarts(order, dtype):
    directions, _ = sh.fibonacci(100, dtype)
    light = torch.eye(order**2, dtype=dtype)
    theirs = sphericart.SphericalHarmonics(order - 1).compute(directions) @ sh.to_sign_free(light)
    ours = sh.evaluate(light, directions)
    # Both are good to a few eps times the order, of values that grow with the root of the order.
    torch.testing.assert_close(ours, theirs, atol=16 * order * torch.finfo(dtype).eps, rtol=0)
