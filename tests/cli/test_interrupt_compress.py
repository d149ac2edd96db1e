"""What is lost when a compression is stopped from outside? A real process on a terminal, a real Ctrl-C."""

import contextlib
import importlib
import os
import re
import select
import signal
import subprocess
import sys
import time

import pytest
import torch

from torchprt.transfer import load, save

SIZES = {"clusters": 96, "components": 6}


def start(command, error):
    # A group of its own, and the default for Ctrl-C, which a test runner in the background may have switched off.
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=error,
        text=True,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "120"},
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def read(terminal, until, process=None):
    """What a process says on a terminal, until something in it matches or it ends."""
    said, limit = "", time.monotonic() + 120
    while not re.search(until, said) and time.monotonic() < limit:
        if select.select([terminal], [], [], 0.05)[0]:
            with contextlib.suppress(OSError):
                said += os.read(terminal, 1 << 16).decode()
        elif process is not None and process.poll() is not None:
            break
    return said


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals and terminals")
def test_the_same_command_goes_on_to_the_same_bits(make_transfer, tmp_path):
    from torchprt.compression import compress

    transfer = make_transfer(side=120, order=5)
    save(transfer, tmp_path / "whole.safetensors")
    output, partial = tmp_path / "a.safetensors", tmp_path / "a.safetensors.partial"
    command = [sys.executable, "-m", "torchprt", "compress", str(tmp_path / "whole.safetensors"), "-o", str(output)]
    command += [text for name, size in SIZES.items() for text in (f"--{name}", str(size))]
    terminal, error = os.openpty()
    process = start(command, error)
    try:
        # A fifth of all is more than the first stage, which is then kept.
        assert re.search("[2-8][0-9]%", read(terminal, "[2-9][0-9]%", process))
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=120)
        said = read(terminal, "from there")
    finally:
        process.kill()
        process.wait()
        os.close(error)
        os.close(terminal)
    assert process.returncode == 130
    assert f"torchprt: stopped; {partial} keeps what is done, the same command goes on" in " ".join(said.split())
    assert "Traceback" not in said
    assert partial.is_file()
    assert not output.exists()

    process = start(command, subprocess.PIPE)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert "torchprt:" not in err
    assert "compressed in" in out
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.safetensors", "whole.safetensors"]
    found, expected = (each.layers["diffuse"].signal for each in (load(output), compress(transfer, **SIZES)))
    for name in ("label", "weights", "mean", "basis", "offsets", "squared_error"):
        assert torch.equal(getattr(found, name), getattr(expected, name))


def test_a_stop_before_anything_was_kept_promises_nothing(run, folder, tmp_path, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("torchprt.compression"), "compress", stopped)
    ended = run("compress", folder / "ball.safetensors", "-o", tmp_path / "a.safetensors")
    assert ended.code == 130
    assert ended.err.splitlines() == ["torchprt: stopped"]
    assert not list(tmp_path.iterdir())


def test_chunks_of_a_bake_of_the_same_name_are_left_as_they_are(refused, folder, tmp_path):
    (tmp_path / "a.safetensors.partial").mkdir()
    (tmp_path / "a.safetensors.partial" / "manifest.json").write_text("{}")
    refused(
        "a.safetensors.partial is a folder",
        arguments=["compress", folder / "ball.safetensors", "-o", tmp_path / "a.safetensors"],
    )


def test_clusters_of_another_command_are_told_of_and_not_used(run, folder, tmp_path, monkeypatch):
    from torchprt.compression.checkpoint import Checkpoint

    with Checkpoint(tmp_path / "a.safetensors.partial", [torch.ones(3)], keep=True) as store:
        store.put("clusters", {"label": torch.ones(3)})
    # pytest makes errors of warnings; the command does not.
    monkeypatch.setattr("warnings.filters", [])
    ended = run("compress", folder / "ball.safetensors", "-o", tmp_path / "a.safetensors", "--clusters", 4)
    assert ended.code == 0
    told = [line for line in ended.err.splitlines() if line.startswith("torchprt: ")]
    assert len(told) == 1
    assert "starts from the beginning" in told[0]
    assert ".py" not in ended.err
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.safetensors"]
