"""Do the other ways out (a page, models as glTF, a server) end where the command line promises?"""

import importlib
import json
import re
import signal
import subprocess
import sys
import urllib.request

import numpy as np
import pytest
import torch
import trimesh
from environments import lamp, save_exr

from torchprt.preview import linear_colours
from torchprt.transfer import load


@pytest.fixture
def no_npm(tmp_path_factory, monkeypatch):
    """Libraries that are only names."""
    export = importlib.import_module("torchprt.web.export")
    folder = tmp_path_factory.mktemp("libraries")
    for name in export.LOADED:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(name)
    monkeypatch.setattr(export, "libraries", lambda: folder)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["-o", "page", "--web", "--from", "environment"], ["--from", "a page"]),
        (["-o", "page", "--web", "--size", 8], ["--size", "a page"]),
        (["-o", "page", "--web", "--order", 2], ["--order", "a page"]),
        (["-o", "a.onnx", "--light", "l.exr"], ["--light", ".onnx without --web"]),
        (["-o", "a.onnx", "--order", 2], ["--order", ".onnx"]),
        (["-o", "a.glb", "--title", "T"], ["--title", ".glb without --web"]),
        (["-o", "a.glb", "--size", 8], ["--size", ".glb"]),
        (["-o", "a.glb", "--order", 5], ["order 5 is not between 1 and the 4"]),
        (["-o", "page", "--web", "--light", "none.exr"], ["none.exr"]),
        (["-o", "page", "--web", "--compressed", "none.safetensors"], ["none.safetensors"]),
        (["-o", "a.gltf"], ["must end in", ".onnx", ".glb"]),
    ],
)
def test_options_that_have_no_use_are_refused(refused, folder, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    refused(*words, arguments=["export", folder / "ball.safetensors", *options])


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
    assert len(about["environments"]) == 4


def test_a_fixed_light_leaves_as_gltf_with_linear_colours(done, folder, tmp_path):
    options = ["--light", folder / "lamp.exr", "--exposure", 0.5]
    done("shade", folder / "ball.safetensors", "-o", tmp_path / "a.glb", *options)
    done("shade", folder / "ball.safetensors", "-o", tmp_path / "a.npy", *options)
    (mesh,) = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    bake = load(folder / "ball.safetensors")
    np.testing.assert_array_equal(mesh.vertices, bake.positions)
    np.testing.assert_array_equal(mesh.faces, bake.faces)
    expected = linear_colours(torch.from_numpy(np.load(tmp_path / "a.npy")), 0.5)
    np.testing.assert_array_equal(mesh.visual.vertex_attributes["color"], expected)


def test_transfer_leaves_as_attributes(done, folder, tmp_path):
    said = done("export", folder / "ball.safetensors", "-o", tmp_path / "a.glb", "--order", 2)
    assert "order 2 in _PRT_n" in said
    (mesh,) = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    np.testing.assert_array_equal(mesh.vertex_attributes["_PRT_0"], load(folder / "ball.safetensors").transfer[0, :4].T)
    assert "order 3" in done("export", folder / "ball.safetensors", "-o", tmp_path / "b.glb")


def test_serving_what_is_no_page_is_refused(refused, tmp_path):
    refused("index.html", "--web", arguments=["serve", tmp_path])


def test_a_page_is_served_until_ctrl_c(tmp_path):
    (tmp_path / "index.html").write_text("a page")
    command = [sys.executable, "-m", "torchprt", "serve", str(tmp_path), "--port", "0"]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell that runs the tests in the background makes its children deaf to Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as server:
        try:
            assert server.stdout is not None
            address = re.search(r"http://127\.0\.0\.1:\d+/", server.stdout.readline())
            assert address
            with urllib.request.urlopen(address[0], timeout=20) as answer:
                assert answer.read() == b"a page"
            server.send_signal(signal.SIGINT)
            _, complaints = server.communicate(timeout=20)
        finally:
            server.kill()
    assert server.returncode == 0
    assert complaints == ""
