"""Is the light that arrives the light that should?"""

import math

import numpy as np
import pytest
import torch
from shapes import bowl, disc, square
from transfers import stored

from torchprt import sh
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, load, make_mesh, samples
from torchprt.transport import bake, frames, hemisphere, unshadowed

# A constant light of radiance 1 has this first coefficient.
ONE = math.sqrt(4 * math.pi)
EPS = torch.finfo(torch.float32).eps


def quiet(scene, **options):
    return bake(scene, progress=False, **options)


def constant(transfer):
    """What every receiver of albedo 1 would read under a constant light of radiance 1."""
    return stored(transfer)[:, 0] * ONE


@pytest.mark.parametrize(
    ("option", "name"),
    [
        ({"order": 0}, "order"),
        ({"order": 65}, "order"),
        ({"rays": 0}, "rays"),
        ({"rays": 1 << 23}, "rays"),
        ({"bounces": -1}, "bounces"),
        ({"bounces": 1.5}, "bounces"),
        ({"bounces": math.nan}, "bounces"),
        ({"bounces": 1, "shadows": False}, "bounces"),
        ({"seed": -1}, "seed"),
        ({"threads": 0}, "threads"),
    ],
)
def test_refuses_arguments_out_of_range(option, name):
    with pytest.raises(InputError, match=name):
        quiet(load(square()), **option)


def test_without_shadows_no_ray_is_traced_and_the_result_is_the_closed_form():
    transfer = quiet(load(square()), shadows=False)
    assert (transfer.transport, transfer.rays, transfer.error) == ("unshadowed", 0, None)
    assert torch.equal(stored(transfer)[0], unshadowed(transfer.normals.double(), 5))


@pytest.mark.parametrize("order", [1, 2, 5, 12])
def test_a_convex_body_has_the_unshadowed_transfer(order):
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)
    transfer = quiet(load(make_mesh(ball.vertices, ball.faces)), order=order, rays=300)
    expected = unshadowed(transfer.normals.double(), order)
    # 300 additions in float32 and a rotation.
    torch.testing.assert_close(stored(transfer)[0], expected, atol=300 * EPS, rtol=0)


def test_a_white_furnace_reads_one_where_nothing_blocks():
    reading = constant(quiet(load(square(), albedo=1.0), rays=257, bounces=1))
    torch.testing.assert_close(reading, torch.ones_like(reading), atol=257 * EPS, rtol=0)


@pytest.mark.parametrize(("radius", "height"), [(0.5, 1.0), (2.0, 1.0), (0.3, 0.05)])
def test_a_disc_overhead_takes_its_form_factor(radius, height):
    scene = Scene([Object(square(0.1, 3)), Object(disc(radius, height), Material(0.0), "blocker")])
    transfer = quiet(scene, rays=4096)
    seen = float(constant(transfer)[0, 4])
    # Area-weighted error of the Fibonacci set on one edge, about count^-3/4.
    assert seen == pytest.approx(1 - radius**2 / (radius**2 + height**2), abs=4096**-0.75)


@pytest.mark.parametrize("order", [3, 5, 9])
def test_shadowed_coefficients_agree_with_quadrature(order):
    """A disc overhead hides exactly the cap of directions within its angle."""
    radius, height = 0.6, 1.0
    scene = Scene([Object(square(0.1, 3)), Object(disc(radius, height, 1024), Material(0.0), "blocker")])
    transfer = stored(quiet(scene, order=order, rays=16384))[0, :, 4].double()
    lowest = 0.0
    edge = height / math.hypot(radius, height)
    # Gauss-Legendre over exactly the visible band of cosines, times a rotation-symmetric rule: exact.
    z, weight = (torch.from_numpy(values) for values in np.polynomial.legendre.leggauss(order + 1))
    y = lowest + (edge - lowest) * (z + 1) / 2
    weight = weight * (edge - lowest) / 2
    phi = torch.arange(2 * order, dtype=torch.float64) * (math.pi / order)
    y, phi = torch.meshgrid(y, phi, indexing="ij")
    around = torch.sqrt(1 - y * y)
    directions = torch.stack([around * phi.cos(), y, around * phi.sin()], -1)
    kernel = y / math.pi * weight[:, None] * (math.pi / order)
    expected = torch.einsum("zp,zpn->n", kernel, sh.basis(directions, order))
    torch.testing.assert_close(transfer, expected, atol=16384**-0.75, rtol=0)


@pytest.mark.parametrize("albedo", [0.3, 0.9])
def test_light_in_a_bowl_adds_up_to_its_closed_form(albedo):
    mesh, opening = bowl(1.2)
    inside = mesh.positions[:, 1] < 0.2
    for bounces, expected in [
        (0, opening),
        (1, opening * (1 + albedo * (1 - opening))),
        (2, opening * (1 + albedo * (1 - opening) + (albedo * (1 - opening)) ** 2)),
        (math.inf, opening / (1 - albedo * (1 - opening))),
    ]:
        transfer = quiet(load(mesh, albedo=albedo), rays=512, bounces=bounces)
        reading = constant(transfer)[0, inside]
        # Facets of the bowl lie inside the sphere: 32 rings leave half a percent.
        assert float(reading.mean()) == pytest.approx(expected, rel=0.01)
        # Rays over the one edge of the opening: 512^-3/4 of a hemisphere.
        assert float(reading.std()) < 2 * 512**-0.75 * expected


def test_endless_bouncing_stops_when_it_adds_nothing_and_says_how_often_it_went():
    mesh, _ = bowl(1.2)
    transfer = quiet(load(mesh, albedo=0.5), rays=128, bounces=math.inf)
    more = quiet(load(mesh, albedo=0.5), rays=128, bounces=transfer.bounces + 10)
    assert 3 < transfer.bounces < 20
    # What is left out is at most the last bounce and its tail, 1e-4 / (1 - .5).
    assert (stored(more) - stored(transfer)).norm() < 2e-4 * stored(more).norm()


def test_energy_of_a_bounce_never_exceeds_what_arrived():
    scene = load(samples.organic(8000).objects[0].mesh, albedo=1.0)
    reading = constant(quiet(scene, rays=64, bounces=math.inf))
    # A white body in a white furnace is white; what is lost are hits on the backs behind vertex normals.
    assert float(reading.max()) < 1.02
    assert float(reading.mean()) > 0.97


def overhead(two_sided=False, up=False, role="receiver"):
    """A small level receiver under a large white square that faces up or down, lit from below and above alike."""
    receiver = Object(square(0.1, 3), Material(0.0))
    return Scene([receiver, Object(square(4.0, 9, height=0.5, up=up), Material(1.0, two_sided), role)])


def test_a_surface_reflects_with_its_front_and_never_with_its_back():
    faces_receiver = constant(quiet(overhead(), bounces=1, rays=256))[0, 4]
    faces_away = constant(quiet(overhead(up=True), bounces=1, rays=256))[0, 4]
    shadow_alone = constant(quiet(overhead(), bounces=0, rays=256))[0, 4]
    assert faces_receiver > 0.8
    assert faces_away == shadow_alone < 0.1


def test_both_sides_of_a_two_sided_surface_reflect():
    one_sided = constant(quiet(overhead(), bounces=1, rays=256))[0, 4]
    for up in (False, True):
        both = constant(quiet(overhead(two_sided=True, up=up), bounces=1, rays=256))[0, 4]
        torch.testing.assert_close(both, one_sided, rtol=1e-4, atol=0)


def test_the_reverse_side_is_recorded_behind_the_fronts():
    sheet = load(square(), two_sided=True)
    transfer = quiet(sheet, rays=64)
    assert transfer.vertices == 50
    torch.testing.assert_close(transfer.normals[25:], -transfer.normals[:25])
    torch.testing.assert_close(
        stored(transfer)[0, :, 25:], unshadowed(transfer.normals[25:].double(), 5), atol=64 * EPS, rtol=0
    )


def test_a_blocker_blocks_and_reflects_nothing():
    blocked = quiet(overhead(role="blocker"), bounces=2, rays=256)
    assert blocked.vertices == 9
    assert constant(blocked)[0, 4] < 0.1


def test_colour_bleeds_from_the_wall_that_is_near():
    scene = samples.coloured_box(resolution=12)
    transfer = quiet(scene, rays=256, bounces=2)
    assert transfer.channels == 3
    low = transfer.positions[:, 1] < transfer.positions[:, 1].min() + 0.05
    up = transfer.normals[:, 1] > 0.9
    x = transfer.positions[:, 0]
    red, green = constant(transfer)[0], constant(transfer)[1]
    # The floor near each wall; what is hidden between objects that touch has no colour to speak of.
    lit = low & up & (red + green > 0.02)
    left, right = lit & (x < 0.8 * x.min()), lit & (x > 0.8 * x.max())
    assert left.sum() > 5
    assert right.sum() > 5
    assert (red[left] > green[left]).all()
    assert (green[right] > red[right]).all()


def test_grey_light_is_stored_once():
    assert quiet(load(square(), albedo=(0.2, 0.5, 0.9)), rays=16).channels == 1
    assert quiet(load(square(), albedo=(0.5, 0.5, 0.5)), rays=16, bounces=1).channels == 1
    assert quiet(load(square(), albedo=(0.2, 0.5, 0.9)), rays=16, bounces=1).channels == 3


def test_points_record_what_vertices_at_their_place_do():
    mesh, _ = bowl(1.2, rings=24, segments=48)
    scene = load(mesh, albedo=0.7)
    for bounces in (0, 1, 3):
        at_vertices = quiet(scene, rays=128, bounces=bounces)
        points = Points(mesh.positions[100:150], mesh.normals[100:150], albedo=0.2)
        at_points = quiet(scene, rays=128, bounces=bounces, receivers=points)
        assert at_points.bounces == bounces
        assert at_points.faces.shape == (0, 3)
        # Their rays start a rounding lower: a ray in thousands may end elsewhere.
        torch.testing.assert_close(stored(at_points), stored(at_vertices)[:, :, 100:150], atol=2e-3, rtol=0)


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("scale", [1.0, 1e-5, 3e4])
def test_where_a_wall_stands_on_a_floor_the_floor_sees_half_the_sky(turn, scale):
    floor = square(resolution=9)
    angle = 0.3 + turn
    spin = torch.tensor(
        [[math.cos(angle), -0.6 * math.sin(angle), 0.8 * math.sin(angle)], [0, 0.8, 0.6],
         [-math.sin(angle), -0.6 * math.cos(angle), 0.8 * math.cos(angle)]], dtype=torch.float64
    )  # fmt: skip
    edge = floor.positions[:, 0] > 0.49
    # The floor turned up about its right edge; far higher than wide, so that half the sky is gone.
    wall = floor.positions.clone()
    wall[:, 1], wall[:, 0] = (0.5 - wall[:, 0]) * 1e4, 0.5
    wall[:, 2] *= 1e4
    scene = Scene(
        [
            Object(make_mesh(floor.positions @ spin.T * scale, floor.faces)),
            Object(make_mesh(wall @ spin.T * scale, floor.faces), Material(0.0), "blocker"),
        ]
    )
    reading = constant(quiet(scene, rays=1024))[0]
    # One Fibonacci direction in thirty lies along the wall.
    torch.testing.assert_close(reading[edge], torch.full_like(reading[edge], 0.5), atol=0.02, rtol=0)


def test_a_vertex_without_a_normal_has_zero_transfer():
    positions = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 0, -1], [5, 5, 5]], dtype=torch.float64)
    mesh = make_mesh(positions, torch.tensor([[0, 1, 2]]))
    for bounces in (0, 1):
        transfer = stored(quiet(load(mesh), rays=32, bounces=bounces))
        assert not transfer[..., 3].any()
        assert transfer[..., :3].any()


def test_one_ray_and_one_triangle_are_enough():
    positions = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 0, -1]], dtype=torch.float64)
    transfer = quiet(load(make_mesh(positions, torch.tensor([[0, 1, 2]]))), rays=1, order=1, bounces=1)
    torch.testing.assert_close(constant(transfer), torch.ones(1, 3))


@pytest.mark.parametrize("factor", [1e-6, 1e6, 3.0])
def test_size_does_not_matter(factor):
    mesh = samples.organic(8000).objects[0].mesh
    plain = quiet(load(mesh), rays=64, bounces=1)
    scaled = quiet(load(make_mesh(mesh.positions * factor, mesh.faces, mesh.normals)), rays=64, bounces=1)
    # Coordinates round otherwise: a ray in thousands that grazes an edge goes the other way, 1/64 of a coefficient.
    difference = (stored(plain) - stored(scaled)).square().mean().sqrt()
    assert difference < 0.01 * stored(plain).square().mean().sqrt()


def test_a_power_of_two_of_the_size_gives_the_same_bits():
    mesh = samples.organic(8000).objects[0].mesh
    plain = quiet(load(mesh), rays=32)
    scaled = quiet(load(make_mesh(mesh.positions * 2.0**20, mesh.faces, mesh.normals)), rays=32)
    assert torch.equal(stored(plain), stored(scaled))


def test_distance_from_the_origin_does_not_matter():
    mesh = samples.organic(8000).objects[0].mesh
    plain = quiet(load(mesh), rays=64)
    moved = quiet(load(make_mesh(mesh.positions + 1e4, mesh.faces, mesh.normals)), rays=64)
    difference = (stored(plain) - stored(moved)).square().mean().sqrt()
    assert difference < 0.01 * stored(plain).square().mean().sqrt()


def test_the_estimated_error_is_the_error():
    scene = samples.organic(8000)
    transfer = quiet(scene, rays=128)
    truth = quiet(scene, rays=4096)
    error = (stored(transfer) - stored(truth)).double().square().mean().sqrt()
    # A sample of a few receivers: their squared errors scatter by a factor of about two.
    assert transfer.error == pytest.approx(float(error), rel=0.5)
    assert transfer.signal == pytest.approx(float(stored(truth).double().square().mean().sqrt()), rel=0.01)


@pytest.mark.parametrize(("rays", "published"), [(256, 0.015), (1024, 0.006)])
def test_error_of_a_scan_by_number_of_rays(data, rays, published):
    scene = load(data / "mesh" / "bunny.ply")
    geometry = scene.geometry()
    chosen = torch.randperm(geometry.receivers, generator=torch.Generator().manual_seed(0))[:256]
    points = Points(geometry.receiver_positions[chosen], geometry.receiver_normals[chosen])
    transfer = stored(quiet(scene, rays=rays, receivers=points))
    truth = stored(quiet(scene, rays=65536, receivers=points))
    assert (transfer - truth).norm() <= published * truth.norm()


def test_directions_of_a_receiver_are_those_of_its_hemisphere():
    """The exact twin: every ray by brute force in float64 against every triangle."""
    mesh = samples.organic(8000).objects[0].mesh
    chosen = torch.arange(0, len(mesh.positions), 1000)
    points = Points(mesh.positions[chosen], mesh.normals[chosen])
    rays = 64
    transfer = quiet(load(mesh), rays=rays, order=1, receivers=points)
    directions = hemisphere(rays)
    world = directions @ frames(mesh.normals[chosen])
    corners = mesh.positions[mesh.faces]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    for row, index in enumerate(chosen):
        origin = mesh.positions[index] + 1e-7 * mesh.normals[index]
        across = torch.linalg.cross(world[row][:, None], edge2[None])
        determinant = (across * edge1).sum(-1)
        to_origin = origin - corners[:, 0]
        u = (to_origin * across).sum(-1) / determinant
        other = torch.linalg.cross(to_origin, edge1)
        v = (world[row] @ other.T) / determinant
        distance = (other * edge2).sum(-1) / determinant
        blocked = ((u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)).any(-1)
        expected = (2 * directions[:, 2] / rays * ~blocked).sum()
        # One grazing ray may differ.
        assert float(constant(transfer)[0, row]) == pytest.approx(float(expected), abs=2.5 / rays)
