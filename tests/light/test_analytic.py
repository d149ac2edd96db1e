"""Do lights with a formula have the energy, the place and the shape that they promise?"""

import math

import mpmath
import numpy as np
import pytest
import torch

from torchprt import light, sh
from torchprt.errors import InputError

EPS = torch.finfo(torch.float64).eps
UP = torch.tensor([0.36, 0.48, 0.8], dtype=torch.float64)


def reading(coefficients, normal):
    """Exit radiance of a white unshadowed surface, by A_l written out: pi, 2 pi / 3, and Ramamoorthi's eq. 8."""
    order = math.isqrt(coefficients.shape[-2])
    factors = []
    for l in range(order):
        if l == 1:
            a = 2 * math.pi / 3
        elif l % 2:
            a = 0.0
        else:
            a = 2 * math.pi * (-1) ** (l // 2 - 1) / ((l + 2) * (l - 1)) * math.comb(l, l // 2) / 2**l
        factors += [a / math.pi] * (2 * l + 1)
    cosine = torch.tensor(factors, dtype=coefficients.dtype) * sh.basis(normal.to(coefficients), order)
    return (cosine[:, None] * coefficients).sum(-2)


def by_quadrature(function, order, edge=None, degree=200):
    """Coefficients of a function of the angle to UP, by Gauss-Legendre on either side of an edge at cos = edge."""
    wanted = torch.zeros(order * order, dtype=torch.float64)
    for low, high in [(-1.0, 1.0)] if edge is None else [(-1.0, edge), (edge, 1.0)]:
        points, weights = map(torch.tensor, legendre_rule(degree))
        z = (high - low) / 2 * points + (high + low) / 2
        for l in range(order):
            legendre = torch.special.legendre_polynomial_p(z, l)
            band = 2 * math.pi * (high - low) / 2 * (weights * function(z) * legendre).sum()
            wanted[l * l : (l + 1) ** 2] += band * sh.basis(UP, order)[l * l : (l + 1) ** 2]
    return wanted


def legendre_rule(degree):
    return np.polynomial.legendre.leggauss(degree)


# Misuse first.


@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (float("nan"), 0.0, 1.0), (float("inf"), 0.0, 0.0)])
def test_refuses_a_direction_that_is_none(direction):
    for call in [
        lambda: light.directional(direction, order=3),
        lambda: light.disc(direction, 0.1, 1.0, 3),
        lambda: light.hemisphere(direction, 1.0, 0.0, 3),
        lambda: light.overcast_sky(1.0, direction, 3),
        lambda: light.sphere(direction, 0.1, 1.0, 3),
    ]:
        with pytest.raises(InputError, match="must be finite and not zero"):
            call()


def test_refuses_shapes_that_are_no_direction_or_colour():
    with pytest.raises(InputError, match="three components"):
        light.directional((1.0, 0.0), order=3)
    with pytest.raises(InputError, match="one number or three"):
        light.constant((1.0, 2.0), 3)
    with pytest.raises(InputError, match="colour of the light must be finite"):
        light.constant((1.0, float("nan"), 2.0), 3)
    with pytest.raises(InputError, match="order"):
        light.constant(1.0, 0)


@pytest.mark.parametrize("angle", [0.0, -1.0, 3.2, float("nan")])
def test_refuses_a_disc_without_or_with_too_much_angle(angle):
    with pytest.raises(InputError, match="half_angle"):
        light.disc((0.0, 0.0, 1.0), angle, 1.0, 3)
    with pytest.raises(InputError, match="half_angle"):
        light.disc((0.0, 0.0, 1.0), torch.tensor([0.1, angle]), 1.0, 3)


@pytest.mark.parametrize("radius", [0.0, -1.0, 2.0, 3.0, float("nan")])
def test_refuses_a_sphere_around_the_origin_or_without_size(radius):
    with pytest.raises(InputError, match="radius"):
        light.sphere((0.0, 0.0, 2.0), radius, 1.0, 3)


# Directional.


@pytest.mark.parametrize(
    ("order", "factor"),
    [(1, 4.0), (2, 4 / 3), (3, 16 / 17), (4, 16 / 17), (5, 32 / 31), (6, 32 / 31)],
)
def test_directional_has_the_factor_of_d3dx(order, factor):
    # CosWtInt of DirectXMath: 1/4 + 1/2 + 5/16 - 3/32, as far as the order goes.
    wanted = math.pi * factor * sh.basis(UP, order)[:, None].expand(-1, 3)
    assert torch.allclose(light.directional(UP, order=order), wanted, rtol=8 * EPS, atol=0)


@pytest.mark.parametrize("order", range(1, 33))
def test_a_facing_white_surface_reads_the_normalised_radiance_at_every_order(order):
    colour = torch.tensor([1.0, 2.0, 0.5], dtype=torch.float64)
    lamps = [light.directional(UP, colour, order=order)]
    lamps += [light.disc(UP, angle, colour, order, normalise=True) for angle in (1e-12, 0.3, 1.5, 3.0, math.pi)]
    for lamp in lamps:
        # A sum of n^2 products.
        assert torch.allclose(reading(lamp, UP), colour, rtol=10 * order * EPS, atol=0)


def test_without_normalisation_the_reading_tends_to_the_radiance():
    readings = [float(reading(light.directional(UP, order=n, normalise=False), UP)[0]) for n in (3, 9, 33)]
    assert abs(readings[0] - 17 / 16) < 20 * EPS
    # The series of the clamped cosine at its peak alternates, with terms that fall as order^-1.5.
    assert abs(readings[1] - 1) < 9**-1.5
    assert abs(readings[2] - 1) < 33**-1.5


# Disc and sphere.


@pytest.mark.parametrize("angle", [0.01, 0.5, math.pi / 2, 2.0, 3.1])
def test_a_disc_is_the_projection_of_its_indicator(angle):
    wanted = by_quadrature(lambda z: (z > math.cos(angle)).double(), 8, edge=math.cos(angle))
    wanted = wanted[:, None] * torch.tensor([1.0, 2.0, 3.0])
    # A sum over 200 nodes, on an interval whose end 1 - cos(angle) is rounded like 1.
    bound = 200 * EPS * wanted.abs().max() + 3 * 2 * math.pi * EPS
    assert (light.disc(UP, angle, (1.0, 2.0, 3.0), 8) - wanted).abs().max() < bound


@pytest.mark.parametrize("angle", [1e-12, 1e-6, 1e-3])
def test_a_small_disc_keeps_its_digits(angle):
    with mpmath.workdps(50):
        solid_angle = float(2 * mpmath.pi * (1 - mpmath.cos(mpmath.mpf(angle))))
        edge = mpmath.cos(mpmath.mpf(angle))
        band = [
            float(2 * mpmath.pi * (mpmath.legendre(l - 1, edge) - mpmath.legendre(l + 1, edge)) / (2 * l + 1))
            for l in range(1, 6)
        ]
    lamp = light.disc(UP, angle, 1.0, 6)[:, 0]
    for l, wanted in enumerate([solid_angle, *band]):
        rows = slice(l * l, (l + 1) ** 2)
        assert torch.allclose(lamp[rows], wanted * sh.basis(UP, 6)[rows], rtol=100 * EPS, atol=100 * EPS * wanted)


def test_a_small_normalised_disc_tends_to_a_directional_light():
    wanted = light.directional(UP, order=6)
    for angle in (1e-30, 1e-12, 1e-4):
        difference = (light.disc(UP, angle, 1.0, 6, normalise=True) - wanted).abs().max()
        # The band l of a disc falls short by l (l + 1) angle^2 / 8.
        assert difference < 30 * angle**2 / 8 * 10 + 20 * EPS


@pytest.mark.parametrize("distance", [1.0001, 2.0, 1e3, 1e15, 1e-15])
def test_a_sphere_reads_radiance_by_the_square_of_its_distance(distance):
    ratio = 0.5
    lamp = light.sphere(UP * distance, ratio * distance, 4.0, 32)
    # sin^2 of the half angle; truncated at order 32 the clamped cosine errs by less than 1 / 32^2.
    assert torch.allclose(reading(lamp, UP), torch.tensor(4 * ratio**2).double(), rtol=1 / 32**2)
    assert torch.allclose(lamp, light.disc(UP, math.asin(ratio), 4.0, 32), rtol=1e-12, atol=100 * EPS)


# Hemisphere, constant, overcast.


@pytest.mark.parametrize("order", [1, 2, 3, 8, 32])
def test_a_constant_light_reads_its_radiance_on_every_surface(order):
    colour = torch.tensor([1.0, 0.25, 3.0], dtype=torch.float64)
    for normal in sh.fibonacci(10)[0]:
        assert torch.allclose(reading(light.constant(colour, order), normal), colour, rtol=4 * EPS, atol=0)
    same = light.hemisphere(UP, colour, colour, order)
    assert (same - light.constant(colour, order)).abs().max() < 20 * EPS


def test_a_hemisphere_is_linear_in_height_and_reads_as_stated():
    lamp = light.hemisphere(UP, (1.0, 0.0, 2.0), (0.0, 1.0, 2.0), 5)
    wanted = by_quadrature(lambda z: (1 + z) / 2, 5)
    assert (lamp[:, 0] - wanted).abs().max() < 100 * EPS
    assert torch.allclose(reading(lamp, UP), torch.tensor([5 / 6, 1 / 6, 2.0], dtype=torch.float64), rtol=10 * EPS)
    for order in (1, 2, 5):
        normalised = light.hemisphere(UP, 1.0, 0.0, order, normalise=True)
        assert torch.allclose(reading(normalised, UP), torch.ones(3).double(), rtol=10 * EPS)


@pytest.mark.parametrize("order", [1, 2, 3, 8, 32])
def test_an_overcast_sky_is_the_cie_formula_over_its_ground(order):
    albedo = 0.3

    def radiance(z):
        return torch.where(z > 0, 7.0 * (1 + 2 * z) / 3, albedo * 7 / 9 * 7.0)

    lamp = light.overcast_sky(7.0, UP, order, ground_albedo=albedo)
    wanted = by_quadrature(radiance, order, edge=0.0)
    assert (lamp - wanted[:, None]).abs().max() < 7 * 400 * EPS


def test_the_ground_under_an_overcast_sky_receives_seven_ninths_pi():
    # The reading of a surface that faces up is E / pi; a black ground, so that nothing comes from below.
    lamp = light.overcast_sky(1.0, UP, 32, ground_albedo=0.0)
    assert torch.allclose(reading(lamp, UP), torch.tensor(7 / 9).double(), rtol=1 / 32**2)


# Everywhere.


def every_light(direction, order, dtype=None):
    return [
        light.directional(direction, order=order),
        light.disc(direction, 0.2, 1.0, order),
        light.disc(direction, 0.2, 1.0, order, normalise=True),
        light.sphere(direction, 0.3, 1.0, order),
        light.hemisphere(direction, 1.0, (0.1, 0.2, 0.3), order),
        light.overcast_sky(1.0, direction, order),
    ]


@pytest.mark.parametrize("order", [1, 2, 6, 32])
def test_a_turned_light_is_the_light_of_a_turned_direction(order):
    rotation = sh.yaw_pitch_roll(torch.tensor([31.0, -50.0, 12.0], dtype=torch.float64))
    for one, other in zip(every_light(UP, order), every_light(rotation @ UP, order), strict=True):
        # The band 31 of a basis function near its peak is of the order of 2 and its slope 31 times that.
        assert (sh.rotate(one, rotation) - other).abs().max() < 100 * order * EPS * max(1, float(one.abs().max()))


def test_batches_of_directions_and_colours_broadcast():
    directions = torch.randn(4, 1, 3, dtype=torch.float64)
    colours = torch.rand(5, 3, dtype=torch.float64)
    lamps = light.directional(directions, colours, order=3)
    assert lamps.shape == (4, 5, 9, 3)
    assert torch.equal(lamps[2, 3], light.directional(directions[2, 0], colours[3], order=3))
    discs = light.disc(directions, torch.tensor([0.1, 0.2, 0.3, 0.4, 0.5]), colours, 3)
    assert discs.shape == (4, 5, 9, 3)
    # A float32 angle is the double of that name only to float32.
    assert torch.allclose(discs[1, 2], light.disc(directions[1, 0], 0.3, colours[2], 3), rtol=1e-6)
    spheres = light.sphere(3 * directions / directions.norm(dim=-1, keepdim=True), 1.0, colours, 3)
    assert spheres.shape == (4, 5, 9, 3)
    assert light.hemisphere(directions, colours, 0.0, 3).shape == (4, 5, 9, 3)
    assert light.overcast_sky(colours, directions, 3).shape == (4, 5, 9, 3)
    assert light.constant(colours, 3).shape == (5, 9, 3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_dtype_is_that_of_the_tensors(dtype):
    direction = UP.to(dtype)
    for lamp in every_light(direction, 4):
        assert lamp.dtype == dtype
        assert lamp.shape == (16, 3)
    for one, other in zip(every_light(direction, 32), every_light(UP, 32), strict=True):
        error = (one - other).abs().max() / other.abs().max()
        # The direction itself is rounded, and band 31 turns that into 31 times as much.
        assert error < 100 * torch.finfo(dtype).eps
    assert light.constant(torch.ones(3, dtype=dtype), 2).dtype == dtype
    assert light.directional((0, 0, 1), 2, order=2).dtype == torch.float32


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_extreme_radiance_and_extreme_lengths_of_directions(dtype, scale):
    direction = UP.to(dtype)
    eps = torch.finfo(dtype).eps
    plain = light.directional(direction, order=6)
    assert torch.allclose(light.directional(direction, scale, order=6) / scale, plain, rtol=16 * eps)
    assert torch.allclose(light.directional(direction * scale, order=6), plain, rtol=16 * eps, atol=16 * eps)
    tiny = light.disc(direction, 1e-15, scale, 6)
    assert tiny.isfinite().all()
    if scale > 1:
        # pi 1e-30 sr of it: small enough that products in float32 would have lost it on the way.
        wanted = math.pi * sh.basis(direction, 6)[:, None].expand(-1, 3)
        assert torch.allclose(tiny, wanted, rtol=16 * eps, atol=16 * eps)
    lamp = light.sphere(direction * scale, scale / 2, 1.0, 6)
    assert torch.allclose(lamp, light.sphere(direction, 0.5, 1.0, 6), rtol=1e-4, atol=1e-5 if eps > 1e-10 else 1e-12)


def test_gradients_flow_to_directions_angles_and_colours():
    direction = torch.tensor([0.2, 2.0, -1.0], dtype=torch.float64, requires_grad=True)
    colour = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64, requires_grad=True)
    angle = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)
    check = torch.autograd.gradcheck
    assert check(lambda d, c: light.directional(d, c, order=4), (direction, colour))
    assert check(lambda d, a, c: light.disc(d, a, c, 4), (direction, angle, colour))
    assert check(lambda d, a, c: light.disc(d, a, c, 4, normalise=True), (direction, angle, colour))
    assert check(lambda d, a, c: light.sphere(d, a, c, 4), (direction, angle, colour))
    assert check(lambda d, c: light.hemisphere(d, c, 0.5 * c, 4), (direction, colour))
    assert check(lambda d, c: light.overcast_sky(c, d, 4), (direction, colour))
    pole = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(light.disc(pole, 0.1, 1.0, 5).square().sum() + pole.sum(), pole)
    assert gradient.isfinite().all()
