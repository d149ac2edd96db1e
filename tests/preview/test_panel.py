"""Are the lines of a panel all on it?"""

import torch

from torchprt.preview.panel import GROUND, LINE, MARGIN, panel


def ink(picture):
    return (picture.int() - torch.tensor(GROUND)).abs().amax(-1) > 60


def test_no_line_is_an_empty_panel():
    assert not ink(panel([])).any()
    assert not ink(panel([""])).any()


def test_every_line_has_its_height_and_the_widest_fits():
    picture = panel(["short", "", "a much longer line that must not be cut off at the end WWW"])
    assert picture.dtype == torch.uint8
    assert len(picture) == 3 * LINE + 2 * MARGIN
    rows = [ink(picture[MARGIN + LINE * number : MARGIN + LINE * (number + 1)]) for number in range(3)]
    assert [bool(row.any()) for row in rows] == [True, False, True]
    columns = rows[2].any(0).nonzero()
    assert int(columns.min()) >= MARGIN - 1
    assert int(columns.max()) < picture.shape[1] - MARGIN + 1


def test_what_is_behind_a_tab_stands_in_one_column():
    picture = panel(["M\tH", "long key\tH"])
    starts = []
    for number in range(2):
        columns = ink(picture[MARGIN + LINE * number : MARGIN + LINE * (number + 1)]).any(0)
        ends = int(columns.nonzero().max())
        starts.append(ends)
    assert starts[0] == starts[1]
