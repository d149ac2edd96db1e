"""Does a volume take from the light that comes to surfaces what it must, and send them what its cells scatter?

The twins are closed forms (a slab, a box that lets nothing through), a loop in float64 over sorted planes, and a
volume that is not there: one that only scatters forward sends on all that it takes.
"""

import math

import numpy as np
import pytest
import torch
from contents import differing
from shapes import square

from torchprt import sh
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, Volume, make_mesh, samples
from torchprt.scene.samples.coloured_box import block
from torchprt.trace import Tracer
from torchprt.transfer import Cells, Dense, Diffuse, Phase, Transfer
from torchprt.transport import CheckpointWarning, bake, bake_volume, hemisphere, unshadowed
from torchprt.transport.through_volume import through

ORDER = 4


def body(gloss=None):
    return Material(0.3, gloss=gloss, specular=0.5) if gloss else Material(0.3)


def floor(material=None, size=2.0, height=0.0, up=True, resolution=3):
    return Object(square(size, resolution, height, up), material or Material(0.5))


def noise(shape=(4, 3, 5), origin=(-1.0, 0.3, -1.2), spacing=(0.5, 0.4, 0.45), depth=4.0, **more):
    """A grid of cells of any extinction, a third of them empty."""
    generator = np.random.default_rng(3)
    values = generator.uniform(0, depth, shape) * (generator.uniform(size=shape) > 0.33)
    return Volume(values, 0.9, origin=origin, spacing=spacing, **more)


def baked(volume, moments=None, albedo=1.0, order=ORDER, directional=False):
    """The transfer of a volume whose cells receive all the light there is, as if nothing were in their way."""
    number = torch.nonzero(volume.occupied.flatten())[:, 0]
    cells = Cells(
        shape=volume.shape,
        origin=volume.origin,
        spacing=volume.spacing,
        cells=number.int(),
        extinction=volume.extinction.flatten()[number],
    )
    weight = torch.as_tensor(albedo, dtype=torch.float32).reshape(1, -1)
    if moments is None:
        values = torch.zeros(1, order**2, len(number))
        values[:, 0] = 1 / math.sqrt(4 * math.pi)
        layer = Diffuse(albedo=weight, signal=Dense(values=values))
    else:
        matrix = torch.eye(len(moments) ** 2, order**2).expand(1, len(number), -1, -1).contiguous()
        layer = Phase(albedo=weight, signal=Dense(values=matrix), moments=moments)
    return Transfer(receivers=cells, layers={layer.kind: layer}, transport="unshadowed")


def vectors(transfer):
    return transfer.layers["diffuse"].signal.values


def run(scene, volume=None, rays=128, **options):
    return bake(scene, order=ORDER, rays=rays, volume=volume, progress=False, **options)


# Misuse


def test_refuses_what_cannot_be_recorded_beside_a_volume():
    plain, cloud = Scene([floor()]), noise()
    with pytest.raises(InputError, match="casts shadows"):
        run(plain, cloud, shadows=False)
    with pytest.raises(InputError, match="mirrors"):
        run(Scene([floor(), floor(Material(mirror=0.9), height=1.0)]), cloud)
    shiny = Scene([floor(body("phong:4"))])
    with pytest.raises(InputError, match="frame 'visibility'"):
        run(shiny, baked(cloud), frame="visibility")
    with pytest.raises(InputError, match="not recorded in a volume"):
        run(plain, run(plain))
    with pytest.raises(InputError, match="order"):
        run(plain, baked(cloud, order=2))


# A volume that is not there


@pytest.mark.parametrize("bounces", [0, 1])
@pytest.mark.parametrize("gloss", [None, "phong:4"])
def test_a_volume_that_no_ray_meets_changes_no_bit(gloss, bounces):
    scene = Scene([floor(body(gloss)), floor(height=1.0, up=False)])
    below = noise(origin=(-1.0, -9.0, -1.0))
    expected = run(scene, bounces=bounces)
    for volume in (below, baked(below)):
        assert not differing(run(scene, volume, bounces=bounces), expected)


@pytest.mark.parametrize("frame", [None, "exit", "incident"])
def test_a_volume_that_only_scatters_forward_is_not_there(frame):
    material = body(None if frame is None else "ggx:0.4")
    scene, options = Scene([floor(material)]), {} if frame is None else {"frame": frame}
    found, expected = (run(scene, each, rays=1024, **options) for each in (baked(noise(), [1.0] * ORDER), None))
    for name, layer in expected.layers.items():
        # What nothing blocks is exact, what comes along rays has their error: a third of 1e-4 for functions that are
        # smooth, more for incident radiance, which ends at the horizon.
        error = 2e-3 if name == "incident" else 1e-4
        torch.testing.assert_close(found.layers[name].signal.values, layer.signal.values, atol=error, rtol=0)
    assert float((vectors(run(scene, noise(), **options)) - vectors(expected)).abs().max()) > 0.05


def test_cells_that_send_what_they_take_leave_a_light_that_is_the_same_everywhere():
    scene = Scene([floor(body("phong:4"))])
    shadowed, found, expected = (run(scene, volume, rays=256) for volume in (noise(), baked(noise()), None))
    for name, layer in expected.layers.items():
        columns = (each.layers[name].signal.values for each in (shadowed, found, expected))
        without, here, there = (each[:, 0] if each.ndim == 3 else each[..., 0] for each in columns)
        # Weights of the cosine add up to 1, the rows of a gloss have the error of the rays.
        torch.testing.assert_close(here, there, atol=3e-6 if name == "diffuse" else 2e-4, rtol=0)
        assert float((without - there).abs().max()) > 0.05


def test_cells_give_their_colour_to_a_scene_without_any():
    found = run(Scene([floor()]), baked(noise(), albedo=[1.0, 0.5, 0.0]))
    assert found.channels == 3
    shadow = vectors(run(Scene([floor()]), noise()))[0]
    red, green, blue = vectors(found)
    torch.testing.assert_close(blue, shadow)
    torch.testing.assert_close(2 * (green - blue), red - blue)


# Closed forms


def test_a_slab_dims_the_sky_as_its_closed_form_says():
    depth = 0.8
    slab = Volume(np.full((3, 2, 3), depth), origin=(-600.0, 0.1, -600.0), spacing=(400.0, 0.5, 400.0))
    found = vectors(run(Scene([floor()]), slab, rays=4096))[0]
    nodes, weights = sh.gauss_legendre_hemisphere(200)
    x, y, cosine = nodes.unbind(-1)
    # The pole of the rule is z, that of the floor +y.
    harmonics = sh.basis(torch.stack([x, cosine, y], -1), ORDER)
    expected = (weights * cosine / math.pi * torch.exp(-depth / cosine)) @ harmonics
    # The rays' own error, which is below 3e-4 for smooth functions and so many of them.
    torch.testing.assert_close(found, expected.float()[:, None].expand_as(found), atol=3e-4, rtol=0)
    sent = vectors(run(Scene([floor()]), baked(slab), rays=4096))[0, 0]
    whole = unshadowed(torch.tensor([[0.0, 1.0, 0.0]]), ORDER)[0, 0]
    torch.testing.assert_close(sent, whole.expand_as(sent), atol=1e-5, rtol=0)


@pytest.mark.parametrize("gloss", [None, "phong:4"])
def test_a_volume_that_lets_nothing_through_does_what_a_black_box_does(gloss):
    # Also to light that bounces: one floor above the other, the box in between.
    surfaces = [floor(body(gloss)), floor(Material(0.9), height=2.0, up=False)]
    low, size = (-0.4, 0.8, -0.5), (0.9, 0.5, 0.7)
    box = make_mesh(*block((low[0] + size[0] / 2, low[1], low[2] + size[2] / 2), size, 0.0, 8), name="box")
    under = [
        (low[0], low[2]),
        (low[0] + size[0], low[2]),
        (low[0] + size[0], low[2] + size[2]),
        (low[0], low[2] + size[2]),
    ]
    base = make_mesh(
        torch.tensor([[x, low[1], z] for x, z in under], dtype=torch.float64), torch.tensor([[0, 1, 2], [0, 2, 3]])
    )
    solid = [Object(each, Material(0.0), role="blocker") for each in (box, base)]
    fog = Volume(np.full((1, 1, 1), 1e6), origin=low, spacing=size)
    for bounces in (0, 2):
        found = run(Scene(surfaces), fog, bounces=bounces)
        expected = run(Scene([*surfaces, *solid]), bounces=bounces)
        for name, layer in expected.layers.items():
            values = found.layers[name].signal.values
            torch.testing.assert_close(values, layer.signal.values, atol=2e-5, rtol=0)


# A loop in float64


def twin(volume, origin, direction, end):
    """Transmittance along a ray, and what each cell adds to it: cells are where their planes are crossed."""
    planes = [volume.origin[a] + volume.spacing[a] * np.arange(volume.shape[a] + 1) for a in range(3)]
    crossings = np.concatenate([(planes[a] - origin[a]) / direction[a] for a in range(3)])
    times = np.unique(np.clip(np.append(crossings, [0.0, end]), 0, end))
    left, gains = 1.0, {}
    for first, last in zip(times[:-1], times[1:], strict=True):
        place = (origin + (first + last) / 2 * direction - volume.origin) / volume.spacing
        cell = tuple(np.floor(place).astype(int))
        if all(0 <= at < count for at, count in zip(cell, volume.shape, strict=True)):
            depth = float(volume.extinction[cell]) * (last - first)
            if depth:
                gains[cell] = gains.get(cell, 0) + left * -np.expm1(-depth)
            left *= np.exp(-depth)
    return left, gains


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_agrees_with_a_loop_over_sorted_planes(scale, shift):
    move = np.array([shift, -2 * shift, 0.5 * shift]) * scale
    values = noise(depth=4 / scale).extinction
    volume = Volume(
        values,
        0.9,
        origin=tuple(scale * np.array([-1.0, 0.3, -1.2]) + move),
        spacing=tuple(scale * np.array([0.5, 0.4, 0.45])),
    )
    ceiling = floor(height=1.1, up=False, size=1.5)
    scene = Scene(
        [
            Object(make_mesh(each.mesh.positions * scale + torch.tensor(move), each.mesh.faces), each.material)
            for each in (floor(), ceiling)
        ]
    )
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    points = torch.tensor([[0.1, 0.0, 0.2], [-0.6, 0.0, 0.7], [0.05, 0.7, -0.1]], dtype=torch.float64)
    points = points * scale + torch.tensor(move)
    normals = torch.tensor([[0.0, 1.0, 0.0]] * 3, dtype=torch.float64)
    origins = tracer.origins(points, normals)
    frames = torch.eye(3).expand(3, 3, 3)
    directions = torch.cat([hemisphere(20), -hemisphere(20)]).float()
    weights = torch.rand(len(directions), generator=torch.Generator().manual_seed(0))
    hits = tracer.hits(origins, frames, directions)
    met = through(baked(volume, [1.0, 0.5, 0.25]), ORDER)
    found = met.seen(tracer, origins, frames, directions, hits, weights, along_rays=True)
    away = met.left(tracer, origins, frames, directions, hits.triangle < 0)
    ends = tracer.distances(origins, hits).double() / tracer.scale
    sent = torch.zeros_like(found.arrives, dtype=torch.float64)
    start = origins.double() / tracer.scale + tracer.centre
    for row in range(3):
        for column, direction in enumerate(directions.double()):
            end = min(float(ends[row, column]), 100 * scale)
            left, gains = twin(volume, start[row].numpy(), direction.numpy(), end)
            assert float(found.left[row, column]) == pytest.approx(left, abs=5e-5)
            if hits.triangle[row, column] < 0:
                assert away[row, column] == found.left[row, column]
            bands = torch.repeat_interleave(torch.tensor([1.0, 0.5, 0.25]), torch.tensor([1, 3, 5]))
            along = torch.zeros(ORDER**2, dtype=torch.float64)
            along[:9] = sh.basis(direction, 3) * bands * sum(gains.values())
            torch.testing.assert_close(found.radiance[row, column].double(), along, atol=5e-5, rtol=0)
            sent[row] += along * weights[column]
    torch.testing.assert_close(found.arrives.double(), sent, atol=5e-4, rtol=0)
    # Not trivial: some rays are blocked beyond the volume or in it, and some light is left.
    assert float((found.left < 0.9).float().mean()) > 0.05
    assert bool((hits.triangle >= 0).any())


# Whoever runs it, and wherever


def scenes():
    return Scene([floor(body("phong:4"), resolution=24), floor(height=3.0, up=False, resolution=12)])


@pytest.mark.parametrize("bounces", [0, 2])
def test_any_number_of_threads_and_any_interruption_give_the_same_bits(tmp_path, bounces):
    class Stops:
        def start(self, stage, total, done=0):
            self.done = done

        def advance(self, count):
            raise KeyboardInterrupt

    scene, cloud, folder = (
        scenes(),
        bake_volume(noise(depth=1.5), order=ORDER, rays=64, progress=False),
        tmp_path / "kept",
    )
    one = run(scene, cloud, rays=32, bounces=bounces, threads=1)
    assert not differing(run(scene, cloud, rays=32, bounces=bounces, threads=3), one)
    with pytest.raises(KeyboardInterrupt):
        bake(scene, order=ORDER, rays=32, bounces=bounces, volume=cloud, checkpoint=folder, progress=Stops())
    assert list(folder.glob("chunk-*"))
    assert not differing(run(scene, cloud, rays=32, bounces=bounces, checkpoint=folder, keep=True), one)
    # What was kept is of this volume and of no other.
    with pytest.warns(CheckpointWarning):
        run(scene, noise(depth=3.9), rays=32, bounces=bounces, checkpoint=folder)


@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)])
def test_size_and_distance_of_the_scene_change_nothing(scale, shift):
    move = np.array([shift, shift, -shift])

    def made(scale, move):
        sheets = [floor(resolution=4), floor(height=3.0, up=False)]
        objects = [
            Object(make_mesh(each.mesh.positions * scale + torch.tensor(move), each.mesh.faces), each.material)
            for each in sheets
        ]
        place = {"origin": tuple(scale * np.array([-1.0, 0.3, -1.2]) + move), "spacing": 0.45 * scale}
        return run(Scene(objects), baked(noise(depth=4 / scale, **place)), bounces=1)

    # A ray by a plane of the grid may be told to be on its other side, which moves little.
    torch.testing.assert_close(vectors(made(scale, move)), vectors(made(1.0, 0 * move)), atol=2e-4, rtol=0)


def test_points_lie_in_the_shadow_as_vertices_do():
    scene, cloud = Scene([floor(resolution=4), floor(Material(0.7), height=3.0, up=False)]), baked(noise())
    geometry = scene.geometry()
    places = Points(geometry.receiver_positions, geometry.receiver_normals, albedo=0.5)
    for bounces in (0, 1):
        found, expected = run(scene, cloud, bounces=bounces, receivers=places), run(scene, cloud, bounces=bounces)
        # Rays of vertices start a little farther off.
        torch.testing.assert_close(vectors(found), vectors(expected), atol=1e-4, rtol=0)


def test_the_shadow_of_the_sample_lies_below_it_and_moves_with_the_light():
    cloud = samples.cloud(12)
    cloud = Volume(cloud.extinction, 0.99, origin=(-1.0, 0.5, -1.0), spacing=cloud.spacing)
    scene = Scene([floor(size=8.0, resolution=17)])
    found = run(scene, cloud)

    def darkest(direction):
        light = sh.basis(torch.nn.functional.normalize(torch.tensor(direction), dim=0), ORDER)
        seen = light @ (vectors(found)[0] - vectors(run(scene))[0])
        return found.positions[seen.argmin(), [0, 2]]

    assert float(darkest([0.0, 1.0, 0.0]).norm()) <= 0.8
    assert float(darkest([0.7, 0.7, 0.0])[0]) <= -0.5
