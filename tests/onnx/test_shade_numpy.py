"""Does what an engineer takes away run where torch cannot be imported, and give the same picture?"""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from transfers import random_glossy

from torchprt.light import SphereEmitter, local_light, with_sample_points
from torchprt.onnx import export
from torchprt.sh import basis, cube_directions, yaw_pitch_roll
from torchprt.shade import local_light_shader, shader, srgb

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "export" / "shade_numpy.py"


@pytest.fixture(scope="module")
def scene(make_transfer, tmp_path_factory):
    from jaxtyping import config

    config.update("jaxtyping_disable", True)
    folder, transfer = tmp_path_factory.mktemp("takeaway"), make_transfer(order=4)
    export(transfer, folder / "scene.onnx", check=False)
    export(transfer, folder / "cube.onnx", source="environment", size=8, check=False)
    glossy = random_glossy(order=3, output_order=2, materials=["phong:8"])
    export(glossy, folder / "glossy.onnx", check=False)
    export(glossy, folder / "walk.onnx", fix_light=torch.ones(9, 3), eye="direction", check=False)
    export(
        with_sample_points(make_transfer(order=3), 5, gradients=True), folder / "local.onnx", local=True, check=False
    )
    config.update("jaxtyping_disable", False)
    mesh = trimesh.Trimesh(transfer.positions.numpy(), transfer.faces.numpy(), process=False)
    mesh.visual.vertex_colors = np.full((25, 4), 7, np.uint8)
    mesh.export(folder / "binary.ply")
    mesh.export(folder / "ascii.ply", encoding="ascii")
    np.savez(folder / "mesh.npz", positions=transfer.positions.numpy(), faces=transfer.faces.numpy())
    # Python runs this before anything else: torch and the project are not there.
    (folder / "sitecustomize.py").write_text("import sys\nsys.modules['torch'] = sys.modules['torchprt'] = None\n")
    return folder, transfer


@pytest.fixture
def run(scene):
    def run(*arguments, code=0):
        environment = os.environ | {"PYTHONPATH": str(scene[0])}
        command = [sys.executable, str(SCRIPT), *map(str, arguments)]
        result = subprocess.run(command, cwd=scene[0], env=environment, capture_output=True, text=True)
        assert "Traceback" not in result.stderr
        assert (result.returncode != 0) == (code != 0), result.stderr
        return result.stdout + result.stderr

    return run


def test_a_lamp_nearby_is_as_in_torch(run, make_transfer):
    transfer = with_sample_points(make_transfer(order=3), 5, gradients=True)
    lamp = SphereEmitter((0.3, 1.5, 0.4), 0.3, (4.0, 3.0, 2.0))
    wanted = local_light_shader(shader(transfer), transfer)(local_light(transfer, [lamp])).mean(0)
    told = run("local.onnx", "--sky", 0, 0, 0, "--sun", 0, 0, 0, "--lamp", 0.3, 1.5, 0.4, 0.3, 4, 3, 2, "--repeat", 1)
    found = [float(word) for word in re.search(r"mean radiance (.*)", told).group(1).split()]
    assert np.allclose(found, wanted.numpy(), rtol=1e-4)


def test_a_lamp_for_a_model_of_one_light_is_refused(run):
    assert "leave out --lamp" in run("scene.onnx", "--lamp", 0, 2, 0, 1, 1, 1, 1, code=1)


def test_torch_is_really_out_of_reach(scene):
    environment = os.environ | {"PYTHONPATH": str(scene[0])}
    result = subprocess.run([sys.executable, "-c", "import torch"], env=environment, capture_output=True, text=True)
    assert "ModuleNotFoundError" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scene.onnx", "--mesh", "mesh.npz"], "--mesh and --output go together"),
        (["scene.onnx", "--direction", 0, 0, 0], "--direction must not be zero"),
        (["scene.onnx", "--input", "small.npy"], "takes a light of shape [16, 3], not [9, 3]"),
        (["scene.onnx", "--mesh", "scene.onnx", "--output", "x.ply"], "is not a PLY file"),
        (["scene.onnx", "--mesh", "cut.ply", "--output", "x.ply"], "cut.ply is cut short"),
        (["glossy.onnx"], "what the model shows depends on the eye: give --eye X Y Z"),
        (["scene.onnx", "--eye", 1, 2, 3], "this model shows the same to every eye: leave out --eye"),
        (["walk.onnx", "--eye", 1, 2, 3, "--input", "small.npy"], "the light of this model is fixed"),
        (["scene.onnx", "--mesh", "other.npz", "--output", "x.ply"], "has 4 vertices but the model shades 25"),
    ],
)
def test_says_what_is_wrong(scene, run, arguments, message):
    np.save(scene[0] / "small.npy", np.zeros((9, 3)))
    np.savez(scene[0] / "other.npz", positions=np.eye(4)[:, :3], faces=np.array([[0, 1, 2]]))
    (scene[0] / "cut.ply").write_bytes((scene[0] / "binary.ply").read_bytes()[:400])
    assert message in run(*arguments, code=1)
    assert not (scene[0] / "x.ply").exists()


@pytest.mark.parametrize("mesh", ["binary.ply", "ascii.ply", "mesh.npz"])
def test_colours_the_mesh_as_torchprt_does(scene, run, mesh):
    folder, transfer = scene
    arguments = ["--sky", 0.2, 0.3, 0.4, "--sun", 1.5, 1.0, 0.5, "--direction", 1, 2, -2, "--yaw", 70]
    text = run("scene.onnx", "--mesh", mesh, "--output", "out.ply", *arguments)
    assert "diffuse transfer, order 4, 25 vertices" in text
    assert "ms a light" in text
    light = torch.zeros(16, 3)
    light[0] = (4 * torch.pi) ** 0.5 * torch.tensor([0.2, 0.3, 0.4])
    light[:9] += basis(torch.tensor([1.0, 2.0, -2.0]) / 3, 3)[:, None] * torch.tensor([1.5, 1.0, 0.5])
    radiance = shader(transfer)(light, yaw_pitch_roll(torch.tensor([70.0, 0.0, 0.0])))
    wanted = 255 * srgb(radiance).numpy()
    written = trimesh.load(folder / "out.ply", process=False)
    # Half a step of rounding, and a hair for float32 at its edge.
    assert np.abs(written.visual.vertex_colors[:, :3] - wanted).max() <= 0.501
    assert np.allclose(written.vertices, transfer.positions)
    assert np.array_equal(written.faces, transfer.faces)
    assert wanted.min() < 50 < 200 < wanted.max()


def test_shades_cube_maps_and_given_lights(scene, run):
    folder, transfer = scene
    light = torch.randn(16, 3, generator=torch.Generator().manual_seed(0))
    np.save(folder / "light.npy", light.numpy())
    text = run("scene.onnx", "--input", "light.npy")
    found = np.array(text.splitlines()[-1].split()[2:], float)
    assert np.allclose(found, shader(transfer)(light).mean(0).numpy(), rtol=1e-4, atol=1e-5)
    assert "mean radiance" in run("cube.onnx")


def test_shows_glossy_surfaces_to_an_eye(scene, run):
    glossy = random_glossy(order=3, output_order=2)
    light = torch.randn(9, 3, generator=torch.Generator().manual_seed(0))
    np.save(scene[0] / "nine.npy", light.numpy())
    eye = torch.tensor([1.0, 2.0, 3.0])
    for arguments, radiance in (
        (["glossy.onnx", "--input", "nine.npy"], shader(glossy)(light, eye=eye)),
        (["walk.onnx"], shader(glossy)(torch.ones(9, 3), view=eye)),
    ):
        found = np.array(run(*arguments, "--eye", 1, 2, 3).splitlines()[-1].split()[2:], float)
        assert np.allclose(found, radiance.mean(0).numpy(), rtol=1e-4, atol=1e-4)


def test_the_snippet_for_glossy_surfaces_runs_as_it_stands(scene):
    snippet = re.search(r"^```python\n(.*?)^```", (ROOT / "docs" / "onnx.md").read_text(), re.MULTILINE | re.DOTALL)
    environment = os.environ | {"PYTHONPATH": str(scene[0])}
    command = [sys.executable, "-c", snippet[1]]
    result = subprocess.run(command, cwd=scene[0], env=environment, capture_output=True, text=True)
    assert result.stderr == ""
    assert result.stdout == "diffuse + exit ['phong:8'] (2, 7, 3)\n"


def test_its_functions_are_those_of_the_project():
    functions = runpy.run_path(str(SCRIPT))
    assert np.abs(functions["cube_directions"](5) - cube_directions(5).numpy()).max() <= 1e-15
    directions = cube_directions(3).reshape(-1, 3)
    assert np.abs(functions["sh_basis"](directions.numpy()) - basis(directions, 3).numpy()).max() <= 1e-15
    turn = yaw_pitch_roll(torch.tensor([33.0, 0.0, 0.0], dtype=torch.float64)).numpy()
    assert np.abs(functions["yaw_matrix"](33) - turn).max() <= 1e-15
    assert functions["sky_and_sun"](1, (1, 1, 1), (1, 1, 1), (0, 0, 1)).shape == (1, 3)
