"""Is a rate told in a unit that says something?"""

import pytest

from torchprt.progress import Parts
from torchprt.transport.progress import rate


@pytest.mark.parametrize(
    ("speed", "said"),
    [
        (0.04, "0.0 /s"),
        (0.4, "0.4 /s"),
        (12.3, "12 /s"),
        (999.0, "999 /s"),
        (1000.0, "1.0 k/s"),
        (45_600.0, "46 k/s"),
        (11_200_000.0, "11 M/s"),
    ],
)
def test_a_rate_has_the_unit_that_fits(speed, said):
    assert rate(speed) == said


def test_parts_are_one_work():
    told = []

    class Told:
        def start(self, stage, total, done=0):
            told.append((stage, total, done))

        def advance(self, count):
            told.append(count)

    parts = Parts(Told(), 3)
    for _ in range(3):
        parts.start("lobes", 10)
        parts.advance(10)
    assert told == [("lobes", 30, 0), 10, 10, 10]
