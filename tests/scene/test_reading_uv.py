"""Do texture coordinates and tangents of a file become the tangents of its mesh?"""

import json

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.scene import read_mesh

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.array([[0.0, 0], [0, 1], [1, 1], [1, 0]], dtype=np.float32)
"""u runs along +y of the square."""
ALONG_Y = np.tile([0.0, 1, 0], (4, 1))

OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 0 1\nvt 1 1\nvt 1 0\n"


@pytest.fixture
def write(tmp_path):
    def write(name: str, content: str | bytes):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def blob(tangents=None, placed=None, uv=UV, count=4) -> bytes:
    """A .glb of the square with texture coordinates and, if given, tangents [4, 4]; `placed` is a node's matrix."""
    parts = {"POSITION": SQUARE, "TEXCOORD_0": uv, "TANGENT": tangents}
    views, accessors, data, attributes = [], [], b"", {}
    for name, array in {**parts, "index": HALVES.astype(np.uint32)}.items():
        if array is None:
            continue
        content = np.ascontiguousarray(array).tobytes()
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(content)})
        kind = "SCALAR" if name == "index" else f"VEC{array.shape[1]}"
        component = {"f": 5126, "u": 5125 if array.dtype.itemsize == 4 else 5123}[array.dtype.kind]
        accessor = {"bufferView": len(views) - 1, "componentType": component, "type": kind}
        accessors.append({**accessor, "count": array.size if name == "index" else len(array)})
        if name == "POSITION":
            accessors[-1] |= {"min": [0, 0, 0], "max": [1, 1, 0]}
        if name != "index":
            attributes[name] = len(accessors) - 1
        data += content + b"\0" * (-len(content) % 4)
    node = {"mesh": 0} if placed is None else {"mesh": 0, "matrix": np.asarray(placed, float).T.ravel().tolist()}
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(count // 4))}],
        "nodes": [node] * (count // 4),
        "meshes": [{"primitives": [{"attributes": attributes, "indices": len(accessors) - 1, "mode": 4}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + len(data)
    head = b"glTF" + (2).to_bytes(4, "little") + total.to_bytes(4, "little")
    return head + len(text).to_bytes(4, "little") + b"JSON" + text + len(data).to_bytes(4, "little") + b"BIN\0" + data


# Misuse


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("f 1/9 2/2 3/3\n", "names texture coordinates 9 of 4"),
        ("f 1/0 2/2 3/3\n", "line 9 has index 0"),
        ("f 1/-9 2/2 3/3\n", "line 9 has index -9"),
        ("vt\nf 1 2 3\n", "line 9 has 0 numbers"),
        ("vt x 1\nf 1 2 3\n", "line 9 holds something that is not a number"),
    ],
)
def test_refuses_texture_coordinates_that_do_not_exist(write, lines, words):
    with pytest.raises(InputError, match=words):
        read_mesh(write("a.obj", OBJ + lines))


# Files without


def test_a_mesh_without_coordinates_has_no_tangents_and_the_report_is_silent(write):
    mesh = read_mesh(write("a.obj", OBJ + "f 1 2 3\n"))
    assert mesh.tangents is None
    assert "texture" not in str(mesh.report)


# Wavefront


@pytest.mark.parametrize("face", ["f 1/1 2/2 3/3 4/4\n", "f 1/-4 2/-3 3/-2 4/-1\n", "f 1/1/ 2/2/ 3/3/ 4/4/\n"])
def test_obj_coordinates_give_tangents(write, face):
    mesh = read_mesh(write("a.obj", OBJ + face))
    np.testing.assert_allclose(mesh.tangents.numpy(), ALONG_Y, atol=1e-15)


def test_obj_seams_do_not_show(write):
    # A strip whose u begins anew in its middle: the vertices on the seam have two coordinates.
    text = "".join(f"v {x} {y} 0\n" for x in range(3) for y in range(2))
    text += "vt 0.5 0\nvt 0.5 1\nvt 1 0\nvt 1 1\nvt 0 0\nvt 0 1\n"
    mesh = read_mesh(write("a.obj", text + "f 1/1 3/3 4/4 2/2\nf 3/5 5/1 6/2 4/6\n"))
    assert len(mesh.positions) == 6
    np.testing.assert_allclose(mesh.tangents.numpy(), np.tile([1.0, 0, 0], (6, 1)), atol=1e-15)


def test_obj_faces_without_coordinates_leave_their_vertices_without_tangents(write):
    text = "v 5 0 0\nv 6 0 0\nv 5 1 0\n"
    mesh = read_mesh(write("a.obj", OBJ + text + "f 1/1 2/2 3/3 4/4\nf 5 6 7\n"))
    np.testing.assert_allclose(mesh.tangents.numpy(), np.concatenate([ALONG_Y, np.zeros((3, 3))]), atol=1e-15)
    assert mesh.report.missing_tangents == 3
    assert "3 vertices whose texture coordinates give no tangent" in str(mesh.report)


def test_obj_coordinates_of_one_number_span_no_area(write):
    mesh = read_mesh(write("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0\nvt 1\nvt .5\nf 1/1 2/2 3/3\n"))
    assert mesh.tangents is None
    assert mesh.report.missing_tangents == 3


# Stanford


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("s1", "t1")])
def test_ply_coordinates_give_tangents_under_any_name(write, names):
    header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    header += "".join(f"property float {name}\n" for name in names)
    header += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    body = "\n".join(" ".join(map(str, [*p, *uv])) for p, uv in zip(SQUARE, UV, strict=True))
    mesh = read_mesh(write("a.ply", f"{header}{body}\n3 0 1 2\n3 0 2 3\n"))
    np.testing.assert_allclose(mesh.tangents.numpy(), ALONG_Y, atol=1e-15)
    with pytest.raises(InputError, match=r"b\.ply"):
        read_mesh(write("b.ply", f"{header}{body}\n3 0 1 2\n3 0 2 9\n"))


# glTF


def test_glb_coordinates_give_tangents(write):
    mesh = read_mesh(write("a.glb", blob()))
    np.testing.assert_allclose(mesh.tangents.numpy(), ALONG_Y, atol=1e-15)


def test_glb_coordinates_may_be_whole_numbers(write):
    mesh = read_mesh(write("a.glb", blob(uv=(65535 * UV).astype(np.uint16))))
    np.testing.assert_allclose(mesh.tangents.numpy(), ALONG_Y, atol=1e-15)


def test_glb_tangents_come_before_coordinates(write):
    given = np.tile(np.array([0.6, 0.8, 0, -1], np.float32), (4, 1))
    mesh = read_mesh(write("a.glb", blob(given)))
    # The file is float32.
    np.testing.assert_allclose(mesh.tangents.numpy(), np.tile([0.6, 0.8, 0], (4, 1)), atol=1e-7)


@pytest.mark.parametrize("tangents", [None, np.tile(np.array([0, 1, 0, 1], np.float32), (4, 1))])
def test_glb_tangents_go_with_the_node(write, tangents):
    # Stretched along x, mirrored in z, turned so that y becomes z.
    matrix = np.array([[3.0, 0, 0, 5], [0, 0, -1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    mesh = read_mesh(write("a.glb", blob(tangents, matrix)))
    np.testing.assert_allclose(mesh.tangents.numpy(), np.tile([0.0, 0, -1], (4, 1)), atol=1e-7)


def test_glb_files_of_trimesh_carry_their_coordinates(write):
    visual = trimesh.visual.TextureVisuals(uv=UV)
    exported = trimesh.Trimesh(SQUARE, HALVES, visual=visual, process=False).export(file_type="glb")
    np.testing.assert_allclose(read_mesh(write("a.glb", exported)).tangents.numpy(), ALONG_Y, atol=1e-7)


def test_gltf_with_its_buffer_beside_it_carries_them_too(tmp_path):
    visual = trimesh.visual.TextureVisuals(uv=UV)
    scene = trimesh.Scene(trimesh.Trimesh(SQUARE, HALVES, visual=visual, process=False))
    for name, content in scene.export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    np.testing.assert_allclose(read_mesh(tmp_path / "model.gltf").tangents.numpy(), ALONG_Y, atol=1e-7)


def test_pieces_without_coordinates_leave_theirs_missing(write):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), geom_name="a")
    textured = trimesh.Trimesh(SQUARE, HALVES, visual=trimesh.visual.TextureVisuals(uv=UV), process=False)
    scene.add_geometry(textured, geom_name="b")
    mesh = read_mesh(write("a.glb", scene.export(file_type="glb")))
    has = mesh.tangents.any(dim=1)
    assert mesh.report.missing_tangents == int((~has).sum()) == len(mesh.positions) - 4
    assert torch.equal(mesh.positions[has].float(), torch.from_numpy(SQUARE))
    assert (mesh.tangent_field.norm(dim=1) - 1).abs().max() < 1e-15
