"""Whatever Python code writes: is a disk at fault one sentence, and what was there before kept?"""

import errno
import os
import pickle
import sys

import numpy as np
import pytest
import torch
from faults import everything, room_for
from transfers import stored

import torchprt as prt
from torchprt import files, light, preview
from torchprt.compression import compress
from torchprt.demo import write_environment
from torchprt.errors import InputError
from torchprt.files import CannotWrite, atomic, atomic_folder, make_folder, write, write_array
from torchprt.measure import Table
from torchprt.scene import samples
from torchprt.transport import Processes, bake

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of the size of files")


def table():
    rows = Table("of nothing")
    for number in range(20):
        rows.add(f"row {number}", error=0.1, seconds=0.5, bytes=number)
    return rows


NOISE = torch.from_numpy(np.random.default_rng(0).random((48, 64, 3), np.float32))
WRITERS = {
    "a.safetensors": lambda path, transfer: prt.save_transfer(transfer, path),
    "a.npy": lambda path, _: light.write_coefficients(torch.rand(256, 3), path),
    "b.npy": lambda path, _: write_array(path, np.zeros(999)),
    "a.png": lambda path, _: preview.save_png(NOISE, path),
    "b.png": lambda path, _: preview.save_picture(NOISE, path),
    "a.jpg": lambda path, _: preview.save_picture(NOISE, path),
    "a.webp": lambda path, _: preview.save_movie([NOISE, NOISE.flip(0)], path),
    "a.gif": lambda path, _: preview.save_gif([NOISE, NOISE.flip(0)], path),
    "a.mp4": lambda path, _: preview.save_mp4([NOISE, NOISE.flip(0)], path),
    "c.png": lambda path, transfer: preview.look(transfer, size=(64, 48)).save(path),
    "a.ply": lambda path, transfer: preview.save_ply(transfer.positions, transfer.faces, transfer.positions, path),
    "a.glb": lambda path, transfer: preview.save_glb(transfer.positions, transfer.normals, transfer.faces, path),
    "b.glb": lambda path, transfer: preview.save_transfer_glb(transfer, path, 2),
    "c.glb": lambda path, _: samples.write_painted_vase(path, 16),
    "a.exr": lambda path, _: write_environment(NOISE, path),
    "a.csv": lambda path, _: table().to_csv(path),
    "a.json": lambda path, _: table().to_json(path),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_writer_on_a_disk_without_room(name, make_transfer, tmp_path):
    path, transfer = tmp_path / name, make_transfer(side=6)
    WRITERS[name](path, transfer)
    size = path.stat().st_size
    path.write_text("former")
    for room in (100, size - 1):
        # pytest waits with its own files until this is over.
        with room_for(room), pytest.raises(InputError) as caught:
            WRITERS[name](path, transfer)
        told = str(caught.value)
        assert told.startswith(f"{path} cannot be written (")
        assert told.endswith("): free some space, then do the same again")
        assert everything(tmp_path) == {name: b"former"}


@pytest.fixture(scope="module")
def scene():
    return samples.plane_and_blocker(32)


@pytest.mark.parametrize("bounces", [0, 1])
def test_a_bake_without_room_for_a_chunk_keeps_the_others_and_goes_on(bounces, scene, tmp_path, monkeypatch):
    given = {"order": 3, "rays": 16, "bounces": bounces, "threads": 1, "progress": False}
    whole = bake(scene, **given)
    full, folder = files.os.open, tmp_path / "kept"

    def third(path, *rest, **options):
        if ".chunk-0000002" in str(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return full(path, *rest, **options)

    with monkeypatch.context() as patched:
        patched.setattr(os, "open", third)
        with pytest.raises(CannotWrite, match=r"chunk-0000002\.safetensors cannot be written \(No space left"):
            bake(scene, checkpoint=folder, **given)
    kept = everything(folder)
    assert {"chunk-0000000.safetensors", "chunk-0000001.safetensors", "manifest.json"} <= kept.keys()
    assert not [name for name in kept if name.startswith(".")]

    class Counts:
        def start(self, stage, total, done=0):
            self.done = getattr(self, "done", done)

        def advance(self, count): ...

    counts = Counts()
    again = bake(scene, checkpoint=folder, **(given | {"progress": counts}))
    assert counts.done > 0
    assert torch.equal(stored(again), stored(whole))
    assert not folder.exists()


def test_hits_that_find_no_room_are_told_of_with_the_place_of_temporary_files(scene, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with room_for(4096), pytest.raises(CannotWrite, match=f"{tmp_path} cannot be written .*set TMPDIR"):
        bake(scene, order=3, rays=64, bounces=1, threads=1, progress=False)
    assert not list(tmp_path.iterdir())


def test_no_place_for_temporary_files(scene, monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    for work in (lambda: bake(scene, order=2, rays=8, bounces=1, threads=1, progress=False), lambda: Processes(1)):
        with pytest.raises(InputError, match=r"cannot be written .*set TMPDIR"):
            work()


def test_a_scene_that_finds_no_room_on_its_way_to_processes(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with Processes(1) as processes, room_for(100), pytest.raises(CannotWrite, match="set TMPDIR"):
        processes._write(torch.zeros(999))
    assert not list(tmp_path.iterdir())


def test_what_a_process_says_of_a_disk_comes_back_whole():
    fault = CannotWrite("a.npy", "full", "buy another")
    back = pickle.loads(pickle.dumps(fault))
    assert (str(back), back.path, back.reason) == (str(fault), fault.path, fault.reason)


def test_a_compression_without_room_keeps_what_it_had_and_goes_on(make_transfer, tmp_path, monkeypatch):
    transfer, path = make_transfer(side=24, order=4), tmp_path / "kept"
    monkeypatch.setattr("torchprt.compression.checkpoint._EVERY", 0.0)

    class Stops:
        told = 0

        def start(self, stage, total, done=0): ...

        def advance(self, count):
            self.told += 1
            if self.told > 9:
                raise KeyboardInterrupt

    given = {"clusters": 6, "components": 2, "checkpoint": path}
    with pytest.raises(KeyboardInterrupt):
        compress(transfer, report=Stops(), **given)
    before = everything(tmp_path)
    assert before.keys() == {"kept"}
    with room_for(200), pytest.raises(CannotWrite, match="kept cannot be written"):
        compress(transfer, **given)
    assert everything(tmp_path) == before
    found = compress(transfer, **given).layers["diffuse"].signal
    whole = compress(transfer, **(given | {"checkpoint": None})).layers["diffuse"].signal
    assert all(torch.equal(value, found.tensors()[name]) for name, value in whole.tensors().items())
    assert not list(tmp_path.iterdir())


# Places


def test_a_device_a_pipe_and_a_protected_file_are_left_alone(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "mine").write_text("mine")
    for path in (os.devnull, tmp_path / "pipe"):
        with pytest.raises(InputError, match="is a pipe or a device"):
            write(path, b"new")
    asked = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: asked(path, mode) and str(path) != str(tmp_path / "mine"))
    with pytest.raises(InputError, match="it is protected, choose another name"):
        write(tmp_path / "mine", b"new")
    assert (tmp_path / "mine").read_text() == "mine"


def test_what_a_link_points_to_is_written(tmp_path):
    (tmp_path / "large").mkdir()
    (tmp_path / "a").symlink_to(tmp_path / "large" / "b")
    for content in (b"first", b"second"):
        write(tmp_path / "a", content)
        assert (tmp_path / "a").is_symlink()
        assert (tmp_path / "large" / "b").read_bytes() == content
    assert sorted(everything(tmp_path)) == ["a", "large", "large/b"]


def test_the_longest_name_that_the_system_takes(tmp_path):
    longest = os.pathconf(tmp_path, "PC_NAME_MAX")
    write(tmp_path / ("a" * (longest - 4) + ".npy"), b"new")
    with pytest.raises(InputError, match="give a shorter name"):
        write(tmp_path / ("a" * (longest - 3) + ".npy"), b"new")


def test_a_file_is_on_the_disk_before_it_takes_its_name(tmp_path, monkeypatch):
    """Where room is found out of late: a fault of fsync is one of the writer."""

    def late(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "a").write_text("former")
    monkeypatch.setattr(os, "fsync", late)
    with pytest.raises(CannotWrite, match="No space left on device"):
        write(tmp_path / "a", b"new")
    assert everything(tmp_path) == {"a": b"former"}


# Folders


def test_a_folder_takes_the_place_of_another_as_a_whole(tmp_path):
    with atomic_folder(tmp_path / "a" / "page") as made:
        (made / "one").write_text("1")
    with atomic_folder(tmp_path / "a" / "page") as made:
        assert not list(made.iterdir())
        (made / "two").write_text("2")
    assert everything(tmp_path) == {"a": None, "a/page": None, "a/page/two": b"2"}


@pytest.mark.parametrize("fault", [KeyboardInterrupt(), RuntimeError("a bug"), OSError(errno.ENOSPC, "full")], ids=repr)
@pytest.mark.parametrize("when", ["in the block", "at the end"])
def test_a_folder_that_is_not_finished_leaves_the_former_one(fault, when, tmp_path, monkeypatch):
    page = tmp_path / "page"
    page.mkdir()
    (page / "one").write_text("former")
    renamed = os.rename

    def stopped(source, target, **options):
        if str(source).endswith("new"):
            raise fault
        renamed(source, target, **options)

    monkeypatch.setattr(os, "rename", stopped)
    expected = CannotWrite if isinstance(fault, OSError) else type(fault)

    def work():
        with atomic_folder(page) as made:
            (made / "two").write_text("2")
            if when == "in the block":
                raise fault

    with pytest.raises(expected):
        work()
    assert everything(tmp_path) == {"page": None, "page/one": b"former"}


def test_a_fault_in_a_new_folder_is_told_of_its_place(tmp_path):
    with room_for(10), pytest.raises(CannotWrite) as caught, atomic_folder(tmp_path / "page") as made:
        write(made / "mesh.glb", bytes(99))
    assert str(caught.value).startswith(f"{tmp_path / 'page' / 'mesh.glb'} cannot be written (")
    assert not list(tmp_path.iterdir())


def test_a_folder_where_a_file_stands(tmp_path):
    (tmp_path / "a").write_text("mine")
    with pytest.raises(InputError, match="a is a file"), atomic_folder(tmp_path / "a"):
        pytest.fail("there is no room for it")
    for path in (tmp_path / "a", tmp_path / "a" / "b"):
        with pytest.raises(InputError, match="cannot be made"):
            make_folder(path)
    with pytest.raises(InputError, match="a is a file, not a folder"), atomic(tmp_path / "a" / "b" / "c"):
        pytest.fail("there is no folder")
    assert everything(tmp_path) == {"a": b"mine"}
