"""Is the error of a recipe that of the light it serves worst?"""

import pytest
import torch

from torchprt.errors import InputError
from torchprt.measure.error import relative_rms
from torchprt.measure.recipe_error import error_under, errors_under


def radiance(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) + 0.1


def test_refuses_other_lights_and_other_receivers():
    with pytest.raises(InputError, match="same lights"):
        error_under(radiance(2, 5, 3), radiance(3, 5, 3))
    with pytest.raises(InputError, match="same lights"):
        error_under([], [])
    with pytest.raises(InputError, match="shape"):
        error_under(radiance(2, 5, 3), radiance(2, 6, 3))
    with pytest.raises(InputError, match="shape"):
        error_under(radiance(2, 3, 5, 3), radiance(2, 4, 5, 3))


def test_a_black_light_is_named():
    wanted = radiance(2, 1, 5, 3)
    wanted[1] = 0
    with pytest.raises(InputError, match="black under light 1"):
        error_under(radiance(2, 1, 5, 3), wanted)


def test_a_number_that_is_not_finite_is_refused():
    found = radiance(1, 5, 3)
    found[0, 0, 0] = torch.nan
    with pytest.raises(InputError, match="NaN"):
        error_under(found, radiance(1, 5, 3))


def test_the_largest_of_the_lights_counts_and_bright_lights_do_not_hide_others():
    wanted, found = radiance(2, 4, 50, 3), radiance(2, 4, 50, 3)
    # Both a tenth too bright and a fifth too dark; the first light a thousand times brighter.
    found[0] *= 1.1
    found[1] *= 0.8
    wanted[0] *= 1000
    found[0] *= 1000
    assert errors_under(found, wanted) == pytest.approx([0.1, 0.2], rel=1e-12)
    assert error_under(found, wanted) == pytest.approx(0.2, rel=1e-12)


def test_it_is_the_relative_rms_over_receivers_and_eyes():
    found, wanted = radiance(1, 3, 20, 3, seed=1), radiance(1, 3, 20, 3)
    assert error_under(found, wanted) == relative_rms(found[0], wanted[0])
    assert error_under(list(found), list(wanted)) == relative_rms(found[0], wanted[0])


def test_what_looks_the_same_from_everywhere_is_compared_with_each_eye():
    found, wanted = radiance(2, 1, 20, 3, seed=1), radiance(2, 3, 20, 3)
    each = errors_under(found.expand(-1, 3, -1, -1), wanted)
    assert errors_under(found, wanted) == each
    assert errors_under(found[:, 0], wanted) == each


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_scale_does_not_matter(scale):
    found, wanted = radiance(1, 20, 3, seed=1), radiance(1, 20, 3)
    assert error_under(found * scale, wanted * scale) == pytest.approx(error_under(found, wanted), rel=1e-12)
