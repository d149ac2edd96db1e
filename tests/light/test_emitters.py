"""Is what arrives from a lamp nearby what its surface sends?"""

import math

import pytest
import torch
from numpy.polynomial.legendre import leggauss
from trimesh.creation import icosphere

from torchprt.errors import InputError
from torchprt.light import MeshEmitter, RectangleEmitter, SphereEmitter, incident, triangles
from torchprt.sh import basis, zonal

F64 = torch.float64
POINTS = torch.tensor([[0.0, 0, 0], [0.4, -0.2, 0.1], [-0.3, 0.5, -0.6]], dtype=F64)
CENTRE = torch.tensor([0.2, 0.1, 2.0], dtype=F64)
RIGHT, UP = torch.tensor([0.5, 0, 0], dtype=F64), torch.tensor([0.1, -0.7, 0], dtype=F64)
SPHERE = SphereEmitter(CENTRE, 0.4, (1.0, 2.0, 3.0))
RECTANGLE = RectangleEmitter(CENTRE, RIGHT, UP, (1.0, 2.0, 3.0))


def ball(subdivisions=2, radius=0.4, **more):
    made = icosphere(subdivisions=subdivisions, radius=radius)
    return MeshEmitter(torch.tensor(made.vertices, dtype=F64) + CENTRE, torch.tensor(made.faces), 1.0, **more)


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda: SphereEmitter((0, 0, math.nan), 1.0, 1.0), "center of a lamp is"),
        (lambda: SphereEmitter((0, 0), 1.0, 1.0), "give three finite numbers"),
        (lambda: SphereEmitter((0, 0, 1), 0.0, 1.0), "radius of a sphere lamp is 0.0: give a number above 0"),
        (lambda: SphereEmitter((0, 0, 1), 1.0, -1.0), "radiance of a lamp is -1.0: give finite numbers of 0 or more"),
        (lambda: SphereEmitter((0, 0, 1), 1.0, (1.0, math.inf, 0)), "finite numbers of 0 or more"),
        (lambda: SphereEmitter((0, 0, 1), 1.0, (1.0, 1.0)), "give one number or three"),
        (lambda: RectangleEmitter((0, 0, 1), (1, 0, 0), (2, 0, 0), 1.0), "have no area"),
        (lambda: MeshEmitter(torch.rand(3, 2), [[0, 1, 2]], 1.0), r"give \[V, 3\] and \[F, 3\]"),
        (lambda: MeshEmitter(torch.rand(3, 3), [[0, 1, 3]], 1.0), "vertices that it does not have"),
        (lambda: MeshEmitter(torch.full((3, 3), math.nan), [[0, 1, 2]], 1.0), "hold NaN or infinity"),
        (lambda: MeshEmitter(torch.zeros(0, 3), torch.zeros(0, 3), 1.0), "have no area"),
        (lambda: incident([], POINTS, 3), "there is no lamp"),
        (lambda: incident([SPHERE], POINTS * math.inf, 3), "points hold NaN"),
        (lambda: incident([SPHERE], CENTRE[None] + 0.1, 3), "the sphere lamp contains or touches sample point 0"),
        (lambda: incident([SPHERE], CENTRE[None] + RIGHT * 0.8, 3), "contains or touches"),
        (lambda: incident([ball()], CENTRE[None] + 0.1, 3), "the lamp of triangles contains or touches"),
        (lambda: incident([RECTANGLE], CENTRE[None] + 0.2 * UP, 3), "the rectangle lamp contains or touches"),
        (lambda: incident([RECTANGLE], CENTRE[None] - torch.tensor([0, 0, 0.01]), 3), "very close to a sample point"),
    ],
)
def test_refuses_what_is_no_lamp_or_lies_in_the_way(make, fault):
    with pytest.raises(InputError, match=fault):
        make()


def test_an_open_mesh_contains_nothing():
    half = ball()
    upper = half.positions[half.faces].mean(1)[:, 2] > CENTRE[2]
    bowl = MeshEmitter(half.positions, half.faces[upper], 1.0, two_sided=True)
    assert incident([bowl], CENTRE[None], 1).isfinite().all()


@pytest.mark.parametrize("order", [1, 5, 12])
def test_a_sphere_is_the_disc_that_it_is_seen_as(order):
    """Twin: Legendre sums over the cap by quadrature."""
    nodes, weights = (torch.tensor(each) for each in leggauss(40))
    steps = CENTRE - POINTS
    distance = steps.norm(dim=1)
    low = (1 - (0.4 / distance) ** 2).sqrt()
    z = (1 + low)[:, None] / 2 + (1 - low)[:, None] / 2 * nodes
    previous, current, bands = torch.zeros_like(z), torch.ones_like(z), []
    for degree in range(order):
        bands.append(2 * math.pi * (current * weights).sum(1) * (1 - low) / 2)
        previous, current = current, ((2 * degree + 1) * z * current - degree * previous) / (degree + 1)
    wanted = zonal(torch.stack(bands, 1), steps / distance[:, None])
    found = incident([SPHERE], POINTS, order)
    torch.testing.assert_close(found, wanted[..., None] * SPHERE.radiance.double(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", [1, 5, 12])
@pytest.mark.parametrize("two_sided", [False, True])
def test_a_rectangle_is_the_sum_over_its_surface(order, two_sided):
    lamp = RectangleEmitter(CENTRE, RIGHT, UP, 1.0, two_sided)
    ticks = (torch.arange(300, dtype=F64) + 0.5) / 150 - 1
    u, v = (each.reshape(-1, 1) for each in torch.meshgrid(ticks, ticks, indexing="ij"))
    for point in (POINTS[1], POINTS[1] + 4 * CENTRE):
        steps = CENTRE + u * RIGHT + v * UP - point
        distance = steps.norm(dim=1)
        seen = steps[:, 2] / distance**3 * lamp.area() / len(steps)
        seen = seen.abs() if two_sided else seen.clamp(min=0)
        wanted = (basis(steps / distance[:, None], order) * seen[:, None]).sum(0)
        # The midpoint rule of the twin errs by 4e-6 here.
        found = incident([lamp], point[None], order)[0, :, 0]
        torch.testing.assert_close(found, wanted, rtol=0, atol=2e-5 * max(float(wanted.abs().max()), 1e-3))


@pytest.mark.parametrize("away", [1.0, 0.1, 0.04])
def test_near_a_triangle_its_light_is_its_solid_angle(away):
    corners = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=F64)
    point = torch.tensor([[0.3, 0.3, away]], dtype=F64)
    light = triangles.triangle_lights(point, corners, torch.ones(1, 3, dtype=F64), 3, False)
    angle = -triangles.solid_angles(point, corners)[0, 0]
    assert abs(float(light[0, 0, 0]) * math.sqrt(4 * math.pi) / float(angle) - 1) <= 1e-6


def test_finer_balls_tend_to_the_sphere():
    wanted = incident([SphereEmitter(CENTRE, 0.4, 1.0)], POINTS, 5)
    errors = [float((incident([ball(level)], POINTS, 5) - wanted).abs().max()) for level in (1, 2, 3)]
    # What an inscribed ball lacks falls with the square of its edges.
    assert errors[0] / errors[1] >= 3.3
    assert errors[1] / errors[2] >= 3.3


def test_distances_to_triangles_are_those_of_their_nearest_points():
    corners = torch.tensor([[[0.0, 0, 0], [2, 0, 0], [0, 1, 0]]], dtype=F64)
    points = torch.tensor([[0.3, 0.3, 2], [-1, -1, 0], [1, -2, 0], [3, 0, 1], [2, 2, 0], [0.5, 0.2, 0]], dtype=F64)
    wanted = torch.tensor([2, math.sqrt(2), 2, math.sqrt(2), 4 / math.sqrt(5), 0], dtype=F64)
    torch.testing.assert_close(triangles.closest(points, corners)[:, 0], wanted)


@pytest.mark.parametrize(
    "lamps", [[SPHERE], [RECTANGLE], [SPHERE, RECTANGLE, ball(1)]], ids=["sphere", "rectangle", "all"]
)
def test_derivatives_are_those_of_moving_the_point(lamps):
    found = incident(lamps, POINTS, 4, gradients=True).unflatten(0, (3, 4))
    torch.testing.assert_close(found[:, 0], incident(lamps, POINTS, 4))
    for axis, step in enumerate(1e-5 * torch.eye(3, dtype=F64)):
        moved = (incident(lamps, POINTS + step, 4) - incident(lamps, POINTS - step, 4)) / 2e-5
        torch.testing.assert_close(found[:, 1 + axis], moved, rtol=0, atol=1e-8)


@pytest.mark.parametrize("gradients", [False, True])
def test_gradients_flow_to_place_size_and_radiance(gradients):
    colour = torch.tensor([1.0, 0.5, 0.2], dtype=F64, requires_grad=True)
    radius = torch.tensor(0.4, dtype=F64, requires_grad=True)
    given = [each.clone().requires_grad_() for each in (CENTRE, RIGHT, UP, POINTS)]

    def light(centre, right, up, points, radius, colour):
        lamps = [SphereEmitter(centre, radius, colour), RectangleEmitter(centre, right, up, colour)]
        return incident(lamps, points, 3, gradients=gradients)

    assert torch.autograd.gradcheck(light, (*given, radius, colour), fast_mode=True)
