"""Does the timing helper run what it says, in turns?"""

import pytest

from torchprt.errors import InputError
from torchprt.measure import time_it
from torchprt.measure.time import _timing


def test_refuses_no_functions_and_no_rounds():
    with pytest.raises(InputError, match="no functions"):
        time_it({})
    with pytest.raises(InputError, match="rounds must be at least 1, not 0"):
        time_it({"a": lambda: None}, rounds=0)


def test_rounds_are_interleaved():
    calls = []
    found = time_it({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, rounds=3, seconds=0.0)
    # Twice each to warm up and to see how long a call takes, then in turns.
    assert "".join(calls) == "aabb" + 3 * "ab"
    assert list(found) == ["a", "b"]
    assert found["a"].rounds == 3


def test_summarises_by_the_median_and_the_quartiles():
    timing = _timing([1.0, 2.0, 3.0, 4.0, 100.0])
    assert (timing.median, timing.best, timing.rounds) == (3.0, 1.0, 5)
    # Exclusive quartiles 1.5 and 52.
    assert timing.spread == pytest.approx((52 - 1.5) / 2 / 3)
    assert _timing([2.0]).spread == 0
    assert _timing([0.0, 0.0]).spread == 0
