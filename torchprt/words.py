"""Counts in words: one is not several."""

from __future__ import annotations

_PLURALS = {"vertex": "vertices", "axis": "axes"}


def count(number: int, noun: str, plural: str = "") -> str:
    """`number` and its noun, in the plural unless it is 1: "1 bounce", "2 bounces", "0 vertices", "3 glossy axes".

    The last word of `noun` becomes plural, or all of it `plural`.
    """
    if number == 1:
        return f"1 {noun}"
    *before, last = noun.split(" ")
    return f"{number} {plural or ' '.join([*before, _PLURALS.get(last, last + 's')])}"
