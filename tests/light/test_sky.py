"""Is the clear sky the published one, and is its sun as bright as the real one?"""

import math

import numpy as np
import pytest
import torch

from torchprt import light, sh
from torchprt.errors import InputError
from torchprt.light.sun import HALF_ANGLE, _tables

LUMINANCE = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)


def sun_at(elevation, azimuth=0.4):
    e = math.radians(elevation)
    spot = [math.cos(e) * math.sin(azimuth), math.sin(e), -math.cos(e) * math.cos(azimuth)]
    return torch.tensor(spot, dtype=torch.float64)


def published_luminance(theta, theta_sun, azimuth, turbidity):
    """Preetham 1999, section 3 and appendix A.2, for one direction, with plain numbers; 1000 cd / m^2."""
    t = turbidity
    a, b, c = 0.17872 * t - 1.46303, -0.35540 * t + 0.42749, -0.02266 * t + 5.32505
    d, e = 0.12064 * t - 2.57705, -0.06696 * t + 0.37027

    def perez(theta, gamma):
        return (1 + a * math.exp(b / math.cos(theta))) * (1 + c * math.exp(d * gamma) + e * math.cos(gamma) ** 2)

    cosine = math.sin(theta) * math.sin(theta_sun) * math.cos(azimuth) + math.cos(theta) * math.cos(theta_sun)
    chi = (4 / 9 - t / 120) * (math.pi - 2 * theta_sun)
    zenith = (4.0453 * t - 4.9710) * math.tan(chi) - 0.2155 * t + 2.4192
    return zenith * perez(theta, math.acos(cosine)) / perez(0.0, theta_sun)


# Misuse first.


@pytest.mark.parametrize("turbidity", [1.0, 1.9, 11.0, float("nan")])
def test_refuses_a_turbidity_outside_the_model(turbidity):
    with pytest.raises(InputError, match="turbidity must be from 2 to 10"):
        light.clear_sky(sun_at(30), turbidity, 3)


def test_refuses_a_sun_that_has_set_and_no_direction():
    for spot in [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0)]:
        with pytest.raises(InputError, match="above the horizon"):
            light.clear_sky(spot, 3.0, 3)
    with pytest.raises(InputError, match="sun_direction"):
        light.clear_sky((0.0, 0.0, 0.0), 3.0, 3)
    with pytest.raises(InputError, match="up"):
        light.clear_sky((0.0, 1.0, 0.0), 3.0, 3, up=(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="one direction"):
        light.clear_sky((0.0, 1.0, 0.0), 3.0, 3, up=torch.ones(1, 3))


# The sky.


@pytest.mark.parametrize("turbidity", [2.0, 3.5, 6.0, 10.0])
@pytest.mark.parametrize("elevation", [2.0, 30.0, 75.0])
def test_the_luminance_is_that_of_the_published_formula(turbidity, elevation):
    theta_sun = math.radians(90 - elevation)
    for theta, azimuth in [(0.0, 0.0), (0.3, 1.0), (1.2, 0.1), (1.5, 3.0), (1.55, -2.0)]:
        # Azimuth of sun_at grows from -z toward +x.
        direction = sun_at(90 - math.degrees(theta), 0.4 + azimuth)[None]
        sky = light.clear_sky_radiance(direction, sun_at(elevation), turbidity)
        wanted = published_luminance(theta, theta_sun, azimuth, turbidity)
        # The luminance row of sRGB is written with four digits.
        assert abs(float(sky[0] @ LUMINANCE) / wanted - 1) < 1e-3


def test_a_clear_sky_is_blue_brighter_about_the_sun_and_black_below():
    directions = sh.latlong_directions(64, 128)
    sky = light.clear_sky_radiance(directions.reshape(-1, 3), sun_at(40, 0.0), 2.5).reshape(64, 128, 3)
    red, _, blue = sky[:32].unbind(-1)
    assert (sky[:32] > 0).all()
    assert (sky[32:] == 0).all()
    # Away from the sun (its back is the left quarter) and from the horizon.
    assert (blue > 1.5 * red)[:24, :32].all()
    brightest = (sky @ LUMINANCE).argmax()
    assert directions.reshape(-1, 3)[brightest] @ sun_at(40, 0.0) > math.cos(0.05)
    # Ninety degrees from the sun the sky is darkest.
    assert float(sky[8, 0] @ LUMINANCE) < 0.3 * float((sky @ LUMINANCE).max())


@pytest.mark.parametrize("elevation", [1.0, 5.0, 45.0, 90.0])
@pytest.mark.parametrize("turbidity", [2.0, 10.0])
def test_the_sky_stays_within_the_gamut(elevation, turbidity):
    upper = sh.latlong_directions(64, 128)[:32].reshape(-1, 3)
    assert (light.clear_sky_radiance(upper, sun_at(elevation), turbidity) > 0).all()


@pytest.mark.parametrize("order", [1, 6, 32])
@pytest.mark.parametrize("elevation", [2.0, 50.0, 90.0])
def test_coefficients_are_those_of_a_fine_picture_of_the_sky(order, elevation):
    height = 512
    picture = light.clear_sky_radiance(
        sh.latlong_directions(height, 2 * height)[: height // 2].reshape(-1, 3), sun_at(elevation), 3.0
    )
    picture = torch.cat([picture.reshape(height // 2, 2 * height, 3), torch.zeros(height // 2, 2 * height, 3)])
    wanted = sh.project_latlong(picture, order)
    sky = light.clear_sky(sun_at(elevation), 3.0, order, sun=False, ground_albedo=0.0)
    # Both rules err near the cusp at the sun: 2e-4 is stated for the sky, and the picture has (pi / 512)^2 order.
    assert (sky - wanted).norm() / wanted.norm() < 2e-4 + order * (math.pi / height) ** 2


def test_the_ground_returns_its_albedo_of_what_falls_on_it():
    spot, up = sun_at(50), torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    for sun in (False, True):
        black = light.clear_sky(spot, 3.0, 32, sun=sun, ground_albedo=0.0)
        white = light.clear_sky(spot, 3.0, 32, sun=sun, ground_albedo=(1.0, 0.5, 0.0))
        # The reading of a surface facing up is irradiance / pi, here through order 32.
        falls = (sh.convolve(black, sh.clamped_cosine(32)).mT @ sh.basis(up, 32)) / math.pi
        ground = (white - black)[0] / math.sqrt(math.pi)
        assert torch.allclose(ground, falls * torch.tensor([1.0, 0.5, 0.0]), rtol=2e-3, atol=1e-9)


def test_up_may_be_any_axis():
    turn = sh.yaw_pitch_roll(torch.tensor([20.0, 70.0, -40.0], dtype=torch.float64))
    upright = light.clear_sky(sun_at(35), 4.0, 5)
    leaning = light.clear_sky(turn @ sun_at(35), 4.0, 5, up=turn @ torch.tensor([0.0, 1.0, 0.0]).double())
    difference = (sh.rotate(upright, turn) - leaning).norm() / upright.norm()
    assert difference < 2e-4


# The sun.


def test_the_colour_matching_functions_are_near_the_observer_of_1931():
    wavelength, _, matching = _tables(torch.device("cpu"))
    solar = matching.sum(0)
    # Colour of the sun outside the atmosphere: x = .32, y = .33, and 1.9 to 2.0e9 cd / m^2.
    assert abs(float(solar[0] / solar.sum()) - 0.322) < 0.01
    assert abs(float(solar[1] / solar.sum()) - 0.332) < 0.01
    assert 1.85e6 < float(solar[1]) < 2.05e6
    assert wavelength[0] == 0.38


def test_the_sun_gives_a_hundred_kilolux_and_reddens_as_it_sinks():
    angles = torch.deg2rad(torch.tensor([0.0, 45.0, 70.0, 85.0, 89.0], dtype=torch.float64))
    suns = light.sun_radiance(angles, 2.5)
    illuminance = suns @ LUMINANCE * math.pi * math.sin(HALF_ANGLE) ** 2
    assert 90 < illuminance[0] < 110
    assert (illuminance.diff() < 0).all()
    ratio = suns[:, 0] / suns[:, 2].clamp(min=1e-9)
    assert (ratio.diff() > 0).all()
    assert (suns >= 0).all()
    hazy = light.sun_radiance(angles, 6.0)
    assert (hazy @ LUMINANCE < suns @ LUMINANCE).all()


def test_what_is_left_out_of_the_spectrum_of_the_sun_does_not_matter():
    """Water vapour and mixed gases of Preetham's table 2, put back."""
    wavelength, _, matching = _tables(torch.device("cpu"))
    water = torch.zeros_like(wavelength)
    gases = torch.zeros_like(wavelength)
    for nm, value in {690: 0.016, 700: 0.024, 710: 0.0125, 720: 1.0, 730: 0.87, 740: 0.061, 750: 0.001}.items():
        water[(nm - 380) // 10] = value
    for mass in (1.0, 10.0):
        depth = 0.2385 * water * 2 * mass / (1 + 20.07 * water * 2 * mass) ** 0.45
        depth += 1.41 * gases * mass / (1 + 118.93 * gases * mass) ** 0.45
        with_them, without = torch.exp(-depth) @ matching, matching.sum(0)
        assert ((with_them - without).abs() / without).max() < 1e-3


def test_the_sun_adds_a_disc_of_its_radiance():
    spot = sun_at(50)
    difference = light.clear_sky(spot, 3.0, 8, ground_albedo=0.0) - light.clear_sky(
        spot, 3.0, 8, ground_albedo=0.0, sun=False
    )
    beam = light.sun_radiance(torch.tensor(math.radians(40), dtype=torch.float64), 3.0)
    assert torch.allclose(difference, light.disc(spot, math.radians(0.2665), beam, 8), rtol=1e-9, atol=1e-9)


# Batches and gradients.


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_batches_of_suns_and_hazes_broadcast(dtype):
    suns = torch.stack([sun_at(10), sun_at(50), sun_at(90)]).to(dtype)
    haze = torch.tensor([[2.0], [5.0]], dtype=dtype)
    lights = light.clear_sky(suns, haze, 4, ground_albedo=torch.rand(3, dtype=dtype))
    assert lights.shape == (2, 3, 16, 3)
    assert lights.dtype == dtype
    exact = light.clear_sky(suns[1].double(), 5.0, 4, ground_albedo=0.0)
    single = light.clear_sky(suns, haze, 4, ground_albedo=0.0)[1, 1].double()
    # Sums over 8192 nodes, pairwise.
    assert (single - exact).norm() / exact.norm() < 100 * torch.finfo(dtype).eps


def test_gradients_flow_to_the_sun_and_the_haze_also_at_the_zenith():
    spot = sun_at(30).requires_grad_()
    haze = torch.tensor(3.0, dtype=torch.float64, requires_grad=True)
    albedo = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64, requires_grad=True)

    def scaled(s, t, a):
        return light.clear_sky(s, t, 3, ground_albedo=a) / 1e3

    assert torch.autograd.gradcheck(scaled, (spot, haze, albedo), rtol=1e-4)
    zenith = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(light.clear_sky(zenith, 3.0, 3).sum(), zenith)
    assert gradient.isfinite().all()
    assert np.isfinite(float(gradient.norm()))
