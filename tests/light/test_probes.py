"""Do sample points spread over the object, and do their weights blend as they say?"""

import dataclasses
import itertools
import math
from types import SimpleNamespace

import pytest
import torch
from trimesh.creation import icosphere

from torchprt.compression import compress, reorder
from torchprt.errors import InputError
from torchprt.light import SphereEmitter, blend_weights, incident, probes, sample_points, with_sample_points
from torchprt.sh import fibonacci
from torchprt.transfer import Texels, load, save

F64 = torch.float64


def sphere(subdivisions=3):
    made = icosphere(subdivisions=subdivisions)
    return torch.tensor(made.vertices, dtype=F64), torch.tensor(made.faces)


def inside(count=200, radius=0.4):
    generator = torch.Generator().manual_seed(1)
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=F64), dim=-1)
    return radius * directions * torch.rand(count, 1, generator=generator, dtype=F64)


@pytest.mark.parametrize(
    ("positions", "faces", "count", "fault"),
    [
        (torch.rand(3, 3), torch.tensor([[0, 1, 2]]), 0, "0 sample points: give 1 or more"),
        (torch.rand(0, 3), torch.zeros(0, 3, dtype=torch.long), 4, "one or more finite points"),
        (torch.tensor([[0.0, 0, math.nan]] * 3), torch.tensor([[0, 1, 2]]), 4, "one or more finite points"),
        (torch.ones(3, 3), torch.tensor([[0, 1, 2]]), 4, "the surface has no area"),
    ],
)
def test_refuses_what_is_no_surface(positions, faces, count, fault):
    with pytest.raises(InputError, match=fault):
        sample_points(positions, faces, count)


@pytest.mark.parametrize("bad", [torch.zeros(0, 3), torch.tensor([[0.0, math.inf, 0]])])
def test_refuses_points_that_are_none(bad):
    with pytest.raises(InputError, match=r"there is no sample point|hold NaN or infinity"):
        blend_weights(bad, torch.rand(4, 3))


@pytest.mark.parametrize("count", [2, 4])
def test_few_points_are_in_the_middle_of_their_sides(count):
    points = sample_points(*sphere(), count)
    torch.testing.assert_close(points.mean(0), torch.zeros(3, dtype=F64), rtol=0, atol=0.02)
    # The centre of half a sphere is half way to its pole.
    assert float(points.norm(dim=1).max()) <= (0.52 if count == 2 else 0.76)


@pytest.mark.parametrize("count", [12, 16, 64])
def test_points_are_spread_evenly_just_off_a_sphere(count):
    points = sample_points(*sphere(), count)
    assert points.shape == (count, 3)
    spacing = math.sqrt(4 * math.pi / count)
    distance = points.norm(dim=1) - 1
    assert float(distance.min()) >= -0.02
    assert float(distance.max()) <= 1.1 * probes.LIFT * spacing
    # Nobody is farther from a point than the corner of a cell, 0.62 of the spacing of hexagons and more of few points.
    nearest = torch.cdist(fibonacci(4000)[0], points / points.norm(dim=1, keepdim=True)).amin(1)
    assert float(nearest.max()) <= 1.05 * spacing


def test_one_point_is_the_middle():
    assert float(sample_points(*sphere(), 1).norm()) <= 0.02


def test_doubled_vertices_and_slivers_change_no_point():
    positions, faces = sphere()
    wanted = sample_points(positions, faces, 9)
    assert torch.equal(sample_points(positions, faces, 9), wanted)
    split = positions[faces].reshape(-1, 3)
    torch.testing.assert_close(sample_points(split, torch.arange(len(split)).reshape(-1, 3), 9), wanted)
    sliver = torch.cat([faces, torch.tensor([[0, 0, 1], [2, 2, 2]])])
    torch.testing.assert_close(sample_points(positions, sliver, 9), wanted)


def test_more_points_than_vertices_are_fine():
    triangle = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=F64)
    points = sample_points(triangle, torch.tensor([[0, 1, 2]]), 20)
    assert len(points.unique(dim=0)) == 20
    loose = sample_points(triangle, torch.zeros(0, 3, dtype=torch.long), 5)
    assert torch.cdist(loose, triangle).amin(1).max() == 0


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("move", [0.0, 1e4])
def test_size_and_place_make_no_difference(scale, move):
    positions, faces = sphere(2)
    turn = torch.tensor([move, -move, move / 2], dtype=F64)
    moved = scale * (positions + turn)
    points, wanted = sample_points(moved, faces, 8), sample_points(positions, faces, 8)
    # The positions that are given were rounded, relative to how far off they are.
    loss = 1e-13 * (1 + 3 * move)
    torch.testing.assert_close(points / scale - turn, wanted, rtol=0, atol=100 * loss)
    one, other = blend_weights(points, moved), blend_weights(wanted, positions)
    torch.testing.assert_close(one, other, rtol=0, atol=1e4 * loss)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 16, 100])
def test_weights_are_a_blend(count):
    points = sample_points(*sphere(), count)
    positions = torch.cat([sphere()[0], 3 * sphere(1)[0], inside(), points])
    weights = blend_weights(points, positions)
    assert weights.shape == (len(positions), count)
    assert bool((weights >= 0).all())
    torch.testing.assert_close(weights.sum(1), torch.ones(len(positions), dtype=F64), rtol=0, atol=1e-14)
    if count == 1:
        assert bool((weights == 1).all())


def test_points_at_one_place_share_the_weight():
    points = torch.zeros(3, 3, dtype=F64)
    torch.testing.assert_close(blend_weights(points, inside()), torch.full((200, 3), 1 / 3, dtype=F64))


def test_what_varies_linearly_is_exact_in_the_hull():
    points = sample_points(*sphere(), 16)
    # But for what the ridge takes, which is what Newton's method stops at: a hundredth of a slope of the dual.
    torch.testing.assert_close(blend_weights(points, inside()) @ points, inside(), rtol=0, atol=0.05)


def test_with_derivatives_what_varies_linearly_is_exact_on_the_surface():
    points = sample_points(*sphere(), 16)
    positions = torch.cat([sphere()[0], 1.2 * sphere(1)[0], inside()])
    blend = blend_weights(points, positions, gradients=True)
    slope = torch.tensor([0.3, -1.0, 2.0], dtype=F64)
    light = torch.cat([1 + points @ slope[:, None], slope.expand(16, 3)], 1)
    torch.testing.assert_close(blend @ light.flatten(), 1 + positions @ slope, rtol=0, atol=1e-12)


def test_far_out_a_light_goes_on_by_no_more_than_a_spacing():
    points = sample_points(*sphere(), 16)
    slope = torch.tensor([0.3, -1.0, 2.0], dtype=F64)
    light = torch.cat([1 + points @ slope[:, None], slope.expand(16, 3)], 1)
    out = torch.linspace(1, 40, 200, dtype=F64)[:, None] * torch.tensor([[0.6, 0.0, 0.8]], dtype=F64)
    along = blend_weights(points, out, gradients=True) @ light.flatten()
    reached = float((points @ slope).max()) + 1 + float(slope.norm()) * probes.spacing_of(points)
    assert bool((along <= reached).all())
    assert float(along[-1]) >= float(along[0])


def test_derivatives_make_what_is_curved_ten_times_closer():
    points = sample_points(*sphere(), 16)
    curved = torch.tensor([[1.0, 0.5, 0], [0.5, -2, 0.2], [0, 0.2, 1.0]], dtype=F64)
    blend = blend_weights(points, sphere()[0], gradients=True)
    values = (points @ curved * points).sum(1, keepdim=True)
    wanted = (sphere()[0] @ curved * sphere()[0]).sum(1)
    plain = blend[:, ::4] @ values[:, 0] - wanted
    first = blend @ torch.cat([values, 2 * points @ curved], 1).flatten() - wanted
    assert first.square().mean() <= plain.square().mean() / 100


def test_weights_have_no_kink():
    """Along a line through a sphere and its hull second differences fall as the square of the step."""
    points = sample_points(*sphere(), 16)
    largest = []
    for steps in (400, 800, 1600):
        line = torch.linspace(-1.7, 1.7, steps + 1, dtype=F64)[:, None] * torch.tensor([0.3, 0.9, 0.2], dtype=F64)
        largest.append(float(blend_weights(points, line).diff(n=2, dim=0).abs().max()))
    assert largest[0] / largest[1] >= 3.5
    assert largest[1] / largest[2] >= 3.5


def test_are_stored_with_the_transfer(make_transfer, tmp_path):
    transfer = with_sample_points(make_transfer(), 5, gradients=True)
    save(transfer, tmp_path / "a.safetensors")
    read = load(tmp_path / "a.safetensors").receivers
    assert torch.equal(read.sample_points, transfer.receivers.sample_points)
    assert torch.equal(read.blend, transfer.receivers.blend)
    taken = transfer.receivers.take(torch.tensor([1, 7]))
    assert torch.equal(taken.blend, transfer.receivers.blend[[1, 7]])
    assert len(taken.sample_points) == 5


def test_blends_go_where_receivers_go(make_transfer):
    transfer = with_sample_points(make_transfer(), 5)
    ordered = reorder(compress(transfer, clusters=3, components=2))
    assert torch.equal(ordered.receivers.blend, transfer.receivers.blend[ordered.receivers.original])
    ground = {"name": "ground", "role": "ground", "side": "front", "rows": [20, 25]}
    held = {"name": "model", "role": "receiver", "side": "front", "rows": [0, 20]}
    standing = dataclasses.replace(transfer, receivers=transfer.receivers.replace(objects=[held, ground]))
    assert torch.equal(standing.without_ground().receivers.blend, transfer.receivers.blend[:20])
    # The points are about the model, and what is on the ground takes its light from them too.
    again = with_sample_points(standing, 5).receivers
    assert again.blend.shape == (25, 5)
    assert torch.equal(again.sample_points, with_sample_points(standing.without_ground(), 5).receivers.sample_points)


def test_a_patch_has_no_place(untyped):
    with pytest.raises(InputError, match="which lies nowhere yet"):
        with_sample_points(SimpleNamespace(receivers=Texels(rows=2, columns=2)), 5)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"blend": None}, "without the other"),
        ({"blend": torch.full((25, 7), 1 / 7)}, "7 columns for 5 sample points"),
        ({"blend": torch.full((25, 5), 0.3)}, "do not sum to 1"),
        ({"blend": torch.tensor([2.0, -1, 0, 0, 0]).expand(25, 5)}, "weights below 0"),
        ({"sample_points": torch.full((5, 3), math.nan)}, "NaN or infinite"),
    ],
)
def test_a_blend_that_is_none_is_refused(make_transfer, change, fault):
    receivers = with_sample_points(make_transfer(), 5).receivers
    with pytest.raises(InputError, match=fault):
        receivers.replace(**change).check()


def test_more_points_err_less_and_gradients_less_again():
    """Under a lamp one radius from a sphere, against the light that is there, in the norm of its coefficients."""
    positions, faces = sphere(3)
    lamp = [SphereEmitter(torch.tensor([1.0, 1.5, -1.4], dtype=F64), 0.25, 1.0)]
    wanted = incident(lamp, positions, 4)
    errors = []
    for count in (1, 4, 16, 64):
        points = sample_points(positions, faces, count)
        blend = blend_weights(points, positions, gradients=True)
        lights = incident(lamp, points, 4, gradients=True)
        plain = torch.einsum("vs,snc->vnc", blend[:, ::4], lights[::4])
        full = torch.einsum("vk,knc->vnc", blend, lights)
        errors.append([float((found - wanted).norm() / wanted.norm()) for found in (plain, full)])
    for fewer, more in itertools.pairwise(errors):
        assert more[0] < fewer[0]
        assert more[1] < fewer[1]
    assert all(full < plain for plain, full in errors)
    assert errors[-1][1] <= 0.02
