"""Does glTF come in as the standard says, whatever its bytes look like?"""

import base64
import json

import numpy as np
import pytest
import torch
from gltf_files import Gltf, draco, meshopt_view

from torchprt.errors import InputError
from torchprt.scene import read_mesh
from torchprt.scene.gltf import Document, pieces

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
UP = np.tile([0.0, 0, 1], (4, 1))
MIRROR = [-1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


def file(*primitives, **tree) -> Gltf:
    """A mesh of these primitives on one node."""
    made = primitives[0] if primitives and isinstance(primitives[0], Gltf) else Gltf()
    first = [each for each in primitives if not isinstance(each, Gltf)]
    made.tree |= {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": first}]}
    made.tree |= tree
    return made


def square(**attributes):
    made = Gltf()
    return file(made, made.primitive(HALVES.reshape(-1), POSITION=SQUARE, **attributes))


class Text(Gltf):
    """A .gltf of this tree as it stands."""

    def __init__(self, tree):
        super().__init__()
        self.tree = tree

    def save(self, path):
        path.write_text(json.dumps(self.tree))
        return path


@pytest.fixture
def read(tmp_path):
    """`read(file)`: the mesh of a file, by way of the disk."""
    return lambda made, name="a.glb": read_mesh(made.save(tmp_path / name))


@pytest.fixture
def refused(read):
    def refused(made, *words, name="a.glb"):
        with pytest.raises(InputError) as caught:
            read(made, name)
        message = str(caught.value)
        assert name in message
        assert "\n" not in message
        for word in words:
            assert word in message

    return refused


# Misuse and faults


def test_an_extension_that_must_be_known_and_is_not_is_refused_by_name(refused, read):
    made = square()
    made.tree["extensionsRequired"] = ["KHR_mesh_quantization", "ACME_voxels"]
    refused(made, "requires ACME_voxels", "without it")
    made.tree["extensionsRequired"] = []
    made.tree["extensionsUsed"] = ["ACME_voxels"]
    assert len(read(made).positions) == 4


def test_another_version_is_refused_by_its_number(refused):
    made = square()
    made.tree["asset"] = {"version": "1.0"}
    refused(made, "glTF 1.0", "convert it to glTF 2.0")


@pytest.mark.parametrize(
    ("key", "change", "words"),
    [
        ("nodes", [{"mesh": 1}], "meshes 1 of 1"),
        ("nodes", [{"mesh": -1}], "meshes -1 of 1"),
        ("scenes", [{"nodes": [3]}], "nodes 3 of 1"),
        ("scene", 2, "scenes 2 of 1"),
        ("nodes", [{"mesh": 0, "children": [1]}, {"children": [0]}], "inside itself"),
        ("nodes", [{"mesh": 0, "skin": 0}], "a mesh"),
        ("meshes", [{"primitives": [{"attributes": {"POSITION": 9}}]}], "accessors 9 of 2"),
    ],
)
def test_what_does_not_exist_is_named(key, change, words, refused, read):
    made = square()
    made.tree[key] = change
    if "skin" in str(change):
        # Without joints in its vertices a mesh is not skinned at all.
        assert len(read(made).positions) == 4
    else:
        refused(made, words)


def test_files_that_are_named_must_be_there(refused, tmp_path):
    made = square()
    made.save(tmp_path / "a.gltf")
    for uri, word in (
        ("none.bin", "none.bin, which does not exist"),
        ("https://example.org/a.bin", "download it"),
        ("data:application/octet-stream;base64,A", "damaged data URI"),
        ("data:application/octet-stream;base64", "without data"),
    ):
        tree = made.tree | {"buffers": [{"byteLength": len(made.data), "uri": uri}]}
        refused(Text(tree), word, name="b.gltf")


def test_numbers_behind_the_end_are_refused(refused):
    for change in ({"count": 5}, {"byteOffset": 4}, {"byteOffset": -4}, {"count": -1}):
        made = square()
        made.tree["accessors"][0] |= change
        refused(made, "accessor 0 ends behind its buffer view")
    made = square()
    made.tree["bufferViews"][0]["byteLength"] = 10_000
    refused(made, "buffer view 0 ends behind its buffer")
    made = square()
    made.tree["buffers"][0]["byteLength"] = 10_000
    refused(made, "of 10000 bytes of buffer 0")
    made = square()
    del made.tree["accessors"][0]["bufferView"]
    made.tree["accessors"][0]["count"] = 10**12
    refused(made, "accessor 0 of 1000000000000 values")


def test_attributes_of_uneven_length_are_refused(refused):
    refused(square(NORMAL=UP[:3]), "3 of NORMAL for 4 vertices")


def test_points_and_lines_alone_are_refused_and_beside_triangles_noted(refused, read):
    made = Gltf()
    lines = {**made.primitive(POSITION=SQUARE), "mode": 1}
    points = {**made.primitive(POSITION=SQUARE), "mode": 0}
    refused(file(made, lines), "1 primitive of lines left out")
    mesh = read(file(made, lines, made.primitive(HALVES.reshape(-1), POSITION=SQUARE), points, points))
    assert len(mesh.positions) == 4
    assert mesh.report.notes == ("1 primitive of lines left out.", "2 primitives of points left out.")
    assert str(mesh.report).endswith("left out.")


def test_a_decoder_that_is_missing_is_named(refused, monkeypatch):
    import sys

    for package, made in (("DracoPy", packed_square()), ("meshopt", meshopt_square())):
        monkeypatch.setitem(sys.modules, package, None)
        refused(made, package, "install it, or export the mesh without compression")


@pytest.mark.parametrize("kind", ["draco", "meshopt"])
def test_compressed_data_with_wrong_bytes_are_read_or_refused_but_never_break(kind, tmp_path):
    made = packed_square() if kind == "draco" else meshopt_square()
    content, random, refusals = made.glb(), np.random.default_rng(1), 0
    for _ in range(150):
        damaged = bytearray(content)
        for at in random.integers(len(content) - len(made.data), len(content), size=random.integers(1, 6)):
            damaged[at] = random.integers(0, 256)
        (tmp_path / "a.glb").write_bytes(bytes(damaged))
        try:
            mesh = read_mesh(tmp_path / "a.glb")
        except InputError:
            refusals += 1
        else:
            assert mesh.positions.isfinite().all()
            assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.positions)
    assert refusals > 0


# Containers


@pytest.mark.parametrize("name", ["a.glb", "a.gltf", "two words.gltf"])
def test_buffers_are_found_in_the_file_and_beside_it(read, name):
    mesh = read(square(), name)
    np.testing.assert_array_equal(mesh.positions, SQUARE)
    np.testing.assert_array_equal(mesh.faces, HALVES)


def test_buffers_and_images_may_stand_in_the_text(tmp_path):
    made = square()
    picture = b"\x89PNG\r\n\x1a\nrest"
    text = base64.b64encode(picture).decode()
    made.tree["images"] = [
        {"bufferView": made.view(picture)},
        {"uri": f"data:image/jpeg;base64,{text}"},
        {"uri": "data:;base64," + text},
        {"uri": "a%20b.png"},
    ]
    (tmp_path / "a b.png").write_bytes(picture)
    coded = base64.b64encode(made.data).decode()
    made.tree["buffers"] = [{"byteLength": len(made.data), "uri": f"data:;base64,{coded}"}]
    document = Document.read(Text(made.tree).save(tmp_path / "a.gltf"))
    np.testing.assert_array_equal(pieces(document).pieces[0].positions, SQUARE)
    kinds = [document.image(number) for number in range(4)]
    assert kinds == [(picture, kind) for kind in ("image/png", "image/jpeg", "image/png", "image/png")]


# Arrays


@pytest.mark.parametrize(("kind", "largest"), [("i1", 127), ("u1", 255), ("i2", 32767), ("u2", 65535)])
def test_whole_numbers_are_themselves_or_stand_for_shares(kind, largest, tmp_path):
    made = Gltf()
    least = 0 if kind[0] == "u" else -largest - 1
    array = np.array([[0, 1], [largest, least]], f"<{kind}")
    made.accessor(array)
    made.accessor(array, normalized=True)
    document = Document(made.glb(), tmp_path / "a.glb")
    np.testing.assert_array_equal(document.accessor(0), array)
    # The least has no counterpart: section 3.11 of the specification clamps it.
    expected = [[0, 1 / largest], [1, max(least / largest, -1)]]
    np.testing.assert_array_equal(document.accessor(1), expected)


def test_values_may_stand_among_others(read):
    rows = np.zeros(4, np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 4)]))
    rows["p"], rows["n"], rows["c"] = SQUARE, UP, [0, 51, 255, 7]
    made = Gltf()
    view = made.view(rows.tobytes(), byteStride=28)
    numbers = [
        made.accessor(rows["p"], bufferView=view),
        made.accessor(rows["n"], bufferView=view, byteOffset=12),
        made.accessor(rows["c"], bufferView=view, byteOffset=24, normalized=True),
    ]
    made = file(
        made, made.primitive(HALVES.reshape(-1), **dict(zip(("POSITION", "NORMAL", "COLOR_0"), numbers, strict=True)))
    )
    mesh = read(made)
    np.testing.assert_array_equal(mesh.positions, SQUARE)
    assert mesh.report.computed_normals == 0
    assert torch.equal(mesh.colours, torch.tensor([[0, 0.2, 1.0]]).expand(4, 3))


@pytest.mark.parametrize("based", [False, True])
def test_sparse_values_replace_those_below_them_or_zeros(read, based):
    made = Gltf()
    entry = {} if based else {"bufferView": None}
    start = np.array([[0, 0, 0], [1, 0, 0], [9, 9, 9], [0, 1, 0]], "<f4")
    number = made.accessor(start, **entry)
    places = [2] if based else [1, 2, 3]
    sparse = {"count": len(places), "indices": {"bufferView": made.view(np.array(places, "u1").tobytes())}}
    sparse["indices"]["componentType"] = 5121
    sparse["values"] = {"bufferView": made.view(SQUARE[places].astype("<f4").tobytes())}
    made.tree["accessors"][number]["sparse"] = sparse
    mesh = read(file(made, made.primitive(HALVES.reshape(-1), POSITION=number)))
    np.testing.assert_array_equal(mesh.positions, SQUARE)


@pytest.mark.parametrize("kind", ["u1", "u2", "u4"])
def test_indices_are_of_any_size(read, kind):
    made = Gltf()
    made = file(made, made.primitive(made.accessor(HALVES.reshape(-1).astype(f"<{kind}")), POSITION=SQUARE))
    np.testing.assert_array_equal(read(made).faces, HALVES)


@pytest.mark.parametrize(
    ("mode", "faces"),
    [
        (4, [[0, 1, 2], [3, 4, 5]]),
        # Each triangle turns as the first: p_i of section 3.7.2.1.
        (5, [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]),
        (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0], [4, 5, 0]]),
    ],
)
def test_without_indices_vertices_follow_each_other(read, mode, faces):
    made = Gltf()
    corners = np.array([[x, y, 0] for x in range(3) for y in range(2)])
    mesh = read(file(made, {**made.primitive(POSITION=corners), "mode": mode}))
    assert mesh.faces.tolist() == faces
    assert len(mesh.positions) == 6


def test_a_strip_is_wound_one_way(read):
    made = Gltf()
    corners = np.array([[x, 1 - y, 0] for x in range(4) for y in range(2)])
    mesh = read(file(made, {**made.primitive(np.arange(8), POSITION=corners), "mode": 5}))
    assert mesh.report.flipped_edges == 0
    assert mesh.normals[:, 2].tolist() == [1.0] * 8


def test_every_set_of_coordinates_and_the_material_of_every_piece_are_there(tmp_path):
    made = Gltf(materials=[{}, {}, {}])
    uv = SQUARE[:, :2]
    first = {**made.primitive(HALVES.reshape(-1), POSITION=SQUARE, TEXCOORD_0=uv, TEXCOORD_1=2 * uv), "material": 2}
    quarter = made.accessor((uv * 255).astype("u1"), normalized=True)
    second = made.primitive(HALVES.reshape(-1), POSITION=SQUARE, TEXCOORD_1=quarter, COLOR_0=np.full((4, 4), 2.5))
    found = pieces(Document(file(made, first, second).glb(), tmp_path / "a.glb")).pieces
    assert [piece.material for piece in found] == [2, None]
    assert [list(piece.uv) for piece in found] == [[0, 1], [1]]
    np.testing.assert_array_equal(found[0].uv[1], 2 * uv)
    np.testing.assert_array_equal(found[1].uv[1], uv)
    # Above one, and with an alpha: as they are.
    assert found[1].colours.tolist() == [[2.5] * 4] * 4
    assert [(piece.mesh, piece.primitive, piece.node) for piece in found] == [(0, 0, 0), (0, 1, 0)]


# Nodes


def test_only_the_default_scene_is_drawn_and_only_once(read):
    made = square()
    made.tree["nodes"] = [{"mesh": 0, "translation": [k, 0, 0]} for k in range(3)]
    made.tree["scenes"], made.tree["scene"] = [{"nodes": [0]}, {"nodes": [2, 1, 2]}], 1
    # In the order of the nodes, not of the scene.
    assert read(made).positions[:, 0].tolist() == [1, 2, 2, 1, 2, 3, 3, 2]
    del made.tree["scene"]
    assert read(made).positions[:, 0].tolist() == [0, 1, 1, 0]
    del made.tree["scenes"]
    assert len(read(made).positions) == 12
    del made.tree["nodes"]
    assert len(read(made).positions) == 4


def test_nodes_stand_in_the_frame_of_their_parents(read):
    made = square()
    half = 0.5**0.5
    made.tree["nodes"] = [
        {"children": [1], "translation": [5, 0, 0], "rotation": [0, 0, half, half], "scale": [2, 1, 1]},
        {"mesh": 0, "translation": [1, 0, 0]},
    ]
    # Moved by one, stretched along x by two, turned from x to y, moved by five.
    x, y = SQUARE[:, 0], SQUARE[:, 1]
    expected = np.stack([5 - y, 2 * (x + 1), 0 * x], axis=1)
    np.testing.assert_allclose(read(made).positions, expected, atol=1e-15)


def test_a_mirrored_node_shows_the_same_side(read):
    made = square(NORMAL=UP, TANGENT=np.tile([1.0, 0, 0, 1], (4, 1)))
    made.tree["nodes"] = [{"mesh": 0, "matrix": MIRROR}]
    mesh = read(made)
    assert mesh.report.opposed_normals == 0
    np.testing.assert_array_equal(mesh.normals, UP)
    np.testing.assert_array_equal(mesh.tangents, np.tile([-1.0, 0, 0], (4, 1)))


def test_gpu_instances_are_nodes(read):
    made, half = square(), 0.5**0.5
    attributes = {
        "TRANSLATION": made.accessor(np.array([[0, 0, 0], [0, 0, 3]], "<f4")),
        "ROTATION": made.accessor(np.array([[0, 0, 0, 32767], [0, 0, 23170, 23170]], "<i2"), normalized=True),
        "SCALE": made.accessor(np.array([[1, 1, 1], [2, 2, 2]], "<f4")),
    }
    extensions = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    made.tree["nodes"] = [{"mesh": 0, "translation": [10, 0, 0], "extensions": extensions}]
    found = read(made).positions
    places = [{"translation": [0, 0, 0]}, {"translation": [0, 0, 3], "rotation": [0, 0, half, half], "scale": [2] * 3}]
    made.tree["nodes"] = [{"children": [1, 2], "translation": [10, 0, 0]}, *({"mesh": 0, **place} for place in places)]
    made.tree["nodes"][0].pop("mesh", None)
    np.testing.assert_allclose(found, read(made).positions, atol=1e-14)
    made.tree["nodes"] = [{"mesh": 0, "extensions": extensions}]
    extensions["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = made.accessor(np.ones((3, 3), "<f4"))
    with pytest.raises(InputError, match="uneven instances of node 0"):
        read(made)


# At rest


def skinned(weights, *, bind=True) -> Gltf:
    """The square on two joints: the first lifts by one, the second stands at x = 1 and stretches y by three."""
    made = Gltf()
    joints = made.accessor(np.tile([0, 1, 0, 0], (4, 1)).astype("u1"))
    primitive = made.primitive(HALVES.reshape(-1), POSITION=SQUARE, NORMAL=UP, JOINTS_0=joints, WEIGHTS_0=weights)
    made = file(made, primitive)
    made.tree["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [100, 0, 0]},
        {"translation": [0, 0, 1]},
        {"translation": [1, 0, 0], "scale": [1, 3, 1]},
    ]
    made.tree["scenes"] = [{"nodes": [0, 1, 2]}]
    made.tree["skins"] = [{"joints": [1, 2]}]
    if bind:
        inverse = np.stack([np.eye(4), np.eye(4)])
        inverse[1, :3, 3] = [-1, 0, 0]
        made.tree["skins"][0]["inverseBindMatrices"] = made.accessor(
            inverse.transpose(0, 2, 1).reshape(2, 16).astype("<f4")
        )
    return made


def test_a_skin_is_where_its_joints_are_and_not_where_its_node_is(read):
    weights = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0], [0, 0, 0, 0]])
    mesh = read(skinned(weights))
    # The third is half way between (1, 1, 1) and (1, 3, 0); the last names its first joint.
    np.testing.assert_allclose(mesh.positions, [[0, 0, 1], [1, 0, 0], [1, 2, 0.5], [0, 1, 1]], atol=1e-7)
    np.testing.assert_allclose(mesh.normals, UP, atol=1e-7)
    without = read(skinned(np.tile([0.0, 1, 0, 0], (4, 1)), bind=False))
    np.testing.assert_allclose(without.positions, SQUARE * [1, 3, 1] + [1, 0, 0], atol=1e-7)


def test_a_joint_that_does_not_exist_is_refused(refused):
    made = skinned(np.tile([0.0, 1, 0, 0], (4, 1)))
    made.tree["skins"][0]["joints"] = [1]
    refused(made, "damaged")
    made.tree["skins"][0]["joints"] = [1, 7]
    refused(made, "nodes 7 of 3")


def test_morph_targets_stand_at_their_default_weights(read):
    made = square()
    lift = made.accessor(UP.astype("<f4"))
    slide = made.accessor(np.tile([2.0, 0, 0], (4, 1)).astype("<f4"))
    made.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": lift}, {"POSITION": slide}]
    np.testing.assert_array_equal(read(made).positions, SQUARE)
    made.tree["meshes"][0]["weights"] = [0.5, 0.25]
    np.testing.assert_array_equal(read(made).positions, SQUARE + np.array([0.5, 0, 0.5]))
    made.tree["nodes"][0]["weights"] = [0, 1]
    np.testing.assert_array_equal(read(made).positions, SQUARE + np.array([2, 0, 0]))


# Compressed


def packed_square(**attributes) -> Gltf:
    made = Gltf()
    return file(made, draco(made, SQUARE, HALVES, **attributes))


def test_draco_is_decoded_with_all_its_attributes(tmp_path):
    uv = SQUARE[:, :2] / 2
    paint = np.array([[0, 255, 0], [1, 2, 3], [4, 5, 6], [7, 8, 9]], "u1")
    made = packed_square(NORMAL=UP, TEXCOORD_0=uv, COLOR_0=paint, TANGENT=np.float32([[1, 0, 0, 1]] * 4))
    # What the extension does not name stands outside, as ever.
    attributes = made.tree["meshes"][0]["primitives"][0]["attributes"]
    attributes["TEXCOORD_1"] = made.accessor((3 * uv).astype("<f4"))
    (piece,) = pieces(Document(made.glb(), tmp_path / "a.glb")).pieces
    # Positions of 20 bits.
    np.testing.assert_allclose(piece.positions, SQUARE, atol=2**-20)
    np.testing.assert_array_equal(piece.faces, HALVES)
    np.testing.assert_allclose(piece.normals, UP, atol=1e-6)
    np.testing.assert_array_equal(piece.uv[0], uv)
    np.testing.assert_array_equal(piece.uv[1], 3 * uv)
    np.testing.assert_array_equal(piece.colours, paint / 255)
    np.testing.assert_array_equal(piece.tangents, [[1, 0, 0]] * 4)


def test_draco_gives_whole_numbers_where_the_file_says_so(tmp_path):
    # As files come that were quantised first: 16-bit shares, which Draco holds as it likes.
    made = Gltf()
    primitive = draco(made, SQUARE * 32767, HALVES)
    made.tree["accessors"][primitive["attributes"]["POSITION"]] |= {"componentType": 5122, "normalized": True}
    (piece,) = pieces(Document(file(made, primitive).glb(), tmp_path / "a.glb")).pieces
    np.testing.assert_array_equal(piece.positions, SQUARE)


def test_draco_in_a_mirrored_node_shows_the_same_side(read):
    made = packed_square(NORMAL=UP)
    made.tree["nodes"] = [{"mesh": 0, "matrix": MIRROR}]
    assert read(made).report.opposed_normals == 0


def meshopt_square(name: str = "EXT_meshopt_compression", triangles: bool = True) -> Gltf:
    """Quantised positions, octahedral normals, exponential coordinates, and indices of either kind."""
    meshopt = pytest.importorskip("meshopt", reason="meshopt has no package for Python 3.10")

    made = Gltf()
    places = np.zeros((4, 4), "<i2")
    places[:, :3] = SQUARE * 32767
    normals = meshopt.encode_filter_oct(np.pad(UP, ((0, 0), (0, 1))).astype(np.float32), 4, 8)
    uv = meshopt.encode_filter_exp((SQUARE[:, :2] * 0.375).astype(np.float32), 15)
    views = [
        meshopt_view(made, places, "ATTRIBUTES", name=name),
        meshopt_view(made, normals, "ATTRIBUTES", name=name, filter="OCTAHEDRAL"),
        meshopt_view(made, uv, "ATTRIBUTES", name=name, filter="EXPONENTIAL"),
        meshopt_view(made, HALVES.reshape(-1).astype("<u2"), "TRIANGLES" if triangles else "INDICES", name=name),
    ]
    numbers = {
        "POSITION": made.accessor(places[:, :3], bufferView=views[0], normalized=True),
        "NORMAL": made.accessor(np.zeros((4, 3), "i1"), bufferView=views[1], normalized=True),
        "TEXCOORD_0": made.accessor(np.zeros((4, 2), "<f4"), bufferView=views[2]),
    }
    indices = made.accessor(HALVES.reshape(-1).astype("<u2"), bufferView=views[3])
    return file(made, made.primitive(indices, **numbers))


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
@pytest.mark.parametrize("triangles", [True, False])
def test_meshopt_is_decoded_with_all_its_filters(name, triangles, tmp_path):
    (piece,) = pieces(Document(meshopt_square(name, triangles).glb(), tmp_path / "a.glb")).pieces
    np.testing.assert_array_equal(piece.positions, SQUARE)
    # The codec may begin a triangle with another of its corners.
    first = [np.roll(face, -int(face.argmin())).tolist() for face in piece.faces]
    assert first == HALVES.tolist()
    np.testing.assert_array_equal(piece.normals, UP)
    np.testing.assert_array_equal(piece.uv[0], SQUARE[:, :2] * 0.375)


def test_a_view_that_claims_to_be_huge_is_refused(refused):
    made = meshopt_square()
    view = next(view for view in made.tree["bufferViews"] if "extensions" in view)
    view["extensions"]["EXT_meshopt_compression"]["count"] = 2**40
    refused(made, "damaged meshopt data of 1099511627776 elements")
