"""Is the front what nobody beats, and is what half the cost loses told right?"""

import itertools
import random

import pytest

from torchprt.measure.front import Point, amount, apart, front, fronts, halved, percent
from torchprt.measure.recipe import Recipe
from torchprt.measure.time import Timing


def point(error, milliseconds, size=100, **changes):
    seconds = milliseconds / 1e3
    return Point(Recipe(**changes), error, 40.0, 0.1, Timing(seconds, 0.0, seconds, 1), size)


def test_of_nothing_there_is_no_front():
    assert front([], "seconds") == []
    assert fronts([]) == []
    assert str(halved([], point(0.1, 1.0), "bytes")) == "half the bytes: nothing that was tried is so cheap"


def test_nobody_beats_a_point_of_the_front_and_all_others_are_beaten():
    generator = random.Random(0)
    points = [
        point(generator.choice([0.01, 0.02, 0.05, 0.1]) * generator.uniform(0.5, 2), generator.uniform(1, 10), rays=n)
        for n in range(1, 200)
    ]
    line = front(points, "seconds")
    assert [each.seconds for each in line] == sorted(each.seconds for each in line)
    assert all(after.error < 0.99 * before.error for before, after in itertools.pairwise(line))
    for each in points:
        # Itself, or one that costs no more and errs no more than 1 % more.
        assert any(other.seconds <= each.seconds and 0.99 * other.error <= each.error for other in line)


def test_errors_that_differ_by_rounding_are_one():
    cheap, dear = point(0.1000001, 1.0), point(0.1, 2.0, order=6)
    assert front([dear, cheap], "seconds") == [cheap]


def test_both_fronts_count_and_the_least_error_comes_first():
    fast = point(0.2, 1.0, 1000, order=2)
    small = point(0.1, 9.0, 10, order=3)
    exact = point(0.01, 5.0, 5000, order=8)
    beaten = point(0.2, 9.0, 5000, order=7)
    assert fronts([beaten, fast, small, exact]) == [exact, small, fast]


def test_half_the_cost_is_the_best_that_is_so_cheap():
    base = point(0.013, 1.0)
    points = [base, point(0.02, 0.6, order=4), point(0.03, 0.5, order=3), point(0.09, 0.1, order=2)]
    half = halved(points, base, "seconds")
    assert half.point is points[2]
    assert str(half) == "half the time: error 1.3 % -> 3 %, with order 3"
    assert halved(points, base, "seconds", 4).point is points[3]
    assert str(halved(points, base, "seconds", 8)) == "an eighth of the time: error 1.3 % -> 9 %, with order 2"
    assert halved(points, base, "seconds", 16).point is None


def test_of_equal_errors_half_the_cost_is_the_cheapest():
    base = point(0.1, 4.0)
    points = [base, point(0.05, 2.0, order=6), point(0.0502, 1.0, runtime="onnx")]
    half = halved(points, base, "seconds")
    assert half.point is points[2]
    assert "(nothing lost)" in str(half)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "all as in the base"),
        ({"order": 3, "runtime": "onnx"}, "order 3, onnx"),
        ({"bounces": 0}, "0 bounces"),
        ({"bounces": 1}, "1 bounce"),
        ({"bounces": 0, "shadows": False}, "unshadowed"),
        ({"window": "none"}, "no hann"),
    ],
)
def test_a_recipe_is_told_by_what_is_other(changes, said):
    base = Recipe(5, 1024, bounces=3, window="hann")
    assert apart(base.replace(**changes), base) == said


def test_errors_and_costs_are_said_as_they_are_read():
    assert [percent(error) for error in (0.0, 0.00042, 0.0131, 0.131, 0.9949, 1.31)] == [
        "0 %", "0.042 %", "1.3 %", "13 %", "99 %", "131 %"
    ]  # fmt: skip
    assert amount("seconds", 4.1e-4) == "0.41 ms"
    assert [amount("bytes", size) for size in (12.0, 870.0 * 2**10, 3.5 * 2**20)] == ["12 B", "870 kB", "3.5 MB"]
