"""Does the command shade and export surfaces that deform in the pose it is given?"""

import math

import numpy as np
import onnx
import pytest
import torch
import trimesh
from PIL import Image

from torchprt import sh
from torchprt.light import disc, write_coefficients
from torchprt.scene import read_mesh
from torchprt.sh import clamped_cosine, yaw_pitch_roll
from torchprt.transfer import Diffuse, Transfer, Vertices, Zonal, save

ORDER = 3
TURN = yaw_pitch_roll(torch.tensor([30.0, 50.0, -20.0], dtype=torch.float64))


def lobes_of(mesh, two_sided=False):
    """Unshadowed transfer of a mesh in one lobe about each normal: exact in every pose."""
    sides = [1, -1] if two_sided else [1]
    normals = torch.cat([side * mesh.normals for side in sides]).float()
    count = len(normals)
    start = len(mesh.positions)
    signal = Zonal(
        axis=normals.T[None, None].contiguous(),
        coefficients=(clamped_cosine(ORDER) / math.pi).float()[None, None, None, :, None].repeat(1, 1, 1, 1, count),
        exact=torch.zeros(1, 1, 0, count),
        squared_error=torch.zeros(count),
        fit_error=0.0,
    )
    vertices = Vertices(
        positions=torch.cat([mesh.positions for _ in sides]).float(),
        normals=normals,
        faces=torch.cat([mesh.faces, mesh.faces.flip(1) + start]) if two_sided else mesh.faces,
    )
    return Transfer(receivers=vertices, layers={"diffuse": Diffuse(albedo=torch.full((1, 1), 0.5), signal=signal)})


@pytest.fixture(scope="session")
def poses(tmp_path_factory):
    """A ball, its lobes, the ball turned, and what does not belong to it."""
    made = tmp_path_factory.mktemp("poses")
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.export(made / "ball.ply")
    for name, vertices in (("turned", ball.vertices @ TURN.numpy().T + 2.0), ("flat", ball.vertices * [1, 1, 0])):
        trimesh.Trimesh(vertices, ball.faces, process=False).export(made / f"{name}.ply")
    trimesh.creation.icosphere(subdivisions=1).export(made / "coarse.ply")
    trimesh.Trimesh(ball.vertices, np.roll(ball.faces, 1, 0), process=False).export(made / "other.ply")
    mesh = read_mesh(made / "ball.ply")
    save(lobes_of(mesh), made / "lobes.safetensors")
    save(lobes_of(mesh, two_sided=True), made / "leaf.safetensors")
    write_coefficients(disc((1.0, 0.2, 0.0), 0.5, 1.0, ORDER).float(), made / "light.npy")
    return made


@pytest.fixture
def shaded(done, poses, tmp_path):
    """Radiance that `shade` writes, and what it said."""

    def shaded(bake, *options):
        said = done("shade", poses / bake, "--light", poses / "light.npy", "-o", tmp_path / "a.npy", *options)
        return torch.from_numpy(np.load(tmp_path / "a.npy")), said

    return shaded


def test_refuses_a_pose_of_a_bake_that_cannot_deform(refused, folder, poses, tmp_path):
    arguments = ["--light", folder / "lamp.exr", "-o", tmp_path / "a.npy", "--pose", poses / "turned.ply"]
    refused(
        "--pose", "'diffuse' has one pose", "torchprt fit", arguments=["shade", folder / "ball.safetensors", *arguments]
    )


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        ("coarse.ply", ["coarse.ply has 42 vertices but the bake 162"]),
        ("other.ply", ["other.ply has other faces than the bake"]),
        ("none.ply", ["none.ply does not exist"]),
        ("light.npy", ["light.npy is an array, not a mesh"]),
    ],
)
def test_refuses_a_mesh_that_is_not_the_baked_one(refused, poses, tmp_path, mesh, words):
    arguments = ["--light", poses / "light.npy", "-o", tmp_path / "a.npy", "--pose", poses / mesh]
    refused(*words, arguments=["shade", poses / "lobes.safetensors", *arguments])


def test_the_rest_pose_is_the_pose_that_was_baked(shaded, poses):
    rest, _ = shaded("lobes.safetensors")
    posed, _ = shaded("lobes.safetensors", "--pose", poses / "ball.ply")
    # Frames are estimated to some roundings of the edges.
    assert (posed - rest).abs().max() <= 1e-5 * rest.abs().max()


def test_a_turned_ball_is_lit_from_where_the_light_is(shaded, poses):
    posed, _ = shaded("lobes.safetensors", "--pose", poses / "turned.ply")
    normals = read_mesh(poses / "ball.ply").normals @ TURN.T
    light = torch.from_numpy(np.load(poses / "light.npy")).double()
    wanted = 0.5 * sh.zonal(clamped_cosine(ORDER) / math.pi, normals) @ light
    assert (posed - wanted).abs().max() <= 1e-5 * wanted.abs().max()


def test_reverse_sides_go_with_the_first_ones(shaded, poses):
    posed, _ = shaded("leaf.safetensors", "--pose", poses / "turned.ply")
    assert posed.shape == (324, 3)
    normals = read_mesh(poses / "ball.ply").normals @ TURN.T
    light = torch.from_numpy(np.load(poses / "light.npy")).double()
    wanted = 0.5 * sh.zonal(clamped_cosine(ORDER) / math.pi, torch.cat([normals, -normals])) @ light
    assert (posed - wanted).abs().max() <= 1e-5 * wanted.abs().max()


def test_collapsed_faces_are_told(shaded, poses, tmp_path):
    ball = trimesh.load(poses / "ball.ply", process=False)
    # One vertex onto its neighbour: the two faces at that edge have no area left.
    vertices = np.array(ball.vertices)
    vertices[ball.faces[0][0]] = vertices[ball.faces[0][1]]
    trimesh.Trimesh(vertices, ball.faces, process=False).export(tmp_path / "pinched.ply")
    posed, said = shaded("lobes.safetensors", "--pose", tmp_path / "pinched.ply")
    assert posed.isfinite().all()
    assert "pinched.ply: 2 faces collapsed" in said


def test_the_picture_and_the_mesh_show_the_pose(done, poses, tmp_path):
    common = ["shade", poses / "lobes.safetensors", "--light", poses / "light.npy", "--size", "80x60"]
    done(*common, "-o", tmp_path / "a.png", "--pose", poses / "flat.ply")
    flat = np.asarray(Image.open(tmp_path / "a.png"))
    done(*common, "-o", tmp_path / "a.png")
    assert (flat != np.asarray(Image.open(tmp_path / "a.png"))).any()
    done(*common, "-o", tmp_path / "a.ply", "--pose", poses / "turned.ply")
    found = trimesh.load(tmp_path / "a.ply", process=False)
    assert np.allclose(found.vertices, read_mesh(poses / "turned.ply").positions.numpy(), atol=1e-6)


def test_info_tells_of_lobes(done, poses):
    said = done("info", poses / "lobes.safetensors")
    assert "zonal diffuse, shadowed, order 3, 1 channel, 162 vertices" in said
    assert "diffuse: 1 lobe a vertex, fit error 0.00% (relative RMS)" in said


@pytest.mark.parametrize("pose", ["frames", "positions"])
def test_an_exported_graph_takes_the_pose(untyped, done, poses, tmp_path, pose):
    said = done("export", poses / "lobes.safetensors", "-o", tmp_path / "a.onnx", "--pose", pose)
    assert "same: relative RMS" in said
    assert [value.name for value in onnx.load(tmp_path / "a.onnx").graph.input] == ["light", "rotation", pose]


def test_refuses_an_export_with_a_pose_that_makes_no_sense(refused, folder, poses, tmp_path):
    output = ["-o", tmp_path / "a.onnx"]
    refused("--pose is 'bones'", arguments=["export", poses / "lobes.safetensors", *output, "--pose", "bones"])
    refused("does not deform", arguments=["export", folder / "ball.safetensors", *output, "--pose", "frames"])
