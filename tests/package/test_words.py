"""Is one thing one, and are several things several?"""

import pytest

from torchprt.words import count, either


@pytest.mark.parametrize(
    ("number", "noun", "said"),
    [
        (1, "bounce", "1 bounce"),
        (0, "bounce", "0 bounces"),
        (2, "vertex", "2 vertices"),
        (1, "vertex", "1 vertex"),
        (12, "shared axis", "12 shared axes"),
        (21, "glossy receiver", "21 glossy receivers"),
    ],
)
def test_a_count_agrees_with_its_noun(number, noun, said):
    assert count(number, noun) == said


def test_choices_are_told_as_people_do():
    assert [either("abc"[:length]) for length in (1, 2, 3)] == ["a", "a or b", "a, b or c"]


def test_another_plural_is_taken_as_it_is():
    assert count(3, "function of the eye", "functions of the eye") == "3 functions of the eye"
    assert count(1, "function of the eye", "functions of the eye") == "1 function of the eye"
