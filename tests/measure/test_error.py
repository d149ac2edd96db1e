"""Are error figures what their names say, at every scale, and refused where they would mean nothing?"""

import math

import pytest
import torch
from transfers import replaced, stored

from torchprt.errors import InputError
from torchprt.measure import max_error, psnr, radiance_error, relative_rms, transfer_error

MEASURES = [relative_rms, max_error, psnr]
EPSILON = torch.finfo(torch.float64).eps


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize(
    ("value", "reference", "message"),
    [
        (torch.ones(3), torch.ones(4), r"value has shape \(3,\) but the reference \(4,\)"),
        (torch.ones(1), torch.ones(3), "compare equal shapes"),
        (torch.ones(0), torch.ones(0), "nothing to compare"),
        (torch.tensor([1.0, torch.nan]), torch.ones(2), "value holds NaN"),
        (torch.ones(2), torch.tensor([1.0, torch.inf]), "reference holds NaN or infinite"),
    ],
)
def test_refuses_what_cannot_be_compared(measure, value, reference, message):
    with pytest.raises(InputError, match=message):
        measure(value, reference)


@pytest.mark.parametrize("measure", [relative_rms, max_error])
def test_refuses_a_reference_of_zeros(measure):
    with pytest.raises(InputError, match="reference is zero everywhere"):
        measure(torch.ones(2), torch.zeros(2))


@pytest.mark.parametrize("peak", [0.0, -1.0, float("nan")])
def test_refuses_a_peak_that_is_not_positive(peak):
    with pytest.raises(InputError, match="peak must be positive"):
        psnr(torch.ones(2), torch.ones(2), peak)


def test_equal_values_have_no_error():
    value = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))
    assert relative_rms(value, value) == max_error(value, value) == 0
    assert psnr(value, value) == math.inf


def test_figures_worked_out_by_hand():
    reference, value = torch.tensor([3.0, -4.0, 0.0, 0.0]), torch.tensor([3.0, -4.0, 1.0, 0.0])
    # RMS of the difference 1/2, of the reference 5/2.
    assert relative_rms(value, reference) == pytest.approx(0.2, rel=4 * EPSILON)
    assert max_error(value, reference) == 0.25
    assert psnr(value, reference) == pytest.approx(10 * math.log10(4), rel=1e-12)
    assert psnr(value, reference, peak=10.0) == pytest.approx(20 + 10 * math.log10(4), rel=1e-12)


@pytest.mark.parametrize("measure", [relative_rms, max_error])
@pytest.mark.parametrize("scale", [2.0**-100, 1.0, 2.0**100])
def test_a_common_factor_changes_nothing(measure, scale):
    generator = torch.Generator().manual_seed(0)
    value, reference = torch.randn(2, 7, 3, generator=generator)
    assert measure(scale * value, scale * reference) == pytest.approx(measure(value, reference), rel=8 * EPSILON)


def test_an_error_of_a_tenth_everywhere_is_a_tenth(make_transfer):
    reference = make_transfer(order=3, channels=3, dtype=torch.float64)
    report = transfer_error(replaced(reference, values=1.1 * stored(reference)), reference)
    assert report.relative_rms == pytest.approx(0.1, rel=1e-12)
    assert report.max_error == pytest.approx(0.1, rel=1e-12)


def test_a_transfer_has_no_error_against_itself(make_transfer):
    report = transfer_error(make_transfer(), make_transfer())
    assert report.relative_rms == report.max_error == 0
    assert torch.equal(report.per_vertex, torch.zeros(25).double())
    assert torch.equal(report.per_band, torch.zeros(4).double())


@pytest.mark.parametrize("channels", [1, 3])
def test_an_error_is_found_where_it_was_put(make_transfer, channels):
    reference = make_transfer(order=3, channels=channels, dtype=torch.float64)
    vectors = stored(reference).clone()
    vectors[:, 4:9, 7] += 0.5
    report = transfer_error(replaced(reference, values=vectors), reference)
    rms = stored(reference).square().mean().sqrt()
    assert report.per_vertex.nonzero().flatten().tolist() == [7]
    assert report.per_band.nonzero().flatten().tolist() == [2]
    # 5 of 9 coefficients of vertex 7; one of 25 vertices in all coefficients of band 2.
    assert float(report.per_vertex[7]) == pytest.approx(float(0.5 * math.sqrt(5 / 9) / rms), rel=1e-12)
    assert float(report.per_band[2]) == pytest.approx(float(0.5 * math.sqrt(1 / 25) / rms), rel=1e-12)


def test_vertices_and_bands_add_up_to_the_whole(make_transfer):
    reference, value = make_transfer(seed=1), make_transfer(seed=2)
    report = transfer_error(value, reference)
    assert float(report.per_vertex.square().mean()) == pytest.approx(report.relative_rms**2, rel=1e-12)
    counts = torch.tensor([1, 3, 5, 7])
    assert float((report.per_band**2 * counts).sum() / 16) == pytest.approx(report.relative_rms**2, rel=1e-12)
    assert relative_rms(stored(value), stored(reference)) == pytest.approx(report.relative_rms, rel=1e-12)


def test_bands_that_are_missing_count_as_zero(make_transfer):
    reference = make_transfer(order=4)
    report = transfer_error(reference.to_order(2), reference)
    lost = stored(reference)[:, 4:].double().square().sum() / stored(reference).double().square().sum()
    assert report.relative_rms == pytest.approx(math.sqrt(lost), rel=1e-12)
    assert report.per_band[:2].tolist() == [0, 0]


def test_half_precision_costs_its_epsilon(make_transfer):
    reference = make_transfer()
    report = transfer_error(reference.to(torch.float16), reference)
    # Rounding to nearest is uniform in half an epsilon either way of a number between 1 and 2.
    assert 0 < report.relative_rms < torch.finfo(torch.float16).eps / 2


@pytest.mark.parametrize(
    ("value", "reference", "message"),
    [
        ({"side": 4}, {}, "16 vertices and 1 channels but the reference has 25 and 1"),
        ({"channels": 3}, {}, "3 channels"),
        ({"order": 5}, {"order": 4}, "order 5, above the 4 of the reference"),
        ({"side": 0}, {"side": 0}, "nothing to compare"),
    ],
)
def test_refuses_transfer_of_another_scene(make_transfer, value, reference, message):
    with pytest.raises(InputError, match=message):
        transfer_error(make_transfer(**value), make_transfer(**reference))


def test_radiance_error_is_that_of_the_shaded_picture(make_transfer):
    reference, value = make_transfer(order=3, seed=1), make_transfer(order=3, seed=2)
    light = torch.randn(4, 9, 3, generator=torch.Generator().manual_seed(0))

    def shade(transfer):
        return transfer.albedo.double() * torch.einsum("nv,bnc->bvc", stored(transfer)[0].double(), light.double())

    report = radiance_error(value, reference, light)
    assert report.relative_rms == pytest.approx(relative_rms(shade(value), shade(reference)), rel=1e-12)
    assert report.max_error == pytest.approx(max_error(shade(value), shade(reference)), rel=1e-12)
    squares = (shade(value) - shade(reference)).square().mean((0, 2)) / shade(reference).square().mean()
    assert torch.allclose(report.per_vertex, squares.sqrt(), rtol=1e-12, atol=0)
    assert report.per_band is None


def test_a_truncated_transfer_is_right_under_a_truncated_light(make_transfer):
    reference = make_transfer(order=4)
    light = torch.randn(16, 3, generator=torch.Generator().manual_seed(0))
    light[4:] = 0
    assert radiance_error(reference.to_order(2), reference, light).max_error <= 16 * EPSILON


def test_refuses_a_light_of_another_order_or_a_reference_with_less(make_transfer):
    with pytest.raises(InputError, match="light has 9 coefficients but the transfer is of order 4"):
        radiance_error(make_transfer(), make_transfer(), torch.zeros(9, 3))
    with pytest.raises(InputError, match="order 5 but the reference has 25 and 4"):
        radiance_error(make_transfer(order=5), make_transfer(order=4), torch.zeros(16, 3))
    with pytest.raises(InputError, match="reference is zero everywhere"):
        radiance_error(make_transfer(), make_transfer(), torch.zeros(16, 3))


def test_a_report_reads_as_one_line(make_transfer):
    text = str(transfer_error(make_transfer(seed=1), make_transfer(seed=2)))
    assert text.startswith("relative RMS ")
    assert "\n" not in text
