"""Counts and choices in words."""

from __future__ import annotations

from collections.abc import Sequence

_PLURALS = {"vertex": "vertices", "axis": "axes"}


def either(words: Sequence[str]) -> str:
    """ "a", "a or b", "a, b or c"."""
    *before, last = words
    return f"{', '.join(before)} or {last}" if before else last


def count(number: int, noun: str, plural: str = "") -> str:
    """`number` and its noun, in the plural unless it is 1: "1 bounce", "2 bounces", "0 vertices", "3 glossy axes".

    The last word of `noun` becomes plural, or all of it `plural`.
    """
    if number == 1:
        return f"1 {noun}"
    *before, last = noun.split(" ")
    return f"{number} {plural or ' '.join([*before, _PLURALS.get(last, last + 's')])}"
