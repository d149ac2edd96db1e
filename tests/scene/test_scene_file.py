"""Is a scene file the scene that it says, and are its faults named?"""

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.scene import Mesh, load, make_mesh, read_mesh, read_scene
from torchprt.sh import yaw_pitch_roll


@pytest.fixture
def folder(tmp_path):
    trimesh.creation.icosphere(1).export(tmp_path / "ball.ply")
    trimesh.creation.box().export(tmp_path / "box.ply")
    (tmp_path / "leaf.toml").write_text("albedo = 0.3\ntranslucency = 0.2\n")
    return tmp_path


def written(folder, text):
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


# Misuse

OBJECT = '[[object]]\nmesh = "ball.ply"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["no objects", "[[object]]"]),
        ("object = 3", ["no objects"]),
        ("object = []", ["no objects"]),
        ("objects = []", ["unknown key 'objects'"]),
        ("[object]\nmesh = 'ball.ply'", ["no objects"]),
        ("[[object]]\nalbedo = 0.5", ["without a mesh"]),
        ("[[object]]\nmesh = 3", ["without a mesh"]),
        ('[[object]]\nmesh = "none.ply"', ["none.ply does not exist"]),
        (OBJECT + "colour = 3", ["unknown key 'colour'", "[[object]]"]),
        (OBJECT + 'role = "mirror"', ["role = 'mirror'"]),
        (OBJECT + 'role = "blocker"', ["only blockers"]),
        (OBJECT + "scale = 0", ["scale = 0"]),
        (OBJECT + "scale = true", ["scale = True"]),
        (OBJECT + "scale = inf", ["scale = inf"]),
        (OBJECT + "scale = [1, 1, 2]", ["scale = [1, 1, 2]"]),
        (OBJECT + "rotate = 90", ["rotate = 90", "three numbers"]),
        (OBJECT + "rotate = [90, 0]", ["three numbers"]),
        (OBJECT + 'move = [0, 0, "1"]', ["move = '1'"]),
        (OBJECT + "move = [0, 0, nan]", ["finite"]),
        (OBJECT + "albedo = 2", ["[0, 1]"]),
        (OBJECT + 'albedo = "vertex"', ["ball.ply has no vertex colours"]),
        (OBJECT + "two_sided = 1", ["two_sided = 1"]),
        (OBJECT + "material = 3", ["material = 3"]),
        (OBJECT + 'material = "glass"', ["'glass'"]),
        (OBJECT + 'material = "none.toml"', ["none.toml does not exist"]),
        (OBJECT + 'material = "ggx:0.3"\ngloss = "phong:4"', ["both material and gloss"]),
        (OBJECT + "ground = 3", ["unknown key 'ground'"]),
        ("ground = 3\n" + OBJECT, ["ground = 3", "[ground]"]),
        (OBJECT + "[ground]\ndepth = 3", ["unknown key 'depth'", "[ground]"]),
        (OBJECT + "[ground]\nheight = '0'", ["height = '0'"]),
        (OBJECT + "[ground]\nheight = 5", ["height of the ground is 5"]),
        (OBJECT + "[ground]\nalbedo = [1, 2]", ["albedo of 2 numbers"]),
        (OBJECT + "[ground]\nalbedo = 7", ["[0, 1]"]),
        ("[[object", ["not a .toml file"]),
    ],
)
def test_refuses_what_is_no_scene_and_names_the_file(folder, text, words):
    path = written(folder, text)
    with pytest.raises(InputError) as fault:
        read_scene(path)
    assert str(fault.value).startswith(str(folder))
    for word in words:
        assert word in str(fault.value)


def test_refuses_a_scene_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load(tmp_path / "none.toml")


@pytest.mark.parametrize("more", [{"albedo": 0.3}, {"two_sided": True}, {"material": "ggx:0.3"}])
def test_refuses_a_material_for_a_scene_that_has_its_own(folder, more):
    with pytest.raises(InputError, match=r"scene.toml is a scene"):
        load(written(folder, OBJECT), **more)


def test_refuses_a_mesh_beside_a_scene(folder):
    with pytest.raises(InputError, match=r"scene.toml is a scene"):
        load([folder / "ball.ply", written(folder, OBJECT)])


# What it says


def test_objects_come_in_their_order_with_their_materials_and_roles(folder):
    scene = load(
        written(
            folder,
            """
            [[object]]
            mesh = "box.ply"
            material = "ggx:0.3,0.04"
            albedo = [0.5, 0.2, 0.1]
            specular = 0.5

            [[object]]
            mesh = "ball.ply"
            material = "leaf.toml"
            albedo = 0.6

            [[object]]
            mesh = "ball.ply"
            role = "blocker"

            [[object]]
            mesh = "box.ply"
            two_sided = true
            gloss = { model = "ggx", roughness = 0.5 }
            """,
        )
    )
    assert [each.role for each in scene.objects] == ["receiver", "receiver", "blocker", "receiver"]
    first, leaf, _, last = (each.material for each in scene.objects)
    assert first.brdf.spec == "ggx:0.3,0.04"
    assert first.specular == 0.5
    assert first.albedo == [0.5, 0.2, 0.1]
    assert (leaf.albedo, leaf.translucency, leaf.two_sided) == (0.6, 0.2, True)
    assert last.two_sided
    assert last.brdf.roughness == 0.5
    assert torch.equal(scene.objects[1].mesh.positions, read_mesh(folder / "ball.ply").positions)


def test_blockers_can_be_added(folder):
    scene = load(written(folder, OBJECT), blockers=[folder / "box.ply"])
    assert [each.role for each in scene.objects] == ["receiver", "blocker"]


def test_things_are_scaled_then_turned_then_moved(folder):
    scene = read_scene(written(folder, OBJECT + "scale = 2\nrotate = [90, 20, -30]\nmove = [1, 2, 3]"))
    plain, placed = read_mesh(folder / "ball.ply"), scene.objects[0].mesh
    turn = yaw_pitch_roll(torch.tensor([90.0, 20.0, -30.0]).double())
    wanted = torch.stack([turn @ (2 * point) for point in plain.positions]) + torch.tensor([1.0, 2, 3]).double()
    assert torch.allclose(placed.positions, wanted, atol=1e-12)
    assert torch.allclose(placed.normals, plain.normals @ turn.T, atol=1e-12)
    assert torch.equal(placed.faces, plain.faces)
    assert placed.report.extent == pytest.approx(np.ptp(wanted.numpy(), axis=0))
    # As if it had been written there.
    again = make_mesh(placed.positions, placed.faces)
    assert isinstance(placed, Mesh)
    assert (again.normals * placed.normals).sum(-1).min() > 0.99


def test_tangents_turn_with_the_mesh(folder):
    lines = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "vt 0 0", "vt 1 0", "vt 0 1", "f 1/1 2/2 3/3"]
    (folder / "flat.obj").write_text("\n".join(lines) + "\n")
    scene = read_scene(written(folder, '[[object]]\nmesh = "flat.obj"\nrotate = [90, 0, 0]'))
    assert torch.allclose(scene.objects[0].mesh.tangents, torch.tensor([0.0, 0, -1]).double().expand(3, 3), atol=1e-12)


def test_a_ground_lies_below_all_receivers(folder):
    scene = read_scene(written(folder, OBJECT + "move = [0, -7, 0]\n[ground]\nalbedo = 0.25"))
    assert scene.objects[1].role == "ground"
    assert float(scene.objects[1].albedo[0]) == 0.25
    assert float(scene.objects[1].mesh.positions[0, 1]) == pytest.approx(-8, abs=1e-3)
