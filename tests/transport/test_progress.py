"""Is a rate told in a unit that says something?"""

import pytest

from torchprt.progress import PROGRESS, QUIET, Parts
from torchprt.transport.progress import Bar, rate


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


def test_programs_read_a_line_for_each_per_cent_of_a_stage(monkeypatch, capsys):
    monkeypatch.setenv(PROGRESS, "lines")
    monkeypatch.delenv(QUIET, raising=False)
    with Bar() as bar:
        bar.start("direct", 1000, 500)
        for _ in range(100):
            bar.advance(5)
        bar.start("bounce 1", 0)
    found = capsys.readouterr().err.splitlines()
    assert found == [f"direct {share}%" for share in range(50, 101)] + ["bounce 1 100%"]


def test_nothing_is_told_to_programs_where_all_shall_be_quiet(monkeypatch, capsys):
    monkeypatch.setenv(PROGRESS, "lines")
    monkeypatch.setenv(QUIET, "1")
    with Bar() as bar:
        bar.start("direct", 10)
        bar.advance(10)
    assert capsys.readouterr().err == ""
