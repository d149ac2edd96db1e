"""Is what is baked around an object what its shape and its surface say, node by node?"""

import math
import pickle
import warnings

import pytest
import torch
from neighbourhoods import box_mesh, slab, slab_around

from torchprt import InputError, sh
from torchprt.scene import Material, Object, Scene, samples
from torchprt.trace import Tracer
from torchprt.transport import GridWarning, bake_neighbourhood
from torchprt.transport.directions import sphere
from torchprt.transport.enclosing import enclosing_box

# Grids are coarse here, so that they are quick to bake.
pytestmark = pytest.mark.filterwarnings("ignore:a grid of:torchprt.transport.GridWarning")

SMALL = {"order": 3, "output_order": 2, "grid": (3, 3, 3), "rays": 64, "progress": False, "threads": 1}
BOX = (-2.0, -2.0, -2.0, 2.0, 2.0, 2.0)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"output_order": 4}, "output_order is 4"),
        ({"grid": (1, 2, 2)}, "from 2 each"),
        ({"grid": 7}, "from 8"),
        ({"grid": (2, 2)}, "three counts"),
        ({"box": (0.0, 1.0)}, "six finite"),
        ({"box": (0.0, 0.0, 0.0, 1.0, -1.0, 1.0)}, "is empty"),
        ({"share": 0.0}, "between 0 and 1"),
        ({"rays": 0}, "rays is 0"),
        ({"bounces": -1}, "bounces is -1"),
        ({"box": (-0.3, -0.04, -0.3, 0.3, 0.04, 0.3)}, "lies in the object"),
    ],
)
def test_refuses_what_makes_no_sense(wrong, words):
    with pytest.raises(InputError, match=words):
        bake_neighbourhood(slab(), **SMALL | wrong)


def test_directions_cover_the_sphere_evenly():
    found = sphere(4096, seed=3)
    torch.testing.assert_close(found.norm(dim=-1), torch.ones(4096, dtype=torch.float64))
    # Of a smooth function: a set that is spread evenly errs as 1 / count.
    products = sh.basis(found, 4).mT @ sh.basis(found, 4) * (4 * math.pi / 4096)
    torch.testing.assert_close(products, torch.eye(16, dtype=torch.float64), rtol=0, atol=2e-3)
    assert not torch.equal(found, sphere(4096, seed=4))
    with pytest.raises(InputError, match="rays is 0"):
        sphere(0)


def test_an_object_that_is_not_seen_leaves_the_identity():
    """Far away it is missed by all rays: what is left is rounding of the sum over them."""
    speck = Scene([Object(box_mesh((-1e-4,) * 3, (1e-4,) * 3), Material(0.5))])
    found = bake_neighbourhood(speck, **SMALL | {"box": (1.0, 1.0, 1.0, 2.0, 2.0, 2.0)})
    values = found.layers["neighbourhood"].signal.values
    torch.testing.assert_close(values, torch.eye(4, 9).expand(1, 27, 4, 9), rtol=0, atol=1e-6)


def brute(scene, points, rays, order, output_order):
    """`int V y_i y_j` at points in float64, ray by ray, V from the slab test of one axis-aligned box."""
    directions, weights = sh.fibonacci(rays)
    (mesh,) = [each.mesh for each in scene.objects]
    low, high = mesh.positions.amin(0), mesh.positions.amax(0)
    safe = torch.where(directions.abs() < 1e-12, 1e-12, directions)
    one, other = ((corner - points[:, None]) / safe for corner in (low, high))
    near, far = torch.minimum(one, other).amax(-1), torch.maximum(one, other).amin(-1)
    visible = (~((near <= far) & (far > 0))).double()
    rows, columns = sh.basis(directions, output_order), sh.basis(directions, order)
    return torch.einsum("vd,d,di,dj->vij", visible, weights, rows, columns)


def test_agrees_with_brute_force_without_a_tracer():
    """20 000 rays of the twin against 4096: each errs by about the perimeter of the shadow over the root of its rays to
    the 3/4, some 2e-3."""
    found = bake_neighbourhood(
        slab(),
        order=4,
        output_order=3,
        grid=(4, 4, 4),
        box=(-1.0, -1.0, -1.0, 1.0, 1.0, 1.0),
        rays=4096,
        progress=False,
        threads=1,
    )
    wanted = brute(slab(), found.receivers.positions, 20_000, 4, 3)
    values = found.layers["neighbourhood"].signal.values[0].double()
    torch.testing.assert_close(values, wanted, rtol=0, atol=8e-3)
    assert float((values - torch.eye(9, 16, dtype=torch.float64)).abs().max()) > 0.05


def test_under_white_light_a_white_closed_furnace_changes_nothing():
    """A white object in a light that is the same everywhere sends as much as it hides, after all bounces: the column of
    the constant is that of the identity. What is left is the error of rays and of bounces."""
    white = slab(1.0)
    found = bake_neighbourhood(white, **SMALL | {"box": BOX, "bounces": math.inf, "rays": 1024, "grid": (4, 4, 4)})
    column = found.layers["neighbourhood"].signal.values[..., 0]
    wanted = torch.zeros(4)
    wanted[0] = 1
    torch.testing.assert_close(column, wanted.expand_as(column), rtol=0, atol=0.02)


def test_light_from_a_coloured_object_has_its_colour():
    dark, lit = (slab_around(bounces).layers["neighbourhood"].signal.values for bounces in (0, 1))
    assert (len(dark), len(lit)) == (1, 3)
    added = (lit - dark)[:, :, 0, 0]
    # One bounce is linear in albedo.
    torch.testing.assert_close(added[0] * 3 / 8, added[1], rtol=1e-3, atol=1e-6)
    assert float(added[0].max()) > 0.01
    assert float(added.min()) > -1e-6


def test_a_glossy_object_and_a_mirror_send_light_too():
    plain = slab(0.0)
    mesh = plain.objects[0].mesh
    options = SMALL | {"box": BOX, "rays": 256}
    black = bake_neighbourhood(plain, **options, bounces=1).layers["neighbourhood"].signal.values[..., 0, 0]
    glossy = bake_neighbourhood(Scene([Object(mesh, Material(gloss="phong:20"))]), **options, bounces=1)
    mirror = bake_neighbourhood([Object(mesh, Material(mirror=1.0))], **options)
    for found in (glossy, mirror):
        added = found.layers["neighbourhood"].signal.values[..., 0, 0] - black
        assert float(added.max()) > 0.005
        assert float(added.min()) > -1e-3
    # A perfect mirror in a constant light is not seen.
    column = mirror.layers["neighbourhood"].signal.values[..., 0, 0]
    torch.testing.assert_close(column, torch.ones_like(column), rtol=0, atol=0.01)


def test_nodes_in_the_object_go_on_as_those_around():
    cube = Scene([Object(box_mesh((-0.5,) * 3, (0.5,) * 3), Material(0.5))])
    found = bake_neighbourhood(
        cube, **SMALL | {"grid": (9, 9, 9), "box": (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0), "rays": 256}
    )
    layer = found.layers["neighbourhood"]
    inner = (found.receivers.positions.abs() < 0.5).all(-1)
    # Three a side lie inside; on the surface rounding decides.
    assert 27 <= layer.inside <= 125
    values = layer.signal.values[0, :, 0, 0]
    outer = values[(found.receivers.positions.abs() > 0.51).any(-1)]
    assert float(values[inner].min()) >= float(outer.min()) - 1e-5
    assert float(values[inner].max()) <= float(outer.max()) + 1e-5


def test_the_box_encloses_the_shadow_by_its_rule():
    geometry = slab().geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    low, high = geometry.positions.amin(0), geometry.positions.amax(0)
    for share in (0.1, 0.02):
        lowest, highest, border = enclosing_box(tracer, low, high, share)
        assert border <= share
        # Of a square of side a at a distance d straight above: about a^2 / (pi d^2).
        below = float(-0.05 - lowest[1])
        assert below == pytest.approx(0.8 / math.sqrt(math.pi * share), rel=0.25)
        assert float(highest[1]) == pytest.approx(0.05 + 0.08)
        torch.testing.assert_close(lowest[[0, 2]], -highest[[0, 2]], rtol=0, atol=0.09)


def test_the_box_is_told_and_cells_are_near_to_cubes():
    found = bake_neighbourhood(slab(), **SMALL | {"grid": 600, "share": 0.1}).receivers
    assert found.share == 0.1
    assert 0 < found.border <= 0.1
    assert found.count == pytest.approx(600, rel=0.25)
    assert max(found.spacing) < 1.4 * min(found.spacing)


def test_a_grid_that_is_too_coarse_is_warned_of_with_the_figure():
    with pytest.warns(GridWarning, match=r"grid of 4x4x4 .* errs by \d+\.\d%"):
        coarse = bake_neighbourhood(
            slab(), **SMALL | {"box": (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0), "rays": 1024, "grid": (4, 4, 4)}
        )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fine = bake_neighbourhood(
            slab(), **SMALL | {"box": (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0), "rays": 1024, "grid": (20, 20, 20)}
        )
    errors = [found.layers["neighbourhood"].interpolation_error for found in (coarse, fine)]
    assert errors[1] < 0.025 < errors[0]


def test_the_same_bits_whoever_runs_it_and_after_an_interruption(tmp_path):
    class Stopped(Exception):
        pass

    class Far:
        """As a cluster would: what tasks and workers are given has been sent, and comes in another order."""

        def map(self, tasks, *shared):
            for task in reversed(list(tasks)):
                yield task, pickle.loads(pickle.dumps(task))(*pickle.loads(pickle.dumps(shared)))

    class Impatient:
        def start(self, stage, total, done=0):
            self.stage = stage

        def advance(self, amount):
            if self.stage == "around":
                raise Stopped

    options = SMALL | {"grid": (11, 10, 10), "box": BOX, "bounces": 1}
    wanted = bake_neighbourhood(slab(), **options).layers["neighbourhood"].signal.values
    other = bake_neighbourhood(slab(), **{**options, "threads": None}, runner=Far())
    assert torch.equal(other.layers["neighbourhood"].signal.values, wanted)
    folder = tmp_path / "kept"
    with pytest.raises(Stopped):
        bake_neighbourhood(slab(), **options | {"progress": Impatient()}, checkpoint=folder)
    assert list(folder.glob("chunk-*"))
    resumed = bake_neighbourhood(slab(), **options, checkpoint=folder)
    assert torch.equal(resumed.layers["neighbourhood"].signal.values, wanted)
    assert not folder.exists()


def test_the_glider_of_the_samples_is_thin_and_its_land_is_a_height_field():
    glider = samples.glider(8)
    assert [each.mesh.name for each in glider.objects] == ["sail", "pilot and frame"]
    assert bake_neighbourhood(glider, **SMALL | {"grid": (6, 6, 6)}).layers["neighbourhood"].inside == 0
    mesh = samples.terrain(12).objects[0].mesh
    torch.testing.assert_close(samples.land(mesh.positions[:, [0, 2]]), mesh.positions[:, 1])
    assert bool((mesh.normals[:, 1] > 0).all())
    for wrong in (lambda: samples.glider(7), lambda: samples.terrain(1)):
        with pytest.raises(InputError, match="resolution is"):
            wrong()
