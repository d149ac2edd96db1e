"""Is a light times a turned vector what turning the vector and multiplying gives?"""

import pytest
import torch

from torchprt import sh
from torchprt.sh.turned_product import TurnedProduct, euler_turns


def values(*shape, dtype=torch.float64, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


def rotations(count, dtype=torch.float64):
    """Random ones behind the identity and half turns about each axis."""
    still = torch.tensor([[0.0, 0, 0], [180, 0, 0], [0, 180, 0], [0, 0, 180]], dtype=torch.float64)
    return sh.yaw_pitch_roll(torch.cat([still, 360 * values(count, 3)])).to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("batch", [(), (2,), (3, 2), (0,)])
@pytest.mark.parametrize("order", [1, 2, 3, 5, 11, 14, 32])
def test_agrees_with_turning_the_vectors(order, batch, dtype):
    turns = rotations(6, dtype)
    light, vectors = values(*batch, order**2, 3, dtype=dtype), values(order**2, len(turns), dtype=dtype, seed=1)
    turned = sh.rotate(vectors.T.unsqueeze(-1), turns)[..., 0]
    found = TurnedProduct(light)(vectors, euler_turns(turns.permute(1, 2, 0).contiguous()))
    assert found.dtype == dtype
    # A sum of N products of numbers about 1, turned by three turns that each add a few rounding errors times the order.
    tolerance = 16 * torch.finfo(dtype).eps * order * order
    torch.testing.assert_close(found, light.mT @ turned.T, rtol=0, atol=tolerance)


def test_there_may_be_no_vector():
    found = TurnedProduct(values(2, 9, 3))(values(9, 0), euler_turns(values(3, 3, 0)))
    assert found.shape == (2, 3, 0)
