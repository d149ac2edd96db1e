"""Is a picture straight from a mesh the one of its bake, and does a ground come with it as it was asked for?"""

import numpy as np
import PIL.Image
import pytest
import torch
import trimesh

from torchprt import load_transfer
from torchprt.cli.bake_options import spelled_out

SMALL = ["--size", "40x30", "--rays", 32]


def pixels(path):
    with PIL.Image.open(path) as opened:
        return np.asarray(opened.convert("RGB")).astype(int)


# What is refused


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["ball.ply", "--bake", "a.ply"], ["a.ply", ".safetensors"]),
        (["ball.ply", "--bake", "none/a.safetensors"], ["make it first"]),
        (["ball.ply", "--bounces", "many"], ["--bounces is 'many'"]),
        (["ball.ply", "--albedo", "2"], ["[0, 1]"]),
        (["ball.ply", "--ground-albedo", "0.3"], ["no ground", "give --ground"]),
        (["ball.ply", "--ground", "--ground-albedo", "1,2"], ["--ground-albedo is '1,2'"]),
        (["ball.ply", "--ground", "nan"], ["--ground is 'nan'"]),
        (["ball.ply", "--ground", "5"], ["height of the ground is 5"]),
        (["ball.ply", "--light", "none.exr"], ["none.exr"]),
        (["none.ply"], ["none.ply does not exist"]),
        (["ball.safetensors", "ball.ply"], ["ball.ply is given beside it"]),
        (["ball.safetensors", "--rays", "16"], ["--rays is given", "is baked already"]),
        (["ball.safetensors", "--two-sided"], ["--two-sided is given"]),
        (["ball.safetensors", "--seed", "0"], ["--seed is given"]),
        (["ball.safetensors", "--ground"], ["--ground is given"]),
        (["ball.safetensors", "--bake", "b.safetensors"], ["--bake is given"]),
    ],
)
def test_render_refuses_before_any_ray_is_traced(refused, folder, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    files = [folder / each if (folder / each).exists() else each for each in arguments]
    refused(*words, arguments=["render", *files, "-o", "a.png"])


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        (["--ground"], ["--ground", "auto"]),
        (["--ground", "-o", "a"], ["--ground", "auto", "-o", "a"]),
        (["--ground", "a.ply"], ["--ground", "auto", "a.ply"]),
        (["--ground", "-0.5", "a.ply"], ["--ground", "-0.5", "a.ply"]),
        (["--ground", "0"], ["--ground", "0"]),
        (["--ground", "auto"], ["--ground", "auto"]),
        (["--ground=-0.5"], ["--ground=-0.5"]),
        (["a.ply", "--ground-albedo", "0.5"], ["a.ply", "--ground-albedo", "0.5"]),
        ([], []),
    ],
)
def test_a_ground_may_stand_without_its_height(given, wanted):
    assert spelled_out(given) == wanted


# What is made


def test_the_picture_of_a_mesh_is_that_of_its_bake(done, folder, tmp_path):
    options = ["--albedo", "0.6,0.3,0.2", "--order", 4, "--rays", 32]
    kept = tmp_path / "kept.safetensors"
    common = ["--light", folder / "lamp.exr", "--size", "40x30"]
    said = done("render", folder / "ball.ply", "-o", tmp_path / "a.png", *common, *options, "--bake", kept)
    assert f"{kept}: diffuse, shadowed, order 4" in said
    done("bake", folder / "ball.ply", "-o", tmp_path / "b.safetensors", *options)
    one, other = load_transfer(kept), load_transfer(tmp_path / "b.safetensors")
    assert torch.equal(one.layers["diffuse"].signal.values, other.layers["diffuse"].signal.values)
    assert one.provenance == other.provenance
    done("render", kept, "-o", tmp_path / "b.png", *common)
    assert np.array_equal(pixels(tmp_path / "a.png"), pixels(tmp_path / "b.png"))
    # Nothing else is left behind.
    assert {each.name for each in tmp_path.iterdir()} == {"a.png", "b.png", "kept.safetensors", "b.safetensors"}


def test_a_picture_alone_leaves_nothing_else(done, folder, tmp_path):
    done("render", folder / "ball.ply", folder / "ball.ply", "-o", tmp_path / "a.png", *SMALL)
    assert [each.name for each in tmp_path.iterdir()] == ["a.png"]


def test_a_glossy_mesh_is_rendered_with_its_material(done, folder, tmp_path):
    said = done("render", folder / "ball.ply", "-o", tmp_path / "a.png", *SMALL, "--material", "phong:8")
    assert "exit, shadowed" in said


def test_a_ground_lies_under_the_model_and_is_not_framed(done, folder, tmp_path):
    common = ["--light", folder / "lamp.exr", *SMALL, "--view", "0,0.3,1"]
    kept = tmp_path / "kept.safetensors"
    plain, stood = tmp_path / "plain.png", tmp_path / "stood.png"
    done("render", folder / "ball.ply", "-o", plain, *common)
    done("render", folder / "ball.ply", "--ground", "-o", stood, *common, "--ground-albedo", "0.8", "--bake", kept)
    transfer = load_transfer(kept)
    assert [each["role"] for each in transfer.receivers.objects] == ["receiver", "ground"]
    assert float(transfer.albedo[-1, 0]) == pytest.approx(0.8)
    # The ball is where it was; beside its foot there is ground, and none at the top.
    before, after = pixels(plain), pixels(stood)
    assert np.array_equal(before[0], after[0])
    assert np.abs(before[27:, :8] - after[27:, :8]).min() > 5
    assert np.abs(before[10:15, 18:22] - after[10:15, 18:22]).max() < 40
    # The lamp shines along the ground: it lights nothing there but the side that looks at it.
    whole = tmp_path / "whole.png"
    done("render", kept, "-o", whole, *common[:2], "--size", "40x30", "--view", "0,0.3,1", "--with-ground")
    assert not np.array_equal(pixels(whole)[10:15, 18:22], after[10:15, 18:22])


def test_models_are_written_without_their_ground_unless_it_is_asked_for(done, refused, folder, tmp_path):
    kept = tmp_path / "kept.safetensors"
    done("bake", folder / "ball.ply", "--ground", "-0.9", "-o", kept, "--rays", 16, "--order", 3)
    vertices = len(trimesh.load(folder / "ball.ply", process=False).vertices)
    everything = load_transfer(kept).vertices
    assert everything > vertices + 1000
    for more, count in (([], vertices), (["--with-ground"], everything)):
        done("shade", kept, "--light", folder / "lamp.exr", "-o", tmp_path / "lit.ply", *more)
        assert len(trimesh.load(tmp_path / "lit.ply", process=False).vertices) == count
        for command in (["shade", kept, "--light", folder / "lamp.exr"], ["export", kept]):
            done(*command, "-o", tmp_path / "lit.glb", *more)
            assert len(trimesh.load(tmp_path / "lit.glb", process=False, force="mesh").vertices) == count
    done("shade", kept, "--light", folder / "lamp.exr", "-o", tmp_path / "lit.npy")
    assert np.load(tmp_path / "lit.npy").shape == (everything, 3)
    refused("--with-ground", arguments=["export", kept, "-o", tmp_path / "a.onnx", "--with-ground"])


def test_a_scene_file_is_baked_and_rendered(done, folder, tmp_path):
    text = f'[[object]]\nmesh = "{folder / "ball.ply"}"\nalbedo = [0.6, 0.2, 0.1]\n\n[ground]\nalbedo = 0.4\n'
    (tmp_path / "scene.toml").write_text(text)
    done("render", tmp_path / "scene.toml", "-o", tmp_path / "a.png", *SMALL, "--bounces", 1)
    said = done("bake", tmp_path / "scene.toml", "-o", tmp_path / "a.safetensors", "--rays", 16)
    assert "ground (ground)" in said
    assert "3 channels" in said
    assert "ground (ground)" in done("info", tmp_path / "scene.toml")
    assert "of the receivers are ground" in done("info", tmp_path / "a.safetensors")
