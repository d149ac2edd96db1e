"""Identities of spherical-harmonic algebra."""

import math

import pytest
import torch

from torchprt import sh

EPS = {torch.float32: 2**-23, torch.float64: 2**-52}
ORDERS = [1, 2, 3, 6, 24]


def lights(*shape, dtype=torch.float64, seed=0):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)).to(dtype)


def turns(count, dtype=torch.float64, seed=1):
    quaternion = torch.nn.functional.normalize(lights(count, 4, seed=seed), dim=-1)
    w, v = quaternion[:, :1, None], quaternion[:, 1:]
    cross = torch.linalg.cross(torch.eye(3, dtype=torch.float64).expand(count, 3, 3), v.unsqueeze(1))
    outer = v.unsqueeze(-1) * v.unsqueeze(-2)
    return ((2 * w * w - 1) * torch.eye(3).double() + 2 * outer - 2 * w * cross).to(dtype)


@pytest.fixture(params=["values", "gradients"])
def rotate(request):
    """`sh.rotate` on both its ways: by Euler turns, and by quadrature because a gradient is recorded."""
    if request.param == "values":
        return sh.rotate
    return lambda light, rotation: sh.rotate(light, rotation.clone().requires_grad_()).detach()


@pytest.mark.parametrize("order", ORDERS)
def test_basis_functions_are_orthonormal(order):
    directions, weights = sh.gauss_legendre(2 * (order - 1))
    table = sh.basis(directions, order)
    gram = table.mT @ (table * weights[:, None])
    torch.testing.assert_close(gram, torch.eye(order**2).double(), atol=8 * order * EPS[torch.float64], rtol=0)


@pytest.mark.parametrize("order", ORDERS)
def test_addition_theorem(order):
    directions, _ = sh.fibonacci(64)
    squared = sh.basis(directions, order).square()
    sums = torch.stack([squared[:, l * l : (l + 1) ** 2].sum(-1) for l in range(order)], -1)
    expected = (2 * torch.arange(order, dtype=torch.float64) + 1) / (4 * math.pi)
    torch.testing.assert_close(sums, expected.expand_as(sums), atol=0, rtol=8 * order * EPS[torch.float64])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("order", ORDERS)
def test_turning_twice_is_turning_once_by_the_product(order, dtype, rotate):
    a, b, light = turns(4, dtype), turns(4, dtype, seed=2), lights(4, order**2, 3, dtype=dtype)
    twice, once = rotate(rotate(light, a), b), rotate(light, b @ a)
    # The rounded product of rounded rotations moves band l by l eps; coefficients are of order one.
    torch.testing.assert_close(twice, once, atol=16 * order * EPS[dtype], rtol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("order", ORDERS)
def test_matrices_multiply_as_rotations_do_and_are_orthogonal(order, dtype):
    a, b = turns(3, dtype), turns(3, dtype, seed=2)
    first, second, both = (sh.rotation_matrix(r, order) for r in (a, b, a @ b))
    tolerance = 8 * order * EPS[dtype]
    torch.testing.assert_close(first @ second, both, atol=tolerance, rtol=0)
    torch.testing.assert_close(first.mT, sh.rotation_matrix(a.mT, order), atol=tolerance, rtol=0)
    torch.testing.assert_close(
        first @ first.mT, torch.eye(order**2, dtype=dtype).expand_as(first), atol=tolerance, rtol=0
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("order", ORDERS)
def test_the_identity_turns_nothing_and_two_half_turns_neither(order, dtype, rotate):
    light = lights(order**2, 3, dtype=dtype)
    tolerance = 8 * order * EPS[dtype]
    torch.testing.assert_close(rotate(light, torch.eye(3, dtype=dtype)), light, atol=tolerance, rtol=0)
    for axis in range(3):
        half = torch.diag(2 * torch.eye(3, dtype=dtype)[axis] - 1)
        torch.testing.assert_close(rotate(rotate(light, half), half), light, atol=2 * tolerance, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
def test_the_norm_of_every_band_is_kept(order, rotate):
    light = lights(5, order**2, 1)
    turned = rotate(light, turns(5))
    for l in range(order):
        band = slice(l * l, (l + 1) ** 2)
        torch.testing.assert_close(
            turned[:, band].norm(dim=1), light[:, band].norm(dim=1), atol=8 * order**1.5 * EPS[torch.float64], rtol=0
        )


@pytest.mark.parametrize("order", ORDERS)
def test_rotating_is_the_product_with_the_matrices(order, rotate):
    light, rotation = lights(4, order**2, 3), turns(4)
    expected = sh.rotation_matrix(rotation, order) @ light
    torch.testing.assert_close(rotate(light, rotation), expected, atol=16 * order * EPS[torch.float64], rtol=0)


@pytest.mark.parametrize("order", [1, 3, 6, 12])
def test_rotating_is_projecting_the_turned_function(order, rotate):
    light, rotation = lights(order**2, 2), turns(1)[0]
    turned = sh.project_function(lambda s: sh.evaluate(light, s @ rotation), order)
    torch.testing.assert_close(rotate(light, rotation), turned, atol=64 * order * EPS[torch.float64], rtol=0)


@pytest.mark.parametrize("order", [1, 3, 6, 12])
def test_the_dot_product_is_the_integral_of_the_product(order):
    a, b = lights(order**2, 1), lights(order**2, 1, seed=4)
    directions, weights = sh.lebedev(2 * (order - 1))
    integral = weights @ (sh.evaluate(a, directions) * sh.evaluate(b, directions))
    torch.testing.assert_close((a * b).sum(0), integral, atol=32 * order**2 * EPS[torch.float64], rtol=0)
    # Parseval: with itself it is the energy.
    energy = weights @ sh.evaluate(a, directions).square()
    torch.testing.assert_close(a.square().sum(0), energy, atol=32 * order**2 * EPS[torch.float64], rtol=0)


@pytest.mark.parametrize(("order_a", "order_b"), [(1, 4), (3, 3), (6, 2)])
def test_products_commute_and_turn_with_their_factors(order_a, order_b):
    a, b = lights(2, order_a**2, 1), lights(2, order_b**2, 1, seed=5)
    product = sh.product(a, b)
    torch.testing.assert_close(product, sh.product(b, a), atol=1e-13, rtol=0)
    rotation = turns(2)
    turned = sh.product(sh.rotate(a, rotation), sh.rotate(b, rotation))
    # The truncated product is whole bands, so it turns with its factors.
    torch.testing.assert_close(turned, sh.rotate(product, rotation), atol=1e-13, rtol=0)


@pytest.mark.parametrize("order", [1, 3, 6])
def test_one_is_the_unit_of_products(order):
    light, one = lights(order**2, 3), torch.full((1, 1), math.sqrt(4 * math.pi), dtype=torch.float64)
    torch.testing.assert_close(sh.product(light, one), light, atol=1e-13, rtol=0)


@pytest.mark.parametrize("order", [1, 3, 6])
def test_convolution_is_the_integral_of_the_turned_kernel(order):
    light, kernel = lights(order**2, 1), torch.linspace(1, -0.3, order, dtype=torch.float64)
    directions, weights = sh.gauss_legendre(2 * order)
    normals, _ = sh.fibonacci(9)
    # Brute force: for every normal n, int f(s) h(n . s) ds.
    kernels = sh.evaluate(sh.zonal(kernel, normals).mT, directions)
    expected = kernels.mT @ (weights[:, None] * sh.evaluate(light, directions))
    ours = sh.evaluate(sh.convolve(light, kernel), normals)
    torch.testing.assert_close(ours, expected, atol=1e-13, rtol=0)


def test_the_irradiance_of_a_lamp_overhead_falls_with_the_cosine():
    lamp = sh.zonal(sh.disc(0.01, 24), torch.tensor([0.0, 0.0, 1.0]).double()).unsqueeze(-1)
    angles = torch.linspace(0, math.pi, 37, dtype=torch.float64)
    normals = torch.stack([torch.sin(angles), torch.zeros_like(angles), torch.cos(angles)], -1)
    irradiance = sh.evaluate(sh.convolve(lamp, sh.clamped_cosine(24)), normals)[:, 0] / (math.pi * 0.01**2)
    # The series ends at band 23: the rest of it is at most the sum of its coefficients, here up to band 999.
    l = torch.arange(1000, dtype=torch.float64)
    rest = (sh.clamped_cosine(1000).abs() * (2 * l + 1) / (4 * math.pi))[24:].sum()
    assert (irradiance - torch.cos(angles).clamp(min=0)).abs().max() < rest


@pytest.mark.parametrize("order", [2, 6])
def test_convolution_and_rotation_commute(order):
    light, rotation, kernel = lights(3, order**2, 3), turns(3), sh.phong(20.0, order)
    one, other = sh.convolve(sh.rotate(light, rotation), kernel), sh.rotate(sh.convolve(light, kernel), rotation)
    torch.testing.assert_close(one, other, atol=1e-14 * order, rtol=0)


def test_a_window_of_ones_is_the_identity_bit_for_bit():
    light = lights(36, 3)
    assert torch.equal(sh.window(light, torch.ones(6, dtype=torch.float64)), light)


def test_zonal_functions_turn_by_turning_their_axis(rotate):
    axis, rotation, kernel = sh.fibonacci(4)[0], turns(4), sh.phong(9.0, 7)
    turned = sh.zonal(kernel, (rotation @ axis.unsqueeze(-1)).squeeze(-1))
    expected = rotate(sh.zonal(kernel, axis).unsqueeze(-1), rotation).squeeze(-1)
    torch.testing.assert_close(turned, expected, atol=1e-14 * 7, rtol=0)
