"""Do runs of lines of one shape say what the lines say one by one?"""

import random
from pathlib import Path

import numpy as np
import pytest

from torchprt.errors import InputError
from torchprt.scene import obj, obj_runs

NOWHERE = Path("a.obj")
VERTICES = ["v 0 0 0", "v 1 0 0", "v 0 1e0 0", "v -0.5 .25 +3.5E-1"]
NORMALS = ["vn 0 0 1", "vn 0 1 0"]
TEXTURES = ["vt 0 0", "vt .5 1"]
# Whole files, each a run or something in it that a run cannot have.
FILES = {
    "triangles": [*VERTICES, "f 1 2 3", "f 2 3 4"],
    "polygons": [*VERTICES, "f 1 2 3 4", "f 4 3 2 1"],
    "of two lengths": [*VERTICES, "f 1 2 3 4", "f 1 2 3"],
    "normals": [*VERTICES, *NORMALS, "f 1//1 2//1 3//2", "f 2//1 3//2 4//1"],
    "two normals of a vertex": [*VERTICES, *NORMALS, "f 1//1 2//1 3//2", "f 2//2 3//2 4//1"],
    "texture coordinates": [*VERTICES, *TEXTURES, "f 1/1 2/2 3/1", "f 2/2 3/1 4/1"],
    "all": [*VERTICES, *NORMALS, *TEXTURES, "f 1/1/2 2/2/1 3/1/1", "f 2/2/2 3/1/1 4/1/1"],
    "two forms": [*VERTICES, *NORMALS, *TEXTURES, "f 1/1/2 2/2/1 3/1/1", "f 2//2 3//1 4//1"],
    # As many numbers as two corners of two.
    "two forms of as many numbers": [*VERTICES, *NORMALS, *TEXTURES, "f 1//2 2/2/1 3/1/1", "f 2/2/2 3//1 4/1/1"],
    "relative": [*VERTICES, "f -4 -3 -2", "f 1 2 4"],
    "spaces": [*VERTICES, "f  1 2\t3 ", "f 2 3 4", "v   1 2   3 "],
    "comments": [*VERTICES, "# vn 3", "f 1 2 3 # the first", "f 2 3 4"],
    "colours": [f"{each} 1 .5 0" for each in VERTICES] + ["f 1 2 3"],
    "some colours": [f"{each} 1 .5 0" for each in VERTICES] + [*VERTICES, "f 1 2 3"],
    "weights": [f"{each} 1" for each in VERTICES] + ["f 1 2 3"],
    "one number": [*VERTICES, "vt .5", "vt 1", "f 1/1 2/2 3/1"],
    "materials": [*VERTICES, "usemtl a", "f 1 2 3", "f 2 3 4", "usemtl b", "f 1 2 4"],
    "other words": [*VERTICES, "vp 1 2", "o ü", "s off", "f 1 2 3", "fo 1 2 3"],
    "words that begin alike": [*VERTICES, "vn.5 1 2 3", "vn.5 4 5 6", "vnx 1 2 3", "f 1 2 3"],
    "large": ["v 1e300 0 0", "v 1 123456789012345678 0", "v 0.1 1 .30000000000000004", "f 1 2 3"],
}
FAULTY = {
    "f 1 2 0": "index 0",
    "f 1 2 x": "'x'",
    "f 1 2.0 3": "'2.0'",
    "f 1 2": "three corners",
    "f 1 2 99999999999999999999": "names vertex|index",
    "v 1 2": "2 numbers",
    "v 1.2.3 1 1": "not a number",
    "v 1 --2 1": "not a number",
    "vn 1 0": "2 numbers",
}


def said(lines, monkeypatch, least):
    monkeypatch.setattr(obj_runs, "LEAST", least)
    return obj.parse_obj("\n".join(lines).encode(), NOWHERE)


def same(ours, wanted):
    for name, mine, theirs in zip(wanted._fields, ours, wanted, strict=True):
        if isinstance(theirs, np.ndarray):
            assert mine.dtype == theirs.dtype, name
            np.testing.assert_array_equal(mine, theirs, err_msg=name)
        else:
            assert mine == theirs, name


@pytest.mark.parametrize("name", FILES)
def test_runs_say_what_lines_say(name, monkeypatch):
    same(said(FILES[name], monkeypatch, 1), said(FILES[name], monkeypatch, 10**9))


def test_so_do_files_of_any_lines(monkeypatch):
    draw = random.Random(5)
    every = sorted({line for lines in FILES.values() for line in lines if line.startswith("f")})
    for _ in range(100):
        lines = [*VERTICES, *NORMALS, *TEXTURES, *draw.choices(every, k=draw.randint(1, 6))]
        same(said(lines, monkeypatch, 1), said(lines, monkeypatch, 10**9))


@pytest.mark.parametrize("line", FAULTY)
@pytest.mark.parametrize("alone", [True, False])
def test_a_faulty_line_in_a_run_is_told_by_its_number(line, alone, monkeypatch):
    before = [*VERTICES, *NORMALS, "f 1 2 3"]
    with pytest.raises(InputError, match=FAULTY[line]) as caught:
        said([*before, *([line] if alone else [line, line])], monkeypatch, 1)
    if "names" not in str(caught.value):
        assert f"line {len(before) + 1} " in str(caught.value)


def test_a_run_is_read_at_once():
    assert obj_runs.numbers(["v 1 2 3", "v 4 5 6"]).tolist() == [[1, 2, 3], [4, 5, 6]]
    assert obj_runs.corners(["f 1//7 2//8 3//9"]).tolist() == [[[1, 7, 0], [2, 8, 0], [3, 9, 0]]]
    assert obj_runs.numbers(["v 1 2 3", "v 4 5"]) is None
    assert obj_runs.corners(["f 1 2 3", "f 1 2 3 4"]) is None
