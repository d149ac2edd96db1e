"""Writing files so that a reader never sees half of one, and a fault of the disk is one sentence."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from torchprt.errors import InputError
from torchprt.suffixes import nearest
from torchprt.words import either

if TYPE_CHECKING:
    import numpy as np

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FREE = "free some space, then do the same again"
_ELSEWHERE = "choose another folder"
# What to do, by what the system says; for all else another folder is worth trying.
_ADVICE = {
    **dict.fromkeys(NO_ROOM, _FREE),
    errno.EACCES: "choose another folder, or change its permissions",
    errno.EPERM: "choose another folder, or change its permissions",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.EMFILE: "raise the limit of open files (ulimit -n), then do the same again",
}
# Faults that libraries may pass on as the words of the system alone.
_IN_WORDS = (*NO_ROOM, errno.EACCES, errno.EPERM, errno.EROFS, errno.EIO)


class CannotWrite(InputError):
    """A file or folder that the system does not let be written: its `path`, the `reason`, and what to do about it."""

    def __init__(self, path: str | os.PathLike[str], reason: str, advice: str):
        super().__init__(f"{path} cannot be written ({reason}): {advice}")
        self.path, self.reason, self.advice = Path(path), reason, advice

    def __reduce__(self) -> tuple[type[CannotWrite], tuple[Path, str, str]]:
        # Workers are other processes.
        return CannotWrite, (self.path, self.reason, self.advice)


@contextlib.contextmanager
def atomic(path: str | os.PathLike[str], *, durable: bool = True) -> Iterator[Path]:
    """A temporary path beside `path` that is renamed to `path` if the block succeeds, removed if it does not.

    The temporary name keeps the suffix of `path`, because writers choose the format by it. If `path` is a link, what it
    points to is written. Unless `durable` is False the content has reached the disk before it takes its name: some
    file systems find only then that there is no room, and a loss of power leaves the former file or the new one.

    Raises InputError if `path` is a folder, a device or protected, if its folder does not exist or cannot be written,
    and (CannotWrite) if the system or a library says while writing that the disk is full or something else is wrong.
    """
    named = Path(path)
    target = _target(named)
    # Not of `tempfile`, whose files are private: this one has the permissions of any new file.
    temporary = target.with_name(f".{target.stem[:32]}.{os.urandom(8).hex()}{target.suffix}")
    with sentences(named):
        try:
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            mode = temporary.stat().st_mode
            yield temporary
            # Writers may have put a private file of their own in its place.
            temporary.chmod(stat.S_IMODE(mode))
            if durable:
                _to_disk(temporary)
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)


def write(path: str | os.PathLike[str], content: bytes) -> None:
    """Writes `content` as by `atomic`: for libraries that do not notice when the disk takes only a part."""
    with atomic(path) as temporary:
        temporary.write_bytes(content)


def write_array(path: str | os.PathLike[str], array: np.ndarray) -> None:
    """Writes an `.npy`, whatever the suffix; numpy itself does not notice when a disk does not take the last part."""
    import numpy

    stream = io.BytesIO()
    numpy.save(stream, array)
    write(path, stream.getvalue())


@contextlib.contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """An empty folder that takes the place of `path` if the block succeeds, and is removed with all in it if not.

    A former folder `path` is put away as a whole, and stays as it is if the block fails. Parents are made.
    Raises InputError as `atomic` does; a fault of a file in the new folder is told of its place under `path`.
    """
    target = Path(path)
    if target.exists() and not target.is_dir():
        raise InputError(f"{target} is a file: give the name of a folder")
    with sentences(target):
        make_folder(target.parent)
        scratch = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name[:32]}."))
        made, former = scratch / "new", scratch / "former"
        try:
            os.mkdir(made)
            yield made
            _exchange(target, made, former)
        except CannotWrite as fault:
            if not fault.path.is_relative_to(made):
                raise
            raise CannotWrite(target / fault.path.relative_to(made), fault.reason, fault.advice) from fault
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


def _exchange(target: Path, made: Path, former: Path) -> None:
    """Puts a folder in the place of another, or leaves that where it is."""
    if not target.exists():
        os.rename(made, target)
        return
    os.rename(target, former)
    try:
        os.rename(made, target)
    except BaseException:
        os.rename(former, target)
        raise


def make_folder(path: str | os.PathLike[str]) -> Path:
    """`path`, made with its parents if it is not there. Raises InputError if it cannot be made."""
    folder = Path(path)
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError as fault:
        raise InputError(f"{folder} cannot be made ({fault.strerror}): {_advice(fault.errno)}") from fault
    return folder


def temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder for what nobody keeps, in the system's place for such; InputError if there is no room for one."""
    try:
        return tempfile.TemporaryDirectory(prefix="torchprt-")
    except OSError as fault:
        raise no_temporary(str(fault.strerror)) from fault


def no_temporary(reason: str) -> CannotWrite:
    """That files which nobody keeps cannot be written."""
    try:
        place = tempfile.gettempdir()
    except OSError:
        place = "a temporary file"
    return CannotWrite(place, reason, "free some space there, or set TMPDIR to a folder with more")


@contextlib.contextmanager
def sentences(path: str | os.PathLike[str]) -> Iterator[None]:
    """What goes wrong with the disk in the block, while `path` is written, is one sentence: CannotWrite.

    Also what libraries make of it. Everything else is passed on as it is.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as fault:
        said = fault_of_disk(fault)
        if said is None:
            raise
        raise CannotWrite(path, *said) from fault


def fault_of_disk(fault: Exception) -> tuple[str, str] | None:
    """What the system says of a disk that does not take a file, and what to do; None if that is not the fault."""
    number = fault.errno if isinstance(fault, OSError) else None
    if number is None:
        number = _number_in(str(fault), isinstance(fault, OSError))
    if number is not None:
        return os.strerror(number), _advice(number)
    return (str(fault), _FREE) if isinstance(fault, OSError) and str(fault) else None


def _number_in(text: str, of_system: bool) -> int | None:
    """The number of a fault that a library tells in words of its own."""
    # Writers in Rust leave the number, OpenEXR the words, numpy only says how much it wrote.
    if said := re.search(r"\(os error (\d+)\)", text):
        return int(said[1])
    if of_system and re.fullmatch(r"\d+ requested and \d+ written", text):
        return errno.ENOSPC
    return next((number for number in _IN_WORDS if os.strerror(number) in text), None)


def _advice(number: int | None) -> str:
    return _ADVICE.get(number or 0, _ELSEWHERE)


def _to_disk(path: Path) -> None:
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _target(named: Path) -> Path:
    """The file that is written for a name. InputError if the system would refuse it, or it is no place for a file."""
    target = Path(os.path.realpath(named)) if os.path.islink(named) else named
    # Not of `Path`, which raises what the system says of names that are too long.
    if os.path.isdir(target):
        raise InputError(f"{named} is a folder: give the name of a file to write")
    if not os.path.isdir(target.parent):
        above = next((each for each in target.parents if os.path.lexists(each)), target.parent)
        if os.path.exists(above) and not os.path.isdir(above):
            raise InputError(f"{named} cannot be written: {above} is a file, not a folder, choose another folder")
        raise InputError(f"{named} cannot be written: the folder {target.parent} does not exist, make it first")
    if len(os.fsencode(target.name)) > _longest(target.parent):
        raise CannotWrite(named, os.strerror(errno.ENAMETOOLONG), _ADVICE[errno.ENAMETOOLONG])
    if os.path.exists(target):
        if not stat.S_ISREG(os.stat(target).st_mode):
            raise InputError(f"{named} is a pipe or a device: give the name of a file to write")
        if not os.access(target, os.W_OK):
            raise InputError(f"{named} cannot be written: it is protected, choose another name")
    return target


def _longest(folder: Path) -> int:
    """Bytes of a name, at most."""
    try:
        return os.pathconf(folder, "PC_NAME_MAX")
    except (OSError, ValueError, AttributeError):
        return 255


def check_writable(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    """`path`, if a file of one of `suffixes` could be written there: asked before long work, not after it.

    Raises InputError if it could not.
    """
    named = Path(path)
    if named.suffix.lower() not in suffixes:
        near = nearest(named.suffix, suffixes) if named.suffix else None
        hint = f", as {named.with_suffix(near)}" if near else ""
        raise InputError(f"{named} must end in {either(suffixes)}{hint}")
    target = _target(named)
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{named} cannot be written: no permission in {target.parent}, choose another folder")
    with sentences(named), tempfile.TemporaryFile(dir=target.parent):
        # Some folders take no files whatever their permissions say.
        return named
