"""Does the map of sight show each vertex as what it is, and say in words what its colours are?"""

import torch

from torchprt.preview import sight_colours, sight_legend
from torchprt.transfer import Vertices


def receivers(sight, count=5):
    marks = None if sight is None else torch.tensor(sight, dtype=torch.uint8)
    faces = torch.zeros(0, 3, dtype=torch.int32)
    return Vertices(positions=torch.rand(count, 3), normals=torch.zeros(count, 3), faces=faces, sight=marks)


def test_a_bake_without_marks_is_grey_and_says_why():
    colours = sight_colours(receivers(None))
    assert torch.equal(colours, colours[:1].expand(5, 3))
    (line,) = sight_legend(receivers(None))
    assert line.startswith("grey: no vertex is marked")


def test_each_kind_has_a_colour_of_its_own():
    colours = sight_colours(receivers([0, 1, 2, 3, 4]))
    for one in range(5):
        for other in range(one):
            assert (colours[one] - colours[other]).abs().max() > 0.2
    assert colours.min() >= 0
    assert colours.max() <= 1


def test_the_shape_is_seen_and_the_colour_kept():
    bake = receivers([1, 1], count=2)
    bake.normals = torch.tensor([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    up, down = sight_colours(bake)
    assert (up > down).all()
    torch.testing.assert_close(up / up.sum(), down / down.sum())


def test_the_legend_counts_what_there_is_and_nothing_else():
    assert sight_legend(receivers([0, 0, 0, 4, 2])) == [
        "grey: 3 vertices, lit by its own rays",
        "green: 1 vertex, lit by its own rays from another place",
        "red: 1 vertex, lit not at all, and dark",
    ]
