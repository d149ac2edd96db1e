"""Can a volume be looked at with every verb that shows something, and do the others say why not?"""

import numpy as np
import pytest
import torch
from PIL import Image
from volumes import puff, random_volume, seeing_all

from torchprt.errors import InputError
from torchprt.transfer import diffuse_transfer, load, save

SIZE = ["--size", "24x18", "--samples", "1"]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A cloud, one that scatters forward, and a wall behind."""
    folder = tmp_path_factory.mktemp("sky")
    save(seeing_all(puff(8), 0.9), folder / "cloud.safetensors")
    save(random_volume("phase", puff(6), order=3), folder / "phase.safetensors")
    corners = torch.tensor([[-3.0, -3.0, -2.0], [3.0, -3.0, -2.0], [3.0, 3.0, -2.0], [-3.0, 3.0, -2.0]])
    values = torch.zeros(1, 9, 4)
    values[0, 0] = 0.1
    faces, up = torch.tensor([[0, 1, 2], [0, 2, 3]]), torch.tensor([0.0, 0.0, 1.0]).expand(4, 3)
    save(diffuse_transfer(values, torch.ones(1, 1), corners, up.contiguous(), faces), folder / "wall.safetensors")
    return folder


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["shade", "cloud.safetensors", "-o", "a.ply"], [".ply is for surfaces", "write .npy or a picture"]),
        (["shade", "cloud.safetensors", "-o", "a.npy", "--emitter", "sphere:0,3,0,1,1,1,1"], ["--emitter is for"]),
        (["shade", "cloud.safetensors", "-o", "a.npy", "--pose", "ball.ply"], ["--pose is for surfaces"]),
        (["shade", "phase.safetensors", "-o", "a.npy"], ["--eye X,Y,Z"]),
        (["render", "cloud.safetensors", "-o", "a.png", "--show", "sight"], ["--show is for surfaces"]),
        (["render", "cloud.safetensors", "-o", "a.png", "--volume", "cloud.safetensors"], ["--volume is for surfaces"]),
        (["render", "wall.safetensors", "-o", "a.png", "--volume", "wall.safetensors"], ["not recorded in a volume"]),
        (["export", "cloud.safetensors", "-o", "a.glb"], [".glb is for surfaces", "page"]),
        (["export", "cloud.safetensors", "-o", "a.onnx", "--local"], ["--local", "picture"]),
        (["export", "cloud.safetensors", "-o", "a.onnx", "--size", "32"], ["--size is '32'", "WIDTHxHEIGHT"]),
        (["export", "cloud.safetensors", "-o", "a.onnx", "--cells", "--fov", "30"], ["--fov is given"]),
        (["export", "wall.safetensors", "-o", "a.onnx", "--cells"], ["--cells is given"]),
        (["export", "wall.safetensors", "-o", "a.onnx", "--from", "environment", "--size", "4x4"], ["whole number"]),
        (["fit", "cloud.safetensors", "-o", "a.safetensors"], ["no surface", "compress"]),
        (["tradeoff", "cloud.safetensors", "-o", "sweep"], ["for surfaces", "give a mesh"]),
        (["cast", "wall.safetensors", "cloud.safetensors", "-o", "a.png"], ["for surfaces", "give a mesh"]),
        (["lay", "cloud.safetensors", "cloud.safetensors", "-o", "a.safetensors"], ["not a mesh"]),
    ],
    ids=lambda value: " ".join(map(str, value[:2])) if isinstance(value, list) else None,
)
def test_says_what_a_volume_has_not(arguments, words, files, tmp_path, refused, monkeypatch):
    monkeypatch.chdir(tmp_path)
    there = [files / each if (files / each).exists() else each for each in arguments]
    refused(*words, arguments=there)


def test_says_what_it_is(files, run):
    told = run("info", files / "phase.safetensors").out
    assert "volume of 6x6x6 cells" in told
    assert "are empty" in told
    assert "phase function of order 3, mean cosine 0.6" in told
    assert "cells, " in told.splitlines()[0]


def test_shades_cells_and_pictures(files, tmp_path, run):
    done = run("shade", files / "cloud.safetensors", "-o", tmp_path / "a.npy", "--light", "sky")
    assert done.code == 0, done.err
    assert "cells" in done.out
    assert np.load(tmp_path / "a.npy").shape == (load(files / "cloud.safetensors").vertices, 3)
    for number, (verb, name) in enumerate((("shade", "phase"), ("render", "phase"))):
        done = run(verb, files / f"{name}.safetensors", "-o", tmp_path / f"{number}.png", "--light", "sky", *SIZE)
        assert done.code == 0, done.err
    shaded, rendered = (np.asarray(Image.open(tmp_path / f"{number}.png")) for number in range(2))
    np.testing.assert_allclose(shaded.astype(int), rendered, atol=1)
    assert np.ptp(shaded) > 20


def test_renders_turntables_and_a_volume_before_a_wall(files, tmp_path, run):
    cloud, wall = files / "cloud.safetensors", files / "wall.safetensors"
    done = run("render", cloud, "-o", tmp_path / "a.gif", "--turntable", "2", "--light", "sky", *SIZE)
    assert done.code == 0, done.err
    options = ["--light", "sky", "--distance", "9", "--target", "0,0,-1", "--view", "0,0,1", *SIZE]
    for name, more in (("wall", []), ("both", ["--volume", cloud])):
        done = run("render", wall, "-o", tmp_path / f"{name}.png", *options, *more)
        assert done.code == 0, done.err
    alone, both = (np.asarray(Image.open(tmp_path / f"{name}.png")).astype(int) for name in ("wall", "both"))
    changed = np.abs(both - alone).max(-1) > 20
    assert changed[9, 12]
    assert 0.02 < changed.mean() < 0.5


def test_export_hands_on_what_a_picture_takes(files, tmp_path, refused, monkeypatch):
    given = {}

    def export_volume(transfer, path, **options):
        given.update(options, cells=transfer.vertices)
        raise InputError("enough")

    monkeypatch.setattr("torchprt.onnx.export_volume", export_volume)
    words = ["--size", "6x4", "--fov", "50", "--target", "0,1,0"]
    refused("enough", arguments=["export", files / "cloud.safetensors", "-o", tmp_path / "a.onnx", *words])
    assert given["size"] == (6, 4)
    assert given["field"] == 50
    assert given["target"] == [0, 1, 0]
