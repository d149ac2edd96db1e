"""Against e3nn: harmonics with the pole along +y, and rotations through angles."""

import warnings

import pytest
import torch

from torchprt import sh

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    o3 = pytest.importorskip("e3nn.o3")

pytestmark = pytest.mark.filterwarnings("ignore")


def lights(*shape):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("order", [1, 2, 3, 8])
def test_the_converted_light_is_the_same_function(order):
    directions, _ = sh.fibonacci(60)
    light = lights(order**2, 3)
    table = o3.spherical_harmonics(list(range(order)), directions, normalize=False, normalization="integral")
    # 64 products of values of order one.
    torch.testing.assert_close(table @ sh.to_e3nn(light), sh.evaluate(light, directions), atol=2e-13, rtol=0)


@pytest.mark.parametrize("order", [2, 4, 6])
def test_turns_lights_as_e3nn_does(order):
    rotation, light = o3.rand_matrix(5).double(), lights(5, order**2, 2)
    angles = o3.matrix_to_angles(rotation)
    matrix = torch.stack(
        [torch.block_diag(*[o3.wigner_D(l, *(a[i] for a in angles)) for l in range(order)]) for i in range(5)]
    )
    theirs = sh.from_e3nn(matrix @ sh.to_e3nn(light))
    # e3nn draws its rotations in float32 and goes through angles.
    torch.testing.assert_close(sh.rotate(light, rotation), theirs, atol=1e-5, rtol=0)
