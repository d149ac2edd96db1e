"""Does a mesh file come in as it is, and does a faulty one say what is wrong with it?"""

import json
import struct

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.scene import read_mesh

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
SIDES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


@pytest.fixture
def write(tmp_path):
    def write(name: str, content: str | bytes):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def ply(vertices: str, faces: str = "3 0 1 2", properties: str = "", count: int = 3, sides: int = 1) -> str:
    return (
        f"ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\n"
        f"{properties}element face {sides}\nproperty list uchar int vertex_indices\nend_header\n{vertices}\n{faces}\n"
    )


def refused(path, *words: str) -> None:
    """The file is refused in one line that names it and says these words."""
    with pytest.raises(InputError) as caught:
        read_mesh(path)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    for word in words:
        assert word in message


# Misuse and faults


def test_refuses_a_file_that_is_missing(tmp_path):
    refused(tmp_path / "nothing.ply", "does not exist", "check the name")


def test_refuses_a_folder(tmp_path):
    (tmp_path / "folder.ply").mkdir()
    refused(tmp_path / "folder.ply", "cannot be read")


@pytest.mark.parametrize("suffix", ["ply", "obj", "glb", "gltf", "stl", "off"])
def test_refuses_an_empty_file(write, suffix):
    refused(write(f"a.{suffix}", b" \n"), "is empty")


def test_refuses_an_unknown_kind_and_names_the_known_ones(write):
    refused(write("a.png", b"1"), ".ply, .obj, .glb, .gltf, .stl, .off")


@pytest.mark.parametrize("suffix", ["ply", "obj", "glb", "gltf", "stl", "off"])
@pytest.mark.parametrize("content", [b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" * 20, b"hello\nworld\n", bytes(range(256)) * 3])
def test_refuses_a_foreign_file(write, suffix, content):
    refused(write(f"a.{suffix}", content))


def test_refuses_a_point_cloud(write):
    header = ply("0 0 0\n1 0 0\n0 1 0", "").split("element face")[0]
    refused(write("a.ply", header + "end_header\n0 0 0\n1 0 0\n0 1 0\n"), "3 points and no faces")
    refused(write("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "3 points and no faces")


def test_refuses_vertices_that_are_not_finite(write):
    refused(write("a.ply", ply("0 0 0\n1 0 nan\n0 1 0")), "not finite", "vertex 1")
    refused(write("a.obj", "v 0 0 0\nv 1 0 0\nv 0 inf 0\nf 1 2 3\n"), "not finite", "vertex 2")


def test_refuses_vertices_that_are_too_large_to_compute_with(write):
    refused(write("a.obj", "v 0 0 0\nv 1e308 0 0\nv 0 -1e308 0\nf 1 2 3\n"), "coordinates above 1e+150")


def test_says_nothing_but_the_refusal(write, caplog, capsys):
    refused(write("a.stl", EXPORTS["text.stl"].replace(b"normal", b"normal x")[:-20]))
    assert not caplog.records
    assert not capsys.readouterr().err


def test_refuses_vertices_that_are_all_zero(write):
    refused(write("a.ply", ply("0 0 0\n0 0 0\n0 0 0")), "at zero", "without compression")


def test_refuses_faces_without_area(write):
    refused(write("a.ply", ply("0 0 0\n1 1 1\n2 2 2")), "without area")


@pytest.mark.parametrize("index", [3, -1, 2**31 - 1])
def test_refuses_a_face_that_names_no_vertex(write, index):
    refused(write("a.ply", ply("0 0 0\n1 0 0\n0 1 0", f"3 0 1 {index}")), "does not exist", f"{index}")


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("f 1 2 4", "vertex 4 of 3"),
        ("f 1 2 0", "index 0"),
        ("f -1 -2 -4", "index -4"),
        ("f 1 2", "three corners"),
        ("f 1 2 x", "'x'"),
        ("v 1 2", "2 numbers"),
        ("v a b c", "not a number"),
        ("f 1//1 2//1 3//1", "normal 1 of 0"),
    ],
)
def test_refuses_a_faulty_obj_line(write, line, word):
    refused(write("a.obj", f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n{line}\n"), word)


def glb(tree: dict, blob: bytes = b"") -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def solid() -> trimesh.Trimesh:
    return trimesh.Trimesh(TETRAHEDRON, SIDES, process=False)


def exports() -> dict[str, bytes]:
    """A tetrahedron in every kind of file, written by trimesh."""
    mesh = solid()
    kinds = {
        "binary.ply": mesh.export(file_type="ply"),
        "text.ply": mesh.export(file_type="ply", encoding="ascii"),
        "a.obj": mesh.export(file_type="obj"),
        "a.glb": mesh.export(file_type="glb"),
        "binary.stl": mesh.export(file_type="stl"),
        "text.stl": mesh.export(file_type="stl_ascii"),
        "a.off": mesh.export(file_type="off"),
    }
    return {name: content.encode() if isinstance(content, str) else content for name, content in kinds.items()}


EXPORTS = exports()


@pytest.mark.parametrize("name", EXPORTS)
def test_a_file_that_is_cut_anywhere_is_whole_or_refused(write, name):
    whole = read_mesh(write(name, EXPORTS[name]))
    content = EXPORTS[name]
    short = 0
    for length in sorted(
        {*range(0, len(content), max(1, len(content) // 150)), *range(len(content) - 12, len(content))}
    ):
        path = write(name, content[:length])
        try:
            mesh = read_mesh(path)
        except InputError:
            short += 1
            continue
        if name.endswith(".obj"):
            # An .obj declares no counts: a cut at the end of a face leaves the faces before it.
            assert 0 < len(mesh.faces) <= len(whole.faces)
        else:
            # In text the very last number may lose digits unseen; everything before it must be there.
            assert len(mesh.faces) == len(whole.faces)
            assert torch.equal(mesh.positions[:-1], whole.positions[:-1])
            assert torch.equal(mesh.faces[:-1], whole.faces[:-1])
    assert short > 10


@pytest.mark.parametrize("name", EXPORTS)
def test_a_file_with_wrong_bytes_is_read_or_refused_but_never_breaks(write, name):
    random = np.random.default_rng(0)
    refusals = 0
    for _ in range(120):
        content = bytearray(EXPORTS[name])
        for at in random.integers(0, len(content), size=random.integers(1, 6)):
            content[at] = random.integers(0, 256)
        try:
            mesh = read_mesh(write(name, bytes(content)))
        except InputError:
            refusals += 1
        else:
            assert mesh.positions.isfinite().all()
            assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.positions)
    assert refusals > 0


# What is in the file


@pytest.mark.parametrize("name", [name for name in EXPORTS if "stl" not in name])
def test_every_kind_keeps_vertices_and_faces_in_order(write, name):
    mesh = read_mesh(write(name, EXPORTS[name]))
    np.testing.assert_array_equal(mesh.positions.numpy(), TETRAHEDRON)
    np.testing.assert_array_equal(mesh.faces.numpy(), SIDES)
    assert mesh.report.watertight
    assert mesh.name.endswith(name)
    assert mesh.positions.dtype == mesh.normals.dtype == torch.float64
    assert mesh.faces.dtype == torch.int64
    assert mesh.colours is None


@pytest.mark.parametrize("name", ["binary.stl", "text.stl"])
def test_stl_repeats_every_corner_and_keeps_sharp_sides_flat(write, name):
    mesh = read_mesh(write(name, EXPORTS[name]))
    np.testing.assert_array_equal(mesh.positions.numpy(), TETRAHEDRON[SIDES].reshape(-1, 3))
    assert mesh.report.watertight
    assert mesh.report.duplicate_vertices == 8
    corners = mesh.positions[mesh.faces]
    flat = torch.nn.functional.normalize(
        torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    )
    # A unit vector made twice in different order: a few roundings.
    torch.testing.assert_close(mesh.normals.reshape(-1, 3, 3), flat[:, None].expand(-1, 3, 3), rtol=0, atol=1e-15)


def test_the_scan_comes_in_bit_for_bit(data):
    path = data / "mesh" / "bunny.ply"
    mesh = read_mesh(path)
    body = path.read_bytes().partition(b"end_header\n")[2]
    positions = np.frombuffer(body, "<f4", 3 * 34835).reshape(-1, 3)
    faces = np.frombuffer(body, np.dtype([("n", "u1"), ("v", "<i4", 3)]), 69666, 12 * 34835)["v"]
    np.testing.assert_array_equal(mesh.positions.numpy(), positions)
    np.testing.assert_array_equal(mesh.faces.numpy(), faces)
    # Unit within two roundings.
    torch.testing.assert_close(mesh.normals.norm(dim=1), torch.ones(34835, dtype=torch.float64), rtol=0, atol=5e-16)


def test_the_open_teapot_is_reported_open(data):
    report = read_mesh(data / "mesh" / "teapot.ply").report
    assert report.boundary_edges > 0
    assert not report.watertight
    assert "open" in str(report)


def test_polygons_become_triangles(write):
    square = "0 0 0\n1 0 0\n1 1 0\n0 1 0"
    mesh = read_mesh(write("a.ply", ply(square, "4 0 1 2 3", count=4)))
    assert len(mesh.faces) == 2
    mesh = read_mesh(write("a.ply", ply(square, "4 0 1 2 3\n3 0 1 2", count=4, sides=2)))
    assert len(mesh.faces) == 3
    mesh = read_mesh(write("a.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv .5 2 0\nv 0 1 0\nf 1 2 3 4 5\n"))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    assert torch.equal(mesh.normals, torch.tensor([[0.0, 0, 1]], dtype=torch.float64).expand(5, 3))


def test_byte_colours_are_decoded_from_srgb(write):
    properties = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    mesh = read_mesh(write("a.ply", ply("0 0 0 0 10 128\n1 0 0 255 188 1\n0 1 0 64 32 200", properties=properties)))
    bytes_ = np.array([[0, 10, 128], [255, 188, 1], [64, 32, 200]]) / 255
    expected = np.where(bytes_ <= 0.04045, bytes_ / 12.92, ((bytes_ + 0.055) / 1.055) ** 2.4)
    # float32 storage.
    np.testing.assert_allclose(mesh.colours.numpy(), expected, rtol=1.2e-7)
    assert mesh.colours[0, 2].item() == pytest.approx(0.2158605, rel=1e-6)


def test_floating_point_colours_are_linear(write):
    properties = "property float red\nproperty float green\nproperty float blue\n"
    mesh = read_mesh(write("a.ply", ply("0 0 0 0 .1 .5\n1 0 0 1 .123 0\n0 1 0 0 0 .001", properties=properties)))
    assert torch.equal(mesh.colours, torch.tensor([[0, 0.1, 0.5], [1, 0.123, 0], [0, 0, 0.001]]))
    mesh = read_mesh(write("a.obj", "v 0 0 0 .1 .2 .3\nv 1 0 0 1 1 1\nv 0 1 0 0 0 0\nf 1 2 3\n"))
    assert torch.equal(mesh.colours, torch.tensor([[0.1, 0.2, 0.3], [1, 1, 1], [0, 0, 0]]))


def test_normals_of_the_file_are_kept_at_unit_length_and_bad_ones_replaced(write):
    properties = "property float nx\nproperty float ny\nproperty float nz\n"
    mesh = read_mesh(write("a.ply", ply("0 0 0 3 0 4\n1 0 0 0 0 0\n0 1 0 nan 0 1", properties=properties)))
    assert mesh.normals.tolist() == [[0.6, 0, 0.8], [0, 0, 1], [0, 0, 1]]
    assert mesh.report.computed_normals == 2


# Wavefront


def test_obj_keeps_the_order_of_vertices_across_materials_and_groups(write):
    text = "".join(f"v {x} {x * x} 0\n" for x in range(6))
    text += "usemtl b\nf 6 5 4\ng one\nusemtl a\nf 1 2 3\no two\nusemtl b\nf 4 3 1\n"
    mesh = read_mesh(write("a.obj", text))
    assert mesh.positions[:, 0].tolist() == list(range(6))
    assert mesh.faces.tolist() == [[5, 4, 3], [0, 1, 2], [3, 2, 0]]


def test_obj_keeps_vertices_that_no_face_names(write):
    text = "v 9 9 9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 8 8 8\nvn 0 0 1\nf 2//1 3//1 4//1\n"
    mesh = read_mesh(write("a.obj", text))
    assert mesh.positions[:, 0].tolist() == [9, 0, 1, 0, 8]
    assert mesh.report.unreferenced_vertices == 2
    assert mesh.report.missing_normals == 2


def test_obj_relative_indices_count_back_from_their_own_line(write):
    first = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n"
    mesh = read_mesh(write("a.obj", first + first.replace("v 0 0 0", "v 0 0 5")))
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_obj_texture_seams_do_not_split_vertices_but_normals_do(write):
    vertices = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvt .5 .5\nvn 0 0 1\nvn 0 1 0\n"
    seam = read_mesh(write("a.obj", vertices + "f 1/1/1 2/2/1 3/3/1\nf 1/2/1 3/1/1 4/1/1\n"))
    assert len(seam.positions) == 4
    split = read_mesh(write("b.obj", vertices + "f 1//1 2//1 3//1\nf 1//2 3//2 4//2\n"))
    assert split.positions[:, :2].tolist() == [[0, 0], [0, 0], [1, 0], [1, 1], [1, 1], [0, 1]]
    assert split.normals[:, 2].tolist() == [1, 0, 1, 1, 0, 0]
    assert split.faces.tolist() == [[0, 2, 3], [1, 4, 5]]


def test_obj_survives_continued_lines_comments_and_windows_endings(write):
    text = "# made by hand\r\nv 0 0 0 # here\r\nv 1 0 \\\r\n0\r\nv 0 1 0\r\n\r\nf 1/ 2/ \\\r\n3/\r\n"
    assert read_mesh(write("a.obj", text)).faces.tolist() == [[0, 1, 2]]


def test_obj_numbers_with_exponents_are_read(write):
    mesh = read_mesh(write("a.obj", "v 0 0 0\nv 1e-3 0 0\nv 0 1E+2 0\nf 1 2 3\n"))
    assert mesh.positions[1, 0].item() == 1e-3
    assert mesh.positions[2, 1].item() == 100


# glTF


def test_glb_pieces_stand_where_the_scene_puts_them(write):
    scene = trimesh.Scene()
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turn[:3, 3] = [5, 0, 0]
    mirror = np.diag([-2.0, 1, 1, 1])
    mirror[:3, 3] = [0, 7, 0]
    other = trimesh.creation.box()
    scene.add_geometry(solid(), node_name="first", geom_name="tetrahedron", transform=turn)
    scene.add_geometry(other, node_name="second", geom_name="box", transform=mirror)
    mesh = read_mesh(write("a.glb", scene.export(file_type="glb")))
    expected = np.concatenate(
        [trimesh.transform_points(TETRAHEDRON, turn), trimesh.transform_points(other.vertices, mirror)]
    )
    # Positions in the file are float32.
    np.testing.assert_allclose(mesh.positions.numpy(), expected, atol=7 * 1.2e-7)
    assert mesh.report.components == 2
    assert mesh.report.watertight
    # The mirrored box still shows its outside.
    corners = mesh.positions[mesh.faces[len(SIDES) :]] - torch.tensor([0.0, 7, 0])
    outward = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outward * corners.mean(dim=1)).sum(dim=1) > 0).all()


def test_glb_normals_follow_a_squashing_transform(write):
    ball = trimesh.creation.icosphere(subdivisions=2)
    scene = trimesh.Scene()
    scene.add_geometry(ball, geom_name="ball", transform=np.diag([1.0, 1, -0.25, 1]))
    blob = scene.export(file_type="glb", include_normals=True)
    mesh = read_mesh(write("a.glb", blob))
    assert mesh.report.computed_normals == 0
    expected = mesh.positions * torch.tensor([1.0, 1, 16], dtype=torch.float64)
    expected = expected / expected.norm(dim=1, keepdim=True)
    # trimesh's normals of a coarse ball are its vertex directions to about a hundredth.
    assert (mesh.normals - expected).abs().max() < 0.05


def test_glb_instances_of_one_mesh_come_in_the_order_of_the_nodes(write):
    scene = trimesh.Scene()
    for number in range(3):
        shift = np.eye(4)
        shift[0, 3] = 10 * number
        scene.add_geometry(solid(), node_name=f"node{number}", geom_name=f"part{number}", transform=shift)
    tree = json.loads(scene.export(file_type="gltf")["model.gltf"])
    assert len(tree["meshes"]) == 3
    for node in tree["nodes"]:
        if "mesh" in node:
            node["mesh"] = 0
    blob = EXPORTS["a.glb"]
    length = int.from_bytes(blob[12:16], "little")
    single = json.loads(blob[20 : 20 + length])
    tree["meshes"] = single["meshes"]
    for key in ("accessors", "bufferViews", "buffers"):
        tree[key] = single[key]
    for mesh in tree["meshes"]:
        mesh["primitives"][0].pop("material", None)
    for key in ("materials", "textures", "images"):
        tree.pop(key, None)
    placed = read_mesh(write("a.glb", glb(tree, blob[28 + length :])))
    assert placed.positions[::4, 0].tolist() == [0, 10, 20]


def test_gltf_with_its_buffer_beside_it_is_read(tmp_path):
    for name, content in trimesh.Scene(solid()).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    mesh = read_mesh(tmp_path / "model.gltf")
    np.testing.assert_array_equal(mesh.positions.numpy(), TETRAHEDRON)
    next(tmp_path.glob("*.bin")).unlink()
    refused(tmp_path / "model.gltf", "export the mesh again")


def test_glb_byte_colours_are_linear(write):
    mesh = solid()
    mesh.visual.vertex_colors = [[0, 51, 255, 255]] * 4
    colours = read_mesh(write("a.glb", mesh.export(file_type="glb"))).colours
    assert torch.equal(colours, torch.tensor([[0, 0.2, 1.0]]).expand(4, 3))
