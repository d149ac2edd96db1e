"""Does what the cells of a volume scatter agree with slow, plain ways to the same?"""

import dataclasses
import math

import numpy as np
import pytest
import torch

import torchprt as prt
from torchprt import sh
from torchprt.errors import InputError
from torchprt.scene import Volume, load, make_mesh
from torchprt.scene.object import Object
from torchprt.transport import CheckpointWarning, Processes, VolumeWarning, bake_volume
from torchprt.transport.volume import _cells, _inside
from torchprt.transport.volume_tasks import BOTH, GROUPS, Enter, Scatter, direction_set

EPSILON = torch.finfo(torch.float32).eps
WHITE = torch.zeros(25, 3)
WHITE[0] = math.sqrt(4 * math.pi)


def lump(n=8, depth=4.0, seed=0):
    """Extinction of a cube from -1 to 1 in which a third holds something, about `depth` from side to side."""
    values = torch.rand(n, n, n, generator=torch.Generator().manual_seed(seed))
    return torch.where(values > 0.65, values, 0) * depth


def volume(n=8, depth=4.0, albedo=0.9, phase=0.0, **more):
    return Volume(lump(n, depth), albedo, origin=(-1, -1, -1), spacing=2 / n, phase=phase, **more)


def baked(of, **options):
    return bake_volume(of, **{"rays": 256, "threads": 1, "progress": False, **options})


def sphere_nodes():
    """Directions, none along an axis, and their weights: exact to degree 34."""
    nodes, weights = sh.lebedev(35)
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(9), dtype=torch.float64))
    return nodes @ turn, weights


def values(transfer):
    return next(iter(transfer.layers.values())).signal.values


def transmittance(of, points, directions):
    """What is left of light that comes to points `[P, 3]` from directions `[D, 3]`: all crossings of planes, sorted."""
    spacing = torch.tensor(of.spacing, dtype=torch.float64)
    start = ((points - torch.tensor(of.origin, dtype=torch.float64)) / spacing)[:, None]
    step = (directions / spacing)[None]
    crossings = [
        (torch.arange(count + 1.0, dtype=torch.float64) - start[..., axis, None]) / step[..., axis, None]
        for axis, count in enumerate(of.shape)
    ]
    along = torch.cat(crossings, -1).clamp(min=0).sort(-1).values
    middle = start[..., None, :] + (along[..., 1:] + along[..., :-1])[..., None] / 2 * step[..., None, :]
    cell = middle.floor().long()
    within = ((cell >= 0) & (cell < torch.tensor(of.shape))).all(-1)
    cell = cell.clamp(min=0).minimum(torch.tensor(of.shape) - 1)
    extinction = of.extinction.double()[cell[..., 0], cell[..., 1], cell[..., 2]]
    return (-(extinction * along.diff(dim=-1) * within).sum(-1)).exp()


def spread_in_cells(transfer, cells, count=5):
    """Points spread evenly over some cells, [cells * count^3, 3]."""
    steps = (torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5
    steps = torch.cartesian_prod(steps, steps, steps) * torch.tensor(transfer.receivers.spacing, dtype=torch.float64)
    return (transfer.positions[cells].double()[:, None] + steps).flatten(0, 1)


# Misuse


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": 0}, "order is 0"),
        ({"rays": 0}, "rays is 0"),
        ({"bounces": -1}, "bounces is -1"),
        ({"output_order": 6}, "output_order is 6"),
        ({"output_order": 0}, "output_order is 0"),
    ],
)
def test_refuses_what_makes_no_sense(options, message):
    with pytest.raises(InputError, match=message):
        baked(volume(phase=0.5), **options)


def test_tells_that_cells_are_too_thick():
    with pytest.warns(VolumeWarning, match="cells of volume are up to 10 mean free paths thick"):
        baked(Volume(torch.full((2, 2, 2), 10.0), spacing=1.0), rays=8, order=1, bounces=0)


def test_tells_that_a_phase_function_is_cut_off():
    with pytest.warns(VolumeWarning, match="has the moment 0.81"):
        baked(volume(phase=0.9), rays=8, order=2, bounces=0)


# What comes from the light


def test_light_agrees_with_paths_from_random_points_in_cells():
    of = volume()
    transfer = baked(of, rays=4096, bounces=0)
    chosen = torch.arange(0, transfer.vertices, 16)
    nodes, weights = sphere_nodes()
    left = transmittance(of, spread_in_cells(transfer, chosen), nodes).view(len(chosen), 125, -1).mean(1)
    expected = left @ (weights[:, None] * sh.basis(nodes, 5)) / (4 * math.pi)
    found = values(transfer)[0].T[chosen].double()
    # Random points err by a part of what light varies inside of a cell; the bake by what it says.
    assert (found - expected).square().mean().sqrt() < 2 * transfer.error + 0.01 * expected.square().mean().sqrt()


def test_a_uniform_sphere_has_the_light_of_the_closed_form():
    n, extinction = 24, 3.0
    finer = (torch.arange(4 * n) + 0.5) / (2 * n) - 1
    inside = torch.stack(torch.meshgrid(finer, finer, finer, indexing="ij")).square().sum(0) < 1
    filled = torch.nn.functional.avg_pool3d(inside[None].float(), 4)[0] * extinction
    transfer = baked(Volume(filled, 0.5, origin=(-1, -1, -1), spacing=2 / n), bounces=0, rays=1024)
    distance = transfer.positions.double().norm(dim=-1)
    # A chord from radius r at the angle of cosine m: the root of |r + t| = 1.
    cosine, weight = (torch.from_numpy(each) for each in np.polynomial.legendre.leggauss(64))
    whole = distance < 1 - 2 / n
    r = distance[whole, None]
    chord = -r * cosine + (1 - r.square() * (1 - cosine.square())).sqrt()
    expected = ((-extinction * chord).exp() * weight / 2).sum(-1)
    found = 0.5 * values(transfer)[0][0][whole].double() * math.sqrt(4 * math.pi)
    off = ((found - 0.5 * expected).square().mean() / (0.5 * expected).square().mean()).sqrt()
    assert off < 2 * transfer.error / transfer.signal + 0.005
    # A linear band: it is brighter toward the light; the sphere is the same from all sides.
    linear = values(transfer)[0][1:4].double()
    along = (linear * sh.basis(transfer.positions.double() / distance[:, None], 2)[:, 1:].T).sum(0)
    assert (along[distance > 0.3] > 0).all()


def test_nothing_is_taken_where_next_to_nothing_is():
    thin = baked(Volume(torch.full((4, 4, 4), 1e-12), spacing=1.0), bounces=0, rays=256)
    exact = torch.zeros(25)
    exact[0] = 1 / math.sqrt(4 * math.pi)
    assert (values(thin)[0] - exact[:, None]).abs().max() < 8 * EPSILON


# What cells send to each other


def tasks(of, rays=96, phase_order=3, blockers=()):
    inside = _inside(of, _cells(of), blockers, 3, tuple(of.moments[:phase_order]), rays, 0)
    enter = [Enter(slice(0, 9), group, rays, BOTH) for group in range(len(GROUPS))]
    scatter = [Scatter(slice(0, 9), group, rays, BOTH) for group in range(len(GROUPS))]
    return (
        sum(task(inside)["arrives"] for task in enter),
        lambda emission: sum(task(inside, emission)["arrives"] for task in scatter),
        inside,
    )


def test_light_that_is_the_same_everywhere_does_not_change_on_its_way():
    direct, scatter, inside = tasks(volume())
    ones = torch.ones(1, len(inside.medium.extinction), 9)
    arrives = scatter(ones)[..., 0] + direct[..., 0] * math.sqrt(4 * math.pi)
    assert (arrives - 1).abs().max() < 64 * EPSILON


def test_each_pass_keeps_energy():
    """What cells send out is taken by cells or goes out of the volume: as much as would come in on the same ways."""
    direct, scatter, inside = tasks(volume())
    sent = torch.rand(1, len(inside.medium.extinction), 9, generator=torch.Generator().manual_seed(3))
    takes = inside.medium.extinction[:, None].double()
    out = (sent * takes * direct[..., :1] * math.sqrt(4 * math.pi)).sum((0, 1))
    taken = (scatter(sent) * takes).sum((0, 1))
    whole = (sent * takes).sum((0, 1))
    assert ((out + taken - whole) / whole).abs().max() < 64 * EPSILON


@pytest.mark.parametrize("phase", [0.0, -0.4])
def test_what_one_cell_gets_from_another_that_gets_from_it(phase):
    _, scatter, inside = tasks(volume(phase=phase))
    rows = inside.rows
    generator = torch.Generator().manual_seed(4)
    one, other = (torch.randn(rows, len(inside.medium.extinction), 9, generator=generator) for _ in range(2))
    # Light that goes the other way has odd bands of the other sign; emission weighs them with the moments.
    bands = torch.repeat_interleave(torch.arange(3), torch.arange(1, 6, 2))[:rows, None, None]
    moments = torch.tensor(inside.moments)[bands]
    turned = (-1.0) ** bands
    takes = inside.medium.extinction[:, None].double()
    there = (one * moments * turned * scatter(other) * takes).sum()
    back = (other * moments * turned * scatter(one) * takes).sum()
    size = (one * moments * scatter(other) * takes).abs().sum()
    assert abs(there - back) < 64 * EPSILON * size


def test_scattering_agrees_with_rays_that_are_marched_from_cells():
    of = volume(n=6, depth=2.5)
    transfer = baked(of, rays=4096, bounces=1, order=1)
    single = baked(of, rays=4096, bounces=0, order=1)
    emission = transfer.receivers.dense(0.9 * values(single)[0]).double()[0]
    chosen = torch.arange(0, transfer.vertices, 6)
    points = spread_in_cells(transfer, chosen, 4)
    nodes, weights = sh.fibonacci(200)
    spacing = 2 / 6
    expected = torch.zeros(len(points), dtype=torch.float64)
    steps = 160
    length = 2 * math.sqrt(3) / steps
    left = torch.ones(len(points), len(nodes), dtype=torch.float64)
    for step in range(steps):
        place = points[:, None] + (step + 0.5) * length * nodes
        cell = ((place + 1) / spacing).floor().long()
        within = ((cell >= 0) & (cell < 6)).all(-1)
        i, j, k = cell.clamp(0, 5).unbind(-1)
        kept = torch.where(within, (-of.extinction[i, j, k].double() * length).exp(), 1)
        expected += (left * (1 - kept) * emission[i, j, k]) @ (weights / (4 * math.pi))
        left *= kept
    added = (values(transfer) - values(single))[0, 0][chosen].double()
    expected = expected.view(len(chosen), 64).mean(1)
    assert (added - expected).square().mean().sqrt() < 2 * transfer.error + 0.01 * expected.square().mean().sqrt()


@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_endless_passes_solve_the_linear_system_that_they_are_the_series_of(phase):
    of = Volume(lump(4, 2.0), 0.95, spacing=0.5, phase=phase)
    transfer = baked(of, rays=1024, bounces=math.inf, order=2)
    _, _, inside = tasks(of, rays=64, phase_order=2 if phase else 1)
    inside = dataclasses.replace(inside, order=2)
    enter = [Enter(slice(0, 4), g, 1024, half) for half in (0, 1) for g in range(6)]
    direct = sum(task(inside)["arrives"] for task in enter).double() / 2
    rows, count, columns = direct.shape
    size = rows * count
    sweeps = [Scatter(slice(0, size), g, 64, half) for half in (0, 1) for g in range(6)]
    unit = torch.eye(size).view(rows, count, size)
    matrix = sum(task(inside, 0.95 * unit)["arrives"] for task in sweeps).double().view(size, size) / 2
    solved = torch.linalg.solve(torch.eye(size, dtype=torch.float64) - matrix, direct.view(size, columns))
    found = values(transfer)
    found = found.permute(0, 2, 1) if not phase else found[0].permute(1, 0, 2)
    # The last pass is over the two halves of the directions, all before over both together.
    assert ((found.reshape(size, columns) - solved).norm() / solved.norm()) < 5e-3


def test_one_pass_after_the_other_comes_to_what_endless_ones_do():
    of = volume(depth=2.0, albedo=0.6)
    many, endless = baked(of, bounces=12, order=2), baked(of, bounces=math.inf, order=2)
    assert many.bounces == 12
    assert endless.bounces < 12
    assert (values(many) - values(endless)).norm() < 2 * endless.error / endless.signal * values(many).norm()


def test_a_white_volume_is_not_seen_in_light_that_is_the_same_everywhere():
    of = Volume(lump(10, 5.0), 1.0, spacing=0.2)
    transfer = baked(of, rays=2048, bounces=math.inf)
    radiance = prt.shader(transfer)(WHITE)
    assert (radiance - 1).square().mean().sqrt() < 3 * transfer.error / transfer.signal
    assert abs(radiance.mean() - 1) < 2e-3


def test_a_black_volume_scatters_nothing():
    transfer = baked(volume(albedo=0.0), bounces=math.inf)
    assert transfer.bounces == 0
    assert not prt.shader(transfer)(WHITE).any()


def test_each_colour_is_as_if_it_were_alone():
    colour = (1.0, 0.5, 0.0)
    coloured = baked(volume(albedo=colour), bounces=2, order=2)
    assert coloured.channels == 3
    for channel, albedo in enumerate(colour):
        alone = baked(volume(albedo=albedo), bounces=2 if albedo else 0, order=2)
        assert torch.equal(values(coloured)[channel], values(alone)[0])
    assert baked(volume(albedo=colour), bounces=0, order=2).channels == 1


def test_endless_passes_end_where_a_colour_or_a_cell_scatters_nothing():
    albedo = 0.7 * (torch.rand(8, 8, 8, 3, generator=torch.Generator().manual_seed(7)) > 0.3)
    albedo[..., 2] = 0
    of = volume(depth=2.0, albedo=albedo)
    endless, many = baked(of, bounces=math.inf, order=2), baked(of, bounces=20, order=2)
    assert endless.bounces < 20
    assert (values(many) - values(endless)).norm() < 2e-4 * values(many).norm()


def test_albedo_may_differ_from_cell_to_cell():
    albedo = torch.rand(8, 8, 8, 1, generator=torch.Generator().manual_seed(5))
    transfer = baked(volume(albedo=albedo), bounces=1, order=2)
    layer = transfer.layers["diffuse"]
    assert torch.equal(layer.albedo[:, 0], albedo.flatten()[transfer.receivers.cells.long()])
    uniform = baked(volume(albedo=1.0), bounces=1, order=2)
    assert (values(transfer)[0, 0] < values(uniform)[0, 0]).all()


# Phase functions


def test_single_scattering_of_a_phase_function_agrees_with_quadrature():
    of, g = volume(n=6, depth=2.0, phase=0.5), 0.5
    transfer = baked(of, rays=4096, bounces=0)
    chosen = torch.arange(0, transfer.vertices, 8)
    nodes, weights = sphere_nodes()
    left = transmittance(of, spread_in_cells(transfer, chosen), nodes).view(len(chosen), 125, -1).mean(1)
    light = torch.randn(25, 3, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    light[0] += 5
    eye = torch.tensor([3.0, 2.0, 1.0], dtype=torch.float64)
    toward = torch.nn.functional.normalize(eye - transfer.positions[chosen].double(), dim=-1)
    # Light from s goes on along -s; it is turned by the angle between that and the way to the eye.
    cosine = -toward @ nodes.T
    phase = (1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5 / (4 * math.pi)
    expected = 0.9 * (left * phase * weights) @ (sh.basis(nodes, 5) @ light)
    layer = transfer.layers["phase"]
    bands = torch.repeat_interleave(torch.tensor(layer.moments), torch.arange(1, 10, 2)).double()
    eyes = sh.basis(-toward, 5) * bands
    found = 0.9 * (eyes[..., None] * (values(transfer)[0][chosen].double() @ light)).sum(1)
    assert ((found - expected).square().mean() / expected.square().mean()).sqrt() < 0.02


def test_a_phase_function_of_one_moment_is_none():
    isotropic, told = baked(volume(), order=3), baked(volume(phase=(1.0,)), order=3)
    assert torch.equal(values(isotropic), values(told))
    # All moments but the first zero, yet followed: what arrives is more than is scattered, and its mean the same.
    direct, _, _ = tasks(volume(phase=0.3))
    assert (direct[0] - tasks(volume())[0][0] * math.sqrt(4 * math.pi)).abs().max() < 5e-3


# Surfaces


def floor(height=-0.25, size=8.0):
    corners = torch.tensor([[-size, height, -size], [size, height, -size], [size, height, size], [-size, height, size]])
    return Object(make_mesh(corners.numpy(), np.array([[0, 2, 1], [0, 3, 2]])), role="blocker")


def test_a_floor_takes_the_light_from_below():
    thin = Volume(torch.full((4, 4, 4), 1e-9), 0.9, origin=(-1, -1, -1), spacing=0.5)
    transfer = baked(thin, rays=1024, bounces=0, blockers=[floor(-0.5, 1e4)])
    height = transfer.positions[:, 1]
    # Half of the mean over the sphere comes from above; of the linear band y the integral over a half.
    above, below = values(transfer)[0][:, height > -0.5], values(transfer)[0][:, height < -0.5]
    assert (above[0] - 0.5 / math.sqrt(4 * math.pi)).abs().max() < 2e-3
    up = sh.basis(torch.tensor([0.0, 1.0, 0.0]), 2)[1] / 4
    assert (above[1] - up).abs().max() < 2e-3
    assert (below[1] + up).abs().max() < 2e-3


def test_what_is_scattered_ends_on_a_floor():
    slab = Volume(torch.full((6, 6, 6), 2.0), 1.0, spacing=0.2)
    _, through, inside = tasks(slab)
    _, cut, _ = tasks(slab, blockers=[floor(0.6)])
    lower = inside.medium.places[:, 1] < 3
    emission = torch.zeros(1, len(lower), 9)
    emission[:, lower] = 1
    assert (through(emission)[0, ~lower, 0] > 0).all()
    assert not cut(emission)[0, ~lower].any()
    assert cut(emission)[0, lower, 0].min() > 0.2


def test_a_body_around_all_of_it_leaves_nothing():
    sphere = load(_box(3.0)).objects[0]
    transfer = baked(volume(), blockers=[Object(sphere.mesh, role="blocker")], order=2)
    assert not values(transfer).any()


def _box(size):
    corners = np.array([[x, y, z] for x in (-size, size) for y in (-size, size) for z in (-size, size)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6]]
    return make_mesh(corners, np.array([*faces, [0, 6, 4], [1, 5, 7], [1, 7, 3]]))


# The same whoever runs it


def test_the_same_bits_for_any_threads_and_in_processes():
    of = volume(phase=0.3)
    one = values(baked(of, order=2, bounces=2))
    assert torch.equal(one, values(baked(of, order=2, bounces=2, threads=3)))
    with Processes(2) as processes:
        assert torch.equal(one, values(baked(of, order=2, bounces=2, threads=None, runner=processes)))


@pytest.mark.parametrize("bounces", [3, math.inf])
@pytest.mark.parametrize("stage", ["light", "pass 3"])
def test_goes_on_where_it_was_stopped(tmp_path, bounces, stage):
    class Stopped:
        def start(self, name, total, done=0):
            self.here = name == stage
            self.first = getattr(self, "first", name)

        def advance(self, count):
            if self.here:
                raise KeyboardInterrupt

    of, folder = volume(), tmp_path / "kept"
    whole = baked(of, order=2, bounces=bounces)
    with pytest.raises(KeyboardInterrupt):
        baked(of, order=2, bounces=bounces, checkpoint=folder, progress=Stopped())
    told = []

    class Listener:
        def start(self, name, total, done=0):
            told.append((name, done))

        def advance(self, count):
            pass

    again = baked(of, order=2, bounces=bounces, checkpoint=folder, progress=Listener())
    assert torch.equal(values(whole), values(again))
    assert again.bounces == whole.bounces
    assert not folder.exists()
    assert told[0][1] > 0
    if stage != "light":
        assert "pass 1" not in [name for name, _ in told]


def test_a_checkpoint_of_another_volume_is_not_used(tmp_path):
    baked(volume(), order=1, bounces=1, checkpoint=tmp_path / "kept", keep=True)
    with pytest.warns(CheckpointWarning):
        other = baked(volume(albedo=0.5), order=1, bounces=1, checkpoint=tmp_path / "kept")
    assert torch.equal(values(other), values(baked(volume(albedo=0.5), order=1, bounces=1)))


@pytest.mark.parametrize(("scale", "moved"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)])
def test_neither_scale_nor_place_matters(scale, moved):
    of = volume()
    other = Volume(of.extinction / scale, 0.9, [scale * each + moved for each in of.origin], scale * of.spacing[0])
    one, two = values(baked(of, order=3)), values(baked(other, order=3))
    assert (one - two).abs().max() < 64 * EPSILON * one.abs().max()


def test_empty_cells_around_it_change_nothing():
    of = volume()
    padded = torch.nn.functional.pad(of.extinction, (2, 1, 0, 3, 5, 2))
    larger = Volume(padded, 0.9, origin=(-1 - 5 * 0.25, -1, -1 - 2 * 0.25), spacing=0.25)
    one, two = baked(of, order=2), baked(larger, order=2)
    assert one.vertices == two.vertices
    assert torch.equal(values(one), values(two))
    assert torch.allclose(one.positions, two.positions)


def test_cells_need_not_be_cubes():
    """Twice as many cells of half the height are the same volume."""
    of = Volume(lump(6, 1.0), 0.9, spacing=(1.0, 1.0, 1.0))
    finer = Volume(of.extinction.repeat_interleave(2, 1), 0.9, spacing=(1.0, 0.5, 1.0))
    one, two = baked(of, order=2, rays=4096), baked(finer, order=2, rays=4096)
    coarse = one.receivers.dense(values(one)[0])
    mean = two.receivers.dense(values(two)[0]).unflatten(2, (6, 2)).mean(3)
    assert ((coarse - mean).norm() / coarse.norm()) < 3 * one.error / one.signal


def test_one_cell():
    transfer = baked(Volume(torch.ones(1, 1, 1), 1.0), order=1, rays=1024, bounces=math.inf)
    assert transfer.vertices == 1
    assert abs(float(prt.shader(transfer)(WHITE[:1])[0, 0]) - 1) < 0.02


def test_directions_integrate_what_they_can():
    for half in (0, 1, BOTH):
        chosen = direction_set(256, 0, half, 6)
        harmonics = sh.basis(chosen.places, 7)
        integrals = chosen.weights @ harmonics
        integrals[0] -= math.sqrt(4 * math.pi)
        assert integrals.abs().max() < 1e-10
        assert chosen.weights.min() > 0
