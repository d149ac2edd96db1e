"""How much memory there is, to refuse what does not fit before it begins."""

from __future__ import annotations

import os
from pathlib import Path

from torchprt.errors import InputError

_LIMIT, _USED = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")


def available() -> int | None:
    """Bytes that can be had without swapping, also where a container may have less than its machine; None if the system
    does not say."""
    found = [each for each in (_of_machine(), _of_container()) if each is not None]
    return min(found) if found else None


def check_memory(needed: int, what: str, instead: str) -> None:
    """Raises InputError if `needed` bytes are more than there are: `what` needs them, what to do `instead`."""
    free = available()
    if free is not None and needed > free:
        raise InputError(f"{what} needs about {needed / 2**30:.1f} GB, and {free / 2**30:.1f} GB are free: {instead}")


def _of_machine() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None


def _of_container() -> int | None:
    try:
        return int(_LIMIT.read_text()) - int(_USED.read_text())
    except (OSError, ValueError):
        return None
