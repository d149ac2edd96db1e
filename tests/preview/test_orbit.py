"""Does the camera go around as the drag says, and never where it cannot see?"""

import math

import pytest
import torch

from torchprt.errors import InputError
from torchprt.preview import Orbit, frame
from torchprt.preview.orbit import FARTHEST, NEAREST, STEEPEST, dragged

CUBE = torch.tensor([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
EPS = torch.finfo(torch.float64).eps


def seen(camera, points):
    """Where points stand on the picture plane: right, up, and their distance ahead."""
    forward, right, above = camera.axes()
    offset = points.double() - torch.tensor(camera.eye).double()
    depth = offset @ forward
    return offset @ right / depth, offset @ above / depth, depth


def test_refuses_a_model_without_vertices():
    with pytest.raises(InputError, match="no vertices"):
        Orbit.around(torch.zeros(0, 3))


@pytest.mark.parametrize("toward", [(0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (math.inf, 0.0, 1.0)])
def test_refuses_what_is_no_direction(toward):
    with pytest.raises(InputError, match="toward"):
        Orbit.around(CUBE, toward)


@pytest.mark.parametrize("toward", [(0.45, 0.35, 1.0), (-3.0, 0.1, -0.5), (1e-20, 2e-21, 3e-20)])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_the_first_camera_is_that_of_the_frame(toward, aspect):
    found, wanted = Orbit.around(CUBE, toward, aspect=aspect).camera(), frame(CUBE, toward, aspect=aspect)
    # Angles there and back: some tens of roundings of coordinates up to 10.
    torch.testing.assert_close(torch.tensor(found.eye), torch.tensor(wanted.eye), rtol=0, atol=1e-6)
    assert found.target == wanted.target
    assert found.field == wanted.field


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_straight_above_and_below_there_is_a_camera(up):
    camera = Orbit.around(CUBE, (0.0, up, 0.0)).camera()
    forward, right, above = camera.axes()
    assert float(forward[1]) * up < -0.999
    torch.testing.assert_close(torch.linalg.cross(right, above), -forward, rtol=0, atol=8 * EPS)


def test_from_all_sides_the_model_is_whole_in_the_picture():
    tall = CUBE * torch.tensor([1.0, 0.2, 4.0])
    orbit = Orbit.around(tall, (1.0, 0.3, 0.0), aspect=1.5, sides=8)
    reach = math.tan(math.radians(orbit.field) / 2)
    for side in range(8):
        x, y, depth = seen(orbit.turned(2 * math.pi * side / 8, 0.0).camera(), tall)
        assert float(depth.min()) > 0
        assert float(x.abs().max()) <= 1.5 * reach
        assert float(y.abs().max()) <= reach


def test_a_drag_to_the_right_takes_the_near_side_to_the_right_and_one_down_takes_it_down():
    orbit = Orbit.around(CUBE, (0.3, 0.2, 1.0))
    near = torch.tensor([orbit.camera().eye]).double() * 0.2
    x, y, _ = seen(orbit.turned(0.1, 0.0).camera(), near)
    assert float(x) > 0.01
    x, y, _ = seen(orbit.turned(0.0, 0.1).camera(), near)
    assert float(y) < -0.01


def test_the_camera_stops_before_it_stands_on_its_head():
    orbit = Orbit.around(CUBE)
    assert orbit.turned(0.0, 10.0).pitch == STEEPEST
    assert orbit.turned(0.0, -10.0).pitch == -STEEPEST
    orbit.turned(0.0, 10.0).camera().directions(2, 2)


def test_a_thousand_turns_stay_in_range():
    orbit = Orbit.around(CUBE)
    for _ in range(1000):
        orbit = orbit.turned(1.234, 0.0)
    assert abs(orbit.yaw) <= math.pi
    # Each turn rounds an angle below 2 pi.
    assert math.remainder(orbit.yaw - Orbit.around(CUBE).yaw + 1234.0, 2 * math.pi) == pytest.approx(0, abs=2000 * EPS)


def test_the_wheel_stops_at_the_nearest_and_the_farthest():
    orbit = Orbit.around(CUBE)
    assert orbit.zoomed(1).distance < orbit.distance < orbit.zoomed(-1).distance
    assert orbit.zoomed(1e3).distance == NEAREST * orbit.first
    assert orbit.zoomed(-1e3).distance == FARTHEST * orbit.first
    assert orbit.zoomed(3).zoomed(-3).distance == pytest.approx(orbit.distance, rel=8 * EPS)


# The light


def test_the_light_is_dragged_as_the_camera_sees_it():
    camera = Orbit.around(CUBE, (1.0, 0.0, 0.0)).camera()
    near = torch.tensor([1.0, 0.0, 0.0])
    # From +x the right of the picture is -z.
    turned = dragged(torch.eye(3), camera, 0.3, 0.0) @ near
    torch.testing.assert_close(turned, torch.tensor([math.cos(0.3), 0.0, -math.sin(0.3)]), rtol=0, atol=1e-6)
    turned = dragged(torch.eye(3), camera, 0.0, 0.3) @ near
    torch.testing.assert_close(turned, torch.tensor([math.cos(0.3), -math.sin(0.3), 0.0]), rtol=0, atol=1e-6)


def test_two_thousand_drags_leave_a_rotation():
    camera, rotation = Orbit.around(CUBE).camera(), torch.eye(3)
    for step in range(2000):
        rotation = dragged(rotation, camera, 0.03, 0.01 * (step % 3))
    # Made orthogonal each time: one rounding to float32.
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3), rtol=0, atol=8 * torch.finfo(torch.float32).eps)
    assert float(torch.linalg.det(rotation)) > 0
