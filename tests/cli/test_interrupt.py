"""What is lost when a bake is stopped from outside? Real processes, real signals."""

import importlib
import re
import signal
import subprocess
import sys
import time

import pytest
import torch
import trimesh
from shapes import grid
from transfers import stored

from torchprt.transfer import load

RAYS = 400


@pytest.fixture(scope="module")
def dunes(tmp_path_factory):
    """A height field of 24 thousand vertices and what an undisturbed bake makes of it."""
    from torchprt import bake
    from torchprt import load as load_scene

    folder = tmp_path_factory.mktemp("dunes")
    ticks = torch.linspace(0, 12, 155)
    x, z = torch.meshgrid(ticks, ticks, indexing="xy")
    points = torch.stack([x, torch.sin(x) * torch.cos(1.3 * z), -z], -1).view(-1, 3)
    trimesh.Trimesh(points.numpy(), grid(155, 155).numpy(), process=False).export(folder / "dunes.ply")
    return folder / "dunes.ply", bake(
        load_scene(folder / "dunes.ply"), rays=RAYS, bounces="auto", threads=1, progress=False
    )


def start(path, output):
    command = [sys.executable, "-m", "torchprt", "bake", str(path), "-o", str(output)]
    command += ["--rays", str(RAYS), "--threads", "1"]
    # A group of its own, and the default for Ctrl-C, which a test runner in the background may have switched off.
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL], ids=["interrupted", "killed"])
def test_the_same_command_goes_on_to_the_same_bits(how, dunes, tmp_path):
    path, whole = dunes
    output, partial = tmp_path / "a.safetensors", tmp_path / "a.safetensors.partial"
    process = start(path, output)
    try:
        until = time.monotonic() + 120
        while len(list(partial.glob("chunk-*"))) < 3:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < until
            time.sleep(0.01)
        process.send_signal(how)
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
        process.wait()
    assert not output.exists()
    kept = len(list(partial.glob("chunk-*")))
    assert 3 <= kept < 24
    if how == signal.SIGINT:
        assert process.returncode == 130
        assert f"torchprt: stopped; {partial} keeps what is done" in err
        assert "Traceback" not in err
        # A chunk that was being written is either there or not.
        assert not list(partial.glob(".chunk-*"))
    else:
        assert process.returncode == -signal.SIGKILL
    assert "baked in" not in out

    process = start(path, output)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert "emptied" not in err
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.safetensors"]
    found = load(output)
    assert torch.equal(stored(found), stored(whole))
    assert found.error == whole.error
    assert re.search(r"\d+ vertices", out)


def test_chunks_of_another_command_are_told_of_and_not_used(run, folder, tmp_path, monkeypatch, recwarn):
    """The warning is one line of the command, without the place in the code that warned."""
    from torchprt.transport.checkpoint import Checkpoint

    output = tmp_path / "a.safetensors"
    Checkpoint(tmp_path / "a.safetensors.partial", "of another bake").save(0, {"x": torch.ones(1)})
    # pytest makes errors of warnings; the command does not.
    monkeypatch.setattr("warnings.filters", [])
    ended = run("bake", folder / "ball.ply", "-o", output, "--rays", 16)
    assert ended.code == 0
    told = [line for line in ended.err.splitlines() if line.startswith("torchprt: ")]
    assert len(told) == 1
    assert "a.safetensors.partial" in told[0]
    assert "from the beginning" in told[0]
    assert ".py" not in ended.err
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.safetensors"]


@pytest.mark.parametrize("options", [["--unshadowed"], []])
def test_a_stop_before_anything_was_kept_promises_nothing(options, run, folder, tmp_path, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("torchprt.transport"), "bake", stopped)
    ended = run("bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", *options)
    assert ended.code == 130
    assert ended.err.splitlines() == ["torchprt: stopped"]
    assert not list(tmp_path.iterdir())


def test_another_file_where_chunks_would_go(refused, folder, tmp_path):
    (tmp_path / "a.safetensors.partial").write_text("mine")
    refused(
        "a.safetensors.partial cannot hold", arguments=["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors"]
    )
    (tmp_path / "b.safetensors.partial").mkdir()
    (tmp_path / "b.safetensors.partial" / "thesis.tex").write_text("mine")
    refused("thesis.tex", arguments=["bake", folder / "ball.ply", "-o", tmp_path / "b.safetensors"])
