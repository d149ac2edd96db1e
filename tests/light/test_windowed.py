"""Is a window chosen by its name the one of that name, and one light not that of another?"""

import pytest
import torch

from torchprt import light, sh
from torchprt.errors import InputError


def lamps(*batch, order=5, dtype=torch.float32):
    directions = torch.randn(*batch, 3, generator=torch.Generator().manual_seed(2), dtype=dtype)
    return light.disc(directions, 0.2, 3.0, order) + light.constant(0.02, order).to(dtype)


@pytest.mark.parametrize("call", [light.windowed, light.window_factors])
def test_refuses_a_window_that_is_not_there(call):
    with pytest.raises(InputError, match="window 'x' is unknown: use one of none, hann"):
        call(lamps(), "x")


@pytest.mark.parametrize("call", [light.windowed, light.window_factors])
@pytest.mark.parametrize("name", light.WINDOWS)
def test_refuses_what_is_no_light(call, name):
    with pytest.raises(InputError, match="square"):
        call(torch.ones(8, 3), name)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("batch", [(), (3,), (2, 3), (0,)])
@pytest.mark.parametrize("name", light.WINDOWS)
def test_each_light_has_its_own_factors_and_they_are_what_it_is_under(name, batch, dtype):
    lamp = lamps(*batch, dtype=dtype)
    factors, under = light.window_factors(lamp, name), light.windowed(lamp, name)
    assert factors.shape == (*batch, 5)
    assert factors.dtype == under.dtype == dtype
    assert torch.equal(under, sh.window(lamp, factors))


def test_none_is_the_light_itself():
    lamp = lamps(2)
    assert light.windowed(lamp, "none") is lamp


@pytest.mark.parametrize("name", ["hann", "lanczos", "gauss"])
def test_the_curves_are_those_of_all_bands(name):
    assert torch.equal(light.window_factors(lamps(order=4), name), getattr(sh, name)(4, dtype=torch.float32))


@pytest.mark.parametrize("order", [2, 3, 5, 8])
def test_auto_is_weaker_than_least_and_leaves_no_lobe_negative(order):
    lamp = lamps(order=order, dtype=torch.float64)
    auto, least = light.window_factors(lamp, "auto"), light.window_factors(lamp, "least")
    assert (auto >= least).all()
    assert (auto[1:] > least[1:]).all()
    directions, _ = sh.gauss_legendre(20 * order)

    def lowest(factors):
        gathered = sh.convolve(sh.window(lamp, factors), sh.phong(order**2 / 3, order))
        values = sh.evaluate(gathered, directions)
        return float(values.min() / values.max())

    # What `sh.least_window` promises.
    assert lowest(auto) > -1e-9
    if (auto < 1).any():
        assert lowest(auto**0.99) < 0


def test_auto_leaves_what_is_smooth_as_it_is():
    sky = light.overcast_sky(1.0, (0.0, 1.0, 0.0), 5)
    assert torch.equal(light.windowed(sky, "auto"), sky)
