"""Does a surface get the colours and the gloss that its file says, by values worked out by hand?"""

import math
import struct

import numpy as np
import pytest
import torch
from gltf_files import Gltf
from textured_files import flat, gltf, png, save_sheet, sheet, textured

from torchprt.errors import InputError
from torchprt.scene import Material, load, object_of, read_mesh, read_surface
from torchprt.scene.energy import reflected

LINEAR_188 = 0.502886
"""((188 / 255 + .055) / 1.055)^2.4"""
LINEAR_128 = 0.215861


def albedo(path, **arguments):
    """The one albedo of a file whose vertices all have the same."""
    values = load(path, **arguments).objects[0].albedo
    assert torch.allclose(values, values[:1].expand(len(values), -1), atol=1e-6)
    return values[0].tolist()


def metal(base, metallic, roughness, **entry):
    """A plain material."""
    core = {"baseColorFactor": [*base, 1], "metallicFactor": metallic, "roughnessFactor": roughness}
    return {"pbrMetallicRoughness": core, **entry}


def text(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content)
    return path


OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
QUAD = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
PLY = "ply\nformat ascii 1.0\n{}element vertex 4\nproperty float x\nproperty float y\nproperty float z\n{}"
PLY_FACES = "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
CORNERS = ("0 0 0", "1 0 0", "1 1 0", "0 1 0")


def ply(tmp_path, properties, values, comment=""):
    lines = "".join(f"{corner} {values}\n" for corner in CORNERS)
    return text(tmp_path, "a.ply", PLY.format(comment, properties) + PLY_FACES + lines + "3 0 1 2\n3 0 2 3\n")


# Misuse


def test_a_file_without_colours_has_none_to_ask_for(tmp_path):
    plain = text(tmp_path, "a.obj", OBJ + QUAD)
    assert albedo(plain) == [0.5]
    with pytest.raises(InputError, match=r"a\.obj has no colours for albedo \"file\": give the albedo as numbers"):
        load(plain, albedo="file")
    with pytest.raises(InputError, match=r"a\.obj has no materials for material \"file\""):
        load(plain, material="file")
    with pytest.raises(InputError, match="is a mesh, of which"):
        object_of(read_mesh(plain), albedo="file")


def test_a_damaged_material_is_refused_in_a_sentence(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [{"pbrMetallicRoughness": {"baseColorFactor": "red"}}])
    assert len(read_mesh(path).positions) == 36
    with pytest.raises(InputError, match=r"a\.glb has damaged materials"):
        load(path)


def test_a_material_that_does_not_exist_is_refused(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [])
    with pytest.raises(InputError, match=r"a\.glb names material 0 of 0"):
        load(path)


def test_a_material_alone_does_not_know_a_file():
    with pytest.raises(InputError, match="is what a mesh file says: give it to load"):
        Material("file")


# Colour spaces, by hand


def test_factor_times_texture_times_vertex_colour(tmp_path):
    tint = np.full((36, 3), 0.5, np.float32)
    material = textured(baseColorFactor=[0.25, 1, 1, 1])
    path = save_sheet(tmp_path / "a.glb", [material], [flat(188, 188, 10)], COLOR_0=tint)
    # The factor and the vertices are linear, the picture is sRGB.
    wanted = [0.25 * LINEAR_188 * 0.5, LINEAR_188 * 0.5, 10 / 255 / 12.92 * 0.5]
    assert albedo(path) == pytest.approx(wanted, rel=1e-5)


def test_a_whole_number_in_color_0_is_linear(tmp_path):
    positions, faces, _ = sheet()
    file = gltf([])
    colours = file.accessor(np.full((36, 4), 128, np.uint8), normalized=True)
    primitive = file.primitive(faces.astype(np.uint32).ravel(), POSITION=positions, COLOR_0=colours)
    file.tree["meshes"] = [{"primitives": [primitive]}]
    assert albedo(file.save(tmp_path / "a.glb")) == pytest.approx([128 / 255] * 3)


def test_a_whole_number_in_a_ply_is_srgb_and_a_real_one_linear(tmp_path):
    names = ("red", "green", "blue")
    whole = "".join(f"property uchar {name}\n" for name in names)
    assert albedo(ply(tmp_path, whole, "188 128 0")) == pytest.approx([LINEAR_188, LINEAR_128, 0], rel=1e-5)
    real = "".join(f"property float {name}\n" for name in names)
    assert albedo(ply(tmp_path, real, "0.25 0.5 1")) == pytest.approx([0.25, 0.5, 1])


def test_vertex_colours_alone_are_not_blurred(tmp_path):
    tint = np.random.default_rng(0).random((36, 3)).astype(np.float32)
    path = save_sheet(tmp_path / "a.glb", [{}], COLOR_0=tint)
    assert torch.equal(load(path).objects[0].albedo, torch.from_numpy(tint))
    assert torch.equal(load(path, albedo="vertex").objects[0].albedo, torch.from_numpy(tint))


def test_the_diffuse_colour_of_an_obj_is_linear_and_its_picture_srgb(tmp_path):
    (tmp_path / "red brick.png").write_bytes(flat(188, 188, 188))
    text(tmp_path, "a.mtl", "newmtl brick\nKd 0.5 0.25 1\nmap_Kd -clamp on -s 1 1 1 red brick.png\n")
    path = text(tmp_path, "a.obj", "mtllib a.mtl\n" + OBJ + "usemtl brick\n" + QUAD)
    assert albedo(path) == pytest.approx([0.5 * LINEAR_188, 0.25 * LINEAR_188, LINEAR_188], rel=1e-5)


def test_scanners_name_a_picture_in_a_comment(tmp_path):
    (tmp_path / "scan.png").write_bytes(flat(188, 128, 0))
    names = "property float s\nproperty float t\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
    path = ply(tmp_path, names, "0.5 0.5 20 20 20", "comment TextureFile scan.png\n")
    # The colours of its vertices are the same once more, and coarser.
    assert albedo(path) == pytest.approx([LINEAR_188, LINEAR_128, 0], rel=1e-5)
    assert "Left out: vertex colours of 'scan.png'" in str(load(path))


@pytest.mark.parametrize("binary", [False, True])
def test_scanners_give_texture_coordinates_to_the_corners_of_faces(tmp_path, binary):
    (tmp_path / "scan.png").write_bytes(png(np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8)))
    head = PLY.format("comment TextureFile scan.png\n", "") + PLY_FACES.replace(
        "end_header", "property list uchar float texcoord\nend_header"
    )
    # The first face lies in the middle of red, the second in that of blue.
    faces = [((0, 1, 2), [0.25, 0.5] * 3), ((0, 2, 3), [0.75, 0.5] * 3)]
    if binary:
        body = np.array([corner.split() for corner in CORNERS], "<f4").tobytes()
        body += b"".join(struct.pack("<B3iB6f", 3, *face, 6, *uv) for face, uv in faces)
        content = head.replace("ascii", "binary_little_endian").encode() + body
    else:
        lines = [f"3 {' '.join(map(str, face))} 6 {' '.join(map(str, uv))}" for face, uv in faces]
        content = (head + "\n".join([*CORNERS, *lines]) + "\n").encode()
    path = tmp_path / "a.ply"
    path.write_bytes(content)
    colours = load(path).objects[0].albedo
    assert colours[1].tolist() == pytest.approx([1, 0, 0], abs=1e-5)
    assert colours[3].tolist() == pytest.approx([0, 0, 1], abs=1e-5)


# Where a picture lies

RED_ABOVE = np.array([[[255, 0, 0]], [[0, 0, 255]]], np.uint8)
"""The upper row red, the lower blue."""


def upper_is_red(colours, mesh) -> bool:
    high = mesh.positions[:, 1] > 0.75
    low = mesh.positions[:, 1] < 0.25
    return bool((colours[high, 0] > 0.7).all() and (colours[low, 2] > 0.7).all())


def test_v_runs_down_in_gltf_and_up_in_the_others(tmp_path):
    _, _, uv = sheet()
    down = np.column_stack([uv[:, 0], 1 - uv[:, 1]])
    clamp = [{"wrapS": 33071, "wrapT": 33071}]
    path = save_sheet(tmp_path / "a.glb", [textured()], [png(RED_ABOVE)], clamp, TEXCOORD_0=down)
    thing = load(path).objects[0]
    assert upper_is_red(thing.albedo, thing.mesh)
    (tmp_path / "a.png").write_bytes(png(RED_ABOVE))
    text(tmp_path, "a.mtl", "newmtl m\nmap_Kd -clamp on a.png\n")
    positions, faces, uv = sheet()
    lines = [f"v {x} {y} {z}" for x, y, z in positions] + [f"vt {u} {v}" for u, v in uv]
    lines += ["usemtl m"] + ["f " + " ".join(f"{corner}/{corner}" for corner in face + 1) for face in faces]
    thing = load(text(tmp_path, "a.obj", "mtllib a.mtl\n" + "\n".join(lines))).objects[0]
    assert upper_is_red(thing.albedo, thing.mesh)


def test_a_texture_transform_is_that_of_its_specification(tmp_path):
    # The first example there: the lower left quadrant of the picture, turned clockwise by 90 degrees.
    quarters = np.zeros((64, 64, 3), np.uint8)
    quarters[32:48, :16, 0] = quarters[48:, :16, 1] = quarters[48:, 16:32, 2] = 255
    moved = {"KHR_texture_transform": {"offset": [0, 1], "rotation": math.pi / 2, "scale": [0.5, 0.5]}}
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": moved}}}
    positions, _, uv = sheet()
    path = save_sheet(
        tmp_path / "a.glb", [material], [png(quarters)], TEXCOORD_0=np.column_stack([uv[:, 0], 1 - uv[:, 1]])
    )
    colours = load(path).objects[0].albedo
    at = lambda x, y: colours[np.abs(positions[:, :2] - [x, y]).sum(1).argmin()].tolist()  # noqa: E731
    # In the picture red stands on green, and blue to the right of it: turned, green is at the upper left.
    assert at(0, 1) == pytest.approx([0, 1, 0], abs=0.15)
    assert at(1, 1) == pytest.approx([1, 0, 0], abs=0.15)
    assert at(0, 0) == pytest.approx([0, 0, 1], abs=0.15)


def test_a_material_may_name_the_second_texture_coordinates(tmp_path):
    _, _, uv = sheet()
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}}}
    halves = np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8)
    path = save_sheet(tmp_path / "a.glb", [material], [png(halves)], TEXCOORD_0=uv, TEXCOORD_1=0 * uv + [0.75, 0.5])
    assert albedo(path) == pytest.approx([0, 0, 1])


def test_a_seam_of_texture_coordinates_does_not_show(tmp_path):
    # The sheet in two halves with a column of vertices each at their seam, as exporters write it.
    positions, faces, uv = sheet(4)
    right = positions[faces].mean(1)[:, 0] > 0.5
    picture = png((np.arange(4096).reshape(64, 64, 1) % 253).repeat(3, 2).astype(np.uint8))
    halves = np.concatenate([positions, positions])
    split = np.where(right[:, None], faces + len(positions), faces)
    file = gltf([textured()], [picture])
    arguments = {"POSITION": halves, "NORMAL": np.tile([0.0, 0, 1], (50, 1)), "TEXCOORD_0": np.concatenate([uv, uv])}
    primitive = file.primitive(split.astype(np.uint32).ravel(), **arguments)
    file.tree["meshes"] = [{"primitives": [{**primitive, "material": 0}]}]
    colours = load(file.save(tmp_path / "a.glb")).objects[0].albedo
    seam = np.intersect1d(faces[right], faces[~right])
    assert len(seam) == 5
    assert torch.equal(colours[seam], colours[seam + 25])
    one = save_sheet(tmp_path / "b.glb", [textured()], [picture], squares=4)
    assert torch.allclose(colours[seam], load(one).objects[0].albedo[seam], atol=1e-6)


def test_holes_do_not_darken_what_is_around_them(tmp_path):
    leaf = np.zeros((64, 64, 4), np.uint8)
    leaf[20:44, 20:44] = (0, 255, 0, 255)
    for mode in ("MASK", "BLEND"):
        path = save_sheet(tmp_path / "a.glb", [{**textured(), "alphaMode": mode}], [png(leaf)], squares=1)
        assert load(path).objects[0].albedo[0].tolist() == pytest.approx([0, 1, 0], abs=0.1)
    opaque = save_sheet(tmp_path / "a.glb", [textured()], [png(leaf)], squares=1)
    assert float(load(opaque).objects[0].albedo[0, 1]) < 0.3


# Several materials


def test_every_vertex_has_the_material_of_its_own_piece(tmp_path):
    positions, faces, _ = sheet(1)
    file = gltf([metal((1, 0, 0), 0, 1, name="red"), metal((0, 0, 1), 0, 1, name="blue", doubleSided=True)])
    primitives = [file.primitive(faces.astype(np.uint32).ravel(), POSITION=positions + shift) for shift in (0, 2.0)]
    file.tree["meshes"] = [{"primitives": [{**each, "material": n} for n, each in enumerate(primitives)]}]
    path = file.save(tmp_path / "a.glb")
    scene = load(path)
    (thing,) = scene.objects
    assert thing.albedo.tolist() == [[1, 0, 0]] * 4 + [[0, 0, 1]] * 4
    assert thing.two_sided.tolist() == [False] * 4 + [True] * 4
    geometry = scene.geometry()
    assert geometry.receivers == 12
    assert geometry.back_slices == (slice(8, 12),)
    assert geometry.two_sided.tolist() == [False] * 2 + [True] * 2
    assert geometry.back_receiver_of_vertex.tolist() == [-1] * 4 + [8, 9, 10, 11]
    assert geometry.display_faces[4:].tolist() == (geometry.faces[2:] + 4).flip(1).tolist()
    assert torch.equal(geometry.receiver_normals[8:], -geometry.receiver_normals[4:8])
    assert not load(path, two_sided=False).objects[0].two_sided.any()
    assert load(path, two_sided=True).objects[0].two_sided.all()
    assert "Both sides of 'blue' receive light" in str(scene)


def test_an_obj_vertex_of_two_materials_has_their_mean_by_area(tmp_path):
    text(tmp_path, "a.mtl", "newmtl one\nKd 1 0 0\nnewmtl two\nKd 0 0 1\n")
    quad = "usemtl one\nf 1 2 3\nusemtl two\nf 1 3 4\n"
    colours = load(text(tmp_path, "a.obj", "mtllib a.mtl\n" + OBJ + quad)).objects[0].albedo
    assert colours.tolist() == [[0.5, 0, 0.5], [1, 0, 0], [0.5, 0, 0.5], [0, 0, 1]]


def test_the_inside_of_a_closed_surface_is_not_recorded(tmp_path):
    import trimesh

    box = trimesh.creation.box()
    file = gltf([metal((1, 0, 0), 0, 1, doubleSided=True)])
    primitive = file.primitive(box.faces.astype(np.uint32).ravel(), POSITION=box.vertices)
    file.tree["meshes"] = [{"primitives": [{**primitive, "material": 0}]}]
    scene = load(file.save(tmp_path / "a.glb"))
    assert not scene.objects[0].two_sided.any()
    assert "of a closed surface, whose outer side alone receives light: 'material 0'." in str(scene)


def test_a_scene_file_takes_what_its_meshes_say_unless_it_says_more(tmp_path):
    save_sheet(tmp_path / "a.glb", [{**metal((0.8, 0.7, 0.4), 1, 0.5), "doubleSided": True}])
    lines = ["", 'material = "file"', "albedo = 0.25", 'albedo = "file"\ngloss = "ggx:0.3,0.04"\ntwo_sided = false']
    text(tmp_path, "scene.toml", "".join(f'[[object]]\nmesh = "a.glb"\n{line}\n' for line in lines))
    plain, whole, grey, varnished = load(tmp_path / "scene.toml").objects
    assert plain.albedo[0].tolist() == pytest.approx([0.8, 0.7, 0.4])
    assert plain.two_sided.all()
    assert [brdf.spec for brdf in whole.material.glosses] == ["ggx:0.25,0.8"]
    assert grey.albedo[0].tolist() == [0.25]
    assert varnished.albedo[0].tolist() == pytest.approx([0.8, 0.7, 0.4])
    assert [brdf.spec for brdf in varnished.material.glosses] == ["ggx:0.3,0.04"]
    assert not varnished.two_sided.any()


# What is left is said


def test_what_is_left_out_is_said_by_the_names_of_the_materials(tmp_path):
    emission = {"emissiveFactor": [1, 0.5, 0], "occlusionTexture": {"index": 0}, "normalTexture": {"index": 0}}
    coat = {"KHR_materials_clearcoat": {"clearcoatFactor": 1}, "KHR_materials_transmission": {}}
    material = {**textured(), "name": "lamp", "extensions": coat, **emission, "alphaMode": "BLEND"}
    said = str(load(save_sheet(tmp_path / "a.glb", [material], [flat(200, 200, 200)])))
    assert "Albedo of the file: textures of 'lamp'." in said
    for words in ("normal map", "occlusion", "emission", "clearcoat", "transmission", "transparency", "gloss"):
        assert f"{words} of 'lamp'" in said


def test_an_unlit_colour_is_taken_as_albedo_and_said(tmp_path):
    material = {**metal((0.2, 0.4, 0.6), 1, 0.1), "name": "sky", "extensions": {"KHR_materials_unlit": {}}}
    path = save_sheet(tmp_path / "a.glb", [material])
    assert albedo(path) == pytest.approx([0.2, 0.4, 0.6])
    assert "Unlit, the colour is taken as albedo: 'sky'." in str(load(path))
    assert not load(path, material="file").objects[0].glossy


def test_a_picture_that_is_missing_is_said_and_the_factor_taken(tmp_path):
    text(tmp_path, "a.mtl", "newmtl brick\nKd 0.5 0.25 1\nmap_Kd gone.png\n")
    path = text(tmp_path, "a.obj", "mtllib a.mtl\n" + OBJ + "usemtl brick\n" + QUAD)
    assert albedo(path) == pytest.approx([0.5, 0.25, 1])
    assert "'brick' has no picture, its factor alone is taken: the picture gone.png is not there." in str(load(path))


def test_a_library_that_is_missing_is_said(tmp_path):
    path = text(tmp_path, "a.obj", "mtllib gone.mtl\n" + OBJ + "usemtl brick\n" + QUAD)
    assert albedo(path) == [0.5]
    assert "The library gone.mtl cannot be read (No such file or directory): 'brick'." in str(load(path))


def test_colours_above_one_are_said_and_taken_as_one(tmp_path):
    real = "".join(f"property float {name}\n" for name in ("red", "green", "blue"))
    path = ply(tmp_path, real, "0.25 0.5 1.5")
    assert albedo(path) == pytest.approx([0.25, 0.5, 1])
    assert "Colours of 4 vertices, from 0.25 to 1.5, are taken as within 0 and 1." in str(load(path))
    assert "Albedo is 1 in the mean: light that bounces dies slowly." in str(load(path))


def test_a_metal_is_diffuse_by_default_and_that_is_said(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [{**metal((1, 0.77, 0.34), 1, 0.3), "name": "gold"}])
    assert albedo(path) == pytest.approx([1, 0.77, 0.34])
    assert "Metal is taken as diffuse, of its base colour: 'gold'." in str(load(path))


def test_what_is_said_instead_comes_first(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [textured()], [flat(188, 188, 188)])
    assert albedo(path, albedo=0.3) == pytest.approx([0.3])
    assert albedo(path, material="ggx:0.3,0.04") == [0]
    assert albedo(path, material="ggx:0.3,0.04", albedo="file") == pytest.approx([LINEAR_188] * 3, rel=1e-5)
    assert albedo(path, material=Material(0.2)) == pytest.approx([0.2])


# Gloss


def test_a_metal_is_ggx_of_its_colour(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [metal((1, 0.8, 0.4), 1, 0.5)])
    (thing,) = load(path, material="file").objects
    # The width of GGX is the square of the roughness of glTF.
    assert [brdf.spec for brdf in thing.material.glosses] == ["ggx:0.25"]
    assert thing.specular[0].tolist() == pytest.approx([1, 0.8, 0.4], rel=1e-5)
    assert thing.albedo[0].tolist() == pytest.approx([0, 0, 0], abs=1e-6)


def test_a_dielectric_keeps_of_its_body_what_the_gloss_lets_through(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [metal((0.8, 0.4, 0.2), 0, 0.5)])
    (thing,) = load(path, material="file").objects
    (brdf,) = thing.material.glosses
    assert brdf.spec == "ggx:0.25,0.04"
    through = 1 - reflected(brdf).mean
    assert 0.9 < through < 0.97
    assert thing.albedo[0].tolist() == pytest.approx([0.8 * through, 0.4 * through, 0.2 * through], rel=1e-4)


def test_between_dielectric_and_metal_reflectance_is_mixed(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [metal((0.8, 0.4, 0.2), 0.25, 1)])
    (thing,) = load(path, material="file").objects
    (brdf,) = thing.material.glosses
    # .75 * .04 + .25 * base
    assert (thing.specular[0] * brdf.f0).tolist() == pytest.approx([0.23, 0.13, 0.08], rel=1e-4)


@pytest.mark.parametrize(
    ("extension", "wanted"),
    [
        ({"KHR_materials_ior": {"ior": 2.0}}, [1 / 9] * 3),
        ({"KHR_materials_specular": {"specularFactor": 0.5}}, [0.02] * 3),
        ({"KHR_materials_specular": {"specularColorFactor": [1, 0.5, 30]}}, [0.04, 0.02, 1]),
    ],
)
def test_reflectance_along_the_normal_may_be_said_otherwise(tmp_path, extension, wanted):
    path = save_sheet(tmp_path / "a.glb", [{**metal((0, 0, 0), 0, 0.5), "extensions": extension}])
    (thing,) = load(path, material="file").objects
    (brdf,) = thing.material.glosses
    assert (thing.specular[0] * brdf.f0).tolist() == pytest.approx(wanted, rel=1e-4)


def test_metal_and_roughness_are_blue_and_green_and_linear(tmp_path):
    core = {"baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicRoughnessTexture": {"index": 0}, "roughnessFactor": 0.5}
    path = save_sheet(tmp_path / "a.glb", [{"pbrMetallicRoughness": core}], [flat(0, 204, 255)])
    (thing,) = load(path, material="file").objects
    assert [brdf.spec for brdf in thing.material.glosses] == ["ggx:0.16,0.5"]
    assert thing.albedo.abs().max() < 1e-6


def test_many_roughnesses_become_few_and_that_is_said(tmp_path):
    _, _, uv = sheet(12)
    ramp = np.zeros((256, 256, 3), np.uint8)
    ramp[..., 1] = np.arange(256)
    core = {"metallicRoughnessTexture": {"index": 0}, "baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicFactor": 0}
    clamp = [{"wrapS": 33071, "wrapT": 33071}]
    path = save_sheet(tmp_path / "a.glb", [{"pbrMetallicRoughness": core}], [png(ramp)], clamp, squares=12)
    scene = load(path, material="file")
    (thing,) = scene.objects
    models = thing.material.glosses
    assert len(models) == 12
    width = torch.tensor([brdf.roughness for brdf in models])[thing.gloss_of_vertex]
    # Half of a twelfth, and what the uneven sheet adds.
    assert float((width.sqrt().numpy() - uv[:, 0]).__abs__().max()) < 0.12
    assert "12 kinds of GGX, roughness rounded by up to" in str(scene)
    geometry = scene.geometry()
    assert len(geometry.gloss) == 12
    assert torch.equal(geometry.gloss_of_glossy, thing.gloss_of_vertex)


def test_the_shininess_of_an_obj_is_a_width_and_counts_only_where_it_is_lit(tmp_path):
    text(
        tmp_path,
        "a.mtl",
        "newmtl a\nKd 0.5 0.5 0.5\nKs 0.2 0.2 0.2\nNs 30\nillum 2\nnewmtl b\nKd 1 1 1\nKs 1 1 1\nillum 1\n",
    )
    shiny = text(tmp_path, "a.obj", "mtllib a.mtl\n" + OBJ + "usemtl a\n" + QUAD)
    (thing,) = load(shiny, material="file").objects
    assert [brdf.spec for brdf in thing.material.glosses] == ["ggx:0.25,0.2"]
    dull = text(tmp_path, "b.obj", "mtllib a.mtl\n" + OBJ + "usemtl b\n" + QUAD)
    assert not load(dull, material="file").objects[0].glossy


def test_a_white_dielectric_gives_back_no_more_than_arrives(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [metal((1, 1, 1), 0, 0.3)])
    (thing,) = load(path, material="file").objects
    (brdf,) = thing.material.glosses
    assert float(thing.albedo.max()) + reflected(brdf).mean == pytest.approx(1, abs=1e-5)
    assert "Toward grazing views it is brighter" in str(load(path, material="file"))


def test_gloss_lies_only_where_the_file_has_it(tmp_path):
    positions, faces, _ = sheet(1)
    unlit = {**metal((1, 0, 0), 0, 1), "extensions": {"KHR_materials_unlit": {}}}
    file: Gltf = gltf([unlit, metal((1, 1, 1), 1, 0.5)])
    primitives = [file.primitive(faces.astype(np.uint32).ravel(), POSITION=positions + shift) for shift in (0, 2.0)]
    file.tree["meshes"] = [{"primitives": [{**each, "material": n} for n, each in enumerate(primitives)]}]
    geometry = load(file.save(tmp_path / "a.glb"), material="file").geometry()
    assert geometry.glossy.tolist() == [4, 5, 6, 7]
    assert [brdf.spec for brdf in geometry.gloss] == ["ggx:0.25"]


def test_retired_specular_glossiness_keeps_its_colour(tmp_path):
    old = {"diffuseFactor": [0.5, 0.25, 1, 1], "specularFactor": [0.1, 0.1, 0.1], "glossinessFactor": 0.5}
    path = save_sheet(tmp_path / "a.glb", [{"extensions": {"KHR_materials_pbrSpecularGlossiness": old}}])
    assert albedo(path) == pytest.approx([0.5, 0.25, 1])
    assert [brdf.spec for brdf in load(path, material="file").objects[0].material.glosses] == ["ggx:0.25,0.1"]


def test_a_surface_says_what_it_holds(tmp_path):
    path = save_sheet(tmp_path / "a.glb", [{"name": "bare"}])
    surface = read_surface(path)
    assert [paint.name for paint in surface.used] == ["bare"]
    assert not surface.coloured
    assert surface.glossy
