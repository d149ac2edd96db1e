"""Does a bake leave as a graph, as a page, as a mesh that carries its transfer?"""

import json

import numpy as np
import pytest
import trimesh
from environments import lamp, save_exr
from transfers import stored

from torchprt.light import BUILT_IN
from torchprt.transfer import load


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["-o", "page", "--web", "--from", "environment"], ["--from", "a page"]),
        (["-o", "page", "--web", "--size", 8], ["--size", "a page"]),
        (["-o", "page", "--web", "--order", 2], ["--order", "a page"]),
        (["-o", "a.onnx", "--light", "l.exr"], ["--light", ".onnx without --web"]),
        (["-o", "a.onnx", "--order", 2], ["--order", ".onnx"]),
        (["-o", "page", "--web", "--source", "a.glb"], ["--source", "a page"]),
        (["-o", "a.onnx", "--source", "a.glb"], ["--source", ".onnx"]),
        (["-o", "a.glb", "--source", "none.glb"], ["none.glb does not exist"]),
        (["-o", "a.glb", "--title", "T"], ["--title", ".glb without --web"]),
        (["-o", "a.glb", "--exact"], ["--exact", ".glb without --web"]),
        (["-o", "a.glb", "--size", 8], ["--size", ".glb"]),
        (["-o", "a.glb", "--order", 5], ["order 5 is not between 1 and the 4"]),
        (["-o", "page", "--web", "--light", "none.exr"], ["none.exr"]),
        (["-o", "page", "--web", "--compressed", "none.safetensors"], ["none.safetensors"]),
        (["-o", "a.gltf"], ["must end in", ".onnx", ".glb"]),
        (["-o", "scene", "--three", "--web"], ["--web and --three"]),
        (["-o", "scene", "--three", "--gpu"], ["--gpu", "--three"]),
        (["-o", "a.glb", "--gpu"], ["--gpu", ".glb without --web"]),
        (["-o", "scene", "--three", "--order", 5], ["order 5 is not between 1 and the 4"]),
    ],
)
def test_options_that_have_no_use_are_refused(refused, folder, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    refused(*words, arguments=["export", folder / "ball.safetensors", *options])


def test_an_export_from_an_environment_says_so(done, folder, tmp_path, untyped):
    done("export", folder / "ball.safetensors", "-o", tmp_path / "b.onnx", "--from", "environment", "--size", 4)
    said = done("info", tmp_path / "b.onnx")
    assert "source: environment" in said
    assert "('B', 6, 4, 4, 3)" in said


def test_a_scene_is_written_whose_bytes_and_losses_are_told(done, folder, tmp_path, no_npm):
    save_exr(tmp_path / "north.exr", lamp((0.0, 0.0, -1.0)))
    bake, light = folder / "ball.safetensors", ["--light", tmp_path / "north.exr"]
    said = done("export", bake, "-o", tmp_path / "scene", "--three", *light)
    assert "off by" in said
    assert "bytes a receiver" in said
    assert f"torchprt serve {tmp_path / 'scene'}" in said
    names = {path.name for path in (tmp_path / "scene").iterdir()}
    assert names == {"index.html", "lights.json", "libraries", "model.glb", "torchprt.js", "transfer.bin"}
    (found,) = json.loads((tmp_path / "scene" / "lights.json").read_text())["environments"]
    assert found["name"] == "north"
    said = done("export", bake, "-o", tmp_path / "scene", "--three", "--order", 3, *light)
    assert "transfer of order 3 in its attributes" in said
    assert not (tmp_path / "scene" / "transfer.bin").exists()
    said = done("export", bake, "-o", tmp_path / "page", "--web", "--gpu", *light)
    assert "half precision" in said
    assert (tmp_path / "page" / "transfer.bin.gz").exists()


def test_a_page_is_written_with_the_lights_that_were_named(done, folder, tmp_path, no_npm, untyped):
    save_exr(tmp_path / "north.exr", lamp((0.0, 0.0, -1.0)))
    done("light", tmp_path / "north.exr", "-o", tmp_path / "coded.npy", "--order", 4)
    done("compress", folder / "ball.safetensors", "-o", tmp_path / "small.safetensors", "--clusters", 2)
    said = done(
        "export", folder / "ball.safetensors", "-o", tmp_path / "page", "--web", "--title", "A ball",
        "--light", tmp_path / "north.exr", "--light", tmp_path / "coded.npy",
        "--compressed", tmp_path / "small.safetensors",
    )  # fmt: skip
    assert "lights north, coded" in said
    assert f"torchprt serve {tmp_path / 'page'}" in said
    about = json.loads((tmp_path / "page" / "scene.json").read_text())
    assert about["title"] == "A ball"
    assert about["compressed"]["bytes"] == load(tmp_path / "small.safetensors").bytes
    image, coded = (np.array(each["coefficients"]) for each in about["environments"])
    np.testing.assert_array_equal(image, coded)


def test_a_page_takes_its_title_from_the_file_and_its_lights_from_the_samples(done, folder, tmp_path, no_npm, untyped):
    said = done("export", folder / "ball.safetensors", "-o", tmp_path / "page", "--web")
    assert "Studio" in said
    about = json.loads((tmp_path / "page" / "scene.json").read_text())
    assert about["title"] == "ball"
    assert len(about["environments"]) == len(BUILT_IN)


def test_a_page_offers_those_that_are_named(done, folder, tmp_path, no_npm, untyped):
    done(
        "export", folder / "ball.safetensors", "-o", tmp_path / "page", "--web", "--light", "sunset", "--light", "white"
    )
    about = json.loads((tmp_path / "page" / "scene.json").read_text())
    assert [each["name"] for each in about["environments"]] == ["sunset", "white"]


def test_transfer_leaves_as_attributes(done, folder, tmp_path):
    said = done("export", folder / "ball.safetensors", "-o", tmp_path / "a.glb", "--order", 2)
    assert "order 2 in _PRT_n" in said
    (mesh,) = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    vectors = stored(load(folder / "ball.safetensors"))
    np.testing.assert_array_equal(mesh.vertex_attributes["_PRT_0"], vectors[0, :4].T)
    assert "order 3" in done("export", folder / "ball.safetensors", "-o", tmp_path / "b.glb")
    # The ball came from a .ply.
    assert "a plain mesh, as " in said
    assert "ball.ply is no glTF" in said


def test_a_gltf_leaves_as_the_asset_that_it_was(done, folder, tmp_path):
    ball = trimesh.load(folder / "ball.ply", process=False)
    ball.visual = trimesh.visual.TextureVisuals(uv=ball.vertices[:, :2])
    ball.export(tmp_path / "ball.glb")
    done("bake", tmp_path / "ball.glb", "-o", tmp_path / "a.safetensors", "--unshadowed", "--order", 3)
    said = done("export", tmp_path / "a.safetensors", "-o", tmp_path / "lit.glb")
    assert f"keeps what {tmp_path / 'ball.glb'} holds" in said
    assert "albedo in _PRT_ALBEDO" in said
    (mesh,) = trimesh.load(tmp_path / "lit.glb", process=False).geometry.values()
    np.testing.assert_allclose(mesh.visual.uv, ball.visual.uv, atol=1e-6)
    # Elsewhere it must be named, and then it must be the one.
    (tmp_path / "ball.glb").rename(tmp_path / "moved.glb")
    assert "is not there any more: --source" in done("export", tmp_path / "a.safetensors", "-o", tmp_path / "b.glb")
    again = ["--source", tmp_path / "moved.glb"]
    assert "moved.glb holds" in done("export", tmp_path / "a.safetensors", "-o", tmp_path / "b.glb", *again)
    assert (tmp_path / "b.glb").read_bytes() == (tmp_path / "lit.glb").read_bytes()
    done("shade", tmp_path / "a.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "c.glb")
