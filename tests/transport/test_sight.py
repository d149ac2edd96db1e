"""Do vertices that cannot see get the light of the surface around them, and all others what they had?"""

import math

import numpy as np
import pytest
import torch
from shapes import square
from transfers import stored
from trimesh.creation import box, icosphere

from torchprt.compression import compress, reorder
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, load, make_mesh, samples
from torchprt.transfer import Sight, Vertices
from torchprt.transfer import load as load_transfer
from torchprt.transfer import save as save_transfer
from torchprt.transport import bake

ONE = math.sqrt(4 * math.pi)
EPS = torch.finfo(torch.float32).eps


def quiet(scene, **options):
    return bake(scene, **{"rays": 256, "order": 3, "progress": False, **options})


def sphere(subdivisions=3):
    made = icosphere(subdivisions=subdivisions)
    return torch.tensor(made.vertices), torch.tensor(made.faces)


def finned():
    """A sphere with a fin: a triangle in both windings that stands on one of its edges."""
    positions, faces = sphere()
    a, b, _ = faces[0].tolist()
    tip = len(positions)
    positions = torch.cat([positions, 1.3 * (positions[a] + positions[b])[None] / 2])
    return make_mesh(positions, torch.cat([faces, torch.tensor([[a, b, tip], [b, a, tip]])]), name="finned")


def folded():
    """A sphere of which one vertex is pushed over its neighbour and a little down, so that faces fold back."""
    positions, faces = sphere()
    positions = positions.clone()
    vertex = int(faces[0, 0])
    ring = faces[(faces == vertex).any(1)].flatten().unique()
    neighbour = int(ring[ring != vertex][0])
    positions[vertex] += 1.8 * (positions[neighbour] - positions[vertex]) - 0.05 * positions[vertex]
    return make_mesh(positions, faces, name="folded"), vertex


def closed_box(centre, size):
    made = box(extents=size)
    return make_mesh(torch.tensor(made.vertices) + torch.tensor(centre), torch.tensor(made.faces), name="box")


def standing(resolution=21, two_sided=False):
    """A box that stands on a floor, and sinks into it a little."""
    floor = Object(square(4.0, resolution), Material(0.5))
    return Scene([floor, Object(closed_box([0.0, 0.4, 0.0], [1.15, 1.0, 1.15]), Material(0.5, two_sided))])


def constant(transfer):
    """The share of a constant light that each vertex has, for every layer's first function."""
    return stored(transfer)[:, 0].mean(0) * ONE


def beside_ring(transfer):
    """The least of what any vertex of a face reads under a constant light, over the median of its ring."""
    values, faces = constant(transfer), transfer.faces.long()
    pairs = torch.cat([faces[:, [i, j]] for i in range(3) for j in range(3) if i != j]).unique(dim=0)
    medians = {v: float(values[pairs[pairs[:, 0] == v, 1]].median()) for v in pairs[:, 0].unique().tolist()}
    return min(float(values[v]) / max(median, 1e-30) for v, median in medians.items())


def count(transfer):
    sight = transfer.receivers.sight
    return {} if sight is None else {kind: int((sight == kind).sum()) for kind in Sight if int((sight == kind).sum())}


def test_sight_must_be_known_and_one_a_vertex():
    transfer = quiet(Scene([Object(square())]))
    parts = transfer.receivers.tensors()
    with pytest.raises(InputError, match="sight"):
        Vertices(**parts, sight=torch.zeros(3, dtype=torch.uint8))
    with pytest.raises(InputError, match="numbers above 4: a newer torchprt"):
        Vertices(**parts, sight=torch.full((25,), 5, dtype=torch.uint8)).check()


# What is right stays as it is, to the bit.


@pytest.mark.parametrize(
    "scene",
    [
        lambda: samples.organic(20_000),
        lambda: samples.plane_and_blocker(),
        lambda: Scene([Object(square(2.0, 9), Material(0.5, two_sided=True))]),
        lambda: Scene([Object(square(2.0, 9)), Object(square(1.0, 5, height=0.2), role="blocker")]),
        # An open sheet over the floor, whose back it sees nearby.
        lambda: Scene([Object(square(2.0, 9)), Object(square(1.0, 5, height=0.2))]),
        lambda: Scene([Object(make_mesh(*sphere()), Material(0.5, two_sided=True))]),
    ],
)
def test_surfaces_that_see_are_left_as_they_are(scene):
    made, raw = quiet(scene()), quiet(scene(), raw=True)
    assert made.receivers.sight is None
    assert torch.equal(stored(made), stored(raw))


def test_the_corner_of_a_room_is_dark_and_right():
    """Three walls, as one smooth piece and as pieces that only stand on each other."""
    n = 9
    floor = square(2.0, n).positions + torch.tensor([1.0, 0.0, -1.0])
    faces = square(2.0, n).faces
    turns = [torch.eye(3), torch.eye(3)[[1, 2, 0]], torch.eye(3)[[2, 0, 1]]]
    walls = [(floor * torch.tensor([1.0, 1.0, -1.0])) @ turn.double() for turn in turns]
    apart = Scene([Object(make_mesh(wall, faces.flip(1))) for wall in walls])
    assert quiet(apart).receivers.sight is None
    everything = torch.cat(walls)
    places, number = torch.unique((everything * 1e6).round(), dim=0, return_inverse=True)
    joined = torch.cat([faces.flip(1) + k * n * n for k in range(3)])
    smooth = make_mesh(places / 1e6, number[joined])
    assert quiet(Scene([Object(smooth)])).receivers.sight is None


# Faces that cancel.


def test_the_tip_of_a_fin_looks_where_most_is_seen():
    mesh = finned()
    tip = len(mesh.positions) - 1
    assert not mesh.normals[tip].any()
    assert float(constant(quiet(Scene([Object(mesh)]), raw=True))[tip]) == 0
    made = quiet(Scene([Object(mesh)]))
    assert made.receivers.sight[tip] == Sight.TURNED
    assert float(torch.linalg.vector_norm(made.normals[tip])) == pytest.approx(1, abs=4 * EPS)
    # A fin on a sphere sees at least the half of the hemisphere that looks away from it.
    assert beside_ring(made) > 0.5
    assert set(count(made)) <= {Sight.VALID, Sight.TURNED}


def test_the_two_sides_of_a_fin_look_apart():
    made = quiet(Scene([Object(finned(), Material(0.5, two_sided=True))]))
    half = made.vertices // 2
    tip = half - 1
    assert made.receivers.sight[tip] == made.receivers.sight[tip + half] == Sight.TURNED
    assert torch.equal(made.normals[tip], -made.normals[tip + half])
    assert float(constant(made)[tip]) > 0.3
    assert float(constant(made)[tip + half]) > 0.3


# Folds.


def test_a_fold_is_no_speck():
    mesh, vertex = folded()
    assert beside_ring(quiet(Scene([Object(mesh)]), raw=True)) < 0.5
    made = quiet(Scene([Object(mesh)]))
    assert made.receivers.sight[vertex] != Sight.VALID
    assert beside_ring(made) > 0.5


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("moved", [0.0, 1e4])
def test_scale_and_place_do_not_matter(scale, moved):
    mesh, _ = folded()
    wanted = quiet(Scene([Object(mesh)]))
    # Moved by ten thousand extents, coordinates are a binary step of 2e-12 coarser: nothing beside float32.
    other = make_mesh(scale * (mesh.positions + moved), mesh.faces)
    found = quiet(Scene([Object(other)]))
    assert torch.equal(found.receivers.sight, wanted.receivers.sight)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_turned_normals_have_unit_length_on_slivers_and_small_meshes(scale):
    """Two triangles in both windings, one of them 1e-18 as high as it is long."""
    positions = scale * torch.tensor([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-18, 0.2], [0.5, 1, 0]]).double()
    faces = torch.tensor([[0, 1, 2], [1, 0, 2], [0, 1, 3], [1, 0, 3]])
    made = quiet(Scene([Object(make_mesh(positions, faces))]))
    assert (made.receivers.sight == Sight.TURNED).all()
    assert float((torch.linalg.vector_norm(made.normals, dim=-1) - 1).abs().max()) < 4 * EPS
    assert float(constant(made).min()) > 0.4


def test_a_soup_of_triangles_is_filled_over_its_seams():
    """A buried floor whose triangles share no vertex: neighbours are those at the same place."""
    scene = standing()
    floor = scene.objects[0].mesh
    soup = make_mesh(floor.positions[floor.faces].view(-1, 3), torch.arange(3 * len(floor.faces)).view(-1, 3))
    made, whole = quiet(Scene([Object(soup), scene.objects[1]])), quiet(scene)
    buried = made.receivers.sight == Sight.FILLED
    assert torch.equal(buried[: len(soup.positions)], (whole.receivers.sight == Sight.FILLED)[floor.faces].flatten())
    assert float(constant(made)[: len(soup.positions)].min()) > 0.2


@pytest.mark.parametrize(("side", "filled"), [(0.16, 9), (0.66, 0)])
def test_a_few_that_see_nothing_are_a_speck_and_many_a_cave(side, filled):
    """A plate just over a floor, which shows it its front: nothing but their number speaks against those below."""
    floor = Object(square(2.0, 41))
    plate = Object(square(side, 5, height=1e-4, up=False), role="blocker")
    made, raw = (quiet(Scene([floor, plate]), rays=128, raw=raw) for raw in (False, True))
    below = constant(raw) == 0
    assert int(below.sum()) == (9 if filled else 169)
    assert count(made).get(Sight.FILLED, 0) == filled
    assert int((constant(made) == 0).sum()) == (0 if filled else 169)


# Buried.


@pytest.mark.parametrize("two_sided", [False, True])
def test_a_floor_in_a_box_goes_on_as_around_it(two_sided):
    scene = standing(two_sided=two_sided)
    floor = scene.objects[0].mesh.positions
    inside = (floor[:, [0, 2]].abs() < 0.57).all(1)
    made, raw = quiet(scene), quiet(scene, raw=True)
    sight = made.receivers.sight[: len(floor)]
    assert torch.equal(sight == Sight.FILLED, inside)
    values, dark = constant(made)[: len(floor)], constant(raw)[: len(floor)]
    assert float(dark[inside].max()) == 0
    assert torch.equal(values[~inside], dark[~inside])
    around = values[~inside & (floor[:, [0, 2]].abs() < 0.85).all(1)]
    # A harmonic function is within its values around.
    assert float(around.min()) - 8 * EPS <= float(values[inside].min())
    assert float(values[inside].max()) <= float(around.max()) + 8 * EPS


def test_bounces_go_on_too():
    scene = standing()
    floor = scene.objects[0].mesh.positions
    inside = (floor[:, [0, 2]].abs() < 0.57).all(1)
    made = quiet(scene, bounces=2)
    mean = constant(made)[: len(floor)][inside].mean()
    direct = constant(quiet(scene))[: len(floor)][inside].mean()
    assert direct < mean < 1


def test_what_is_enclosed_wholly_stays_dark_and_is_counted():
    inner = make_mesh(0.2 * sphere(2)[0], sphere(2)[1])
    scene = Scene([Object(inner), Object(closed_box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]))])
    made = quiet(scene)
    assert count(made)[Sight.BLIND] == len(inner.positions)
    assert float(constant(made)[: len(inner.positions)].abs().max()) == 0


# Everything that can be baked.


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"bounces": 1},
        {"frame": "incident"},
        {"frame": "visibility"},
        {"factors": 3},
    ],
)
@pytest.mark.parametrize("make", [finned, lambda: folded()[0]])
def test_every_glossy_layer_is_lit_where_its_neighbours_are(make, options):
    mesh = make()
    scene = Scene([Object(mesh, Material(0.3, gloss="ggx:0.5", specular=0.5))])
    made, raw = quiet(scene, **options), quiet(scene, raw=True, **options)
    wrong = made.receivers.sight != Sight.VALID
    (layer,) = made.eye_layers.values()
    (other,) = raw.eye_layers.values()
    size, before = (each.signal.values.square().flatten(2).sum((0, 2)).sqrt() for each in (layer, other))
    if "frame" in options and options["frame"] == "visibility":
        size, before = (each.signal.values.square().sum((0, 1)).sqrt() for each in (layer, other))
    middle = size[~wrong].median()
    assert float(before[wrong].min()) < 0.5 * middle
    assert float(size[wrong].min()) > 0.5 * middle
    assert float((torch.linalg.vector_norm(layer.tangents, dim=-1) - 1).abs().max()) < 4 * EPS
    assert float((layer.tangents * made.normals).sum(-1).abs().max()) < 4 * EPS


def test_filling_then_lighting_is_lighting_then_filling():
    from torchprt.trace import Tracer
    from torchprt.transport.sight import with_sight
    from torchprt.transport.solve import vertex_receivers
    from torchprt.transport.workers import Threads

    geometry = standing().geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    with Threads(1) as workers:
        _, _, validity = with_sight(geometry, tracer, vertex_receivers(geometry, tracer), workers)
    generator = torch.Generator().manual_seed(0)
    arriving = torch.rand(geometry.receivers, 9, generator=generator)
    light = torch.rand(9, 1, generator=generator)
    lit = arriving @ light
    validity.fill(lit)
    validity.fill(arriving)
    torch.testing.assert_close(arriving @ light, lit, rtol=64 * EPS, atol=0)
    flat = torch.ones(geometry.receivers, 1)
    flat[validity.rows] = 0
    validity.fill(flat)
    torch.testing.assert_close(flat, torch.ones_like(flat), rtol=4 * EPS, atol=0)


def test_points_are_recorded_where_they_are():
    scene = standing()
    points = Points(torch.zeros(1, 3).double(), torch.tensor([[0.0, 1.0, 0.0]]).double(), 0.5)
    made = quiet(scene, receivers=points)
    assert made.receivers.sight is None
    assert float(constant(made)[0]) == 0


# What the file and what is made of it know.


def test_files_and_reordered_clusters_keep_what_was_seen(tmp_path):
    made = quiet(Scene([Object(folded()[0], Material(0.5))]))
    save_transfer(made, tmp_path / "folded.safetensors")
    assert torch.equal(load_transfer(tmp_path / "folded.safetensors").receivers.sight, made.receivers.sight)
    small = compress(made, clusters=4, components=2)
    assert torch.equal(small.receivers.sight, made.receivers.sight)
    ordered = reorder(small)
    assert torch.equal(ordered.receivers.sight, made.receivers.sight[ordered.receivers.original.long()])


def test_an_interrupted_bake_goes_on_with_the_same_bits(tmp_path):
    scene = standing()
    whole = quiet(scene, bounces=1)
    quiet(scene, bounces=1, checkpoint=tmp_path / "kept", keep=True)
    again = quiet(scene, bounces=1, checkpoint=tmp_path / "kept")
    assert torch.equal(stored(again), stored(whole))


# Scans.


@pytest.mark.parametrize("name", ["fins", "folds"])
@pytest.mark.parametrize("bounces", [0, 1])
def test_no_vertex_of_a_hard_scan_is_a_speck(data, name, bounces):
    path = data / "hard" / f"{name}.ply"
    if not path.exists():
        pytest.skip(f"no real data: {path.name} is not there")
    scene = load(path, albedo=0.5)
    assert beside_ring(quiet(scene, raw=True)) < 0.5
    assert beside_ring(quiet(scene, bounces=bounces)) >= 0.5


def test_a_clean_scan_is_hardly_touched(data):
    made = quiet(load(data / "mesh" / "bunny.ply"), rays=64)
    assert sum(found for kind, found in count(made).items() if kind) <= 2
    assert np.isfinite(stored(made).numpy()).all()
