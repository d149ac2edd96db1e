"""Does Embree see the lamps that are there, and what is in front of them?"""

import pytest
import torch
from trimesh.creation import box, icosphere

from torchprt.errors import InputError
from torchprt.light import Emitter, MeshEmitter, RectangleEmitter, SphereEmitter, capture, incident
from torchprt.scene import make_mesh
from torchprt.transport import lamps_seen

F64 = torch.float64
POINTS = torch.tensor([[0.0, 0, 0], [0.4, -0.2, 0.1]], dtype=F64)
CENTRE = torch.tensor([0.2, 0.1, 2.0], dtype=F64)
SPHERE = SphereEmitter(CENTRE, 0.4, (1.0, 2.0, 3.0))
RECTANGLE = RectangleEmitter(CENTRE, torch.tensor([0.5, 0, 0], dtype=F64), torch.tensor([0, -0.7, 0], dtype=F64), 1.0)


def mesh(made, move=(0.0, 0.0, 0.0)):
    return make_mesh(torch.tensor(made.vertices, dtype=F64) + torch.tensor(move, dtype=F64), torch.tensor(made.faces))


def wall(at):
    return mesh(box((40.0, 40.0, 0.1)), (0.0, 0.0, at))


def relative(found, wanted):
    return float((found - wanted).norm() / wanted.norm())


def test_refuses_lamps_that_it_cannot_trace():
    class Glow(Emitter):
        light = clearance = None

    with pytest.raises(InputError, match="there is no lamp"):
        lamps_seen([])
    Glow.__abstractmethods__ = frozenset()
    with pytest.raises(InputError, match="a lamp of class Glow cannot be traced"):
        lamps_seen([Glow()])


def test_refuses_points_in_lamps_and_in_blockers():
    with pytest.raises(InputError, match="sphere lamp contains or touches sample point 0"):
        capture(CENTRE[None], 3, lamps_seen([SPHERE]), size=4)
    with pytest.raises(InputError, match=r"sample point 1 at \(0\.4, -0\.2, 0\.1\) is inside a blocker"):
        capture(POINTS, 3, lamps_seen([SPHERE], [mesh(box((0.2, 0.2, 0.2)), (0.4, -0.2, 0.1))]), size=4)


@pytest.mark.parametrize("lamps", [[SPHERE], [RECTANGLE]], ids=["sphere", "rectangle"])
def test_with_nothing_in_the_way_it_is_the_closed_form(lamps):
    # What is left is the edge of the lamp, half a texel where it runs along them: of sides of 40 texels about 2 %.
    assert relative(capture(POINTS, 4, lamps_seen(lamps), size=128), incident(lamps, POINTS, 4)) <= 0.02


def test_a_ball_of_triangles_shines_as_the_sphere():
    made = icosphere(subdivisions=4, radius=0.4)
    ball = MeshEmitter(torch.tensor(made.vertices, dtype=F64) + CENTRE, torch.tensor(made.faces), SPHERE.radiance)
    assert (
        relative(capture(POINTS, 4, lamps_seen([ball]), size=64), capture(POINTS, 4, lamps_seen([SPHERE]), size=64))
        <= 0.01
    )


def test_a_wall_in_front_takes_all_and_one_behind_nothing():
    plain = capture(POINTS, 3, lamps_seen([SPHERE, RECTANGLE]), size=16)
    assert torch.equal(capture(POINTS, 3, lamps_seen([SPHERE, RECTANGLE], [wall(3.0)]), size=16), plain)
    assert not capture(POINTS, 3, lamps_seen([SPHERE, RECTANGLE], [wall(1.0)]), size=16).any()


def test_the_nearer_lamp_hides_the_other():
    near = SphereEmitter(CENTRE / 2, 0.3, 5.0)
    both, alone = (capture(POINTS[:1], 3, lamps_seen(lamps), size=16) for lamps in ([SPHERE, near], [near]))
    torch.testing.assert_close(both, alone)
    across = capture(POINTS[:1], 3, lamps_seen([RECTANGLE, near]), size=16)
    assert relative(across, alone) < relative(capture(POINTS[:1], 3, lamps_seen([RECTANGLE]), size=16) + alone, alone)


def test_the_back_of_a_lamp_is_black_unless_it_has_two_sides():
    turned = [RectangleEmitter(CENTRE, RECTANGLE.right, -RECTANGLE.up, 1.0, both) for both in (False, True)]
    dark, lit = (capture(POINTS, 3, lamps_seen([lamp]), size=16) for lamp in turned)
    assert not dark.any()
    torch.testing.assert_close(lit, capture(POINTS, 3, lamps_seen([RECTANGLE]), size=16))


def test_differences_are_near_to_the_exact_derivatives():
    found = capture(POINTS, 3, lamps_seen([SPHERE]), size=256, gradients=True, step=0.2).unflatten(0, (2, 4))
    wanted = incident([SPHERE], POINTS, 3, gradients=True).unflatten(0, (2, 4))
    # 0.5 % of the light from the edge, over a step that changes it by a fifth, and the curvature across the step.
    assert relative(found[:, 1:], wanted[:, 1:]) <= 0.05


def test_gradients_flow_to_the_radiance_of_lamps():
    colour = torch.tensor([0.2, 0.5, 1.0], dtype=F64, requires_grad=True)

    def light(colour):
        lamps = [SphereEmitter(CENTRE, 0.4, colour), RectangleEmitter(-CENTRE, RECTANGLE.right, RECTANGLE.up, colour)]
        return capture(POINTS, 2, lamps_seen(lamps, [wall(5.0)]), size=8)

    assert torch.autograd.gradcheck(light, (colour,), fast_mode=True)
