"""Does what a screen shows follow IEC 61966-2-1, and does the tone curve behave at the extremes?"""

import math

import pytest
import torch

from torchprt.errors import InputError
from torchprt.shade import display, filmic, srgb


def iec(value):
    """IEC 61966-2-1:1999, section 5.2, as it is written."""
    return 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055


def test_refuses_an_unknown_tone_map(untyped):
    with pytest.raises(InputError, match="tone map 'reinhard' is unknown"):
        display(torch.zeros(1, 3), tone="reinhard")


@pytest.mark.parametrize("shape", [(3,), (0, 3), (1, 3), (2, 4, 5, 3)])
def test_keeps_the_shape(shape):
    for function in (filmic, srgb, display):
        assert function(torch.zeros(shape)).shape == shape


def test_srgb_is_the_standard():
    linear = torch.cat([torch.linspace(0, 1, 1000), torch.tensor([0.0031308, 0.0031309, 1e-30])]).double()
    shown = srgb(linear[:, None].expand(-1, 3))
    wanted = torch.tensor([iec(value) for value in linear.tolist()]).double()
    # The two formulas of the standard meet within 3e-8 only, so its threshold may fall to either side.
    assert (shown - wanted[:, None]).abs().max() <= 1e-7


def test_srgb_clips_to_what_a_screen_can_show():
    shown = srgb(torch.tensor([[-1.0, 2.0, 1e30]]))
    assert torch.allclose(shown, torch.tensor([[0.0, 1.0, 1.0]]), rtol=0, atol=2 * torch.finfo(torch.float32).eps)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_filmic_rises_all_the_way_and_ends_at_one(dtype):
    ramp = torch.cat([torch.zeros(1), torch.logspace(-30, 30, 20001)]).to(dtype)
    curve = filmic(ramp[:, None].expand(-1, 3))[:, 0]
    assert torch.isfinite(curve).all()
    # Neighbours may differ by rounding where the curve is flat.
    assert curve.diff().min() >= -2 * torch.finfo(dtype).eps
    assert curve[0] == 0
    assert curve[-1] == 1


def test_filmic_is_its_rational_formula_on_both_sides_of_one():
    x = torch.tensor([1e-3, 0.18, 0.5, 0.999, 1.0, 1.001, 3.0]).double()
    wanted = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    found = filmic(x[:, None].expand(-1, 3))[:, 0]
    assert (found - wanted).abs().max() <= 4 * torch.finfo(torch.float64).eps
    assert found[1] == pytest.approx(0.267, abs=1e-3)


def test_black_and_negative_radiance_are_black():
    assert torch.equal(display(torch.tensor([[0.0, -1.0, -1e30]])), torch.zeros(1, 3))


def test_a_stop_doubles():
    radiance = torch.rand(10, 3, generator=torch.Generator().manual_seed(0)) / 4
    assert torch.equal(display(radiance, exposure=1.0), display(2 * radiance))
    assert torch.equal(display(radiance, exposure=torch.tensor(-2.0)), display(radiance / 4))


def test_without_a_tone_map_it_is_srgb_alone():
    radiance = torch.rand(10, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(display(radiance, tone="none"), srgb(radiance))


@pytest.mark.parametrize("tone", ["none", "filmic"])
@pytest.mark.parametrize("value", [0.0, 1e-30, 0.0031308, 0.18, 1.0, 1e30])
def test_gradients_are_finite_everywhere(tone, value):
    radiance = torch.full((1, 3), value, requires_grad=True)
    display(radiance, tone=tone).sum().backward()
    assert torch.isfinite(radiance.grad).all()


def test_the_exposure_can_be_learned():
    exposure = torch.zeros((), requires_grad=True)
    display(torch.full((1, 3), 0.18), exposure=exposure).sum().backward()
    assert math.isfinite(exposure.grad)
    assert exposure.grad > 0
