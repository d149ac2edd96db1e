"""Does a glTF file keep what it had, and does every number reach the vertex that it was computed for?"""

import dataclasses
import io
import json

import numpy as np
import pytest
import torch
from gltf_files import Gltf, draco, meshopt_view
from PIL import Image

from torchprt.compression import compress, reorder
from torchprt.errors import InputError
from torchprt.preview import AssetWarning, find_asset, save_lit_glb, save_transfer_glb
from torchprt.scene import Material, Object, Scene, load, read_mesh, samples
from torchprt.scene.gltf import Document, pieces
from torchprt.transport import bake

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
UP = np.tile([0.0, 0, 1], (4, 1))


def square(**tree) -> Gltf:
    """A square on one node; `tree` may say otherwise."""
    made = Gltf()
    primitive = made.primitive(HALVES.reshape(-1), POSITION=SQUARE, NORMAL=UP)
    made.tree |= {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
    }
    made.tree |= tree
    return made


def baked(*sources, **options):
    """Its transfer, without rays: what a vertex has differs by its normal and its number alone."""
    transfer = bake(load(list(sources), **options), order=2, shadows=False)
    layer = transfer.layers["diffuse"]
    values = layer.signal.values + torch.arange(transfer.vertices)
    return transfer.with_layers(
        diffuse=dataclasses.replace(layer, signal=dataclasses.replace(layer.signal, values=values))
    )


def kept(transfer, path, **options):
    """The file that it is exported as, of the asset that it finds."""
    asset, why = find_asset(transfer, **options)
    assert asset is not None, why
    save_transfer_glb(transfer, path, 2, asset=asset)
    return Document.read(path)


def first(document, piece, name="_PRT_0"):
    """The first number of every vertex of a piece."""
    entry = document.tree["meshes"][piece.mesh]["primitives"][piece.primitive]
    return document.accessor(entry["attributes"][name])[:, 0]


def same_vertices(document, transfer, name="_PRT_0", rows=slice(None)):
    """Whether every vertex of the file has the place, and the number, of its receiver."""
    found = pieces(document).pieces
    positions = np.concatenate([piece.positions for piece in found])
    order = torch.arange(transfer.vertices).double()[:, None]
    order = transfer.receivers.in_mesh_order(order)[:, 0].long()
    values = transfer.layers["diffuse"].signal.values[0, 0][order][rows]
    np.testing.assert_allclose(positions, transfer.positions[order][rows], atol=1e-5)
    np.testing.assert_allclose(np.concatenate([first(document, piece, name) for piece in found]), values, rtol=1e-6)


# What cannot be kept


def test_a_file_that_was_not_baked_is_refused(tmp_path):
    transfer = baked(square().save(tmp_path / "a.glb"))
    with pytest.raises(InputError, match=r"none\.glb does not exist"):
        find_asset(transfer, tmp_path / "none.glb")
    more = square(nodes=[{"mesh": 0}, {"mesh": 0}], scenes=[{"nodes": [0, 1]}]).save(tmp_path / "more.glb")
    with pytest.raises(InputError, match=r"more\.glb has 8 vertices"):
        find_asset(transfer, more)
    other = square(nodes=[{"mesh": 0, "matrix": [1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}])
    with pytest.raises(InputError, match=r"other\.glb has its vertices elsewhere"):
        find_asset(transfer, other.save(tmp_path / "other.glb"))
    (tmp_path / "a.ply").write_text("ply")
    with pytest.raises(InputError, match=r"a\.ply is damaged or not glTF"):
        find_asset(transfer, tmp_path / "a.ply")


def test_a_plain_mesh_is_written_where_the_file_is_gone_or_changed_and_says_so(tmp_path):
    path = square().save(tmp_path / "a.glb")
    transfer = baked(path)
    square(nodes=[{"mesh": 0, "scale": [1, 2, 1]}]).save(path)
    assert find_asset(transfer) == (None, f"a plain mesh, as the vertices of {path} have moved since it was baked")
    square(nodes=[{"mesh": 0}, {"mesh": 0}], scenes=[{"nodes": [0, 1]}]).save(path)
    assert find_asset(transfer) == (None, f"a plain mesh, as {path} has 8 vertices and had 4 when it was baked")
    path.unlink()
    assert find_asset(transfer)[1] == f"a plain mesh, as {path} is not there any more: --source says where it is"
    assert save_lit_glb(transfer, torch.ones(4, 3), tmp_path / "lit.glb").startswith("a plain mesh")
    assert len(read_mesh(tmp_path / "lit.glb").positions) == 4
    none = baked(samples.cylinder(6).objects[0].mesh)
    assert find_asset(none) == (None, f"a plain mesh, as {none.receivers.objects[0]['name']} is no glTF")


def test_it_is_found_beside_the_bake_too(tmp_path):
    (tmp_path / "there").mkdir()
    path = square().save(tmp_path / "a.glb")
    transfer = baked(path)
    path.rename(tmp_path / "there" / "a.glb")
    asset, why = find_asset(transfer, near=tmp_path / "there")
    assert asset is not None
    assert why == f"keeps what {tmp_path / 'there' / 'a.glb'} holds"


# What is kept


def test_everything_else_in_the_tree_stays(tmp_path):
    made = square(
        extras={"a": 1},
        extensionsUsed=["KHR_lights_punctual", "ACME_x"],
        extensions={"KHR_lights_punctual": {"lights": [{"type": "point"}]}, "ACME_x": {"y": [1, 2]}},
        cameras=[{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}],
    )
    made.tree["meshes"][0] |= {"name": "m", "extras": [1, 2], "weights": [0.5]}
    made.tree["asset"] |= {"generator": "a maker", "copyright": "me"}
    path = made.save(tmp_path / "a.gltf")
    tree = kept(baked(path), tmp_path / "b.glb").tree
    for key in ("extras", "extensions", "extensionsUsed", "cameras", "nodes", "scenes", "scene"):
        assert tree[key] == made.tree[key]
    assert tree["asset"]["copyright"] == "me"
    assert tree["asset"]["generator"].startswith("a maker, torchprt")
    mesh = tree["meshes"][0]
    # Any JSON may stand in extras.
    assert (mesh["name"], mesh["weights"], mesh["extras"]["extras"]) == ("m", [0.5], [1, 2])
    assert mesh["extras"]["torchprt"]["order"] == 2
    attributes = mesh["primitives"][0]["attributes"]
    assert list(attributes) == ["POSITION", "NORMAL", "_PRT_ALBEDO", "_PRT_0"]
    assert tree["buffers"] == [{"byteLength": tree["buffers"][0]["byteLength"]}]


def test_kept_twice_it_is_the_same_file(tmp_path):
    path = square().save(tmp_path / "a.glb")
    transfer = baked(path)
    kept(transfer, tmp_path / "b.glb")
    again = kept(transfer, tmp_path / "c.glb", given=tmp_path / "b.glb")
    assert again.tree["asset"]["generator"].count("torchprt") == 1
    same_vertices(again, transfer)


def test_pictures_beside_the_file_go_into_it(tmp_path):
    content = b"\x89PNG\r\n\x1a\nrest"
    (tmp_path / "a b.png").write_bytes(content)
    images = [{"uri": "a%20b.png", "name": "n"}, {"uri": "none.png"}, {"uri": "https://example.org/a.png"}]
    path = square(images=images).save(tmp_path / "a.gltf")
    transfer = baked(path)
    with pytest.warns(AssetWarning, match=r"none\.png, which does not exist.*left out"):
        document = kept(transfer, tmp_path / "b.glb")
    assert document.image(0) == (content, "image/png")
    assert document.tree["images"][0]["name"] == "n"
    assert document.tree["images"][1:] == images[1:]


def test_compressed_files_come_out_plain(tmp_path):
    made = square()
    made.tree["meshes"][0]["primitives"] = [draco(made, SQUARE, HALVES, NORMAL=UP, COLOR_0=np.full((4, 3), 7, "u1"))]
    made.tree["extensionsUsed"] = ["KHR_draco_mesh_compression", "ACME_x"]
    transfer = baked(made.save(tmp_path / "a.glb"))
    document = kept(transfer, tmp_path / "b.glb")
    assert document.tree["extensionsUsed"] == ["ACME_x"]
    assert "extensionsRequired" not in document.tree
    assert "extensions" not in document.tree["meshes"][0]["primitives"][0]
    # The place of what was compressed is taken by what is not.
    assert all("buffer" in view for view in document.tree["bufferViews"])
    same_vertices(document, transfer)
    np.testing.assert_array_equal(pieces(document).pieces[0].colours, np.full((4, 3), 7 / 255))
    np.testing.assert_array_equal(read_mesh(tmp_path / "b.glb").faces, HALVES)

    made = Gltf()
    rows = np.pad(SQUARE, ((0, 0), (0, 1))).astype("<f4")
    view = meshopt_view(made, rows, "ATTRIBUTES")
    primitive = made.primitive(HALVES.reshape(-1), POSITION=made.accessor(rows[:, :3], bufferView=view))
    made.tree |= {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}]}
    transfer = baked(made.save(tmp_path / "c.glb"))
    document = kept(transfer, tmp_path / "d.glb")
    assert not {"extensionsUsed", "extensionsRequired"} & document.tree.keys()
    assert len(document.tree["buffers"]) == 1
    same_vertices(document, transfer)


def test_two_primitives_of_one_compression_share_its_arrays(tmp_path):
    made = square()
    primitive = draco(made, SQUARE, HALVES, NORMAL=UP)
    made.tree["meshes"][0]["primitives"] = [primitive, json.loads(json.dumps(primitive))]
    made.tree["meshes"].append({"primitives": [draco(made, 2 * SQUARE, HALVES)]})
    made.tree["meshes"][1]["primitives"][0]["attributes"]["POSITION"] = primitive["attributes"]["POSITION"]
    made.tree["nodes"], made.tree["scenes"] = [{"mesh": 0}, {"mesh": 1}], [{"nodes": [0, 1]}]
    transfer = baked(made.save(tmp_path / "a.glb"))
    document = kept(transfer, tmp_path / "b.glb")
    same_vertices(document, transfer)
    one, two = (each["attributes"] for each in document.tree["meshes"][0]["primitives"])
    assert one["POSITION"] == two["POSITION"]
    assert document.tree["meshes"][1]["primitives"][0]["attributes"]["POSITION"] != one["POSITION"]


# Instances


def test_nodes_that_share_a_mesh_get_one_each(tmp_path):
    made = square()
    lines = {**made.primitive(POSITION=SQUARE), "mode": 1}
    made.tree["meshes"][0]["primitives"].insert(0, lines)
    made.tree["nodes"] = [{"mesh": 0, "translation": [2 * k, 0, 0], "name": str(k)} for k in range(4)]
    made.tree["scenes"] = [{"nodes": [3, 0, 1]}, {"nodes": [2]}]
    transfer = baked(made.save(tmp_path / "a.glb"))
    document = kept(transfer, tmp_path / "b.glb")
    tree = document.tree
    # The node of the other scene was not baked, and shows what it showed.
    assert [node["mesh"] for node in tree["nodes"]] == [1, 2, 0, 3]
    assert [node["name"] for node in tree["nodes"]] == ["0", "1", "2", "3"]
    assert "_PRT_0" not in tree["meshes"][0]["primitives"][1]["attributes"]
    assert all(mesh["primitives"][0] == lines for mesh in tree["meshes"])
    same_vertices(document, transfer)


def test_instances_of_the_card_become_nodes(tmp_path):
    made = square()
    places = {"TRANSLATION": made.accessor(np.array([[0, 0, 0], [0, 0, 3]], "<f4"))}
    extensions = {"EXT_mesh_gpu_instancing": {"attributes": places}}
    made.tree["nodes"] = [{"mesh": 0, "translation": [10, 0, 0], "extensions": extensions, "name": "n"}]
    made.tree["extensionsUsed"] = made.tree["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    transfer = baked(made.save(tmp_path / "a.glb"))
    document = kept(transfer, tmp_path / "b.glb")
    same_vertices(document, transfer)
    assert document.tree["nodes"][0] == {"translation": [10, 0, 0], "name": "n", "children": [1, 2]}
    assert not {"extensionsUsed", "extensionsRequired"} & document.tree.keys()


@pytest.mark.parametrize("scenes", [True, False])
def test_a_file_of_meshes_alone_gets_nodes(scenes, tmp_path):
    made = square(scenes=[{}])
    del made.tree["nodes"]
    if not scenes:
        del made.tree["scenes"], made.tree["scene"]
    transfer = baked(made.save(tmp_path / "a.glb"))
    same_vertices(kept(transfer, tmp_path / "b.glb"), transfer)


# Which vertex


def test_a_bake_in_another_order_fits(tmp_path):
    made = Gltf()
    ball = samples.cylinder(16).objects[0].mesh
    primitive = made.primitive(ball.faces.numpy().reshape(-1), POSITION=ball.positions, NORMAL=ball.normals)
    made.tree |= {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}]}
    whole = bake(load(made.save(tmp_path / "a.glb")), order=2, rays=16, progress=False)
    transfer = reorder(compress(whole, clusters=8, components=2))
    assert not torch.equal(transfer.positions, whole.positions)
    document = kept(transfer, tmp_path / "b.glb")
    (piece,) = pieces(document).pieces
    np.testing.assert_allclose(piece.positions, whole.positions, atol=1e-6)
    entry = document.tree["meshes"][0]["primitives"][0]
    found = document.accessor(entry["attributes"]["_PRT_0"])
    wanted = whole.layers["diffuse"].signal.values[0].T.numpy()
    # Clusters are near to what they hold, each vertex to its own.
    assert np.abs(found - wanted).max() < 0.2 < np.abs(found - wanted[::-1]).max()


def test_reverse_sides_have_attributes_of_their_own(tmp_path):
    transfer = baked(square().save(tmp_path / "a.glb"), two_sided=True)
    assert transfer.vertices == 8
    document = kept(transfer, tmp_path / "b.glb")
    same_vertices(document, transfer, rows=slice(4))
    same_vertices(document, transfer, "_PRT_BACK_0", rows=slice(4, 8))
    assert "_PRT_BACK_ALBEDO" in document.tree["meshes"][0]["primitives"][0]["attributes"]


def test_what_else_was_baked_follows_as_plain_meshes(tmp_path):
    path = square().save(tmp_path / "a.glb")
    board = samples.cylinder(6).objects[0].mesh
    transfer = baked(path, board)
    document = kept(transfer, tmp_path / "b.glb")
    same_vertices(document, transfer)
    assert len(document.tree["meshes"]) == 2
    assert torch.equal(read_mesh(tmp_path / "b.glb").faces, transfer.faces.long())
    # The other way round, and both twice: the first glTF is kept.
    transfer = baked(board, path, path)
    document = kept(transfer, tmp_path / "c.glb")
    assert len(document.tree["meshes"]) == 3
    found = pieces(document).pieces
    np.testing.assert_allclose(first(document, found[0]), transfer.layers["diffuse"].signal.values[0, 0, -8:-4])
    assert [len(piece.positions) for piece in found] == [4, len(board.positions), 4]


def test_a_scene_that_moved_the_mesh_moves_the_asset(tmp_path):
    mesh = read_mesh(square().save(tmp_path / "a.glb"))
    turn = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=torch.float64)
    moved = dataclasses.replace(mesh, positions=3 * mesh.positions @ turn.T + 5, normals=mesh.normals @ turn.T)
    transfer = bake(Scene([Object(moved, Material(0.5))]), order=2, shadows=False)
    document = kept(transfer, tmp_path / "b.glb")
    (piece,) = pieces(document).pieces
    np.testing.assert_allclose(piece.positions, moved.positions, atol=1e-6)
    np.testing.assert_allclose(piece.normals / 9, moved.normals, atol=1e-6)


# Under a light


def lit(path, transfer, colours):
    """The colours that a viewer shows of a file without a texture: factor x COLOR_0 of every piece."""
    save_lit_glb(transfer, colours, path)
    document = Document.read(path)
    shown = []
    for piece in pieces(document).pieces:
        material = document.entry("materials", piece.material)
        assert material["extensions"]["KHR_materials_unlit"] == {}
        factor = material.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1, 1, 1, 1])
        shown.append(piece.colours[:, :3] * factor[:3])
    return document, shown


def test_light_is_over_the_colour_of_the_material_so_that_viewers_show_it(tmp_path):
    made = square(materials=[{"name": "red", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.4, 0.001, 0.5]}}])
    alpha = made.accessor(np.array([[1, 1, 1, k / 4] for k in range(4)], "<f4"))
    made.tree["meshes"][0]["primitives"][0] |= {"material": 0}
    made.tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = alpha
    transfer = baked(made.save(tmp_path / "a.glb"))
    colours = torch.rand(4, 3)
    document, (shown,) = lit(tmp_path / "b.glb", transfer, colours)
    np.testing.assert_allclose(shown, colours, rtol=1e-6)
    assert document.entry("materials", 1)["pbrMetallicRoughness"]["baseColorFactor"] == [1, 1, 1, 0.5]
    (piece,) = pieces(document).pieces
    np.testing.assert_array_equal(piece.colours[:, 3], [0, 0.25, 0.5, 0.75])
    # The material that it had is still there, and so is its name.
    assert document.tree["materials"][0] == made.tree["materials"][0]
    assert document.tree["materials"][1]["name"] == "red"
    assert document.tree["extensionsUsed"] == ["KHR_materials_unlit"]


def test_a_primitive_without_a_material_is_white(tmp_path):
    transfer = baked(square().save(tmp_path / "a.glb"))
    colours = torch.rand(4, 3)
    _, (shown,) = lit(tmp_path / "b.glb", transfer, colours)
    np.testing.assert_array_equal(shown, colours)


def test_both_sides_are_lit_and_each_is_seen_from_its_own(tmp_path):
    made = square(materials=[{"doubleSided": True}])
    made.tree["meshes"][0]["primitives"][0]["material"] = 0
    transfer = baked(made.save(tmp_path / "a.glb"), two_sided=True)
    colours = torch.rand(8, 3)
    document, shown = lit(tmp_path / "b.glb", transfer, colours)
    np.testing.assert_array_equal(np.concatenate(shown), colours)
    mesh = read_mesh(tmp_path / "b.glb")
    corners = mesh.positions[mesh.faces]
    facing = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert facing.tolist() == [1, 1, -1, -1]
    assert document.tree["materials"][1]["doubleSided"] is False
    # In a mirrored node too.
    made.tree["nodes"] = [{"mesh": 0, "scale": [-1, 1, 1]}]
    transfer = baked(made.save(tmp_path / "a.glb"), two_sided=True)
    lit(tmp_path / "b.glb", transfer, colours)
    assert torch.equal(read_mesh(tmp_path / "b.glb").faces, transfer.faces.long())


def textured(dark: int) -> Gltf:
    """The square with a picture that is dark in its left half and white in its right."""
    texels = np.full((8, 8, 3), 255, np.uint8)
    texels[:, :4] = dark
    content = io.BytesIO()
    Image.fromarray(texels).save(content, "PNG")
    made = square(
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 0.1, 1, 1]}}],
        textures=[{"source": 0, "sampler": 0}],
        samplers=[{"wrapS": 33071, "wrapT": 33071}],
    )
    made.tree["images"] = [{"bufferView": made.view(content.getvalue()), "mimeType": "image/png"}]
    primitive = made.tree["meshes"][0]["primitives"][0]
    primitive["material"] = 0
    primitive["attributes"]["TEXCOORD_0"] = made.accessor(SQUARE[:, :2].astype("<f4"))
    return made


def test_a_texture_times_its_light_is_the_colour_in_the_mean(tmp_path):
    transfer = baked(textured(128).save(tmp_path / "a.glb"))
    colours = torch.rand(4, 3)
    save_lit_glb(transfer, colours, tmp_path / "b.glb")
    (piece,) = pieces(Document.read(tmp_path / "b.glb")).pieces
    # Hat functions over the faces by brute force; 128 of 255 in sRGB is .2158605 in linear numbers.
    random = np.random.default_rng(0).dirichlet([1, 1, 1], 200_000)
    for vertex in range(4):
        total, weight = 0.0, 0.0
        for face in HALVES[(vertex == HALVES).any(axis=1)]:
            hat = random[:, list(face).index(vertex)]
            # Linear between the middles of the texels on both sides of the edge.
            shown = np.interp(random @ SQUARE[face, 0], [3.5 / 8, 4.5 / 8], [0.2158605, 1])
            total += (hat * shown).sum()
            weight += hat.sum()
        # Six standard deviations of 2e5 samples.
        np.testing.assert_allclose(piece.colours[vertex] * total / weight, colours[vertex], rtol=0.008)


def test_how_far_colours_reach_above_one_is_said_and_where_nothing_can_be_shown_little_is(tmp_path):
    transfer = baked(textured(0).save(tmp_path / "a.glb"))
    assert "COLOR_0 reaches" in save_lit_glb(transfer, torch.full((4, 3), 0.9), tmp_path / "b.glb")
    assert "COLOR_0" not in save_lit_glb(transfer, torch.full((4, 3), 0.01), tmp_path / "b.glb")
    black = baked(textured(0).save(tmp_path / "a.glb"))
    made = textured(0)
    made.tree["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = made.accessor(np.full((4, 2), 0.1, "<f4"))
    made.save(tmp_path / "a.glb")
    save_lit_glb(black, torch.full((4, 3), 0.5), tmp_path / "b.glb")
    (piece,) = pieces(Document.read(tmp_path / "b.glb")).pieces
    np.testing.assert_allclose(piece.colours, np.full((4, 3), 25), rtol=1e-6)


def test_where_one_material_of_two_is_double_sided_only_that_has_a_reverse(tmp_path):
    made = square(materials=[{}, {"doubleSided": True}])
    other = made.primitive(HALVES.reshape(-1), POSITION=SQUARE + np.array([0, 0, 3]), NORMAL=UP)
    made.tree["meshes"][0]["primitives"] = [
        {**made.tree["meshes"][0]["primitives"][0], "material": 0},
        {**other, "material": 1},
    ]
    whole = baked(made.save(tmp_path / "a.glb"), two_sided=True)
    # As a bake records it that follows the file.
    index = torch.cat([torch.arange(8), torch.arange(12, 16)])
    layer = whole.layers["diffuse"].take(index, None)
    transfer = dataclasses.replace(whole, receivers=whole.receivers.take(index), layers={"diffuse": layer})
    assert [each["rows"] for each in transfer.receivers.objects] == [[0, 8], [8, 12]]
    document = kept(transfer, tmp_path / "b.glb")
    one, two = (each["attributes"] for each in document.tree["meshes"][0]["primitives"])
    assert "_PRT_BACK_0" not in one
    values = transfer.layers["diffuse"].signal.values[0, 0]
    np.testing.assert_array_equal(document.accessor(two["_PRT_BACK_0"])[:, 0], values[8:])
    assert len(document.tree["meshes"]) == 1
    colours = torch.rand(12, 3)
    _, shown = lit(tmp_path / "c.glb", transfer, colours)
    np.testing.assert_array_equal(np.concatenate(shown), colours)
