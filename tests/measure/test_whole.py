"""Does the bar of a sweep go forward only, to its end and no earlier?"""

import pytest

from torchprt.measure.whole import Whole


class Listener:
    def __init__(self):
        self.stages, self.told = [], []

    def start(self, stage, total, done=0):
        self.stages.append((stage, total, done))

    def advance(self, count):
        self.told.append(count)


@pytest.fixture
def heard():
    return Listener()


def test_of_nothing_it_is_full_at_once(heard):
    whole = Whole(heard, "sweep", 0.0)
    whole.end()
    assert heard.stages == [("sweep", 1, 0)]
    assert sum(heard.told) == 1


def test_it_only_goes_forward_and_is_full_at_the_end_alone(heard):
    whole = Whole(heard, "sweep", 10.0)
    for _ in range(3):
        with whole.step(5.0) as step:
            for stage in range(4):
                step.start(f"stage {stage}", 7)
                for _ in range(9):
                    # More than was announced.
                    step.advance(1)
        # Longer than the whole was said to be.
        assert sum(heard.told) < 100
    whole.end()
    assert sum(heard.told) == 100
    assert all(count > 0 for count in heard.told)
    assert len(heard.stages) == 1


def test_stages_move_it_within_their_step(heard):
    whole = Whole(heard, "sweep", 20.0)
    with whole.step(10.0) as step:
        step.start("first", 10, 5)
        assert sum(heard.told) == pytest.approx(30, abs=1)
        step.advance(5)
        assert sum(heard.told) == pytest.approx(60, abs=1)
        step.start("second", 0)
        assert sum(heard.told) == pytest.approx(60, abs=1)
    assert sum(heard.told) == pytest.approx(100, abs=1)


def test_what_is_left_is_filled_by_what_is_expected(heard):
    whole = Whole(heard, "sweep", 20.0)
    with whole.step(10.0):
        pass
    whole.expect(100.0)
    with whole.step(50.0):
        pass
    assert sum(heard.told) == pytest.approx(150, abs=1)


def test_a_step_that_fails_is_not_done(heard):
    whole = Whole(heard, "sweep", 10.0)
    with pytest.raises(KeyboardInterrupt), whole.step(5.0):
        raise KeyboardInterrupt
    assert sum(heard.told) == 0
