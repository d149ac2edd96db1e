"""Does the camera look where it is told, and does a frame hold the whole model?"""

import math

import pytest
import torch

from torchprt.errors import InputError
from torchprt.preview import Camera, frame

EPSILON = torch.finfo(torch.float64).eps


def seen_at(camera, points, aspect):
    """Where points stand in the picture, [-1, 1] to the right and up, and how far ahead: by a matrix of its own."""
    eye, target, up = (torch.tensor(v, dtype=torch.float64) for v in (camera.eye, camera.target, camera.up))
    back = (eye - target) / (eye - target).norm()
    right = torch.linalg.cross(up, back)
    right = right / right.norm()
    axes = torch.stack([right, torch.linalg.cross(back, right), -back])
    x, y, ahead = (axes @ (points.double() - eye).T).unbind(0)
    reach = math.tan(math.radians(camera.field) / 2)
    return x / ahead / reach / aspect, y / ahead / reach, ahead


@pytest.mark.parametrize("size", [(0, 5), (5, 0), (-1, 5)])
def test_refuses_a_picture_without_pixels(size):
    with pytest.raises(InputError, match=f"size {size[0]}x{size[1]}"):
        Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)).directions(*size)


@pytest.mark.parametrize("eye", [(0.0, 5.0, 0.0), (0.0, -5.0, 0.0), (0.0, 0.0, 0.0)])
def test_refuses_to_look_along_its_own_up(eye):
    with pytest.raises(InputError, match="up vector"):
        Camera(eye, (0.0, 0.0, 0.0)).directions(4, 4)


def test_the_middle_of_the_picture_is_the_target():
    camera = Camera((3.0, -2.0, 7.0), (0.5, 1.0, -1.0), field=50.0)
    middle = camera.directions(31, 17)[8, 15]
    toward = torch.tensor(camera.target, dtype=torch.float64) - torch.tensor(camera.eye, dtype=torch.float64)
    # Both are unit vectors made in a few roundings.
    torch.testing.assert_close(middle, toward / toward.norm(), atol=4 * EPSILON, rtol=0)


def test_up_is_up_and_right_is_right():
    rays = Camera((0.0, 0.0, 9.0), (0.0, 0.0, 0.0)).directions(8, 6)
    assert (rays[0, :, 1] > 0).all()
    assert (rays[-1, :, 1] < 0).all()
    assert (rays[:, -1, 0] > 0).all()
    assert (rays[:, 0, 0] < 0).all()
    assert rays.shape == (6, 8, 3)


def test_the_field_is_the_whole_vertical_angle_and_pixels_are_square():
    rays = Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), field=90.0).directions(40, 20)
    # From the middle of the first row to that of the last; at 90 degrees the picture's half height is 1.
    steps = rays[1:, 0] - rays[:-1, 0]
    torch.testing.assert_close(steps[:, 1], torch.full((19,), -0.1, dtype=torch.float64), atol=8 * EPSILON, rtol=0)
    torch.testing.assert_close(rays[0, 1:, 0] - rays[0, :-1, 0], -steps[:1, 1].expand(39), atol=8 * EPSILON, rtol=0)
    assert float(rays[0, 0, 1]) == pytest.approx(0.95, abs=8 * EPSILON)


def test_another_up_turns_the_picture():
    usual = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0)).directions(5, 5)
    turned = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), up=(1.0, 0.0, 0.0)).directions(5, 5)
    # The column that was on the right is the row on top.
    torch.testing.assert_close(turned[0].flip(0), usual[:, -1].flip(0), atol=4 * EPSILON, rtol=0)


def test_refuses_to_frame_nothing():
    with pytest.raises(InputError, match="no vertices"):
        frame(torch.zeros(0, 3))


@pytest.mark.parametrize("toward", [(0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (math.inf, 0.0, 0.0)])
def test_refuses_no_direction(toward):
    with pytest.raises(InputError, match="toward"):
        frame(torch.rand(5, 3), toward)


@pytest.mark.parametrize("options", [{"aspect": 0.0}, {"aspect": math.nan}, {"field": 180.0}, {"field": 0.0}])
def test_refuses_a_frame_without_a_picture(options):
    with pytest.raises(InputError, match=next(iter(options))):
        frame(torch.rand(5, 3), **options)


@pytest.mark.parametrize("aspect", [0.2, 0.75, 1.0, 4 / 3, 6.0])
@pytest.mark.parametrize("toward", [(0.45, 0.35, 1.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -3.0, 0.0)])
def test_a_frame_holds_every_vertex_and_wastes_little(aspect, toward):
    generator = torch.Generator().manual_seed(7)
    for number in range(20):
        stretch = torch.rand(3, generator=generator, dtype=torch.float64) ** 3 + 1e-3
        centre = torch.randn(3, generator=generator, dtype=torch.float64)
        points = (torch.randn(40, 3, generator=generator, dtype=torch.float64) * stretch + centre) * 10.0 ** (
            number - 10
        )
        x, y, ahead = seen_at(frame(points, toward, aspect=aspect), points, aspect)
        assert (ahead > 0).all()
        reach = float(torch.maximum(x.abs(), y.abs()).max())
        # The margin is 6 %; a model that is long toward the eye is seen from further off.
        assert 0.05 < reach <= 0.94 + 1e-9
    assert frame(points, toward, aspect=aspect, field=20.0).field == 20.0


def test_a_ball_on_the_bounding_sphere_is_not_cropped():
    """Vertices all around at the same distance: the case that a bounding box alone does not hold."""
    points = torch.nn.functional.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    x, y, _ = seen_at(frame(points, aspect=1.0), points, 1.0)
    assert 0.85 < float(torch.maximum(x.abs(), y.abs()).max()) < 1


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (3.0, 4.0, 5.0)])
def test_one_point_is_looked_at_from_some_distance(point):
    camera = frame(torch.tensor([point]))
    assert math.dist(camera.eye, camera.target) == pytest.approx(1.0)
    assert camera.target == point


def test_straight_from_above_minus_z_is_up_in_the_picture():
    points = torch.tensor([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 1.0]])
    x, y, _ = seen_at(frame(points, (0.0, 1.0, 0.0)), points, 4 / 3)
    assert int(y.argmax()) == 0
    assert int(x.argmax()) == 1


# Where it is told to stand


@pytest.mark.parametrize("distance", [0.0, -1.0, math.inf, math.nan])
def test_refuses_to_stand_nowhere(distance):
    with pytest.raises(InputError, match=f"distance is {distance}"):
        frame(torch.rand(5, 3), distance=distance)


def test_refuses_to_look_at_no_point():
    with pytest.raises(InputError, match="target is"):
        frame(torch.rand(5, 3), target=(0.0, math.nan, 0.0))


def test_it_looks_at_its_target_from_its_distance():
    camera = frame(torch.rand(5, 3), (0.0, 3.0, 4.0), target=(1.0, 2.0, 3.0), distance=10.0, field=20.0)
    assert camera.target == (1.0, 2.0, 3.0)
    assert camera.eye == pytest.approx((1.0, 8.0, 11.0))
    assert camera.field == 20.0


@pytest.mark.parametrize("target", [(0.0, 0.0, 0.0), (2.0, -1.0, 0.5)])
def test_a_target_beside_the_model_still_leaves_all_of_it_in_the_picture(target):
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    camera = frame(points, target=target, aspect=1.5, field=50.0)
    x, y, ahead = seen_at(camera, points, 1.5)
    assert bool((ahead > 0).all())
    assert float(torch.maximum(x.abs(), y.abs()).max()) <= 1
