"""Does light stay in its chart, in every level of a map?"""

import pytest
import torch
from atlases import cube

from torchprt.errors import InputError
from torchprt.transfer import bilinear, mips


def one_bright(place, side=2):
    return (place.chart == side).float()[:, None].expand(-1, 3).contiguous()


def charts_of_level(place, rows, columns):
    """How many texels of each chart are in each texel of a level."""
    row = ((place.texel.long() // place.columns + 0.5) / place.rows * rows).long()
    column = ((place.texel.long() % place.columns + 0.5) / place.columns * columns).long()
    found = torch.zeros(rows, columns, 6, dtype=torch.long)
    return found.index_put((row, column, place.chart.long()), torch.tensor(1), accumulate=True)


def read_along(place, image):
    """The map read linearly at the texels of every chart and at its corners, and the chart of each."""
    weights = torch.tensor([[0.98, 0.01, 0.01], [0.01, 0.98, 0.01], [0.01, 0.01, 0.98], [0.4, 0.3, 0.3]])
    face = torch.arange(len(place.mesh_faces)).repeat_interleave(4)
    return bilinear(image, place.uv_at(face, weights.repeat(len(place.mesh_faces), 1))), face // 2


def test_refuses_levels_of_nothing():
    with pytest.raises(InputError, match="smallest level is to have 0"):
        mips(cube(), torch.zeros(216, 1), smallest=0)


def test_levels_halve_down_to_the_smallest():
    place = cube(texels=6, gutter=2, size=(50, 66))
    shapes = [tuple(each.shape) for each in mips(place, torch.rand(2, place.count, 3))]
    assert shapes == [(2, 50, 66, 3), (2, 25, 33, 3), (2, 12, 16, 3)]


@pytest.mark.parametrize(("texels", "gutter"), [(24, 4), (13, 1), (21, 0)])
def test_no_texel_of_a_dark_side_has_light_of_the_bright_one(texels, gutter):
    place = cube(texels, gutter)
    levels = mips(place, one_bright(place))
    assert min(levels[-1].shape[:2]) < 16
    for image in levels:
        # All or nothing: also what fills the gutters.
        assert set(image.unique().tolist()) == {0.0, 1.0}
        share = charts_of_level(place, *image.shape[:2])
        # Of the chart that has the most, of several the first.
        most = share.max(-1, keepdim=True).values
        first = (share == most).long().argmax(-1)
        bright = image[..., 0][most[..., 0] > 0] == 1
        assert torch.equal(bright, first[most[..., 0] > 0] == 2)


def test_a_filter_reads_nothing_of_another_chart_while_charts_are_far_enough_apart():
    """Charts 2 x 4 texels apart: levels up to 3/2 2^k = 6 of ours, and of a box filter, which takes the gutters as they
    are, up to 3/2 2^k = 3."""
    place = cube(texels=23, gutter=4)
    values = one_bright(place)
    safe = {"ours": 2, "box": 1}
    levels = mips(place, values)
    box = place.image(values)
    for level, image in enumerate(levels):
        for name, shown in (("ours", image), ("box", box)):
            found, chart = read_along(place, shown)
            wrong = (found[:, 0] - (chart == 2).float()).abs().max()
            if level <= safe[name]:
                assert wrong < 1e-6, (name, level)
        if min(box.shape[:2]) >= 2:
            box = box[: box.shape[0] // 2 * 2, : box.shape[1] // 2 * 2]
            box = torch.nn.functional.avg_pool2d(box.movedim(-1, 0)[None], 2)[0].movedim(0, -1)
    # A box filter leaks further down.
    assert box.shape[0] < 12
    found, chart = read_along(place, box)
    assert (found[:, 0] - (chart == 2).float()).abs().max() > 0.01


def test_a_texel_is_the_mean_of_its_chart():
    place = cube(texels=4, gutter=2)
    values = torch.rand(place.count, 2)
    _, half = mips(place, values, smallest=8)[:2]
    row, column = place.texel.long() // place.columns // 2, place.texel.long() % place.columns // 2
    for r, c in {(int(a), int(b)) for a, b in zip(row, column, strict=True)}:
        torch.testing.assert_close(half[r, c], values[(row == r) & (column == c)].mean(0))
