"""The command line in this process: what it says, where, and how it ends."""

import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh
from environments import lamp, save_exr

from torchprt.cli import main


@dataclass
class Ended:
    code: int
    out: str
    err: str


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """`run("bake", path, ...)`: the command with these arguments."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["torchprt", *map(str, arguments)])
        capfd.readouterr()
        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        return Ended(code, *capfd.readouterr())

    return run


@pytest.fixture
def refused(run: Callable[..., Ended], tmp_path: Path) -> Callable[..., Ended]:
    """`refused(word, ..., arguments=[...])`: it ends with 2 and one sentence with these words, and writes nothing."""

    def refused(*words: str, arguments: list[object]) -> Ended:
        before = sorted(tmp_path.rglob("*"))
        ended = run(*arguments)
        assert ended.code == 2, ended
        lines = ended.err.splitlines()
        assert len(lines) == 1, ended.err
        assert lines[0].startswith("torchprt: ")
        for word in words:
            assert word in lines[0]
        assert sorted(tmp_path.rglob("*")) == before
        return ended

    return refused


@pytest.fixture
def misused(run: Callable[..., Ended], tmp_path: Path) -> Callable[..., Ended]:
    """As `refused` for what the parser of the options refuses: usage, the option and the fault, in a frame."""

    def misused(*words: str, arguments: list[object]) -> Ended:
        before = sorted(tmp_path.rglob("*"))
        ended = run(*arguments)
        assert ended.code == 2, ended
        assert "Traceback" not in ended.err
        for word in words:
            assert word in ended.err
        assert sorted(tmp_path.rglob("*")) == before
        return ended

    return misused


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that no test changes: a unit ball, its bake, a lamp at +x."""
    from torchprt import bake, load, save_transfer

    made = tmp_path_factory.mktemp("made")
    trimesh.creation.icosphere(subdivisions=2).export(made / "ball.ply")
    scene = load(made / "ball.ply")
    save_transfer(bake(scene, order=4, rays=64, threads=1, progress=False), made / "ball.safetensors")
    save_exr(made / "lamp.exr", lamp((1.0, 0.0, 0.0)))
    return made


@pytest.fixture
def done(run):
    """The command, which must succeed and complain of nothing but progress; what it said."""

    def done(*arguments):
        ended = run(*arguments)
        assert ended.code == 0, ended.err
        assert "torchprt:" not in ended.err
        return ended.out

    return done


@pytest.fixture
def shaded(done, folder, tmp_path):
    """Radiance by way of an .npy file."""

    def shaded(light, *options, transfer=folder / "ball.safetensors"):
        done("shade", transfer, "--light", light, "-o", tmp_path / "shaded.npy", *options)
        return np.load(tmp_path / "shaded.npy")

    return shaded


@pytest.fixture
def no_npm(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Libraries that are only names."""
    export = importlib.import_module("torchprt.web.export")
    folder = tmp_path_factory.mktemp("libraries")
    three = importlib.import_module("torchprt.web.three")
    for name in (*export.LOADED, *three.THREE):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(name)
    monkeypatch.setattr(export, "libraries", lambda: folder)
    monkeypatch.setattr(three, "libraries", lambda: folder)
