"""Does the table of frames say what the frames cost and lose?"""

import pytest
import torch
from shapes import square

from torchprt.errors import InputError
from torchprt.measure import Timing, compare_frames, random_lights
from torchprt.scene import Material, Object, Scene, load, samples

QUICK = {"rays": 256, "count": 8, "views": 16, "rounds": 1}


def shiny(gloss="ggx:0.3"):
    return Material(albedo=0.0, gloss=gloss)


@pytest.fixture(scope="module")
def table():
    blocker = samples.plane_and_blocker(3).objects[1].mesh
    scene = load(square(2.0, 12), material=shiny(), blockers=blocker)
    return compare_frames(scene, order=3, factors=(2, 7), **QUICK)


def test_refuses_no_glossy_material_and_two():
    with pytest.raises(InputError, match="0 glossy materials"):
        compare_frames(load(square()), **QUICK)
    two = Scene([Object(square(), shiny()), Object(square(height=1.0), shiny("phong:9"))])
    with pytest.raises(InputError, match="2 glossy materials"):
        compare_frames(two, **QUICK)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"light": random_lights(1, 4)}, "order 5 has 25"),
        ({"views": 0}, "views is 0"),
        ({"count": 0}, "count is 0"),
        ({"factors": (26,)}, "rows is 26"),
    ],
)
def test_refuses_what_does_not_fit(options, match):
    with pytest.raises(InputError, match=match):
        compare_frames(load(square(), material=shiny()), **{**QUICK, "rays": 16, **options})


def test_every_frame_stores_what_it_says(table):
    rows = {row.name: row for row in table.rows}
    receivers = int(table.title.split(", ")[2].split()[0])
    numbers = {
        "exit, output order 3": 81,
        "exit, output order 2": 36,
        "exit, output order 3, zero": 81,
        "exit, factored, 2 rows": 18,
        "exit, factored, 7 rows": 63,
        "incident, output order 3": 81,
        "visibility, order 3": 9,
        "visibility, order 6": 36,
    }
    assert {name: row.extra["numbers"] for name, row in rows.items()} == numbers
    for name, row in rows.items():
        constant = row.bytes - 4 * numbers[name] * receivers
        # Beside what each receiver stores there are tables: two maps of 32 x 32, or a kernel at the nodes of a rule.
        if "factored" in name:
            assert constant == 4 * 32 * 32 * int(name.split()[-2])
        elif "visibility" in name:
            degree = row.extra["numbers"] ** 0.5 + 3 + 2 * 3 - 4
            assert constant == 4 * 9 * (degree // 2 + 1) * (degree + 1)
        else:
            assert constant == 0


def test_errors_fall_where_more_is_stored(table):
    errors = {row.name: row.error for row in table.rows}
    assert errors["exit, output order 3"] < errors["exit, output order 2"]
    # Functions orthonormal on the hemisphere against functions of the sphere that are zero on half of it.
    assert errors["exit, output order 2"] < errors["exit, output order 3, zero"]
    assert errors["exit, factored, 7 rows"] < errors["exit, factored, 2 rows"]
    assert errors["visibility, order 6"] <= errors["visibility, order 3"]
    # Products with enough bands are the matrix.
    assert errors["visibility, order 6"] == pytest.approx(errors["exit, output order 3"], rel=0.1)
    assert min(errors.values()) > 0
    assert max(errors.values()) < 1


def test_every_frame_is_timed(table):
    for row in table.rows:
        assert isinstance(row.seconds, Timing)
        assert row.seconds.median > 0
        assert row.extra["eye moves, ms"] > 0


def test_asks_only_for_the_rows_that_are_wanted():
    found = compare_frames(
        load(square(1.0, 4), material=shiny("phong:3")),
        random_lights(1, 2).float(),
        order=2,
        output_orders=(3,),
        visibility_orders=(),
        **QUICK | {"count": 3},
    )
    assert [row.name for row in found.rows] == [
        "exit, output order 3",
        "exit, output order 2, zero",
        "incident, output order 2",
    ]
    assert found.title == "phong:3, order 2, 16 glossy receivers"
    assert torch.isfinite(torch.tensor([row.error for row in found.rows])).all()
