"""Does a glTF file hold exactly the values it was given, for readers that no one here wrote?"""

import json
import struct

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.preview import colours, linear_colours, save_glb, save_transfer_glb
from torchprt.shade import shader, srgb

POSITIONS = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0.25], [0, 1, 1e-3]], dtype=torch.float64)
NORMALS = torch.tensor([[0.0, 0, 2], [0, 0, 0], [0, 1, 0], [0.6, 0.8, 0]], dtype=torch.float64)
FACES = torch.tensor([[0, 1, 2], [0, 2, 3]])


def read(path):
    """The JSON of the file and its arrays by attribute, by hand."""
    content = path.read_bytes()
    magic, version, total = struct.unpack_from("<4sII", content)
    assert (magic, version, total) == (b"glTF", 2, len(content))
    length, kind = struct.unpack_from("<I4s", content, 12)
    assert (kind, length % 4) == (b"JSON", 0)
    tree = json.loads(content[20 : 20 + length])
    size, kind = struct.unpack_from("<I4s", content, 20 + length)
    binary = content[28 + length :]
    assert (kind, size) == (b"BIN\0", len(binary))
    assert tree["buffers"] == [{"byteLength": size}]

    def array(number):
        accessor = tree["accessors"][number]
        view = tree["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(part, kind).reshape(accessor["count"], width)

    (primitive,) = tree["meshes"][0]["primitives"]
    arrays = {name: array(number) for name, number in primitive["attributes"].items()}
    if "indices" in primitive:
        arrays["indices"] = array(primitive["indices"]).reshape(-1, 3)
    return tree, arrays


def test_refuses_a_model_of_nothing_and_a_place_that_is_none(tmp_path):
    with pytest.raises(InputError, match="would have no vertices"):
        save_glb(torch.zeros(0, 3), torch.zeros(0, 3), FACES[:0], tmp_path / "a.glb")
    with pytest.raises(InputError, match="cannot be written"):
        save_glb(POSITIONS, NORMALS, FACES, tmp_path / "none" / "a.glb")
    assert not list(tmp_path.iterdir())


def test_it_holds_what_it_was_given(tmp_path):
    colour = torch.tensor([[0.0, 0.5, 1], [1e-6, 0, 0], [0.25, 0.25, 0.25], [1, 1, 1]])
    extra = {"_WEIGHT": torch.arange(4.0)[:, None], "_FOUR": torch.randn(4, 4)}
    save_glb(POSITIONS, NORMALS, FACES, tmp_path / "a.glb", colour=colour, attributes=extra, extras={"a": [1, "ä"]})
    tree, arrays = read(tmp_path / "a.glb")
    assert list(arrays) == ["POSITION", "NORMAL", "COLOR_0", "_WEIGHT", "_FOUR", "indices"]
    np.testing.assert_array_equal(arrays["POSITION"], POSITIONS.float())
    np.testing.assert_array_equal(arrays["NORMAL"], np.float32([[0, 0, 1], [0, 1, 0], [0, 1, 0], [0.6, 0.8, 0]]))
    np.testing.assert_array_equal(arrays["COLOR_0"], colour)
    np.testing.assert_array_equal(arrays["_FOUR"], extra["_FOUR"])
    np.testing.assert_array_equal(arrays["indices"], FACES)
    place = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    assert np.float32(place["min"]).tolist() == [0, 0, 0]
    assert np.float32(place["max"]).tolist() == [1, 1, 0.25]
    assert tree["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    assert tree["meshes"][0]["extras"] == {"a": [1, "ä"]}
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.glb"]


def test_trimesh_reads_the_same(tmp_path):
    colour = torch.rand(4, 3)
    save_glb(POSITIONS, NORMALS, FACES, tmp_path / "a.glb", colour=colour, attributes={"_K": torch.ones(4, 2)})
    (mesh,) = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    np.testing.assert_array_equal(mesh.vertices, POSITIONS.float())
    np.testing.assert_array_equal(mesh.faces, FACES)
    np.testing.assert_array_equal(mesh.visual.vertex_attributes["color"], colour)
    np.testing.assert_array_equal(mesh.vertex_attributes["_K"], np.ones((4, 2)))


def test_without_faces_it_is_points(tmp_path):
    save_glb(POSITIONS[:1], NORMALS[:1], FACES[:0], tmp_path / "a.glb")
    tree, arrays = read(tmp_path / "a.glb")
    assert tree["meshes"][0]["primitives"][0]["mode"] == 0
    assert "indices" not in arrays
    assert len(arrays["POSITION"]) == 1


@pytest.mark.parametrize("tone", ["filmic", "none"])
def test_linear_colours_become_the_colours_of_a_ply_in_srgb(tone):
    radiance = torch.tensor([[0.0, 0.18, 1.0], [4.0, 1e-4, 1e6], [-1.0, 0.5, 0.02]])
    shown = (255 * srgb(linear_colours(radiance, 0.7, tone))).round().to(torch.uint8)
    assert torch.equal(shown, colours(radiance, 0.7, tone))


@pytest.mark.parametrize(("channels", "order", "count"), [(1, 1, 1), (1, 3, 3), (1, 4, 4), (3, 3, 7), (3, 4, 12)])
def test_light_over_the_attributes_is_what_the_shader_computes(make_transfer, tmp_path, channels, order, count):
    transfer = make_transfer(order=4, channels=channels)
    save_transfer_glb(transfer, tmp_path / "a.glb", order)
    tree, arrays = read(tmp_path / "a.glb")
    said = tree["meshes"][0]["extras"]["torchprt"]
    assert (said["order"], said["channels"]) == (order, channels)
    names = [name for name in arrays if name.startswith("_PRT_")]
    assert names == [f"_PRT_{k}" for k in range(count)]
    numbers = np.concatenate([arrays[name] for name in names], 1)
    assert not numbers[:, channels * order**2 :].any()
    light = torch.randn(order**2, 3, generator=torch.Generator().manual_seed(2))
    vectors = numbers[:, : channels * order**2].reshape(25, channels, order**2)
    # As a vertex shader would: a channel at a time.
    lit = [arrays["COLOR_0"][:, c] * (vectors[:, c % channels] @ light[:, c].numpy()) for c in range(3)]
    np.testing.assert_allclose(np.stack(lit, 1), shader(transfer.to_order(order))(light), rtol=1e-5, atol=1e-5)


def test_transfer_that_does_not_fit_attributes_is_refused(make_transfer, tmp_path):
    from transfers import random_glossy

    for words, transfer, order in (
        ("order 5 is not between 1 and the 4", make_transfer(order=4), 5),
        ("order 5 with 3 channels takes 19 attributes", make_transfer(order=5, channels=3), 5),
        (r"kind 'diffuse \+ exit' does not fit", random_glossy("exit", order=3, output_order=2), 2),
    ):
        with pytest.raises(InputError, match=words):
            save_transfer_glb(transfer, tmp_path / "a.glb", order)
    assert not list(tmp_path.iterdir())
