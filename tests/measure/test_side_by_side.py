"""Are times shared by recipes that take the same, and told in the time of one base?"""

import pytest

from torchprt.measure.keep import Kept
from torchprt.measure.recipe import Recipe
from torchprt.measure.side_by_side import SideBySide
from torchprt.measure.time import Timing

BASE = Recipe(5, 256, bounces=2)


@pytest.fixture
def times(tmp_path):
    return SideBySide(Kept(tmp_path), BASE, lambda recipe: {"subject": "a", "channels": 3 if recipe.bounces else 1})


@pytest.mark.parametrize(
    "changes", [{"rays": 64}, {"bounces": 1}, {"window": "hann"}], ids=lambda changes: next(iter(changes))
)
def test_values_take_no_other_time(times, changes):
    assert times.key(BASE.replace(**changes)) == times.key(BASE)


@pytest.mark.parametrize(
    "changes",
    [
        {"order": 4},
        {"bounces": 0},
        {"dtype": "float16"},
        {"runtime": "onnx"},
        {"clusters": 4, "components": 2},
        {"lobes": 2},
        {"frame": "exit", "output_order": 3},
        {"frame": "exit", "factors": 2},
        {"adaptive": 0.1},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_shapes_and_runtimes_do(times, changes):
    assert times.key(BASE.replace(**changes)) != times.key(BASE)


def test_another_scene_and_another_base_have_times_of_their_own(times, tmp_path):
    other = SideBySide(Kept(tmp_path), BASE, lambda recipe: {"subject": "b", "channels": 1})
    beside = SideBySide(Kept(tmp_path), BASE.replace(order=3), lambda recipe: {"subject": "a", "channels": 3})
    assert len({times.key(BASE), other.key(BASE), beside.key(BASE)}) == 3


def test_what_was_timed_is_known_and_all_is_in_the_time_of_one_base(times, monkeypatch):
    small, large = BASE.replace(order=2), BASE.replace(order=8)
    # While the second two are timed the machine is twice as slow.
    said = iter([{"small": 1.0, "base": 2.0}, {"large": 8.0, "base": 4.0}])

    def timed(functions, rounds):
        found = next(said)
        named = dict(zip(functions, found.values(), strict=True))
        return {name: Timing(value, 0.1, value, rounds) for name, value in named.items()}

    monkeypatch.setattr("torchprt.measure.side_by_side.time_it", timed)
    assert not times.known(small)
    times.time({small: lambda: 0}, lambda: 0)
    times.time({large: lambda: 0}, lambda: 0)
    assert times.known(small)
    assert times.known(small.replace(rays=1))
    found = times.timings([small, large])
    # The base in the middle takes 3.
    assert [timing.median for timing in found] == [1.5, 6.0]
    assert [timing.best for timing in found] == [1.5, 6.0]
    assert found[0].spread == 0.1
