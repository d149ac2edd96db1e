"""Do the deformations and the rig move vertices as they say?"""

import math

import pytest
import torch

from torchprt.errors import InputError
from torchprt.scene import Rig, bend, twist

EPS = torch.finfo(torch.float64).eps


def column(count=41):
    """Points on the y axis from -1 to 3, and beside it."""
    y = torch.linspace(-1, 3, count, dtype=torch.float64)
    zero = torch.zeros_like(y)
    axis = torch.stack([zero, y, zero], -1)
    return torch.cat([axis, axis + torch.tensor([0.3, 0.0, 0.0]), axis + torch.tensor([0.0, 0.0, 0.3])])


@pytest.mark.parametrize("deform", [bend, twist])
def test_refuses_heights_in_the_wrong_order(deform):
    for low, high in ((1.0, 1.0), (2.0, 1.0), (math.nan, 1.0)):
        with pytest.raises(InputError, match="lower height first"):
            deform(column(), 0.3, low, high)


@pytest.mark.parametrize("deform", [bend, twist])
def test_no_vertices_stay_none(deform):
    assert deform(torch.zeros(0, 3), 1.0, 0.0, 1.0).shape == (0, 3)


@pytest.mark.parametrize("deform", [bend, twist])
def test_the_angle_zero_moves_nothing(deform):
    # Two roundings of coordinates below 4.
    assert (deform(column(), 0, 0.0, 2.0) - column()).abs().max() <= 8 * EPS


@pytest.mark.parametrize("deform", [bend, twist])
def test_nothing_moves_below(deform):
    points = column()
    below = points[:, 1] <= 0
    assert (deform(points, 1.3, 0.0, 2.0) - points)[below].abs().max() <= 4 * EPS


@pytest.mark.parametrize("deform", [bend, twist])
def test_what_lies_above_moves_rigidly(deform):
    points = column()
    above = points[:, 1] >= 2
    distances = torch.cdist(points[above], points[above])
    moved = deform(points, 2.0, 0.0, 2.0)[above]
    # cdist loses half the digits between near points; distances are below 2.
    assert (torch.cdist(moved, moved, compute_mode="donot_use_mm_for_euclid_dist") - distances).abs().max() < 1e-7


@pytest.mark.parametrize("angle", [1e-30, 1e-6, 0.4, math.pi, -2.0])
def test_the_bent_axis_is_an_arc_of_its_length(angle):
    y = torch.linspace(0, 2, 101, dtype=torch.float64)
    points = torch.stack([0 * y, y, 0 * y], -1)
    arc = bend(points, angle, 0.0, 2.0)
    radius = 2 / angle
    # An arc of radius R about (R, 0, 0), compared without R - R cos.
    wanted = torch.stack([2 * radius * (y / radius / 2).sin() ** 2, radius * (y / radius).sin(), 0 * y], -1)
    assert (arc - wanted).abs().max() <= 16 * EPS


def test_twisting_turns_each_height_by_its_part():
    points = column()
    turned = twist(points, 1.2, 0.0, 2.0)
    angle = 1.2 * (points[:, 1].clamp(0, 2)) / 2
    start = torch.atan2(points[:, 0], points[:, 2])
    beside = points[:, [0, 2]].abs().sum(-1) > 0
    found = torch.atan2(turned[:, 0], turned[:, 2]) - start
    assert (found - angle)[beside].abs().max() <= 16 * EPS
    assert torch.equal(turned[:, 1], points[:, 1])


@pytest.mark.parametrize("deform", [bend, twist])
def test_angles_of_several_poses_are_several_poses(deform):
    angles = torch.tensor([[0.1, 0.5], [-0.3, 0.0]], dtype=torch.float64)
    poses = deform(column(), angles, 0.0, 2.0)
    assert poses.shape == (2, 2, len(column()), 3)
    assert torch.equal(poses[1, 0], deform(column(), -0.3, 0.0, 2.0))


@pytest.mark.parametrize("deform", [bend, twist])
def test_gradients_flow_to_positions_and_angle_even_at_zero(deform):
    points = (column(5) + 0.05).requires_grad_(True)
    for angle in (0.0, 0.7):
        turn = torch.tensor(angle, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(lambda p, t: deform(p, t, 0.0, 2.0), (points, turn))


def two_hinges():
    """An arm along x with hinges about z at x = 0 and x = 1."""
    weights = torch.tensor([[1.0, 0.0], [0.0, 1.0]], dtype=torch.float64)
    pivots = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], dtype=torch.float64)
    axes = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    return Rig(weights, pivots, axes, (-1, 0))


def test_a_rig_is_refused_if_its_parts_do_not_fit():
    rig = two_hinges()
    with pytest.raises(InputError, match="joints in weights"):
        Rig(rig.weights, rig.pivots[:1], rig.axes, (-1, 0))
    for parents in ((0, -1), (-1, 2), (-2, 0)):
        with pytest.raises(InputError, match="after its parent"):
            Rig(rig.weights, rig.pivots, rig.axes, parents)


def test_a_rig_at_rest_moves_nothing():
    assert torch.equal(two_hinges().pose(torch.zeros(3, 2)), torch.eye(4).expand(3, 2, 4, 4))


def test_a_hand_follows_its_arm():
    quarter = math.pi / 2
    matrices = two_hinges().pose(torch.tensor([quarter, quarter], dtype=torch.float64))
    tip = matrices[1] @ torch.tensor([2.0, 0.0, 0.0, 1.0], dtype=torch.float64)
    # The arm points up (+y) to the elbow at (0, 1), the hand back along -x.
    assert (tip - torch.tensor([-1.0, 1.0, 0.0, 1.0])).abs().max() <= 8 * EPS


def test_gradients_flow_to_the_angles_of_a_rig():
    angles = torch.tensor([0.0, 0.4], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(two_hinges().pose, (angles,))
