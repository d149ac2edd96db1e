"""Do cube maps about sample points give the light that is there, and its derivatives?"""

import pytest
import torch

from torchprt.errors import InputError
from torchprt.light import (
    RectangleEmitter,
    SphereEmitter,
    capture,
    constant,
    incident,
    local_light,
    with_sample_points,
)

F64 = torch.float64
POINTS = torch.tensor([[0.0, 0, 0], [0.4, -0.2, 0.1]], dtype=F64)
LAMP = SphereEmitter(torch.tensor([0.2, 0.1, 2.0], dtype=F64), 0.4, (1.0, 2.0, 3.0))


def sky(points, directions):
    """Radiance of a few bands that varies linearly from place to place."""
    base = 1 + 0.5 * directions[:, 1] + 0.3 * directions[:, 0] * directions[:, 2]
    return (base * (2 + points @ points.new_tensor([0.3, -0.2, 0.1]))[:, None])[..., None].expand(-1, -1, 3)


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ({"size": 0}, "give one or more of both"),
        ({"points": torch.zeros(0, 3)}, "0 points and cube maps"),
        ({"points": POINTS[:1], "gradients": True}, "follows from nothing: give step"),
        ({"gradients": True, "step": 0.0}, "step is 0.0: give a length above 0"),
        ({"radiance": lambda p, d: torch.zeros(len(p), 3)}, r"has shape \[2, 3\]: it must be \[2, 96, 3\]"),
        ({"radiance": lambda p, d: -sky(p, d)}, "holds negative values, NaN or infinity"),
        ({"radiance": lambda p, d: sky(p, d) * torch.nan}, "holds negative values, NaN or infinity"),
    ],
)
def test_refuses_what_cannot_be_captured(arguments, fault):
    given = {"points": POINTS, "radiance": sky, "size": 4} | arguments
    with pytest.raises(InputError, match=fault):
        capture(given.pop("points"), 3, given.pop("radiance"), **given)


def test_every_point_has_its_own_cube_map():
    found = capture(POINTS, 3, sky, size=16)
    for number, point in enumerate(POINTS):
        torch.testing.assert_close(found[number], capture(point[None], 3, sky, size=16)[0])
    ratio = (2 + POINTS @ torch.tensor([0.3, -0.2, 0.1], dtype=F64)) / 2
    torch.testing.assert_close(found, found[:1] * ratio[:, None, None])


def test_differences_are_derivatives_of_what_varies_linearly():
    found = capture(POINTS, 3, sky, size=8, gradients=True, step=0.3).unflatten(0, (2, 4))
    torch.testing.assert_close(found[:, 0], capture(POINTS, 3, sky, size=8))
    slopes = torch.tensor([0.3, -0.2, 0.1], dtype=F64)[:, None, None] / 2
    torch.testing.assert_close(found[:, 1:], (found[:1, :1] * slopes).expand(2, -1, -1, -1))


def test_gradients_flow_through_what_is_captured():
    colour = torch.tensor([0.2, 0.5, 1.0], dtype=F64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda c: capture(POINTS, 2, lambda p, d: sky(p, d) * c, size=4), (colour,))


def test_lights_of_a_transfer_are_those_of_its_points(make_transfer):
    transfer = with_sample_points(make_transfer(dtype=F64), 3, gradients=True)
    points = transfer.receivers.sample_points
    found = local_light(transfer, [LAMP], environment=constant((1.0, 1.0, 1.0), 4).double())
    wanted = incident([LAMP], points, 4, gradients=True).unflatten(0, (3, 4))
    wanted[:, 0] += constant((1.0, 1.0, 1.0), 4).double()
    torch.testing.assert_close(found, wanted.flatten(0, 1))


@pytest.mark.parametrize(
    ("lamps", "environment", "fault"),
    [
        ([SphereEmitter((0.5, 0.05, 0.5), 0.1, 1.0)], None, "the sphere lamp contains or touches vertex"),
        (
            [RectangleEmitter((0.5, 0, 0.5), (0.1, 0, 0), (0, 0, 0.1), 1.0)],
            None,
            "the rectangle lamp contains or touches",
        ),
        ([LAMP], torch.zeros(9, 3), "environment has shape .* is of order 4"),
    ],
)
def test_lamps_that_touch_the_surface_are_refused(make_transfer, lamps, environment, fault):
    with pytest.raises(InputError, match=fault):
        local_light(with_sample_points(make_transfer(), 3), lamps, environment=environment)


def test_transfer_without_points_is_refused(make_transfer):
    with pytest.raises(InputError, match="has no sample points"):
        local_light(make_transfer(), [LAMP])
