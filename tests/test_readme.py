"""Does the README tell the truth? Its commands and snippets run as they stand, in a folder with a mesh and a light."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"


def blocks(language, page=README):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the README takes as given: model.ply, ring.ply and environment.exr."""
    from torchprt import demo, light, preview
    from torchprt.scene import samples

    place = tmp_path_factory.mktemp("readme")
    box = samples.coloured_box(6).geometry()
    grey = torch.full((len(box.positions), 3), 128, dtype=torch.uint8)
    preview.save_ply(box.positions, box.faces, grey, place / "model.ply")
    ring = samples.ring(12)
    preview.save_ply(ring.positions, ring.faces, torch.full((len(ring.positions), 3), 128).byte(), place / "ring.ply")
    demo.write_environment(light.studio(32), place / "environment.exr")
    return place


def test_the_commands_then_onnx_runtime_alone(folder, monkeypatch, untyped):
    from typer.testing import CliRunner

    from torchprt.cli import app

    monkeypatch.chdir(folder)
    (commands,) = blocks("sh")
    for line in commands.splitlines():
        command, *arguments = shlex.split(line)
        assert command == "torchprt"
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, (line, result.output, result.exception)
    assert {"model.safetensors", "lit.png", "light.npy", "model.onnx"} <= {file.name for file in folder.iterdir()}

    snippet = blocks("python")[1] + "\nimport sys\nassert not {'torch', 'torchprt'} & set(sys.modules)\n"
    subprocess.run([sys.executable, "-c", snippet], check=True, cwd=folder)
    colours = np.load("colours.npy")
    assert colours.dtype == np.uint8
    assert len(np.unique(colours)) > 10


def test_the_snippet_in_python(folder, monkeypatch):
    from torchprt.scene import read_mesh

    monkeypatch.chdir(folder)
    names: dict = {}
    exec(blocks("python")[0], names)
    vertices = len(read_mesh("model.ply").positions)
    assert names["radiance"].shape == names["turned"].shape == (vertices, 3)
    # The studio is no symmetric room: a quarter turn changes the picture.
    assert (names["radiance"] - names["turned"]).abs().max() > 0.05 * names["radiance"].max()
    assert len(read_mesh("lit.ply").positions) == vertices


def test_the_page_on_torch_runs(untyped):
    names: dict = {}
    found = blocks("python", ROOT / "docs" / "torch.md")
    for block in found:
        exec(block, names)
    assert len(found) > 1


PAGES = [README, ROOT / "CONTRIBUTING.md", ROOT / "export" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_and_picture_of_a_page_exists(page):
    for target in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            path, _, anchor = target.partition("#")
            file = page.parent / path if path else page
            assert file.exists(), target
            assert not anchor or anchor in anchors(file), target


def anchors(page):
    """As GitHub makes them: lower case, punctuation gone, spaces to hyphens."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}
