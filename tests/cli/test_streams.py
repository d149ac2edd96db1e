"""What if nobody listens, and what if an input is no file, or goes while it is read?"""

import errno
import io
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from faults import everything

import torchprt
from torchprt.cli import main

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such pipes and devices")


class Deaf(io.TextIOWrapper):
    """A stream to nobody, or to a disk without room."""

    number = 0

    def write(self, text):
        raise OSError(self.number, os.strerror(self.number))


@pytest.fixture
def deaf(tmp_path_factory):
    """`deaf(number)`: a stream that answers with this fault of the system."""
    with (tmp_path_factory.mktemp("deaf") / "heard").open("wb") as file, Deaf(file) as stream:

        def deaf(number):
            stream.number = number
            return stream

        yield deaf


def ended(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["torchprt", *map(str, arguments)])
    try:
        main()
    except SystemExit as end:
        return end.code or 0
    return 0


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_bake_that_nobody_listens_to_is_finished(stream, deaf, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, stream, deaf(errno.EPIPE))
    arguments = ["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--rays", "8", "--threads", "1"]
    assert ended(monkeypatch, *arguments) == 0
    assert (tmp_path / "a.safetensors").exists()


def test_an_answer_that_finds_no_room_is_a_fault(deaf, folder, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", deaf(errno.ENOSPC))
    assert ended(monkeypatch, "info", folder / "ball.ply") == 2
    said = capsys.readouterr().err
    assert said == "torchprt: standard output cannot be written (No space left on device): send it elsewhere\n"


LINES = """
"$1" -m torchprt info "$2" "$2" "$2" | head -1
"$1" -m torchprt --help > /dev/full
echo "ended $?"
"""


def test_the_first_line_of_an_answer_and_help_that_finds_no_room(folder):
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    path = os.pathsep.join([str(Path(torchprt.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    command = ["sh", "-c", LINES, "sh", sys.executable, folder / "ball.ply"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=os.environ | {"PYTHONPATH": path})
    assert done.stdout == f"{folder / 'ball.ply'} (receiver)\nended 2\n"
    assert done.stderr.splitlines() == [
        "torchprt: standard output cannot be written (No space left on device): send it elsewhere"
    ]


READS = {
    "a.ply": ["bake", "a.ply", "-o", "b.safetensors"],
    "a.glb": ["bake", "a.glb", "-o", "b.safetensors"],
    "a.usd": ["bake", "a.usd", "-o", "b.safetensors"],
    "a.toml": ["bake", "a.toml", "-o", "b.safetensors"],
    "b.ply": ["bake", "ball.ply", "--blocker", "b.ply", "-o", "b.safetensors"],
    "b.toml": ["bake", "ball.ply", "--material", "b.toml", "-o", "b.safetensors"],
    "a.safetensors": ["shade", "a.safetensors", "-o", "b.npy"],
    "b.safetensors": ["render", "b.safetensors", "-o", "b.png"],
    "c.safetensors": ["compress", "c.safetensors", "-o", "b.safetensors"],
    "d.safetensors": ["fit", "d.safetensors", "-o", "b.safetensors"],
    "e.safetensors": ["export", "e.safetensors", "-o", "b.onnx"],
    "f.safetensors": ["lay", "f.safetensors", "ball.ply", "-o", "b.safetensors"],
    "a.exr": ["light", "a.exr", "-o", "b.npy"],
    "a.png": ["patch", "a.png", "-o", "b.safetensors"],
    "a.npy": ["shade", "ball.safetensors", "--light", "a.npy", "-o", "c.npy"],
    "c.onnx": ["info", "c.onnx"],
    "c.mp4": ["info", "c.mp4"],
    "c.npy": ["info", "c.npy"],
    "c.jpg": ["info", "c.jpg"],
}


@pytest.mark.parametrize("name", READS)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "forbidden"])
def test_an_input_that_is_no_file_to_read(kind, name, run, folder, tmp_path, monkeypatch):
    """A pipe would be waited for for ever."""
    monkeypatch.chdir(tmp_path)
    for path in folder.iterdir():
        Path(path.name).symlink_to(path)
    if kind == "pipe":
        os.mkfifo(name)
    elif kind == "device":
        Path(name).symlink_to("/dev/zero")
    elif kind == "folder":
        Path(name).mkdir()
    else:
        Path(name).write_bytes(b"content")
        opened = open

        def forbidden(path, *rest, **options):
            if str(path) == name:
                raise PermissionError(13, "Permission denied", name)
            return opened(path, *rest, **options)

        monkeypatch.setattr("io.open", forbidden)
        monkeypatch.setattr("builtins.open", forbidden)
    before = sorted(os.listdir())
    done = run(*READS[name])
    assert done.code == 2, done
    assert "Traceback" not in done.err
    assert len(done.err.splitlines()) == 1, done.err
    words = {"pipe": "it is a pipe or a device", "device": "it is a pipe or a device", "forbidden": "Permission denied"}
    assert name in done.err
    # `info` tells of folders, of which this is none that it knows.
    assert words.get(kind, "is a folder") in done.err
    assert sorted(os.listdir()) == before


def test_a_mesh_that_is_gone_before_it_is_read(run, tmp_path, monkeypatch):
    trimesh.creation.icosphere().export(tmp_path / "a.ply")
    read = Path.read_bytes

    def gone(path):
        if path.name == "a.ply":
            path.unlink()
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", gone)
    done = run("bake", tmp_path / "a.ply", "-o", tmp_path / "a.safetensors")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert "a.ply cannot be read (No such file or directory)" in done.err
    assert not everything(tmp_path)


def test_a_result_may_take_the_place_of_what_it_is_made_of(done, folder, tmp_path):
    """What was read lies in memory as a map of the file."""
    for name in ("a.safetensors", "b.safetensors"):
        shutil.copy(folder / "ball.safetensors", tmp_path / name)
    done("compress", tmp_path / "a.safetensors", "-o", tmp_path / "c.safetensors", "--clusters", 3)
    done("compress", tmp_path / "b.safetensors", "-o", tmp_path / "b.safetensors", "--clusters", 3)
    lit = []
    for name in ("b", "c"):
        done("shade", tmp_path / f"{name}.safetensors", "--light", "white", "-o", tmp_path / f"{name}.npy")
        lit.append(np.load(tmp_path / f"{name}.npy"))
    assert np.array_equal(*lit)
