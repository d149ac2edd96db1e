"""Do pictures, models and windows show what texels have, where they lie on the meshes, without cracks at seams?"""

import dataclasses
import io
import json
import math

import numpy as np
import pytest
import torch
from atlases import SIDES, cube, lit_cube
from gltf_files import Gltf
from PIL import Image
from transfers import random_glossy

from torchprt.errors import InputError
from torchprt.light.exr import read_exr
from torchprt.preview import (
    Camera,
    Environment,
    Orbit,
    Session,
    Still,
    Studio,
    save_lit_glb,
    save_map,
    save_mapped_glb,
    subject,
)
from torchprt.preview.asset_map import split
from torchprt.scene.gltf import Document, pieces
from torchprt.shade import shader, srgb
from torchprt.transfer import to_vertices

CAMERA = Camera((3.0, 2.5, 3.5), (0.0, 0.0, 0.0), field=40.0)
LIGHT = torch.tensor([[3.0, 2.0, 1.0], *[[0.2, 0.1, -0.1]] * 8])


# Pictures


def test_a_picture_shows_the_colour_of_each_side_up_to_its_edges():
    place = cube()
    still = Still.of(place, size=(60, 50), camera=CAMERA, samples=1)
    colours = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1]])
    picture = still.radiance(colours[place.chart.long()], background=0.25).reshape(-1, 3)
    # With one ray a pixel each is of one side, and what a filter reads beside a chart is of its gutter.
    for pixel in picture.unique(dim=0):
        assert any(torch.allclose(pixel, each, atol=1e-6) for each in (*colours, torch.full((3,), 0.25)))
    assert len(picture.unique(dim=0)) >= 4


def test_it_is_the_picture_of_as_many_vertices():
    """Of what is linear on each side: away from its rim, half a texel wide, as vertices have it."""
    whole = lit_cube(texels=12)
    place = whole.receivers
    wanted = place.positions * 0.3 + 0.5
    still = Still.of(place, size=(60, 50), camera=CAMERA, samples=4)
    vertices = Still(place.mesh_positions, place.mesh_faces, size=(60, 50), camera=CAMERA, samples=4)
    apart = (still.radiance(wanted) - vertices.radiance(place.mesh_positions * 0.3 + 0.5)).abs()
    assert apart.max() < 0.3 / 12 + 1e-5
    assert apart.median() < 1e-5


def test_refuses_radiance_of_other_receivers():
    still = Still.of(cube(), size=(4, 4), camera=CAMERA)
    with pytest.raises(InputError, match="radiance of 24 vertices for a model of 216"):
        still.radiance(torch.zeros(24, 3))


def test_a_ground_is_not_framed_and_fades():
    place = cube()
    twice = {"role": "ground", "vertices": [4, 24], "faces": [2, 12], "charts": [1, 6], "name": "floor"}
    split_up = place.replace(
        objects=[{**place.objects[0], "vertices": [0, 4], "faces": [0, 2], "charts": [0, 1]}, twice]
    )
    assert torch.equal(subject(split_up), place.mesh_positions[:4])
    still = Still.of(split_up, size=(40, 40), camera=CAMERA)
    assert still.coverage.max() <= 1
    assert still.coverage.sum() < Still.of(place, size=(40, 40), camera=CAMERA).coverage.sum()


def test_gloss_is_shaded_for_the_eye_at_texels_and_then_read():
    place = cube(texels=4, gutter=1)
    glossy = random_glossy(vertices=place.count, order=3, output_order=2)
    tangents = torch.tensor(SIDES)[place.chart.long(), 1].float()
    transfer = dataclasses.replace(glossy, receivers=place)
    transfer = transfer.with_layers(exit=transfer.layers["exit"].replace(tangents=tangents))
    environment = Environment("light", LIGHT)
    studio = Studio(transfer, shader(transfer), environment, size=(30, 30), samples=1, tone="none", exposure=0.0)
    with torch.no_grad():
        radiance = shader(transfer)(LIGHT, eye=torch.tensor(CAMERA.eye))
    still = Still.of(place, size=(30, 30), camera=CAMERA, samples=1)
    wanted = still.picture(radiance.float(), exposure=0.0, tone="none")
    torch.testing.assert_close(studio.picture(CAMERA, torch.eye(3)), wanted, rtol=0, atol=1e-4)


# The state of a window


def test_a_session_shows_a_map_and_picks_texels():
    whole = lit_cube(order=3)
    session = Session({"cube": whole}, [Environment("light", LIGHT)])
    assert torch.equal(session.faces, whole.receivers.mesh_faces.long())
    assert session.surface_uv.shape == (12, 3, 2)
    colours = session.colours()
    assert len(colours) == whole.vertices
    assert session.map(colours).shape == (20, 30, 3)
    said = session.pick(50, 50, 100, 100)
    assert said.startswith("texel ")
    seen = session.camera.eye
    picked = session.picked
    # It faces the eye, and lies next to where the middle of the window is.
    assert float(whole.normals[picked] @ (torch.tensor(seen) - whole.positions[picked])) > 0
    assert session.lobe() is not None
    middle = Orbit.around(whole.receivers.mesh_positions.double()).camera()
    still = Still.of(whole.receivers, size=(101, 101), camera=middle, samples=1)
    triangle, _ = still.hits
    assert len(triangle) > 0


def test_refuses_poses_of_texels():
    with pytest.raises(InputError, match="poses move vertices"):
        Session({"cube": lit_cube()}, [Environment("light", LIGHT)], poses=torch.zeros(2, 24, 3))


def test_refuses_texels_beside_vertices_of_one_mesh():
    whole = lit_cube()
    with pytest.raises(InputError, match="give bakes of one mesh"):
        Session({"texels": whole, "vertices": to_vertices(whole)}, [Environment("light", LIGHT)])


# Maps


def test_a_map_is_the_image_in_half_floats_and_refuses_what_does_not_fit(tmp_path):
    place = cube()
    values = torch.rand(place.count, 3) * 100
    save_map(place, values, tmp_path / "a.exr")
    np.testing.assert_allclose(read_exr(tmp_path / "a.exr"), place.image(values), rtol=2.0**-11)
    for fault in (65505.0, math.nan, math.inf):
        values[3, 1] = fault
        with pytest.raises(InputError, match="half floats reach to 65504"):
            save_map(place, values, tmp_path / "b.exr")
    assert not (tmp_path / "b.exr").exists()


def test_refuses_a_map_of_vertices_and_of_other_files(tmp_path):
    with pytest.raises(InputError, match="bake it with --texels"):
        save_map(to_vertices(lit_cube()).receivers, torch.zeros(24, 3), tmp_path / "a.exr")
    with pytest.raises(InputError, match=r"must end in \.exr, \.png or \.npy"):
        save_map(cube(), torch.zeros(216, 3), tmp_path / "a.hdr")


# Models


def shown(document):
    """Of every piece its positions, places on the map, and the pixels of the map."""
    found = []
    for piece in pieces(document).pieces:
        material = document.entry("materials", piece.material)
        assert material["extensions"] == {"KHR_materials_unlit": {}}
        texture = material["pbrMetallicRoughness"]["baseColorTexture"]
        image = document.entry("textures", texture["index"])["source"]
        pixels = np.asarray(Image.open(io.BytesIO(document.image(image)[0])))
        found.append((piece, piece.uv[texture["texCoord"]], pixels))
    return found


def test_a_model_shows_the_map_on_a_second_set_of_texture_coordinates(tmp_path):
    whole = lit_cube()
    place = whole.receivers
    colours = torch.rand(place.count, 3)
    told = save_lit_glb(whole, colours, tmp_path / "a.glb")
    assert "plain mesh" in told
    assert "TEXCOORD_1" in told
    ((piece, uv, pixels),) = shown(Document.read(tmp_path / "a.glb"))
    np.testing.assert_allclose(uv[piece.faces], place.mesh_uv, atol=1e-6)
    np.testing.assert_allclose(piece.positions[piece.faces], place.mesh_positions[place.mesh_faces.long()], atol=1e-6)
    np.testing.assert_array_equal(pixels, (srgb(place.image(colours)) * 255).round().to(torch.uint8))
    # Both sets are there: the standard wants none without those before it.
    assert set(piece.uv) == {0, 1}


def test_vertices_at_seams_are_split_and_others_are_not():
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])[faces]
    vertex, corners, places = split(faces, uv)
    assert vertex.tolist() == [0, 1, 2, 3]
    assert corners.tolist() == faces.tolist()
    uv[1] += 2
    vertex, corners, places = split(faces, uv)
    assert vertex.tolist() == [0, 0, 1, 2, 2, 3]
    np.testing.assert_array_equal(places[corners], uv)
    np.testing.assert_array_equal(vertex[corners], faces)


def file_of_the_cube(path, welded, mapped=False):
    """A glTF of the cube with a texture and its own texture coordinates, from vertices of one side or of all.

    `mapped`: the map is on its second set already, and a third follows.
    """
    place = cube()
    positions, faces = place.mesh_positions.numpy(), place.mesh_faces.numpy().astype(np.int64)
    if welded:
        positions, number = np.unique(positions, axis=0, return_inverse=True)
        faces = number.reshape(-1)[faces]
    made = Gltf()
    alpha = made.accessor(np.full((len(positions), 4), 128, "u1"), normalized=True)
    own = np.linspace(0, 1, 2 * len(positions)).reshape(-1, 2)
    sets = {"TEXCOORD_0": own}
    if mapped:
        sets |= {"TEXCOORD_1": np.zeros_like(own), "TEXCOORD_2": own}
        sets["TEXCOORD_1"][faces] = place.mesh_uv.numpy()
    primitive = made.primitive(
        faces.reshape(-1), POSITION=positions, COLOR_0=alpha, _ID=np.arange(len(positions), dtype="f4"), **sets
    )
    made.tree |= {
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "dice"}],
        "meshes": [{"primitives": [{**primitive, "material": 0}]}],
        "materials": [
            {"name": "wood", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.4, 0.3, 1]}, "doubleSided": True}
        ],
    }
    made.save(path)
    objects = [
        {"name": str(path), "role": "receiver", "vertices": [0, len(positions)], "faces": [0, 12], "charts": [0, 6]}
    ]
    return place.replace(
        mesh_positions=torch.from_numpy(positions).float(),
        mesh_normals=torch.nn.functional.normalize(torch.from_numpy(positions).float(), dim=-1),
        mesh_faces=torch.from_numpy(faces).int(),
        objects=objects,
    )


@pytest.mark.parametrize("welded", [False, True])
def test_the_file_that_was_baked_is_kept_with_the_map_as_a_set_more(welded, tmp_path):
    place = file_of_the_cube(tmp_path / "dice.glb", welded)
    whole = dataclasses.replace(lit_cube(), receivers=place)
    told = save_mapped_glb(whole, torch.rand(place.count, 3), tmp_path / "lit.glb")
    assert told == f"keeps what {tmp_path / 'dice.glb'} holds; the map is on TEXCOORD_1"
    before, after = Document.read(tmp_path / "dice.glb"), Document.read(tmp_path / "lit.glb")
    ((piece, uv, _),) = shown(after)
    (old,) = pieces(before).pieces
    np.testing.assert_allclose(uv[piece.faces], place.mesh_uv, atol=1e-6)
    np.testing.assert_allclose(piece.positions[piece.faces], old.positions[old.faces], atol=1e-6)
    np.testing.assert_allclose(piece.uv[0][piece.faces], old.uv[0][old.faces], atol=1e-6)
    # Eight corners become as many vertices as there are places on the map.
    assert len(piece.positions) == 24
    assert piece.colours is None
    entry = after.tree["meshes"][0]["primitives"][0]["attributes"]
    assert len(after.accessor(entry["_ID"])) == 24
    assert after.tree["nodes"] == before.tree["nodes"]
    material = after.entry("materials", piece.material)
    assert (material["name"], material["doubleSided"]) == ("wood", True)
    assert after.tree["materials"][0] == before.tree["materials"][0]


def test_the_set_that_it_was_baked_on_is_not_repeated(tmp_path):
    """Some engines have two sets, and a copy would be a third or fourth."""
    place = file_of_the_cube(tmp_path / "dice.glb", welded=False, mapped=True)
    told = save_mapped_glb(
        dataclasses.replace(lit_cube(), receivers=place), torch.rand(place.count, 3), tmp_path / "lit.glb"
    )
    assert told.endswith("the map is on TEXCOORD_1")
    before, after = Document.read(tmp_path / "dice.glb"), Document.read(tmp_path / "lit.glb")
    ((piece, uv, _),) = shown(after)
    np.testing.assert_allclose(uv[piece.faces], place.mesh_uv, atol=1e-6)
    assert sorted(piece.uv) == [0, 1, 2]
    assert len(piece.positions) == len(pieces(before).pieces[0].positions)


def test_a_file_of_other_faces_becomes_a_plain_mesh(tmp_path):
    place = file_of_the_cube(tmp_path / "dice.glb", False)
    turned = place.replace(mesh_faces=place.mesh_faces[:, [1, 2, 0]], mesh_uv=place.mesh_uv[:, [1, 2, 0]])
    told = save_mapped_glb(dataclasses.replace(lit_cube(), receivers=turned), torch.rand(216, 3), tmp_path / "b.glb")
    assert "has other faces than were baked" in told
    more = place.replace(
        mesh_positions=place.mesh_positions[:23].repeat(2, 1),
        mesh_normals=place.mesh_normals[:23].repeat(2, 1),
        mesh_faces=place.mesh_faces.clamp(max=22),
        objects=[],
    )
    whole = dataclasses.replace(lit_cube(), receivers=more)
    with pytest.raises(InputError, match="24 vertices, and the transfer was recorded at"):
        save_mapped_glb(whole, torch.rand(216, 3), tmp_path / "b.glb", given=tmp_path / "dice.glb")


def test_the_file_of_a_model_is_what_the_standard_asks_for(tmp_path):
    save_mapped_glb(lit_cube(), torch.rand(216, 3), tmp_path / "a.glb")
    document = Document.read(tmp_path / "a.glb")
    tree = document.tree
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    assert len(tree["bufferViews"]) == len(tree["accessors"]) + len(tree["images"])
    assert all(view["byteOffset"] % 4 == 0 for view in tree["bufferViews"])
    json.dumps(tree, allow_nan=False)
    (mesh,) = tree["meshes"]
    position = tree["accessors"][mesh["primitives"][0]["attributes"]["POSITION"]]
    assert (position["min"], position["max"]) == ([-1, -1, -1], [1, 1, 1])
