"""Does a reader ever see half a file?"""

import errno
import os
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from faults import room_for
from safetensors.torch import save_file

import torchprt
from torchprt.errors import InputError
from torchprt.files import CannotWrite, atomic, check_writable, fault_of_disk

ROOT = Path(torchprt.__file__).parents[1]


def half_write(path, fault):
    with atomic(path) as temporary:
        temporary.write_text("half")
        assert path.read_text() == "former"
        raise fault


@pytest.mark.parametrize("fault", [RuntimeError, KeyboardInterrupt])
def test_a_failure_leaves_the_former_file_and_nothing_beside_it(fault, tmp_path):
    path = tmp_path / "a.bin"
    path.write_text("former")
    with pytest.raises(fault):
        half_write(path, fault)
    assert path.read_text() == "former"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.bin"]


def test_success_replaces_the_former_file_at_once(tmp_path):
    path = tmp_path / "a.bin"
    path.write_text("former")
    with atomic(path) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".bin"
        assert temporary.parent == tmp_path
    assert path.read_text() == "new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.bin"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has other permissions")
def test_the_file_has_the_permissions_of_any_new_file(tmp_path):
    before = os.umask(0o027)
    try:
        with atomic(tmp_path / "a.bin"):
            pass
        # It puts a private file of its own in the place of the one that is there.
        with atomic(tmp_path / "b.bin") as temporary:
            save_file({"a": torch.zeros(3)}, temporary)
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(before)
    for name in ("a.bin", "b.bin"):
        assert stat.S_IMODE((tmp_path / name).stat().st_mode) == 0o640


def test_refuses_a_folder_and_a_place_in_a_folder_that_is_missing(tmp_path):
    for path, words in ((tmp_path, "is a folder"), (tmp_path / "none" / "a.bin", "cannot be written")):
        with pytest.raises(InputError, match=words), atomic(path):
            pytest.fail("there is nothing to write to")
    assert not list(tmp_path.iterdir())


def test_asking_whether_a_file_can_be_written_writes_none(tmp_path):
    assert check_writable(tmp_path / "a.NPY", (".npy", ".ply")) == tmp_path / "a.NPY"
    for name, words in (
        ("a.txt", r"a\.txt must end in \.npy or \.ply"),
        ("a", "must end in"),
        ("none/a.npy", "make it"),
    ):
        with pytest.raises(InputError, match=words):
            check_writable(tmp_path / name, (".npy", ".ply"))
    assert not list(tmp_path.iterdir())
    (tmp_path / "b.npy").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        check_writable(tmp_path / "b.npy", (".npy",))
    (tmp_path / "c").write_text("a file, not a folder")
    with pytest.raises(InputError, match="c is a file, not a folder"):
        check_writable(tmp_path / "c" / "a.npy", (".npy",))


def test_names_without_a_folder_are_of_the_folder_one_is_in(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check_writable("a.npy", (".npy",))
    with atomic("a.npy") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "a.npy").read_text() == "new"


KILLED = """
import os, signal, sys
from torchprt.files import atomic

with atomic(sys.argv[1]) as temporary:
    temporary.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_a_process_that_is_killed_in_the_middle_leaves_the_former_file(tmp_path):
    path = tmp_path / "a.bin"
    path.write_text("former")
    ended = subprocess.run([sys.executable, "-c", KILLED, path], capture_output=True, timeout=120, cwd=ROOT)
    assert ended.returncode == -9, ended
    assert path.read_text() == "former"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of the size of files")
@pytest.mark.parametrize(
    ("writer", "number"),
    [
        (lambda to: to.write_bytes(bytes(8192)), errno.EFBIG),
        (lambda to: save_file({"a": torch.zeros(4096)}, to), errno.EFBIG),
        # numpy does not know why it wrote less than it should.
        (lambda to: np.zeros(4096).tofile(to), errno.ENOSPC),
    ],
    ids=["python", "safetensors", "numpy"],
)
def test_a_disk_without_room_is_a_sentence_and_leaves_the_former_file(writer, number, tmp_path):
    path = tmp_path / "a.npy"
    path.write_text("former")
    with room_for(4096), pytest.raises(CannotWrite) as caught, atomic(path) as temporary:
        writer(temporary)
    reason = os.strerror(number)
    assert str(caught.value) == f"{path} cannot be written ({reason}): free some space, then do the same again"
    assert path.read_text() == "former"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.npy"]


@pytest.mark.parametrize(
    ("fault", "number"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), errno.ENOSPC),
        (RuntimeError("I/O error: No space left on device (os error 28)"), errno.ENOSPC),
        (RuntimeError('Failed to write pixel data to image file "a.exr". No space left on device.'), errno.ENOSPC),
        (OSError("9 requested and 3 written"), errno.ENOSPC),
        (OSError(errno.EACCES, "Permission denied"), errno.EACCES),
        (RuntimeError("Permission denied (os error 13)"), errno.EACCES),
        (ValueError("28"), None),
        (ValueError("9 requested and 3 written"), None),
        (RuntimeError("a bug"), None),
    ],
)
def test_only_faults_of_the_disk_are_told_as_such(fault, number):
    said = fault_of_disk(fault)
    assert (said and said[0]) == (None if number is None else os.strerror(number))
