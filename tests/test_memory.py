"""Is what does not fit refused before it begins?"""

import pytest

from torchprt import memory
from torchprt.errors import InputError


def test_a_machine_says_how_much_memory_it_has() -> None:
    free = memory.available()
    assert free is None or 1 << 20 < free < 1 << 50


def test_what_does_not_fit_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: 3 << 30)
    memory.check_memory(3 << 30, "a map", "give fewer texels")
    with pytest.raises(InputError, match=r"a map needs about 4.0 GB, and 3.0 GB are free: give fewer texels"):
        memory.check_memory(4 << 30, "a map", "give fewer texels")


def test_where_nothing_is_known_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: None)
    memory.check_memory(1 << 60, "a map", "give fewer texels")
