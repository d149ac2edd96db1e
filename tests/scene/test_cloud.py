"""The sample cloud: the same at every resolution, a fifth of its cube, as deep as it is asked to be."""

import pytest
import torch
from torch.nn import functional

from torchprt.errors import InputError
from torchprt.scene import samples


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"resolution": 3}, "from 4"), ({"resolution": 513}, "to 512"), ({"optical_depth": 0.0}, "above 0")],
)
def test_refuses_clouds_that_are_none(wrong, said):
    with pytest.raises(InputError, match=said):
        samples.cloud(**wrong)


@pytest.fixture(scope="module")
def usual():
    return samples.cloud()


def test_a_fifth_of_the_cube_is_cloud_and_no_face_of_it(usual):
    filled = usual.occupied
    assert 0.15 < filled.float().mean() < 0.3
    for axis in range(3):
        for end in (0, -1):
            assert not filled.select(axis, end).any()


def test_it_is_the_same_cloud_at_another_resolution(usual):
    other = samples.cloud(13)
    assert other.shape == (13, 13, 13)
    assert other.spacing == pytest.approx((2 / 13,) * 3)
    # The mean over the cube: cells are means, and it is scaled over a middle that is as wide as cells allow.
    assert float(other.extinction.mean()) == pytest.approx(float(usual.extinction.mean()), rel=0.12)
    looks = [functional.interpolate(each.extinction[None, None], (8, 8, 8), mode="area") for each in (usual, other)]
    assert torch.corrcoef(torch.stack([look.flatten() for look in looks]))[0, 1] > 0.97


def test_it_is_as_deep_over_its_middle_as_asked_and_the_seed_is_all_that_is_random(usual):
    deep = samples.cloud(optical_depth=24)
    torch.testing.assert_close(deep.extinction, 2 * usual.extinction)
    middle = deep.extinction[13:19, :, 13:19].sum(1).mean() * deep.spacing[1]
    assert float(middle) == pytest.approx(24, rel=1e-5)
    assert not torch.equal(samples.cloud(seed=5).occupied, usual.occupied)
