"""Do points of faces have the colour, the gloss and the normal that the pictures of their file show there?"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from texel_scenes import plane
from textured_files import flat, gltf, noise, png, save_sheet, sheet, textured

from torchprt.errors import InputError
from torchprt.scene import Material, Object, load
from torchprt.scene.finish import Finish
from torchprt.scene.lightmap import Lightmap
from torchprt.scene.texel_samples import texel_samples
from torchprt.scene.texture import srgb_to_linear

MIDDLE = torch.full((1, 1, 3), 1 / 3)
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
QUAD = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"


def finish(path, **arguments) -> Finish:
    return Finish(load(path, **arguments).objects[0])


def everywhere(object, seed=0, samples=3):
    """A point of every face, several times."""
    faces = len(object.mesh.faces)
    weights = np.random.default_rng(seed).dirichlet(np.ones(3), (faces, samples))
    return torch.arange(faces)[:, None].expand(-1, samples), torch.from_numpy(weights)


def colour_of(made: Finish, face=0, weights=MIDDLE, side=None) -> list[float]:
    return made.reflecting(torch.tensor([[face]]), weights, side).albedo[0].tolist()


def normal_of(made: Finish, face=0, weights=MIDDLE) -> list[float]:
    return made.normals(torch.tensor([face]), weights[0])[0].tolist()


def tilted(x: float, y: float, z: float) -> bytes:
    """A normal map of one normal, to 1/255."""
    return flat(*(round(255 * (value / 2 + 0.5)) for value in (x, y, z)))


def bumpy(**entry) -> dict:
    """A material whose normals are those of the first texture."""
    return {"normalTexture": {"index": 0, **entry}}


# Misuse


def test_faces_that_are_not_those_of_the_file_are_refused(tmp_path):
    object = load(save_sheet(tmp_path / "a.glb", [textured()], [flat(9, 9, 9)])).objects[0]
    other = replace(object.mesh, faces=object.mesh.faces.flip(0))
    with pytest.raises(InputError, match=r"a\.glb has other faces than the file that its material is of"):
        Finish(Object(other, object.material))


def test_a_surface_of_no_file_is_linear_between_its_vertices():
    mesh = plane(2)
    albedo = 0.5 * torch.rand(len(mesh.positions), 3)
    object = Object(mesh, Material(albedo, gloss="ggx:0.3", specular=0.2))
    face, weights = everywhere(object)
    made = Finish(object).reflecting(face, weights)
    wanted = (albedo[mesh.faces[face]] * weights[..., None].float()).sum(2).mean(1)
    assert torch.allclose(made.albedo, wanted, atol=1e-6)
    assert torch.allclose(made.specular, torch.full_like(made.specular, 0.2))
    assert (made.gloss == 0).all()
    assert torch.allclose(Finish(object).normals(face[:, 0], weights[:, 0]), torch.tensor([0.0, 1, 0]).double())


def test_a_blocker_and_no_points_are_no_trouble(tmp_path):
    object = load(save_sheet(tmp_path / "a.glb", [textured()], [flat(9, 9, 9)])).objects[0]
    made = Finish(object).reflecting(torch.zeros(0, 4, dtype=torch.int64), torch.zeros(0, 4, 3))
    assert made.albedo.shape == (0, 3)
    assert Finish(Object(object.mesh, Material(0.0), "blocker")).normals(torch.tensor([0]), MIDDLE[0])[0, 2] == 1


# Colours


def test_a_point_has_the_linear_colour_of_the_picture_there(tmp_path):
    texels = noise(8)
    object = load(save_sheet(tmp_path / "a.glb", [textured()], [png(texels)])).objects[0]
    face, weights = everywhere(object, samples=1)
    place = (object.mesh.positions[object.mesh.faces[face]] * weights[..., None]).sum(2)[:, 0].numpy()
    linear = srgb_to_linear(texels / 255.0)
    # By hand: u, v run with x, y; the four texels around, repeated.
    at = 8 * place[:, :2] - 0.5
    low = np.floor(at).astype(int)
    share = at - low
    wanted = np.zeros((len(at), 3))
    for right in (0, 1):
        for below in (0, 1):
            weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - below - share[:, 1])
            wanted += weight[:, None] * linear[(low[:, 1] + below) % 8, (low[:, 0] + right) % 8]
    found = Finish(object).reflecting(face, weights).albedo.numpy()
    assert np.abs(found - wanted).max() < 2e-5


def test_a_point_that_stands_for_much_has_the_mean_of_the_picture(tmp_path):
    texels = noise(32)
    made = finish(save_sheet(tmp_path / "a.glb", [textured()], [png(texels)]))
    mean = srgb_to_linear(texels / 255.0).mean((0, 1))
    assert colour_of(made, side=torch.full((1, 1), 1.0)) == pytest.approx(mean, abs=1e-5)
    # A texel is 1/32 wide.
    sharp = colour_of(made, side=torch.full((1, 1), 1 / 32))
    assert sharp == pytest.approx(colour_of(made))
    assert sharp != pytest.approx(mean, abs=0.05)


def test_factor_times_texture_times_vertex_colour(tmp_path):
    tint = np.random.default_rng(0).random((36, 3)).astype(np.float32)
    material = textured(baseColorFactor=[0.25, 1, 0.5, 1])
    object = load(save_sheet(tmp_path / "a.glb", [material], [flat(255, 188, 255)], COLOR_0=tint)).objects[0]
    face, weights = everywhere(object, samples=1)
    between = (tint[object.mesh.faces[face]] * weights[..., None].numpy()).sum(2)[:, 0]
    found = Finish(object).reflecting(face, weights).albedo
    assert np.allclose(found, between * [0.25, 0.502886, 0.5], atol=1e-5)


def test_a_hole_has_no_part_in_the_mean_of_samples(tmp_path):
    texels = np.array([[[255, 0, 0, 255], [0, 0, 255, 0]]], np.uint8)
    path = save_sheet(tmp_path / "a.glb", [{**textured(), "alphaMode": "MASK"}], [png(texels)], [{"magFilter": 9728}])
    object = load(path).objects[0]
    place = object.mesh.positions[object.mesh.faces].mean(1)[:, 0]
    face = torch.stack([place.argmin(), place.argmax()])[None]
    found = Finish(object).reflecting(face, torch.full((1, 2, 3), 1 / 3)).albedo[0]
    assert found.tolist() == pytest.approx([1, 0, 0], abs=1e-4)


def test_a_face_has_its_own_material_and_not_half_of_its_neighbours(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    faces = "usemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\n"
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + OBJ + faces)
    made = finish(tmp_path / "a.obj")
    assert colour_of(made, 0) == [1, 0, 0]
    assert colour_of(made, 1) == [0, 0, 1]


def test_v_runs_up_in_an_obj(tmp_path):
    (tmp_path / "a.png").write_bytes(png(np.array([[[255, 0, 0]], [[0, 0, 255]]], np.uint8)))
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + OBJ + "usemtl a\n" + QUAD)
    # Near (0, 1): the upper left.
    red, _, blue = colour_of(finish(tmp_path / "a.obj"), 1, torch.tensor([[[0.2, 0.1, 0.7]]]))
    assert red > 0.8 > 0.2 > blue


def test_what_is_said_instead_is_no_longer_of_the_picture(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [textured()], [flat(188, 188, 188)])
    assert colour_of(finish(path)) == pytest.approx([0.502886] * 3, abs=1e-5)
    assert colour_of(finish(path, albedo=0.1)) == pytest.approx([0.1])
    assert colour_of(finish(path, albedo=0.1, material="file")) == pytest.approx([0.1])
    # The colour of the file under a gloss that is given.
    coated = finish(path, albedo="file", material="ggx:0.3,0.04")
    assert colour_of(coated) == pytest.approx([0.502886] * 3, abs=1e-5)
    assert coated.reflecting(torch.tensor([[0]]), MIDDLE).gloss.tolist() == [0]


# Gloss


@pytest.mark.parametrize("metallic", [0, 255])
def test_a_uniform_gloss_is_that_of_the_vertices(tmp_path, metallic):
    material = textured(0, metallicRoughnessTexture={"index": 1}, metallicFactor=1)
    path = save_sheet(tmp_path / "a.glb", [material], [flat(200, 150, 100), flat(0, 128, metallic)])
    object = load(path, material="file").objects[0]
    made = Finish(object).reflecting(*everywhere(object))
    assert torch.allclose(made.albedo, object.albedo[:1], atol=1e-5)
    assert torch.allclose(made.specular, object.specular[:1], atol=1e-5)
    assert (made.gloss == 0).all()


def test_texels_tell_metal_from_paint_where_vertices_mix_them(tmp_path):
    # Left half paint, right half polished metal, on a sheet of one square.
    shine = png(np.array([[[0, 200, 0], [0, 60, 255]]], np.uint8))
    material = textured(0, metallicRoughnessTexture={"index": 1}, metallicFactor=1)
    path = save_sheet(tmp_path / "a.glb", [material], [flat(255, 255, 255), shine], [{"magFilter": 9728}], squares=2)
    object = load(path, material="file").objects[0]
    made = Finish(object).reflecting(*everywhere(object, samples=1))
    models = object.material.glosses
    peak = made.specular[:, 0] * torch.tensor([float(models[number].f0) for number in made.gloss])
    left = object.mesh.positions[object.mesh.faces].mean(1)[:, 0] < 0.4
    right = object.mesh.positions[object.mesh.faces].mean(1)[:, 0] > 0.6
    assert torch.allclose(peak[left], torch.tensor(0.04), atol=1e-3)
    assert torch.allclose(peak[right], torch.tensor(1.0), atol=1e-3)
    assert (made.albedo[right] < 1e-3).all()


# Normals


def test_a_flat_map_leaves_the_normals(tmp_path):
    made = finish(save_sheet(tmp_path / "a.glb", [bumpy()], [flat(128, 128, 255)]))
    # 128 is 1/255 beside the middle.
    assert normal_of(made) == pytest.approx([0, 0, 1], abs=1.5 / 255 * 2)


def test_x_runs_along_u_and_y_up_the_picture(tmp_path):
    # u runs with x and v with y, which is down the picture.
    made = finish(save_sheet(tmp_path / "a.glb", [bumpy()], [tilted(0.6, 0, 0.8)]))
    assert normal_of(made) == pytest.approx([0.6, 0, 0.8], abs=0.01)
    # Seen from +z the picture is mirrored: up the picture is -y all the same.
    made = finish(save_sheet(tmp_path / "b.glb", [bumpy()], [tilted(0, 0.6, 0.8)]))
    assert normal_of(made) == pytest.approx([0, -0.6, 0.8], abs=0.01)


def test_mirrored_texture_coordinates_mirror_the_normals(tmp_path):
    _, _, uv = sheet()
    u, v = uv.T
    cases = [((1 - u, v), (-0.48, -0.36)), ((u, 1 - v), (0.48, 0.36)), ((v, u), (-0.36, 0.48))]
    for number, (turned, wanted) in enumerate(cases):
        pairs = np.stack(turned, -1)
        made = finish(save_sheet(tmp_path / f"{number}.glb", [bumpy()], [tilted(0.48, 0.36, 0.8)], TEXCOORD_0=pairs))
        assert normal_of(made) == pytest.approx([*wanted, 0.8], abs=0.01)


def test_both_sides_of_a_mirror_line_keep_their_own_tangents():
    from torchprt.scene.normal_map import tangent_space

    # u grows toward the middle from both sides, as on a face that is painted by halves; the vertices are shared.
    places = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]], float)
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    u = np.array([0, 1, 0, 0, 1, 0])[faces]
    space = tangent_space(places, faces, np.tile([0.0, 0, 1], (6, 1)), np.stack([u, 1 - places[faces][..., 1]], -1))
    assert np.allclose(space.tangents[:2], [1, 0, 0])
    assert np.allclose(space.tangents[2:], [-1, 0, 0])
    assert space.handed.tolist() == [1, 1, -1, -1]


def test_the_tangents_of_the_file_come_first(tmp_path):
    tangents = np.tile([0, 1, 0, -1], (36, 1)).astype(np.float32)
    path = save_sheet(tmp_path / "a.glb", [bumpy()], [tilted(0.48, 0.36, 0.8)], TANGENT=tangents)
    # B = -(z x y) = x.
    assert normal_of(finish(path)) == pytest.approx([0.36, 0.48, 0.8], abs=0.01)


def test_a_node_that_mirrors_takes_its_normals_along(tmp_path):
    positions, faces, uv = sheet()
    tangents = np.tile([1, 0, 0, -1], (36, 1)).astype(np.float32)
    for name, more in (("a", {}), ("b", {"TANGENT": tangents})):
        file = gltf([bumpy()], [tilted(0.48, 0.36, 0.8)])
        file.tree["nodes"] = [{"mesh": 0, "scale": [-1, 1, 1]}]
        primitive = file.primitive(faces.astype(np.uint32).ravel(), POSITION=positions, TEXCOORD_0=uv, **more)
        file.tree["meshes"] = [{"primitives": [{**primitive, "material": 0}]}]
        # Not mirrored: (.48, -.36, .8).
        found = normal_of(finish(file.save(tmp_path / f"{name}.glb")))
        assert found == pytest.approx([-0.48, -0.36, 0.8], abs=0.01)


def test_the_scale_of_a_map_flattens_it(tmp_path):
    made = finish(save_sheet(tmp_path / "a.glb", [bumpy(scale=0.5)], [tilted(0.6, 0, 0.8)]))
    assert normal_of(made) == pytest.approx([0.3 / math.hypot(0.3, 0.8), 0, 0.8 / math.hypot(0.3, 0.8)], abs=0.01)


def test_a_normal_into_the_surface_is_brought_out(tmp_path):
    made = finish(save_sheet(tmp_path / "a.glb", [bumpy()], [tilted(0.6, 0, -0.8)]))
    x, _, z = normal_of(made)
    assert 0 < z < 0.01
    assert x > 0.99


def test_an_obj_has_its_normals_under_norm_and_a_height_map_is_left_and_said(tmp_path):
    (tmp_path / "n.png").write_bytes(tilted(0.48, 0.36, 0.8))
    for line in ("norm n.png", "map_Kn n.png"):
        (tmp_path / "a.mtl").write_text(f"newmtl a\nKd 1 1 1\n{line}\nbump n.png\n")
        (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + OBJ + "usemtl a\n" + QUAD)
        said = str(load(tmp_path / "a.obj"))
        assert "At texels, not at vertices: normal map of 'a'." in said
        assert "Left out: bump map of 'a'" in said
        # v runs up with y, and so does the picture.
        assert normal_of(finish(tmp_path / "a.obj")) == pytest.approx([0.48, 0.36, 0.8], abs=0.01)


def test_a_map_without_texture_coordinates_or_picture_is_said_and_the_normals_stay(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 1 1\nnorm gone.png\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + OBJ + "usemtl a\n" + QUAD)
    made = finish(tmp_path / "a.obj")
    assert normal_of(made) == [0, 0, 1]
    assert "gone.png" in made.notes[0]
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + OBJ + "usemtl a\nf 1 2 3\nf 1 3 4\n")
    made = finish(tmp_path / "a.obj")
    assert normal_of(made) == [0, 0, 1]
    assert "no texture coordinates" in made.notes[0]


# Maps


@pytest.mark.parametrize("size", [16, 4])
def test_a_texel_has_the_mean_of_the_picture_over_it(tmp_path, size):
    texels = noise(16)
    scene = load(save_sheet(tmp_path / "a.glb", [textured()], [png(texels)], [{"magFilter": 9728}]))
    samples = texel_samples(scene, scene.geometry(), Lightmap(size, uv=0))
    blocks = srgb_to_linear(texels / 255.0).reshape(size, 16 // size, size, 16 // size, 3)
    assert np.allclose(samples.points.albedo, blocks.mean((1, 3)).reshape(-1, 3), atol=1e-5)


def test_a_picture_that_is_not_there_is_said_with_the_map(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 1 1\nnorm gone.png\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + OBJ + "usemtl a\n" + QUAD)
    scene = load(tmp_path / "a.obj")
    samples = texel_samples(scene, scene.geometry(), Lightmap(8))
    assert any("gone.png" in each for each in samples.notes)
