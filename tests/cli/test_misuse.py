"""Does whatever cannot be used end in one sentence that names it, with code 2 and nothing written?"""

import json
import math
import os
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from environments import save_exr
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from torchprt.light import disc

# The command itself


def test_a_verb_that_is_not_there_is_refused(misused):
    misused("frobnicate", arguments=["frobnicate"])


@pytest.mark.parametrize("verb", ["bake", "shade", "light", "export", "info"])
def test_a_verb_without_its_arguments_is_refused(verb, misused):
    misused("Missing", arguments=[verb])


def test_an_option_that_is_not_there_is_refused(misused, folder, tmp_path):
    misused("--ray", arguments=["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--ray", "5"])


def test_without_anything_it_shows_its_verbs(run):
    ended = run()
    assert "bake" in ended.out + ended.err
    assert "Traceback" not in ended.err


# Meshes


def triangle(vertices="0 0 0\n1 0 0\n0 1 0", faces="3 0 1 2\n", count=1):
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    return f"{header}element face {count}\nproperty list uchar int vertex_indices\nend_header\n{vertices}\n{faces}"


def draco():
    """A .glb whose triangles are in an extension, with nothing in the places of the plain ones."""
    extension = "KHR_draco_mesh_compression"
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, "extensions": {extension: {"bufferView": 0}}}
    tree = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [extension],
        "extensionsRequired": [extension],
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": [
            {"componentType": 5126, "type": "VEC3", "count": 3},
            {"componentType": 5125, "type": "SCALAR", "count": 3},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 8}],
        "buffers": [{"byteLength": 8}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", 8, 0x004E4942) + b"\1" * 8
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


MESHES = {
    "empty.ply": (b"", "is empty"),
    "truncated.ply": (trimesh.creation.icosphere().export(file_type="ply")[:-40], "export the mesh again"),
    "truncated.glb": (trimesh.creation.icosphere().export(file_type="glb")[:-40], "cut short"),
    "foreign.obj": (b"\x89PNG\r\n\x1a\n" * 50, ""),
    "foreign.ply": (b"hello\n" * 50, "not a .ply file"),
    "a.blend": (b"BLENDER", "not a mesh file"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no faces"),
    "points.ply": (triangle(faces="", count=0).encode(), "no faces"),
    "nan.ply": (triangle("0 0 0\n1 nan 0\n0 1 0").encode(), "not finite"),
    "zero.ply": (triangle("0 0 0\n0 0 0\n0 0 0").encode(), "all its vertices at zero"),
    "outside.ply": (triangle(faces="3 0 1 7\n").encode(), "vertex that does not exist"),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("role", ["mesh", "blocker", "info"])
def test_a_mesh_that_cannot_be_used(name, role, refused, tmp_path, folder):
    content, word = MESHES[name]
    if role == "info" and name == "a.blend":
        word = "no file that can be told of"
    path = tmp_path / name
    path.write_bytes(content)
    whole = ["bake", folder / "ball.ply", "--blocker", path, "-o", tmp_path / "a.safetensors"]
    arguments = {"mesh": ["bake", path, "-o", tmp_path / "a.safetensors"], "blocker": whole, "info": ["info", path]}
    refused(str(path), word, arguments=arguments[role])


def test_a_mesh_that_is_missing(refused, tmp_path):
    for arguments in (
        ["bake", tmp_path / "none.ply", "-o", tmp_path / "a.safetensors"],
        ["info", tmp_path / "none.ply"],
    ):
        refused("none.ply does not exist", arguments=arguments)


def test_a_folder_for_a_mesh(refused, tmp_path):
    (tmp_path / "a.ply").mkdir()
    refused("a.ply cannot be read", arguments=["bake", tmp_path / "a.ply", "-o", tmp_path / "a.safetensors"])


def test_a_compressed_mesh_that_is_damaged(refused, tmp_path):
    (tmp_path / "a.glb").write_bytes(draco())
    arguments = ["bake", tmp_path / "a.glb", "-o", tmp_path / "a.safetensors"]
    refused("a.glb", "damaged Draco data", arguments=arguments)


# Options of a bake


@pytest.mark.parametrize(
    "text", ["1.5", "-0.1", "nan", "inf", "0.5,0.5", "1,2,3", "0.1,0.2,0.3,0.4", "red", "", "0.5;0.5"]
)
def test_an_albedo_that_no_surface_has(text, refused, folder, tmp_path):
    refused("albedo", arguments=["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--albedo", text])


def test_colours_of_a_mesh_that_has_none(refused, folder, tmp_path):
    arguments = ["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--albedo", "vertex"]
    refused("ball.ply", "no vertex colours", arguments=arguments)


@pytest.mark.parametrize("text", ["-1", "1.5", "nan", "-inf", "two", "", "1e3"])
def test_bounces_that_cannot_be_counted(text, refused, folder, tmp_path):
    refused("bounces", arguments=["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--bounces", text])


def test_bounces_without_shadows(refused, folder, tmp_path):
    arguments = ["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--bounces", "1", "--unshadowed"]
    refused("bounces need shadows", arguments=arguments)


@pytest.mark.parametrize(
    ("option", "text"),
    [(option, text) for option in ("--order", "--rays", "--seed", "--threads") for text in ("-1", "x", "1.5", "")]
    + [("--order", "0"), ("--order", "65"), ("--rays", "0"), ("--rays", "99999999"), ("--threads", "0")],
)
def test_numbers_out_of_range(option, text, misused, folder, tmp_path):
    misused(option, arguments=["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", option, text])


# Outputs


VERBS = {
    "bake": (["ball.ply"], ".safetensors"),
    "shade": (["ball.safetensors", "--light", "lamp.exr"], ".npy"),
    "light": (["lamp.exr"], ".npy"),
    "export": (["ball.safetensors"], ".onnx"),
}


@pytest.fixture(params=VERBS)
def verb(request, folder, monkeypatch):
    """A verb with good inputs, whose work must not begin."""
    import torchprt.transfer
    from torchprt import light, scene

    def works(*_, **__):
        raise AssertionError("work began before the output was looked at")

    monkeypatch.setattr(torchprt.transfer, "load", works)
    monkeypatch.setattr(scene, "load", works)
    monkeypatch.setattr(light, "read_with_report", works)
    inputs, suffix = VERBS[request.param]
    return [request.param, *(item if item.startswith("--") else folder / item for item in inputs)], suffix


def test_an_output_in_a_folder_that_is_missing(verb, refused, tmp_path):
    arguments, suffix = verb
    refused("does not exist, make it first", arguments=[*arguments, "-o", tmp_path / "none" / f"a{suffix}"])


def test_an_output_that_is_a_folder(verb, refused, tmp_path):
    arguments, suffix = verb
    (tmp_path / f"a{suffix}").mkdir()
    refused("is a folder", arguments=[*arguments, "-o", tmp_path / f"a{suffix}"])


@pytest.mark.parametrize("name", ["a.txt", "a", "a.safetensors.bak"])
def test_an_output_of_another_kind(verb, name, refused, tmp_path):
    arguments, suffix = verb
    refused(f"{name} must end in", suffix, arguments=[*arguments, "-o", tmp_path / name])


def test_a_folder_without_permission(verb, refused, tmp_path, monkeypatch):
    # The administrator, who runs tests in containers, may write anywhere.
    asked = os.access
    monkeypatch.setattr("os.access", lambda path, mode: mode != os.W_OK and asked(path, mode))
    arguments, suffix = verb
    refused("no permission", arguments=[*arguments, "-o", tmp_path / f"a{suffix}"])


def test_a_demo_where_a_file_stands(refused, tmp_path):
    (tmp_path / "a").write_text("mine")
    refused("cannot be made", arguments=["demo", "-o", tmp_path / "a"])


# Lights


def lights(folder, tmp_path, path):
    """The ways to use an environment image."""
    yield ["shade", folder / "ball.safetensors", "--light", path, "-o", tmp_path / "out.npy"]
    yield ["light", path, "-o", tmp_path / "out.npy"]


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("empty.exr", b"", "is empty"),
        ("empty.png", b"", "is empty"),
        ("foreign.exr", b"hello" * 40, "no image"),
        ("foreign.hdr", bytes(range(256)), "no image"),
        ("head.exr", b"\x76\x2f\x31\x01\x02\0\0\0", "damaged or truncated"),
        ("none.png", None, "does not exist"),
    ],
)
def test_an_image_that_cannot_be_used(name, content, word, refused, folder, tmp_path):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    for arguments in lights(folder, tmp_path, tmp_path / name):
        refused(name, word, arguments=arguments)
    refused(name, word, arguments=["info", tmp_path / name])


def test_a_truncated_image(refused, folder, tmp_path):
    (tmp_path / "a.exr").write_bytes((folder / "lamp.exr").read_bytes()[:-200])
    for arguments in lights(folder, tmp_path, tmp_path / "a.exr"):
        refused("a.exr is damaged or truncated", arguments=arguments)


def test_an_environment_that_is_not_twice_as_wide_as_high(refused, folder, tmp_path):
    save_exr(tmp_path / "a.exr", np.ones((8, 15, 3)))
    for arguments in lights(folder, tmp_path, tmp_path / "a.exr"):
        refused("a.exr is 15 x 8 pixels", "twice as wide as high", arguments=arguments)


@pytest.mark.parametrize("value", [math.inf, math.nan])
def test_pixels_that_are_not_finite_are_refused_and_repaired_on_request(value, refused, run, folder, tmp_path):
    pixels = np.ones((8, 16, 3))
    pixels[3, 4, 1] = value
    save_exr(tmp_path / "a.exr", pixels)
    for arguments in lights(folder, tmp_path, tmp_path / "a.exr"):
        refused("a.exr holds", "--repair", arguments=arguments)
    for arguments in lights(folder, tmp_path, tmp_path / "a.exr"):
        ended = run(*arguments, "--repair")
        assert ended.code == 0
        assert "replaced by the median" in ended.out
        assert not ended.err
        assert np.isfinite(np.load(tmp_path / "out.npy")).all()
    # All its neighbours are 1.
    run("light", save_exr(tmp_path / "ones.exr", np.ones((8, 16, 3))), "-o", tmp_path / "ones.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "out.npy"), np.load(tmp_path / "ones.npy"))


def test_nothing_to_repair_from(refused, folder, tmp_path):
    save_exr(tmp_path / "a.exr", np.full((8, 16, 3), np.nan))
    for arguments in lights(folder, tmp_path, tmp_path / "a.exr"):
        refused("a.exr has a channel without any finite value", arguments=[*arguments, "--repair"])


def test_negative_radiance_is_treated_and_told(run, folder, tmp_path):
    pixels = np.ones((8, 16, 3))
    pixels[2, 3] = -4
    save_exr(tmp_path / "bad.exr", pixels)
    save_exr(tmp_path / "good.exr", pixels.clip(0))
    results = []
    for name in ("bad", "good"):
        for arguments in lights(folder, tmp_path, tmp_path / f"{name}.exr"):
            ended = run(*arguments)
            assert ended.code == 0
            assert not ended.err
            assert ("3 values are negative, down to -4: they were set to 0" in ended.out) == (name == "bad")
            results.append(np.load(tmp_path / "out.npy"))
    np.testing.assert_array_equal(results[0], results[2])
    np.testing.assert_array_equal(results[1], results[3])


def pickled(path):
    np.save(path, np.array([{"light": 1}], dtype=object), allow_pickle=True)


def saved(values):
    return lambda path: np.save(path, values)


def cut(path):
    np.save(path, np.zeros((16, 3), np.float32))
    path.write_bytes(path.read_bytes()[:-5])


LIGHTS = {
    "none": (lambda path: None, "does not exist"),
    "empty": (lambda path: path.write_bytes(b""), "not a whole .npy"),
    "foreign": (lambda path: path.write_bytes(b"hello" * 99), "not a whole .npy"),
    "archive": (lambda path: path.write_bytes(b"PK\3\4" * 20), "not a whole .npy"),
    "pickled": (pickled, "not a whole .npy"),
    "truncated": (cut, "not a whole .npy"),
    "folder": (lambda path: path.mkdir(), "is a folder"),
    "another_order": (saved(np.zeros((9, 3), np.float32)), "order 3 but the transfer is of order 4"),
    "no_square": (saved(np.zeros((15, 3))), "15 coefficients"),
    "no_rows": (saved(np.zeros((0, 3))), "0 coefficients"),
    "one_channel": (saved(np.zeros((16, 1))), "[16, 1]"),
    "flat": (saved(np.zeros(48)), "[48]"),
    "complex": (saved(np.zeros((16, 3), complex)), "complex128"),
    "text": (saved(np.full((16, 3), "1")), "<U1"),
    "nan": (saved(np.full((16, 3), np.nan)), "NaN or infinite"),
    "large": (saved(np.full((16, 3), 1e300)), "NaN or infinite"),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_coefficients_that_cannot_be_used(name, refused, folder, tmp_path):
    make, word = LIGHTS[name]
    path = tmp_path / f"{name}.npy"
    make(path)
    arguments = ["shade", folder / "ball.safetensors", "--light", path, "-o", tmp_path / "out.npy"]
    refused(f"{name}.npy", word, arguments=arguments)
    # These hold something else, which can be told.
    if name not in ("another_order", "no_square", "no_rows", "one_channel", "flat"):
        refused(f"{name}.npy", "is a folder" if name == "folder" else word, arguments=["info", path])


@pytest.mark.parametrize("text", ["0", "-1", "65"])
def test_a_light_of_no_order(text, misused, folder, tmp_path):
    misused("order", arguments=["light", folder / "lamp.exr", "-o", tmp_path / "a.npy", "--order", text])


# Transfer


def rewritten(folder, path, change=None, drop=(), **metadata):
    tensors = load_file(folder / "ball.safetensors")
    with safe_open(folder / "ball.safetensors", framework="pt") as file:
        entries = file.metadata()
    if change:
        change(tensors)
    for name in drop:
        tensors.pop(name, None)
        entries.pop(name, None)
    save_file(tensors, path, metadata={**entries, **metadata})


def poisoned(tensors):
    tensors["diffuse.signal.values"][0, 0, 0] = math.nan


def whole_numbers(tensors):
    tensors["diffuse.signal.values"] = tensors["diffuse.signal.values"].to(torch.int32)


def renamed(kind, other):
    """What the file says of its layers, one of whose kinds is another."""
    said = [
        {
            "name": "diffuse",
            "kind": "diffuse",
            "tensors": ["albedo"],
            "signal": {"kind": "dense", "tensors": ["values"]},
        }
    ]
    return json.dumps(said).replace(f'"kind": "{kind}"', f'"kind": "{other}"')


def shorter(tensors):
    tensors["positions"] = tensors["positions"][:-1].clone()


def truncate(folder, path):
    path.write_bytes((folder / "ball.safetensors").read_bytes()[:-1000])


TRANSFERS = {
    "none": (lambda folder, path: None, "does not exist"),
    "empty": (lambda folder, path: path.write_bytes(b""), "not a whole safetensors"),
    "foreign": (lambda folder, path: path.write_bytes(b"hello" * 99), "not a whole safetensors"),
    "truncated": (truncate, "not a whole safetensors"),
    "stranger": (lambda folder, path: save_file({"x": torch.zeros(3)}, path), "not a transfer"),
    "no_tensor": (lambda folder, path: rewritten(folder, path, drop=["diffuse.albedo"]), "'diffuse.albedo'"),
    "no_metadata": (lambda folder, path: rewritten(folder, path, drop=["rays"]), "'rays'"),
    "newer": (lambda folder, path: rewritten(folder, path, format="99"), "newer"),
    "layer": (lambda folder, path: rewritten(folder, path, layers=renamed("diffuse", "subsurface")), "'subsurface'"),
    "signal": (lambda folder, path: rewritten(folder, path, layers=renamed("dense", "wavelet")), "'wavelet'"),
    "receivers": (lambda folder, path: rewritten(folder, path, receivers='{"kind": "voxels"}'), "'voxels'"),
    "nan": (lambda folder, path: rewritten(folder, path, poisoned), "NaN"),
    "dtype": (lambda folder, path: rewritten(folder, path, whole_numbers), "int32"),
    "shape": (lambda folder, path: rewritten(folder, path, shorter), "[162, 3]: it must be [V, 3] with V = 161"),
}


@pytest.mark.parametrize("name", TRANSFERS)
def test_a_transfer_that_cannot_be_used(name, refused, folder, tmp_path):
    make, word = TRANSFERS[name]
    path = tmp_path / f"{name}.safetensors"
    make(folder, path)
    for arguments in (
        ["shade", path, "--light", folder / "lamp.exr", "-o", tmp_path / "out.npy"],
        ["export", path, "-o", tmp_path / "out.onnx"],
        ["info", path],
    ):
        refused(path.name, word, arguments=arguments)


# Options of shading and of export


@pytest.mark.parametrize(
    ("option", "text"),
    [
        *(("--rotate", text) for text in ("1,2,3,4", "1,,2", "a,b,c", "nan,0,0", "inf,0,0", "")),
        *(("--size", text) for text in ("800", "0x600", "800x0", "-1x5", "800,600", "99999x9", "x", "²x3", "1.5x2")),
        *(("--view", text) for text in ("0,0,0", "1,2", "x,y,z", "nan,0,1", "")),
        *(("--window", text) for text in ("hamming", "Hann", "")),
        *(("--tone", text) for text in ("aces", "Filmic", "")),
        *(("--exposure", text) for text in ("nan", "inf", "-200")),
    ],
)
@pytest.mark.parametrize("suffix", [".npy", ".png"])
def test_options_of_shading_that_make_no_sense(option, text, suffix, refused, folder, tmp_path):
    arguments = ["shade", folder / "ball.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / f"a{suffix}"]
    refused(f"{option} is", text, arguments=[*arguments, option, text])


def test_an_exposure_that_is_no_number(misused, folder, tmp_path):
    arguments = ["shade", folder / "ball.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "a.png"]
    misused("--exposure", arguments=[*arguments, "--exposure", "bright"])


def test_an_export_from_nothing_known(refused, folder, tmp_path):
    arguments = ["export", folder / "ball.safetensors", "-o", tmp_path / "a.onnx"]
    refused("--from is 'image'", arguments=[*arguments, "--from", "image"])
    for size in ("1", "0", "-4"):
        refused("size", arguments=[*arguments, "--from", "environment", "--size", size])


@pytest.mark.parametrize("content", [None, b"", b"hello" * 20])
def test_an_onnx_file_that_is_none(content, refused, tmp_path):
    path = tmp_path / "a.onnx"
    if content is not None:
        path.write_bytes(content)
    refused("a.onnx", arguments=["info", path])


def test_a_bug_is_not_taken_for_a_fault_of_the_input(run, folder, tmp_path, monkeypatch):
    """Only InputError is a sentence: anything else must keep its traceback."""

    def breaks(*_, **__):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("torchprt.light.project", breaks)
    with pytest.raises(ZeroDivisionError):
        run("light", folder / "lamp.exr", "-o", tmp_path / "a.npy")
    assert not list(tmp_path.iterdir())


def test_a_light_file_is_where_the_sentence_says(folder, refused, tmp_path):
    """The name is given as the user wrote it."""
    np.save(tmp_path / "a.npy", disc((0.0, 1.0, 0.0), 0.5, 1.0, 3).numpy())
    given = Path(tmp_path) / "." / "a.npy"
    refused(str(given), arguments=["shade", folder / "ball.safetensors", "--light", given, "-o", tmp_path / "b.npy"])


def test_a_page_without_its_option_is_told_of_it(refused, folder, tmp_path):
    for name in ("page", "made"):
        if name == "made":
            (tmp_path / name).mkdir()
        refused(
            f"{name} must end in",
            "give --web",
            arguments=["export", folder / "ball.safetensors", "-o", tmp_path / name],
        )


def test_an_input_of_another_kind_is_called_by_its_name(refused, folder, tmp_path):
    refused("ball.ply is a mesh, not a transfer", arguments=["shade", folder / "ball.ply", "-o", tmp_path / "a.npy"])
    refused(
        "ball.safetensors is a transfer, not a mesh",
        arguments=["bake", folder / "ball.safetensors", "-o", tmp_path / "a.safetensors"],
    )
