"""Are lamps nearby words of the command, and do they light the side that they are on?"""

import numpy as np
import pytest
import trimesh

from torchprt.light import SphereEmitter, incident
from torchprt.onnx import describe
from torchprt.shade import shader, under_field
from torchprt.transfer import load

LAMP = "sphere:2.5,0,0,0.3,9,6,3"


@pytest.mark.parametrize(
    ("word", "fault"),
    [
        ("cube:1,2,3", "give sphere:X,Y,Z,RADIUS,R,G,B or rectangle:"),
        ("sphere:1,2,3", "give 7 numbers with commas between them"),
        ("sphere:1,2,nan,1,1,1,1", "the numbers must be finite"),
        ("sphere:1,2,3,-1,1,1,1", "radius of a sphere lamp"),
        ("sphere:1,2,3,1,1,-1,1", "radiance of a lamp"),
        ("rectangle:0,0,3,1,0,0,2,0,0,1,1,1", "have no area"),
        ("sphere:1,0,0,0.3,1,1,1", "contains or touches vertex"),
    ],
)
def test_refuses_what_is_no_lamp_or_touches(word, fault, refused, folder, tmp_path):
    refused(fault, arguments=["shade", folder / "ball.safetensors", "-o", tmp_path / "a.npy", "-q", "--emitter", word])


def test_gradients_without_points_are_refused(refused, folder, tmp_path):
    arguments = ["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--sample-gradients"]
    refused("--sample-gradients is given, but no points", arguments=arguments)


def test_background_of_lamps_alone_is_refused(refused, folder, tmp_path):
    arguments = ["render", folder / "ball.safetensors", "-o", tmp_path / "a.png", "--emitter", LAMP, "--background"]
    refused("there are lamps alone", arguments=arguments)


def test_local_export_without_points_is_refused(refused, folder, tmp_path):
    refused("no sample points", arguments=["export", folder / "ball.safetensors", "-o", tmp_path / "a.onnx", "--local"])


@pytest.mark.usefixtures("untyped")
def test_points_are_kept_with_the_bake_and_read(run, folder, tmp_path):
    path = tmp_path / "a.safetensors"
    arguments = ["bake", folder / "ball.ply", "-o", path, "--rays", 64, "--bounces", 0, "--order", 4]
    assert run(*arguments, "--sample-points", 12, "--sample-gradients").code == 0
    transfer = load(path)
    assert transfer.receivers.blend.shape == (transfer.vertices, 48)
    ended = run("shade", path, "-o", tmp_path / "a.npy", "--emitter", LAMP)
    assert ended.code == 0, ended.err
    assert "under 1 lamp" in ended.out + ended.err
    found = np.load(tmp_path / "a.npy")
    lamp = SphereEmitter((2.5, 0, 0), 0.3, (9.0, 6.0, 3.0))
    field = incident([lamp], transfer.positions.double(), transfer.order).float()
    wanted = under_field(shader(transfer), field).numpy()
    # The blend of 12 points, a radius and more from the lamp.
    assert np.sqrt(((found - wanted) ** 2).mean() / (wanted**2).mean()) <= 0.06
    ball = trimesh.load(folder / "ball.ply", process=False).vertices
    assert ball[found[:, 0].argmax(), 0] > 0.9
    assert run("export", path, "-o", tmp_path / "a.onnx", "--local").code == 0
    assert describe(tmp_path / "a.onnx")["inputs"]["light"] == ("B", 48, 16, 3)


def test_lamps_are_added_to_a_light_and_stand_still_when_it_turns(run, folder, tmp_path):
    def radiance(*words):
        arguments = ["shade", folder / "ball.safetensors", "-o", tmp_path / "a.npy", *words]
        ended = run(*arguments)
        assert ended.code == 0, ended.err
        return np.load(tmp_path / "a.npy")

    sky, lamp = radiance("--light", "sunset", "--rotate", 90), radiance("--emitter", LAMP)
    both = radiance("--light", "sunset", "--rotate", 90, "--emitter", LAMP)
    np.testing.assert_allclose(both, sky + lamp, rtol=0, atol=1e-4 * both.max())


def test_a_picture_is_under_the_lamp(run, folder, tmp_path):
    ended = run(
        *("render", folder / "ball.safetensors", "-o", tmp_path / "a.png", "--size", "60x40"),
        *("--emitter", LAMP, "--light", "white"),
    )
    assert ended.code == 0, ended.err
    assert "16 sample points with gradients made on the way" in ended.out + ended.err
    assert "under 1 lamp and white" in ended.out + ended.err
