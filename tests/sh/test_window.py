import math

import pytest
import torch
from scipy.spatial import cKDTree

from torchprt import sh
from torchprt.errors import InputError
from torchprt.sh.window import neighbours

EPS = {torch.float32: 2**-23, torch.float64: 2**-52}


def suns(order, count, dtype=torch.float64):
    """Small lamps over a dim sky: the truncated series rings far below zero."""
    axis, _ = sh.fibonacci(count)
    sun = sh.zonal(sh.disc(0.05, order), axis).unsqueeze(-1) * torch.tensor([100.0, 80.0, 60.0]).double()
    sun[..., 0, :] += 0.05
    return sun.to(dtype)


@pytest.mark.parametrize("make", [sh.hann, sh.lanczos, sh.gauss])
def test_refuses_windows_without_order_or_width(make):
    with pytest.raises(InputError, match="order"):
        make(0)
    for width in (0.0, -1.0, math.nan):
        with pytest.raises(InputError, match="width"):
            make(3, width)


def test_refuses_factors_of_another_order():
    with pytest.raises(InputError, match="order 3"):
        sh.window(torch.zeros(9, 3), torch.ones(4))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_refuses_lights_that_are_not_finite(bad):
    light = torch.ones(9, 3)
    light[4, 1] = bad
    with pytest.raises(InputError, match="finite"):
        sh.least_window(light)


def test_refuses_a_channel_with_a_negative_mean():
    light = torch.ones(9, 3)
    light[0, 2] = -0.1
    with pytest.raises(InputError, match="mean is negative"):
        sh.least_window(light)


@pytest.mark.parametrize("make", [sh.hann, sh.lanczos, sh.gauss])
def test_windows_keep_the_mean_and_fall_from_band_to_band(make):
    factors = make(6)
    assert factors[0] == 1
    assert (factors.diff() < 0).all()
    assert (factors > 0).all()


@pytest.mark.parametrize("make", [sh.hann, sh.lanczos])
def test_windows_end_at_their_width(make):
    assert torch.equal(make(6, 3)[3:], torch.zeros(3, dtype=torch.float64))


@pytest.mark.parametrize("make", [sh.hann, sh.lanczos, sh.gauss])
@pytest.mark.parametrize("width", [math.inf, 1e9])
def test_a_window_of_endless_width_changes_nothing(make, width):
    # (pi l / width)^2 is far below eps.
    torch.testing.assert_close(make(6, width), torch.ones(6, dtype=torch.float64), atol=0, rtol=2 * 2**-52)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("order", [2, 3, 6, 9])
def test_the_least_window_leaves_no_negative_radiance_and_is_no_stronger_than_needed(order, dtype):
    light = suns(order, 3, dtype)
    result, factors = sh.least_window(light)
    elsewhere, _ = sh.gauss_legendre(20 * order)
    values = sh.evaluate(result.double(), elsewhere).flatten(1)
    floor = max(16 * order * EPS[dtype], 1e-9)
    assert (values.amin(1) >= -floor * values.abs().amax(1)).all()
    # Before it was negative, and a window weaker by a hundredth leaves it so.
    strength = factors[:, 1].double().log() * 0.99
    l = torch.arange(order, dtype=torch.float64)
    weaker = torch.exp(strength[:, None] * l * (l + 1) / 2)
    too_low = sh.evaluate(sh.window(light.double(), weaker), elsewhere).flatten(1).amin(1)
    assert (too_low < 0).all()


def test_all_channels_share_the_window_so_colours_keep():
    light = suns(4, 2)
    result, factors = sh.least_window(light)
    assert factors.shape == (2, 4)
    torch.testing.assert_close(result, sh.window(light, factors), atol=0, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_light_without_negative_radiance_comes_back_bit_for_bit(dtype):
    light = torch.zeros(2, 3, 9, 3, dtype=dtype)
    light[..., 0, :] = 1
    light[1, :, 2] = 0.3
    light[0, 0] = 0
    result, factors = sh.least_window(light)
    assert torch.equal(result, light)
    assert torch.equal(factors, torch.ones(2, 3, 3, dtype=dtype))


def test_a_second_window_finds_nothing_to_do():
    once, _ = sh.least_window(suns(5, 2))
    twice, factors = sh.least_window(once)
    assert torch.equal(once, twice)
    assert (factors == 1).all()


def test_lights_of_one_batch_do_not_change_each_other():
    light = torch.stack([suns(4, 1)[0], torch.eye(16, 3, dtype=torch.float64).cumsum(0).clamp(max=0), suns(4, 2)[1]])
    together, _ = sh.least_window(light)
    for one, alone in zip(together, light, strict=True):
        torch.testing.assert_close(one, sh.least_window(alone)[0], atol=1e-12, rtol=0)


@pytest.mark.parametrize("order", [1, 3])
def test_a_light_without_mean_loses_everything_else(order):
    light = torch.zeros(order * order, 1, dtype=torch.float64)
    light[1:] = 1
    result, factors = sh.least_window(light)
    assert torch.equal(result, torch.zeros_like(light))
    assert factors[0] == 1


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_window_does_not_depend_on_the_brightness(scale):
    _, factors = sh.least_window(suns(4, 1))
    _, scaled = sh.least_window(suns(4, 1) * scale)
    torch.testing.assert_close(factors, scaled, atol=1e-8, rtol=0)


def test_takes_no_lights():
    result, factors = sh.least_window(torch.zeros(0, 9, 3))
    assert result.shape == (0, 9, 3)
    assert factors.shape == (0, 3)


def test_refuses_a_kernel_of_another_order():
    with pytest.raises(InputError, match="order 3"):
        sh.least_window(torch.ones(9, 3), torch.ones(4))


@pytest.mark.parametrize("order", [3, 6])
def test_with_a_kernel_what_it_gathers_is_nowhere_negative_and_the_window_is_weaker(order):
    light, cosine = suns(order, 2), sh.clamped_cosine(order)
    result, factors = sh.least_window(light, cosine)
    elsewhere, _ = sh.gauss_legendre(20 * order)
    irradiance = sh.evaluate(sh.convolve(result, cosine), elsewhere).flatten(1)
    assert (irradiance.amin(1) >= -1e-9 * irradiance.amax(1)).all()
    assert (factors[:, 1:] > sh.least_window(light)[1][:, 1:]).all()
    torch.testing.assert_close(result, sh.window(light, factors), atol=0, rtol=0)


@pytest.mark.parametrize("order", [1, 2, 5, 6, 7])
def test_the_directions_around_each_are_those_that_a_tree_finds(order):
    directions, _ = sh.fibonacci(64 * order**2)
    _, nearest = cKDTree(directions.numpy()).query(directions.numpy(), k=9)
    assert (nearest[:, 0] == range(len(directions))).all()
    assert torch.equal(neighbours(directions), torch.from_numpy(nearest[:, 1:]))
