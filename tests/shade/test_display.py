"""Does what a screen shows follow IEC 61966-2-1, and does the tone curve behave at the extremes?"""

import math

import pytest
import torch
from kornia.color import linear_rgb_to_rgb

from torchprt.errors import InputError
from torchprt.shade import agx, display, filmic, neutral, srgb, tone_mapped
from torchprt.shade.display import TONES, linear

CURVES = {"neutral": neutral, "agx": agx, "filmic": filmic}


def khronos(colour):
    """The specification of the PBR neutral tone map of 2024, a colour after the other, with its own branches."""
    least = min(colour)
    offset = least - 6.25 * least * least if least < 0.08 else 0.04
    colour = [channel - offset for channel in colour]
    peak = max(colour)
    if peak < 0.8 - 0.04:
        return colour
    d = 1 - (0.8 - 0.04)
    new_peak = 1 - d * d / (peak + d - (0.8 - 0.04))
    colour = [channel * new_peak / peak for channel in colour]
    g = 1 - 1 / (0.15 * (peak - new_peak) + 1)
    return [channel * (1 - g) + new_peak * g for channel in colour]


def blender(colour):
    """AgX: to the inset primaries of Rec. 2020, 16.5 stops, the sigmoid of sixth degree, and back; in plain Python.

    The columns are those of the published shader, where a mat3 is written column after column.
    """

    def product(columns, vector):
        return [sum(column[row] * value for column, value in zip(columns, vector, strict=True)) for row in range(3)]

    to_2020 = ((0.6274, 0.0691, 0.0164), (0.3293, 0.9195, 0.0880), (0.0433, 0.0113, 0.8956))
    from_2020 = ((1.6605, -0.1246, -0.0182), (-0.5876, 1.1329, -0.1006), (-0.0728, -0.0083, 1.1187))
    inset = (
        (0.856627153315983, 0.137318972929847, 0.11189821299995),
        (0.0951212405381588, 0.761241990602591, 0.0767994186031903),
        (0.0482516061458583, 0.101439036467562, 0.811302368396859),
    )
    outset = (
        (1.1271005818144368, -0.1413297634984383, -0.14132976349843826),
        (-0.11060664309660323, 1.157823702216272, -0.11060664309660294),
        (-0.016493938717834573, -0.016493938717834257, 1.2519364065950405),
    )
    colour = product(inset, product(to_2020, colour))
    x = [(math.log2(max(channel, 1e-10)) + 12.47393) / (4.026069 + 12.47393) for channel in colour]
    x = [min(max(channel, 0.0), 1.0) for channel in x]
    x = [15.5 * c**6 - 40.14 * c**5 + 31.96 * c**4 - 6.868 * c**3 + 0.4298 * c**2 + 0.1191 * c - 0.00232 for c in x]
    x = product(from_2020, [max(channel, 0.0) ** 2.2 for channel in product(outset, x)])
    return [min(max(channel, 0.0), 1.0) for channel in x]


def colours():
    """Colours from far below to far above what a screen shows, and where formulas change."""
    random = torch.rand(400, 3, generator=torch.Generator().manual_seed(0)).double()
    scaled = random * 2.0 ** torch.linspace(-12, 8, 400).double()[:, None]
    corners = [
        [0.08, 0.3, 0.5],
        [0.0799999, 0.3, 0.5],
        [0.8, 0.04, 0.4],
        [0.8, 0.8, 0.8],
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
    ]
    return torch.cat([scaled, torch.tensor(corners, dtype=torch.float64)])


def iec(value):
    """IEC 61966-2-1:1999, section 5.2, as it is written."""
    return 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1 / 2.4) - 0.055


def test_refuses_an_unknown_tone_map(untyped):
    with pytest.raises(InputError, match="tone map 'reinhard' is unknown"):
        display(torch.zeros(1, 3), tone="reinhard")


@pytest.mark.parametrize("shape", [(3,), (0, 3), (1, 3), (2, 4, 5, 3)])
def test_keeps_the_shape(shape):
    for function in (neutral, agx, filmic, srgb, display, tone_mapped):
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


@pytest.mark.parametrize(("curve", "published"), [(neutral, khronos), (agx, blender)])
def test_a_tone_map_is_its_published_formula(curve, published):
    given = colours()
    wanted = torch.tensor([published(colour) for colour in given.tolist()], dtype=torch.float64)
    # A polynomial with coefficients up to 40, whose terms cancel.
    torch.testing.assert_close(curve(given), wanted, rtol=0, atol=1e-12)
    torch.testing.assert_close(curve(given.float()), wanted.float(), rtol=0, atol=2e-5)


def test_neutral_by_hand():
    """Worked out on paper: 6.25 x^2 of a dark grey; .04 off a base colour; 1 - .24^2 / (peak - .52) of a white lamp."""
    given = torch.tensor(
        [[0.04, 0.04, 0.04], [0.5, 0.3, 0.1], [1.04, 1.04, 1.04], [4.04, 4.04, 4.04]], dtype=torch.float64
    )
    wanted = torch.tensor([[0.01] * 3, [0.46, 0.26, 0.06], [0.88] * 3, [1 - 0.0576 / 3.48] * 3], dtype=torch.float64)
    torch.testing.assert_close(neutral(given), wanted, rtol=0, atol=1e-12)


def test_neutral_keeps_the_hue_of_a_lit_colour_and_filmic_does_not():
    """Of a red that is lit twice as brightly as a screen can show: channels in proportion, but for what turns white."""
    red = torch.tensor([[1.5, 0.3, 0.15]], dtype=torch.float64)
    apart = {}
    for name, curve in (("neutral", neutral), ("filmic", filmic)):
        shown = curve(red)[0]
        # How far green is between blue and red: the hue, whatever white is mixed in.
        apart[name] = abs(float((shown[1] - shown[2]) / (shown[0] - shown[2])) - (0.3 - 0.15) / (1.5 - 0.15))
    assert apart["neutral"] < 1e-12
    assert apart["filmic"] > 0.1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("curve", [neutral, agx])
def test_greys_rise_all_the_way_and_stay_grey(curve, dtype):
    ramp = torch.cat([torch.zeros(1), torch.logspace(-30, 30, 20001)]).to(dtype)
    shown = curve(ramp[:, None].expand(-1, 3))
    assert torch.isfinite(shown).all()
    # The published matrices of AgX are rounded to four digits; its curve dips by 2e-5 at its very end.
    assert (shown.amax(-1) - shown.amin(-1)).max() <= 2e-3
    assert shown[:, 1].diff().min() >= -1e-4
    assert shown[0].max() <= 1e-6
    assert shown[-1].min() > 0.97
    assert shown.max() <= 1


@pytest.mark.parametrize("tone", TONES)
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_that_of_single_rounded(tone, dtype):
    given = (torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) * 4).to(dtype)
    shown = tone_mapped(given, exposure=0.5, tone=tone)
    assert shown.dtype == dtype
    assert torch.equal(shown, tone_mapped(given.float(), exposure=0.5, tone=tone).to(dtype))


@pytest.mark.parametrize("tone", [tone for tone in TONES if tone != "none"])
def test_the_derivative_is_that_of_finite_differences(tone):
    given = colours()[::40].requires_grad_()
    assert torch.autograd.gradcheck(CURVES[tone], (given,), eps=1e-7, atol=1e-4)


def test_linear_undoes_srgb():
    shown = torch.linspace(0, 1, 256).double()[:, None].expand(-1, 3)
    torch.testing.assert_close(srgb(linear(shown)), shown, rtol=0, atol=1e-7)


def test_black_and_negative_radiance_are_black():
    for tone in TONES:
        assert torch.equal(display(torch.tensor([[0.0, -1.0, -1e30]]), tone=tone), torch.zeros(1, 3))


def test_a_stop_doubles():
    radiance = torch.rand(10, 3, generator=torch.Generator().manual_seed(0)) / 4
    assert torch.equal(display(radiance, exposure=1.0), display(2 * radiance))
    assert torch.equal(display(radiance, exposure=torch.tensor(-2.0)), display(radiance / 4))


def test_without_a_tone_map_it_is_srgb_alone():
    radiance = torch.rand(10, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(display(radiance, tone="none"), srgb(radiance))


@pytest.mark.parametrize("tone", TONES)
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


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_srgb_is_that_of_kornia(dtype):
    planes = torch.linspace(0, 1, 3 * 1001, dtype=dtype).reshape(1, 3, -1, 1)
    expected = linear_rgb_to_rgb(planes)[0, :, :, 0].mT
    torch.testing.assert_close(srgb(planes[0, :, :, 0].mT), expected, rtol=2 * torch.finfo(dtype).eps, atol=0)
