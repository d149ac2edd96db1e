"""Writing files so that a reader never sees half of one."""

import contextlib
import errno
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from torchprt.errors import InputError
from torchprt.suffixes import nearest
from torchprt.words import either

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextlib.contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside `path` that is renamed to `path` if the block succeeds, removed if it does not.

    The temporary name keeps the suffix of `path`, because writers choose the format by it.
    Raises InputError if the folder does not exist or cannot be written, or if the disk is full.
    """
    target = Path(path)
    if target.is_dir():
        raise InputError(f"{target} is a folder: give the name of a file to write")
    try:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}.", suffix=target.suffix)
    except OSError as fault:
        raise InputError(f"{target} cannot be written ({fault.strerror}): choose another folder") from fault
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes private files; give the result the permissions that any new file would have.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(target)
    except Exception as fault:
        reason = no_room(fault)
        if reason is None:
            raise
        raise InputError(f"{target} cannot be written ({reason}): free some space, then do the same again") from fault
    finally:
        temporary.unlink(missing_ok=True)


def no_room(fault: Exception) -> str | None:
    """What the system says of a disk that is full, or a quota, if that is the fault of a writer; None if it is not."""
    number = fault.errno if isinstance(fault, OSError) else None
    if number is None:
        # Writers in Rust leave it in their text, numpy only says how much it wrote.
        said = re.search(r"\(os error (\d+)\)", str(fault))
        short = isinstance(fault, OSError) and re.fullmatch(r"\d+ requested and \d+ written", str(fault))
        number = int(said[1]) if said else errno.ENOSPC if short else None
    return os.strerror(number) if number in NO_ROOM else None


def check_writable(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    """`path`, if a file of one of `suffixes` could be written there: asked before long work, not after it.

    Raises InputError if it could not.
    """
    target = Path(path)
    if target.suffix.lower() not in suffixes:
        near = nearest(target.suffix, suffixes) if target.suffix else None
        hint = f", as {target.with_suffix(near)}" if near else ""
        raise InputError(f"{target} must end in {either(suffixes)}{hint}")
    if target.is_dir():
        raise InputError(f"{target} is a folder: give the name of a file to write")
    if not target.parent.is_dir():
        raise InputError(f"{target} cannot be written: the folder {target.parent} does not exist, make it first")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{target} cannot be written: no permission in {target.parent}, choose another folder")
    return target
