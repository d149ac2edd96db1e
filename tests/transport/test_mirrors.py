"""Does light go on where it meets a mirror, none lost and none made, on the first and on every later leg?

The twins are laws of optics: a kaleidoscope shows the sky that it cuts off, a plane mirror shows the scene once more,
a tall cylinder keeps the flux that enters it, and inside of a circle parallel light draws a nephroid.
"""

import math
import warnings

import pytest
import torch
from contents import differing

from torchprt import sh
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, load, make_mesh, mirror_of, read_material, samples
from torchprt.scene.samples.grid import grid as sample_grid
from torchprt.scene.samples.grid import join
from torchprt.shade import shader
from torchprt.trace import Tracer, follow
from torchprt.transfer import load as read
from torchprt.transfer import save
from torchprt.transport import MirrorWarning, bake, hemisphere, unshadowed
from torchprt.transport.mirrors import by_way_of_mirrors, mirrors_of
from torchprt.transport.receivers import Receivers

UP = torch.tensor([0.0, 1.0, 0.0])


def grid(origin, along, across, columns, rows):
    return sample_grid(*(tuple(map(float, each)) for each in (origin, along, across)), columns, rows)


def floor(size=1.0, squares=8, albedo=0.5, **more):
    sheet = grid((-size, 0, size), (2 * size, 0, 0), (0, 0, -2 * size), squares, squares)
    return Object(make_mesh(*sheet, name="floor"), Material(albedo, **more))


def walls(height=1.0, mirror=1.0, below=0.01):
    """Four walls around the floor that look inward."""
    sheets = [
        grid((-1, -below, 1), (0, 0, -2), (0, height + below, 0), 1, 1),
        grid((1, -below, -1), (0, 0, 2), (0, height + below, 0), 1, 1),
        grid((1, -below, 1), (-2, 0, 0), (0, height + below, 0), 1, 1),
        grid((-1, -below, -1), (2, 0, 0), (0, height + below, 0), 1, 1),
    ]
    return Object(make_mesh(*join(*sheets), name="walls"), Material(mirror=mirror))


def vectors(transfer):
    return transfer.layers["diffuse"].signal.values


# Misuse


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"mirror": 1.2}, "ranges from 1.2"),
        ({"mirror": (0.5, float("nan"), 0.5)}, "ranges"),
        ({"mirror": (0.5, 0.5)}, "shape"),
        ({"mirror": 0.9, "albedo": 0.5}, "neither albedo"),
        ({"mirror": 0.9, "gloss": "ggx:0.3"}, "neither albedo"),
        ({"mirror": 0.9, "translucency": 0.5}, "neither albedo"),
    ],
)
def test_refuses_a_mirror_that_is_none(arguments, what):
    with pytest.raises(InputError, match=what):
        Material(**arguments)


@pytest.mark.parametrize("text", ["mirror:tin", "mirror:1,2", "mirror:", "mirror:2"])
def test_refuses_a_mirror_in_words_that_name_none(text):
    with pytest.raises(InputError, match=text):
        read_material(text)


def test_reads_mirrors_in_words():
    assert read_material("mirror").reflectance.tolist() == [[1.0]]
    assert read_material("mirror:.5").reflectance.tolist() == [[0.5]]
    assert read_material("mirror:1,.5,.25").reflectance.tolist() == [[1.0, 0.5, 0.25]]
    assert read_material("mirror:gold").coloured is False
    assert mirror_of(samples.ring(12), "mirror:gold").coloured


def test_refuses_a_scene_of_mirrors_alone_and_a_mirror_that_blocks():
    with pytest.raises(InputError, match="only blockers and mirrors"):
        load(samples.ring(12), material="mirror")
    with pytest.raises(InputError, match="a mirror and a blocker"):
        Object(samples.ring(12), Material(mirror=1.0), "blocker")
    with pytest.raises(InputError, match="no mirror"):
        mirror_of(samples.ring(12), "ggx:0.3")


def test_visibility_alone_cannot_hold_what_mirrors_turn():
    scene = Scene([floor(albedo=0.1, gloss="ggx:0.4"), walls()])
    with pytest.raises(InputError, match="mirrors"):
        bake(scene, order=2, rays=16, frame="visibility", progress=False)


# Laws


def test_a_scene_says_what_its_mirrors_need():
    grey, gold = Scene([floor(), walls(mirror=0.8)]), Scene([floor(), walls(mirror=(1.0, 0.8, 0.3))])
    assert [each.requires().channels for each in (grey, gold)] == [1, 3]
    assert grey.geometry().receivers == 81
    assert "walls (mirror)" in str(gold)
    assert [each["name"] for each in bake(gold, order=1, rays=4, progress=False).receivers.objects] == ["floor"]


def test_a_kaleidoscope_shows_the_sky_that_its_walls_cut_off():
    # The height of a direction is the same in all mirrors, so lights around the vertical shine as if there were none.
    transfer = bake(Scene([floor(), walls()]), order=5, rays=512, progress=False, raw=True)
    inside = (transfer.positions[:, [0, 2]].abs() < 0.99).all(1)
    alone = unshadowed(UP[None], 5)
    axis = sh.basis(UP, 5)
    for band in range(5):
        rows = slice(band**2, (band + 1) ** 2)
        found = axis[rows] @ vectors(transfer)[0, rows][:, inside]
        # What was cut off, of a zonal function that is at most this.
        most = (2 * band + 1) / (4 * math.pi)
        assert 0 < transfer.cut < 1e-3
        torch.testing.assert_close(found, (axis[rows] @ alone[rows]).expand_as(found), rtol=0, atol=1.5e-3 * most)


def test_a_cylinder_keeps_the_flux_that_enters_it():
    # Every direction of the light, not only on the mean: each coefficient of the transfer, over the area of the floor.
    columns = 96
    angle = 2 * math.pi * torch.arange(columns).double() / columns
    around = torch.stack([angle.cos(), 0 * angle, -angle.sin()], -1)
    wall = torch.cat([around - 0.01 * UP, around + 0.5 * UP])
    first = torch.arange(columns)
    after = (first + 1) % columns
    faces = torch.cat(
        [torch.stack([first, after, after + columns], -1), torch.stack([first, after + columns, first + columns], -1)]
    )
    pipe = Object(make_mesh(wall, faces, normals=torch.cat([around, around]), name="pipe"), Material(mirror=1.0))
    # Rings of equal area inside, a twelfth of a turn at a time.
    radius = ((torch.arange(12).double() + 0.5) / 12).sqrt()
    spokes = 2 * math.pi * (torch.arange(17).double() + 0.5) / 17
    places = torch.stack(
        [radius[:, None] * spokes.cos(), 0 * radius[:, None] + 0 * spokes, radius[:, None] * spokes.sin()], -1
    ).view(-1, 3)
    points = Points(places, UP.double().expand(len(places), 3))
    transfer = bake(Scene([floor(2.0), pipe]), order=4, rays=4096, receivers=points, progress=False)
    mean = vectors(transfer)[0].mean(-1)
    alone = unshadowed(UP[None], 4)[:, 0]
    # Of 204 receivers, each with the error of 4096 rays across caustics: some 1 % / sqrt(204); the polygon is 0.1 %
    # less than its circle, and 1e-4 is cut off.
    torch.testing.assert_close(mean, alone, rtol=0, atol=3e-3 * float(alone.norm()))


def even(light):
    """The part of a light that is the same on both sides of the plane x = 0."""
    flipped = torch.diag(torch.tensor([-1.0, 1.0, 1.0], dtype=light.dtype))
    points, weights = sh.gauss_legendre(2 * (sh.order_of(len(light)) - 1))
    values = sh.basis(points @ flipped, sh.order_of(len(light))) @ light
    other = sh.basis(points, sh.order_of(len(light))).T @ (values * weights[:, None])
    return (light + other) / 2


@pytest.mark.parametrize("gloss", [None, "ggx:0.5"])
def test_a_plane_mirror_shows_the_scene_once_more(gloss):
    # Under a light that is even in x all is as if the other half were there, for any number of bounces.
    def half(sign):
        low = grid((0.2, 0, 1), (1.0, 0, 0), (0, 0, -2.0), 6, 8)
        side = grid((1.2, 0, 1), (0, 0, -2.0), (0, 0.8, 0), 8, 5)
        positions, faces = join(low, side)
        return positions * [sign, 1, 1], faces if sign > 0 else faces[:, ::-1].copy()

    def body(sheet):
        return Object(
            make_mesh(*sheet, name="half"),
            Material((0.7, 0.5, 0.3) if gloss is None else (0.2, 0.15, 0.1), gloss=gloss),
        )

    sheet = grid((0, -30, 30), (0, 0, -60), (0, 60, 0), 1, 1)
    mirror = Object(make_mesh(*sheet, name="mirror"), Material(mirror=1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        options = {"order": 3, "rays": 2048, "bounces": 3, "progress": False, "raw": True}
        one = bake(Scene([body(half(1)), mirror]), **options)
        both = bake(Scene([body(half(1)), body(half(-1))]), **options)
    light = even(torch.randn(9, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)).float()
    eye = {} if gloss is None else {"eye": torch.tensor([0.8, 2.0, 0.4])}
    shown, wanted = shader(one)(light, **eye), shader(both)(light, **eye)[: one.vertices]
    # The directions of a receiver are the same, the rays of the other half end where theirs are mirrored: what differs
    # is the sky between, of the same radiance on both sides, rounding, and the correction, which is not even.
    error = (shown - wanted).norm() / wanted.norm()
    assert error < 2e-3
    assert (shader(bake(Scene([body(half(1))]), **options))(light, **eye) - wanted).norm() > 10 * error * wanted.norm()


def test_metals_reflect_more_at_grazing_angles_and_in_their_colour():
    gold = (1.0, 0.5, 0.2)
    sheet = grid((0, -1, 5), (0, 0, -10), (0, 8, 0), 1, 1)
    wall = Object(make_mesh(*sheet, name="wall"), Material(mirror=gold))
    place = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
    points = Points(place, UP.double()[None])
    transfer = bake(Scene([floor(0.01), wall]), order=3, rays=4096, receivers=points, progress=False)
    # By hand, along other directions: the ray (x, y, z) meets the wall at x = 0 if it does so within its edges.
    directions, weights = sh.fibonacci(1 << 18)
    weights = weights * directions[:, 1].clamp(min=0) / math.pi
    distance = torch.where(directions[:, 0] < 0, 1 / (-directions[:, 0]).clamp(min=1e-9), math.inf)
    height, along = distance * directions[:, 1], distance * directions[:, 2]
    meets = (directions[:, 0] < 0) & (height <= 7) & (along.abs() <= 5)
    turned = torch.where(meets[:, None], directions * torch.tensor([-1.0, 1, 1]).double(), directions)
    share = torch.tensor(gold).double()
    share = share + (1 - share) * (1 - directions[:, :1].abs()) ** 5
    share = torch.where(meets[:, None], share, 1.0)
    expected = torch.einsum("dn,dc,d->cn", sh.basis(turned, 3), share, weights)
    # The error of 4096 directions across the edges of the wall (see the spherical Fibonacci sets of the bake).
    torch.testing.assert_close(vectors(transfer)[..., 0].double(), expected, rtol=0, atol=3e-3)


def test_matrices_of_glossy_receivers_hold_mirrored_light():
    # The same directions by hand: the rows of incident radiance against the harmonics of where each ray came to.
    scene = Scene([floor(squares=2, albedo=0.1, gloss="ggx:0.5"), walls(2.0)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        transfer = bake(scene, order=3, rays=256, frame="incident", progress=False, raw=True)
    layer = transfer.layers["incident"]
    geometry = scene.geometry()
    tracer, mirrors = Tracer(geometry.positions, geometry.faces), mirrors_of(geometry)
    place, normal = transfer.positions[4:5].double(), transfer.normals[4:5].double()
    receivers = Receivers(place, normal, tracer.origins(place, normal), layer.tangents[4:5].double())
    directions = hemisphere(256).float()
    hits = tracer.hits(receivers.origins, receivers.frames(), directions)
    seen = by_way_of_mirrors(tracer, mirrors, hits, receivers.frames(), directions)
    assert len(seen.row) > 100
    world = directions @ receivers.frames()[0]
    arrived = world.clone()
    arrived[seen.column] = seen.rays.direction
    free = (seen.hits.triangle[0] < 0).float()
    expected = torch.einsum("dr,dn,d->rn", sh.basis(directions, 3), sh.basis(arrived, 3), free) * 2 * math.pi / 256
    # Directions that no mirror turned share the correction of the closed form, some 1e-3 with 256 of them.
    torch.testing.assert_close(layer.signal.values[0, 4], expected, rtol=0, atol=5e-3)


def test_parallel_light_in_a_ring_draws_a_nephroid():
    # From +x, at 45 degrees: reflected once it is densest at half the radius on the far side, the cusp of the caustic.
    geometry = Scene([floor(3.0, 1), mirror_of(samples.ring(512))]).geometry()
    tracer, mirrors = Tracer(geometry.positions, geometry.faces), mirrors_of(geometry)
    x = torch.linspace(-0.75, -0.25, 27, dtype=torch.float64)
    places = torch.stack([x, 0 * x, 0 * x], -1)
    normals = UP.double().expand(27, 3)
    receivers = Receivers(places, normals, tracer.origins(places, normals))
    # Rays of the hemisphere that could come from the light by one reflection: by the far wall, at its height.
    directions = hemisphere(1 << 16).float()
    light = torch.nn.functional.normalize(torch.tensor([1.0, 0.45, 0.0]), dim=0)
    found = []
    for row in range(27):
        one = receivers[slice(row, row + 1)]
        hits = tracer.hits(one.origins, one.frames(), directions)
        seen = by_way_of_mirrors(tracer, mirrors, hits, one.frames(), directions)
        toward = (seen.rays.direction @ light > math.cos(math.radians(2))) & (seen.rays.triangle < 0)
        found.append(float(directions[seen.column[toward], 2].sum()))
    brightest = float(x[int(torch.tensor(found).argmax())])
    # The inner wall is at .95; the light is 4 degrees wide, which blurs the cusp by some 4 % of the way.
    assert abs(brightest + 0.95 / 2) < 0.04


# Bad rooms, places and scales


def test_a_closed_room_of_mirrors_is_bounded_and_told_of():
    lid = Object(make_mesh(*grid((-1, 1, -1), (2, 0, 0), (0, 0, 2), 1, 1), name="lid"), Material(mirror=1.0))
    with pytest.warns(MirrorWarning, match=r"of the light .* after 32 reflections"):
        transfer = bake(
            Scene([floor(albedo=0.2), walls(below=0.0), lid]), order=2, rays=64, bounces=2, progress=False, raw=True
        )
    assert transfer.cut > 1e-3
    assert bool(vectors(transfer).isfinite().all())


@pytest.mark.parametrize(("scale", "move"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)])
def test_scale_and_place_change_nothing(scale, move):
    def scene(scale, move):
        things = (floor(squares=3), walls())
        return Scene(
            [
                Object(make_mesh(o.mesh.positions * scale + move, o.mesh.faces, name=o.mesh.name), o.material)
                for o in things
            ]
        )

    options = {"order": 3, "rays": 64, "progress": False}
    first, other = (vectors(bake(scene(*where), **options)) for where in ((1.0, 0.0), (scale, move)))
    # Rays through the edge between two walls may choose the other; float32 positions at 1e4 differ by 1e-3.
    assert float((first - other).abs().mean()) < 2e-3


def test_the_result_is_the_same_to_the_bit_whoever_traces_it(tmp_path):
    scene = Scene([floor(squares=24), walls(mirror=(0.9, 0.8, 0.7))])
    options = {"order": 3, "rays": 32, "bounces": 2, "progress": False}
    first = bake(scene, threads=1, **options)
    assert not differing(bake(scene, threads=3, checkpoint=tmp_path / "kept", **options), first)
    assert first.channels == 3


def test_a_mirror_without_normals_or_area_is_as_flat_as_its_faces():
    positions = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], dtype=torch.float64)
    faces = torch.tensor([[0, 1, 2], [0, 1, 3]])
    tracer = Tracer(positions, faces)
    mirror = Object(make_mesh(positions, faces, normals=torch.zeros(4, 3), name="sheet"), Material(mirror=0.5))
    mirrors = mirrors_of(Scene([floor(), mirror]).geometry())
    mirrors = type(mirrors)(mirrors.number[-2:], mirrors.reflectance, torch.zeros(4, 3, dtype=torch.float64))
    down = torch.tensor([[0.1, 0.0, -1.0]])
    start = tracer.local(torch.tensor([[0.2, 0.2, 1.0]])).float()
    hits = tracer.onward(start, down)
    found = follow(tracer, mirrors, hits, torch.tensor([0]), down)
    torch.testing.assert_close(
        found.direction, torch.nn.functional.normalize(down * torch.tensor([1.0, 1, -1]), dim=-1)
    )
    assert found.triangle.tolist() == [-1]
    assert 0.5 <= float(found.share) < 0.5 + 1e-6


def test_a_file_keeps_the_mirrors_and_what_was_cut_off(tmp_path):
    transfer = bake(Scene([floor(), walls(mirror=(0.9, 0.8, 0.7))]), order=2, rays=16, progress=False)
    save(transfer, tmp_path / "a.safetensors")
    again = read(tmp_path / "a.safetensors")
    assert again.cut == transfer.cut is not None
    for one, other in zip(again.receivers.mirrors, transfer.receivers.mirrors, strict=True):
        assert torch.equal(one, other)
    assert transfer.receivers.mirrors[2][0].tolist() == pytest.approx([0.9, 0.8, 0.7])
    plain = bake(Scene([floor()]), order=2, rays=16, progress=False)
    assert plain.cut is None
    assert plain.receivers.mirrors is None
