"""Does the map of sight show each vertex as what it is, and say in words what its colours are?"""

from types import SimpleNamespace

import pytest
import torch

from torchprt.errors import InputError
from torchprt.preview import sight_colours, sight_legend
from torchprt.preview.sight import SIGHTS


def receivers(sight):
    return SimpleNamespace(sight=torch.tensor(sight, dtype=torch.uint8), normals=torch.zeros(len(sight), 3))


def test_a_bake_that_does_not_say_is_refused_and_has_no_legend():
    for bake in (SimpleNamespace(), SimpleNamespace(sight=None)):
        assert sight_legend(bake) == []
        with pytest.raises(InputError, match="bake it again"):
            sight_colours(bake)


def test_each_kind_has_a_colour_of_its_own():
    colours = sight_colours(receivers([0, 1, 2, 3, 4]))
    for one in range(5):
        for other in range(one):
            assert (colours[one] - colours[other]).abs().max() > 0.2
    assert colours.min() >= 0
    assert colours.max() <= 1


def test_the_shape_is_seen_and_the_colour_kept():
    bake = receivers([1, 1])
    bake.normals = torch.tensor([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    up, down = sight_colours(bake)
    assert (up > down).all()
    torch.testing.assert_close(up / up.sum(), down / down.sum())


def test_the_legend_counts_what_there_is_and_nothing_else():
    lines = sight_legend(receivers([0, 0, 0, 4, 2]))
    assert lines == [
        "grey: 3 vertices, each looked out as it stands",
        "green: 1 vertex, each looked out from another place",
        "red: 1 vertex, each is blind, and dark",
    ]
    assert len(SIGHTS) == 5
