"""Is a compression one bar, which never goes back and ends full?"""

import pytest
from transfers import random_glossy

from torchprt.cli.one_bar import LENGTH, OneBar
from torchprt.compression import compress


class Bar:
    def __init__(self):
        self.started, self.steps = [], []

    def start(self, stage, total, done=0):
        self.started.append((stage, total, done))

    def advance(self, count):
        self.steps.append(count)


@pytest.mark.parametrize("searching", [False, True])
def test_stages_never_go_back_nor_beyond_the_end(searching):
    bar = Bar()
    told = OneBar(bar, "compress", searching)
    stages = ["sampling"] * searching + ["clusters", "growing", "growing", "dropping", "refining", "weights"] * 6
    for stage in stages:
        # One that goes on from before, and one that has nothing to do.
        told.start(stage, 100, 30)
        told.advance(70)
        told.start(stage, 0)
        assert sum(bar.steps) < LENGTH
    told.end()
    told.end()
    assert bar.started == [("compress", LENGTH, 0)]
    assert sum(bar.steps) == LENGTH
    assert min(bar.steps) > 0


def test_nothing_done_is_no_bar():
    bar = Bar()
    OneBar(bar, "compress", False).end()
    assert not bar.started
    assert not bar.steps


@pytest.mark.parametrize("sizes", [{"clusters": 4, "components": 2}, {"error": 0.5}])
def test_a_compression_moves_it_in_many_steps(sizes):
    bar = Bar()
    told = OneBar(bar, "compress", "error" in sizes)
    compress(random_glossy(vertices=600), report=told, **sizes)
    told.end()
    assert len(bar.started) == 1
    assert sum(bar.steps) == LENGTH
    assert len(bar.steps) > 5
