"""Does the command tell what is in a file, or in one sentence why it cannot?"""

import json

import numpy as np
import pytest
import torch
from transfers import random_glossy

from torchprt.compression import fit
from torchprt.preview import save_movie, save_picture
from torchprt.transfer import save

# What it refuses


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.ply", b"\x89PNG\r\n\x1a\n", ["a.ply is a PNG picture", "rename it to a.png"]),
        ("a.safetensors", b"ply\nformat ascii 1.0\n", ["a.safetensors is a PLY mesh", "rename it to a.ply"]),
        ("a", b"\x93NUMPY", ["a is an array of numpy", "no suffix", "rename it to a.npy"]),
        ("a.safetensor", b"hello", ["a.safetensor is no file", "did you mean", "a.safetensors"]),
        ("a.txt", b"hello", ["a.txt is no file", "it is none of", ".onnx"]),
        ("a.npy", b"\x93NUMPY\x01", ["a.npy is not a whole .npy file"]),
        ("a.mp4", b"\0\0\0\x20ftypisom" + bytes(20), ["a.mp4 is not a whole video"]),
        ("a.toml", b"albedo = ", ["a.toml is not a .toml file"]),
        ("a.toml", b"\xff\xfe", ["a.toml is not a .toml file"]),
    ],
)
def test_a_file_that_is_not_what_its_name_says(name, content, words, refused, tmp_path):
    if name == "a.mp4":
        pytest.importorskip("av")
    (tmp_path / name).write_bytes(content)
    refused(*words, arguments=["info", tmp_path / name])


def test_a_folder_of_something_else(refused, tmp_path):
    (tmp_path / "a").mkdir()
    refused("a is a folder", "give files", arguments=["info", tmp_path / "a"])


def test_a_page_that_is_damaged(refused, tmp_path):
    (tmp_path / "scene.json").write_text("{}")
    refused("scene.json is damaged", arguments=["info", tmp_path])


def test_one_that_cannot_be_told_of_does_not_hide_the_others(run, folder, tmp_path):
    ended = run("info", folder / "ball.ply", tmp_path / "none.ply", folder / "lamp.exr")
    assert ended.code == 2
    assert "The surface is closed" in ended.out
    assert "64 x 32 pixels" in ended.out
    assert ended.err == f"torchprt: {tmp_path / 'none.ply'} does not exist: check the name\n"


# What it tells


def test_info_tells_of_meshes_and_images_too(done, folder):
    assert "The surface is closed and consistently wound" in done("info", folder / "ball.ply")
    assert "64 x 32 pixels, as an environment has" in done("info", folder / "lamp.exr")


def test_info_tells_of_every_layer_by_its_name(done, tmp_path):
    baked = random_glossy("exit", order=3, output_order=2, materials=["phong:4"])
    save(fit(baked, lobes=2), tmp_path / "a.safetensors")
    said = done("info", tmp_path / "a.safetensors")
    assert "zonal diffuse + zonal exit, shadowed, order 3, output order 2 (optimal)" in said
    assert "\ndiffuse: 2 lobes a vertex, fit error " in said
    assert "\nexit: 2 lobes a row, fit error " in said
    assert "\nexit: materials phong:4, specular of every vertex, mean (" in said


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.ones((9, 3)), "light of order 3, mean radiance (0.2821, 0.2821, 0.2821)"),
        (np.ones((10, 3)), "radiance of 10 vertices, mean (1, 1, 1), from 1 to 1"),
        (np.ones((65**2, 3)), "radiance of 4225 vertices"),
        (np.full((5, 3), np.nan), "radiance of 5 vertices, 15 numbers not finite"),
        (np.zeros((1, 4, 3)), "1 pose of 4 vertices, from 0 to 0"),
        (np.zeros((2, 2), np.float32), "float32 of shape [2, 2]"),
        (np.zeros((0, 3)), "radiance of 0 vertices, empty"),
    ],
)
def test_arrays_are_told_by_their_shape(values, said, done, tmp_path):
    np.save(tmp_path / "a.npy", values)
    assert f"a.npy: {said}" in done("info", tmp_path / "a.npy")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_pictures(suffix, done, tmp_path):
    save_picture(torch.full((4, 6, 3), 0.5), tmp_path / f"a{suffix}")
    assert "6 x 4 pixels, not twice as wide as high" in done("info", tmp_path / f"a{suffix}")


def test_a_picture_of_another_format_than_its_name(done, tmp_path):
    save_picture(torch.full((4, 8, 3), 0.5), tmp_path / "a.jpg")
    (tmp_path / "a.jpg").rename(tmp_path / "a.png")
    said = done("info", tmp_path / "a.png")
    assert "8 x 4 pixels, as an environment has" in said
    assert "It is a JPEG picture, whatever its name says: rename it to a.jpg" in said


@pytest.mark.parametrize("suffix", [".gif", ".webp", ".mp4"])
def test_turntables(suffix, done, tmp_path):
    if suffix == ".mp4":
        pytest.importorskip("av")
    shown = [torch.full((4, 6, 3), value) for value in (0.0, 0.3, 0.6, 0.9)]
    save_movie(shown, tmp_path / f"a{suffix}", 10)
    assert f"a{suffix}: 4 pictures of 6 x 4 pixels, 0.4 s, 10 a second" in done("info", tmp_path / f"a{suffix}")


def test_materials(done, tmp_path):
    (tmp_path / "a.toml").write_text('albedo = [0.1, 0.2, 0.3]\ngloss = "ggx:0.3"\nspecular = 0.5\ntwo_sided = true\n')
    said = done("info", tmp_path / "a.toml")
    assert "a.toml: material, albedo 0.1, 0.2, 0.3" in said
    assert "Gloss ggx:0.3" in said
    assert "specular 0.5" in said
    assert "Both sides reflect." in said


def test_a_page(done, tmp_path):
    lights = [{"name": "studio"}, {"name": "sky"}]
    about = {"title": "Ball", "subtitle": "diffuse transfer, order 4", "transport": "shadowed", "vertices": 1}
    (tmp_path / "scene.json").write_text(json.dumps(about | {"environments": lights}))
    said = done("info", tmp_path)
    assert "page 'Ball'" in said
    assert "diffuse transfer, order 4, shadowed, 1 vertex\n" in said
    assert f"Lights studio, sky; look at it with: torchprt serve {tmp_path}" in said


def test_what_a_stopped_bake_keeps(done, folder, tmp_path):
    from torchprt import load
    from torchprt.transport import bake

    class Stops:
        def start(self, stage, total, done=0): ...

        def advance(self, count):
            raise KeyboardInterrupt

    kept = tmp_path / "a.safetensors.partial"
    with pytest.raises(KeyboardInterrupt):
        bake(load(folder / "ball.ply"), rays=8, threads=1, checkpoint=kept, keep=True, progress=Stops())
    said = done("info", kept)
    assert "a bake that was stopped, 1 chunk, " in said
    assert f"with -o {tmp_path / 'a.safetensors'} goes on" in said


def test_what_d3dx_saved_is_told_without_a_mesh(done, tmp_path):
    header = np.array([4, 9, 3, 0, 0, 0], "<u4").tobytes()
    (tmp_path / "a.prt").write_bytes(header + np.ones(4 * 27, "<f4").tobytes())
    said = done("info", tmp_path / "a.prt")
    for word in ("diffuse, shadowed, order 3, 3 channels, 4 vertices", "4 receivers", "neither albedo", "load_d3dx"):
        assert word in said
    header = np.array([4, 9, 1, 2, 2, 1, 2, 1], "<u4").tobytes()
    body = np.ones(9 * 2 * 2 + 4, "<f4").tobytes() + np.array([0, 1, 1, 0], "<u4").tobytes()
    (tmp_path / "b.pca").write_bytes(header + body)
    said = done("info", tmp_path / "b.pca")
    for word in (
        "clustered diffuse",
        "map of 2 x 2 texels",
        "2 clusters (D3DX), 1 PCA vectors each",
        "error not known",
    ):
        assert word in said
