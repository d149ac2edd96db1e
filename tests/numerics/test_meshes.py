"""Does a bake hold on meshes that are tiny, huge, far away or badly made?"""

import functools
import math
import warnings

import pytest
import torch
import trimesh
from shapes import square

from torchprt.compression import compress, decompress, fit
from torchprt.errors import InputError
from torchprt.scene import Material, Points, load, make_mesh
from torchprt.shade import shader
from torchprt.transport import OrderWarning, bake

# The checks of shapes would take most of the time.
pytestmark = pytest.mark.usefixtures("untyped")
RAYS = 64
ONE = math.sqrt(4 * math.pi)


def quiet(scene, **options):
    return bake(scene, **{"rays": RAYS, "order": 3, "threads": 1, "progress": False, **options})


def white(transfer):
    """Radiance under a constant light of 1."""
    light = torch.zeros(transfer.order**2, 3)
    light[0] = ONE
    return shader(transfer)(light)[:, 0]


def triangles(*corners):
    return torch.tensor(corners, dtype=torch.float64).reshape(-1, 3), torch.arange(3 * len(corners)).reshape(-1, 3)


def steps():
    """A floor with a wall on it: shadows, and an edge where rays start in a corner."""
    floor = square(resolution=4)
    wall = torch.stack([torch.full((16,), 0.5).double(), floor.positions[:, 0] + 0.5, floor.positions[:, 2]], -1)
    return torch.cat([floor.positions, wall]), torch.cat([floor.faces, floor.faces + 16])


def with_needle():
    points, faces = steps()
    more, last = triangles([[0, 0.2, 0], [1, 0.2, 0], [0.5, 0.2, 1e-6]])
    return torch.cat([points, more]), torch.cat([faces, last + len(points)])


def with_sliver():
    points, faces = steps()
    more, last = triangles([[0, 0.2, 0], [1, 0.2, 0], [0.5, 0.2 + 1e-15, 0]], [[0, 0.3, 0], [0, 0.3, 0], [0, 0.3, 1]])
    return torch.cat([points, more]), torch.cat([faces, last + len(points)])


def coincident():
    points, faces = steps()
    return torch.cat([points, points]), torch.cat([faces, faces + len(points)])


def both_windings():
    points, faces = steps()
    return points, torch.cat([faces, faces.flip(1)])


def inside_out():
    ball = trimesh.creation.icosphere(subdivisions=2)
    return torch.tensor(ball.vertices).double(), torch.tensor(ball.faces).flip(1)


def loose():
    points, faces = steps()
    return torch.cat([points, torch.tensor([[0.3, 2.0, 0.1], [0.3, 2.0, 0.1]]).double()]), faces


MESHES = {
    one.__name__.replace("_", " "): one
    for one in (steps, with_needle, with_sliver, coincident, both_windings, inside_out, loose)
}
SCALES = (1e-6, 1.0, 1e6)
# In sizes of the mesh; float64 has 1e-10 of it left at the last.
MOVES = (0.0, 1e4, 1e6)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_vertices_for_a_triangle_are_refused_by_name(count):
    places, faces = torch.zeros(count, 3, dtype=torch.float64), torch.zeros(0, 3, dtype=torch.int64)
    with pytest.raises(InputError, match="dots"):
        quiet(load(make_mesh(places + torch.arange(count)[:, None], faces, name="dots")))


@pytest.mark.parametrize("count", [1, 2])
def test_one_point_or_two_are_baked_packed_and_shaded(count):
    places = torch.tensor([[0.0, 0.1, 0.0]]).double().expand(count, 3).contiguous()
    up = torch.tensor([[0.0, 1.0, 0.0]]).double().expand(count, 3).contiguous()
    transfer = quiet(load(make_mesh(*steps())), receivers=Points(places, up, 1.0))
    assert white(transfer).shape == (count,)
    assert white(transfer).min() > 0.3
    packed = compress(transfer, clusters=1, components=1)
    torch.testing.assert_close(white(packed), white(transfer))
    torch.testing.assert_close(white(decompress(packed)), white(transfer))
    assert white(fit(transfer)).isfinite().all()


def test_no_point_is_refused():
    with pytest.raises(InputError, match="points are none"):
        quiet(load(make_mesh(*steps())), receivers=Points(torch.zeros(0, 3), torch.zeros(0, 3), 1.0))


@functools.cache
def plain(name):
    return white(quiet(load(make_mesh(*MESHES[name]()))))


@pytest.mark.parametrize("moved", MOVES)
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("name", MESHES)
def test_size_and_place_change_a_grazing_ray_or_none(name, scale, moved):
    points, faces = MESHES[name]()
    there = torch.tensor([1.0, -0.7, 0.3]).double() * moved
    wanted = plain(name)
    found = white(quiet(load(make_mesh((points + there) * scale, faces))))
    assert found.isfinite().all()
    # No surface sends more than it gets, but for the noise of the directions.
    assert -0.05 < found.min() <= found.max() < 1.05
    # Slivers are below the rounding of coordinates far away, and their normals with them.
    kept = slice(0, 32) if name in ("with needle", "with sliver") else slice(None)
    # Of 64 rays, one that lies along an edge may go the other way.
    assert (found - wanted)[kept].abs().mean() < 1 / RAYS
    assert (found - wanted)[kept].abs().max() < 6 / RAYS


@pytest.mark.parametrize("material", [Material(0.5), Material(0.0, gloss="phong:1e4"), Material(0.0, gloss="ggx:0.05")])
@pytest.mark.parametrize("name", MESHES)
def test_matrices_and_bounces_are_finite(name, material):
    with warnings.catch_warnings():
        # Three bands are few for such a gloss.
        warnings.simplefilter("ignore", OrderWarning)
        transfer = quiet(load(make_mesh(*MESHES[name]()), material=material), bounces=1, rays=16)
    assert all(layer.signal.dense().values.isfinite().all() for layer in transfer.layers.values())
