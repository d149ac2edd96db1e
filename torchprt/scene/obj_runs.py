"""Runs of lines of an .obj file that are all of one shape, read at once."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

# Fewer lines are as fast one by one.
LEAST = 64
_NUMBER, _SPACE, _OTHER = b"0", b" ", b"?"


def _classes() -> np.ndarray:
    """What each byte stands for in the shape of a line."""
    table = np.full(256, ord(_OTHER), np.uint8)
    table[list(b"0123456789+-.eE")] = ord(_NUMBER)
    table[list(b" \t")] = ord(_SPACE)
    for byte in b"\n/":
        table[byte] = byte
    return table


_CLASSES = _classes()


def numbers(lines: Sequence[str]) -> np.ndarray | None:
    """The numbers `[L, k]` of lines that have k each after their keyword; None if they are not all of one shape, or any
    is more than numbers and spaces."""
    body = _body(lines)
    shape = None if body is None else _shape(body, len(lines))
    if body is None or shape is None or b"/" in shape:
        return None
    return _read(body, np.float64, len(lines), shape)


def corners(lines: Sequence[str]) -> np.ndarray | None:
    """The corners `[L, k, 3]` of faces of k: vertex, normal and texture coordinates, from 1; 0 for none. None if the
    lines are not all of one shape, or some index counts from the end, or is 0."""
    body = _body(lines)
    if body is None or any(each in body for each in b"+-.eE"):
        return None
    shape = _shape(body, len(lines))
    if shape is None:
        return None
    each = shape.split()
    forms = {b"0": [0], b"0/0": [0, 2], b"0//0": [0, 1], b"0/0/0": [0, 2, 1]}
    if len(set(each)) != 1 or each[0] not in forms:
        return None
    found = _read(body.replace(b"/", b" "), np.int64, len(lines), shape)
    if found is None or not (found > 0).all():
        return None
    made = np.zeros((len(lines), len(each), 3), np.int64)
    made[..., forms[each[0]]] = found.reshape(len(lines), len(each), -1)
    return made


def _body(lines: Sequence[str]) -> bytes | None:
    """The lines without their keywords, which are all as long; None where there are letters of other alphabets."""
    start = len(lines[0].split(None, 1)[0])
    try:
        return ("\n".join([line[start:] for line in lines]) + "\n").encode("ascii")
    except UnicodeEncodeError:
        return None


def _shape(body: bytes, count: int) -> bytes | None:
    """The shape that all of `count` lines have: "0" for a number, single spaces; None if they differ."""
    kinds = _CLASSES[np.frombuffer(body, np.uint8)]
    # Of a number, or of spaces, the first byte stands for all.
    again = np.zeros(len(kinds), bool)
    again[1:] = (kinds[1:] == kinds[:-1]) & ((kinds[1:] == ord(_NUMBER)) | (kinds[1:] == ord(_SPACE)))
    kinds = kinds[~again]
    # Spaces at the end say nothing.
    trailing = np.zeros(len(kinds), bool)
    trailing[:-1] = (kinds[:-1] == ord(_SPACE)) & (kinds[1:] == ord("\n"))
    kinds = kinds[~trailing]
    if len(kinds) % count:
        return None
    rows = kinds.reshape(count, -1)
    first = rows[0].tobytes()
    if _OTHER in first or not first.endswith(b"\n") or b"\n" in first[:-1] or not (rows == rows[0]).all():
        return None
    return first


def _read(body: bytes, dtype: type, count: int, shape: bytes) -> np.ndarray | None:
    width = shape.count(_NUMBER)
    if not width:
        return None
    with warnings.catch_warnings():
        # What is no number ("1.2.3") is a warning, and told of by whoever reads the lines one by one.
        warnings.simplefilter("error")
        try:
            found: np.ndarray = np.fromstring(body.decode("ascii"), dtype=dtype, sep=" ")
        except (DeprecationWarning, ValueError, OverflowError):
            return None
    return found.reshape(count, width) if len(found) == count * width else None
