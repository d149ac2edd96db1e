"""Is the colour of an error where the scale says?"""

import pytest
import torch

from torchprt.errors import InputError
from torchprt.preview import Still, error_colours


@pytest.mark.parametrize("most", [0, -1, float("inf"), float("nan")])
def test_a_scale_without_an_end_is_refused(most):
    with pytest.raises(InputError, match=f"most is {most}"):
        error_colours(torch.ones(3), most)


@pytest.mark.parametrize("bad", [-1e-9, float("nan"), float("inf")])
def test_what_is_no_error_is_refused(bad):
    with pytest.raises(InputError, match="negative or not finite"):
        error_colours(torch.tensor([0.5, bad]), 1.0)


def test_no_vertices_have_no_colours():
    assert error_colours(torch.empty(0), 1).shape == (0, 3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("most", [1e-30, 1.0, 8e30])
def test_the_stations_and_what_lies_between_and_beyond(most, dtype):
    place = torch.tensor([0, 0.125, 0.25, 0.5, 0.75, 0.875, 1, 1.25, 4], dtype=dtype)
    colours = [[0, 0, 1], [0, 0.5, 1], [0, 1, 1], [0, 1, 0], [1, 1, 0], [1, 0.5, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]]
    # The product `place * most` is rounded once, the quotient again, and a station is a quarter of the scale.
    atol = 8 * torch.finfo(dtype).eps
    torch.testing.assert_close(error_colours(place * most, most), torch.tensor(colours, dtype=dtype), rtol=0, atol=atol)


def test_a_still_shows_them_as_they_are():
    positions = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
    still = Still(positions, torch.tensor([[0, 1, 2]]), size=(24, 24))
    picture = still.radiance(error_colours(torch.full((3,), 0.5), 1.0), background=1.0)
    torch.testing.assert_close(picture[12, 12], torch.tensor([0.0, 1.0, 0.0]), rtol=0, atol=1e-6)
    torch.testing.assert_close(picture[0, 0], torch.ones(3))
