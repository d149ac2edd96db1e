"""Is what a glossy surface sends toward the eye what it should be?"""

import math
import warnings

import pytest
import torch
from shapes import bowl, disc, square

from torchprt import brdf, sh
from torchprt.bake import OrderWarning, bake, hemisphere, unshadowed
from torchprt.bake.receivers import tangent_frames
from torchprt.bake.solve import surfaces, vertex_receivers
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, load, make_mesh, samples
from torchprt.trace import Tracer
from torchprt.transfer import DiffuseTransfer, GlossyTransfer, VisibilityTransfer

# Small orders and default tangents on purpose: what is baked is compared with what should be.
pytestmark = [
    pytest.mark.filterwarnings("ignore::torchprt.bake.OrderWarning"),
    pytest.mark.filterwarnings("ignore::torchprt.scene.TangentWarning"),
]

EPS = torch.finfo(torch.float32).eps
# A constant light of radiance 1 has this first coefficient.
ONE = math.sqrt(4 * math.pi)


def quiet(scene, **options):
    return bake(scene, progress=False, **options)


def shiny(gloss="phong:10", albedo=0.0, **options):
    return Material(albedo=albedo, gloss=gloss, **options)


def floor_and_wall(material, resolution=9, blocker=True):
    """A floor, a wall standing on it, and a small disc over the floor: shadows, and light from one to the other."""
    floor = square(2.0, resolution)
    wall = square(2.0, resolution)
    upright = torch.stack(
        [wall.positions[:, 0], wall.positions[:, 2] + 1.0, torch.full_like(wall.positions[:, 0], -1.0)], -1
    )
    standing = make_mesh(upright, wall.faces.flip(1), name="wall")
    objects = [Object(floor, material), Object(standing, material)]
    if blocker:
        objects.append(Object(disc(0.4, 0.6), Material(0.0), "blocker"))
    return Scene(objects)


def frames_of(transfer):
    return tangent_frames(transfer.normals[transfer.glossy.long()].double(), transfer.tangents.double())


def exit_radiance(transfer, views):
    """`[C, G, views, N]` in double precision: what goes toward local directions, for every light coefficient."""
    functions = sh.exit_functions(views, transfer.output_order, transfer.projection)
    return functions @ transfer.matrix.double()


def views(count=40):
    return hemisphere(count, seed=5)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"frame": "outgoing"}, "frame"),
        ({"output_order": -1}, "order"),
        ({"output_order": 33}, "output_order"),
        ({"visibility_order": 40}, "visibility_order"),
        ({"projection": "mirror"}, "projection"),
        ({"factors": 3, "frame": "incident"}, "factors"),
        ({"frame": "visibility", "bounces": 1}, "bounces"),
    ],
)
def test_refuses_what_does_not_fit(options, word, untyped):
    # The run-time type checks of the tests would refuse some of it first.
    with pytest.raises(InputError, match=word):
        quiet(load(square(), material=shiny()), **options)


@pytest.mark.parametrize("options", [{"frame": "visibility"}, {"factors": 2}])
def test_tables_of_one_material_refuse_two(options):
    scene = Scene([Object(square(), shiny("phong:5")), Object(square(height=1.0), shiny("phong:9"))])
    with pytest.raises(InputError, match="2"):
        quiet(scene, **options)


@pytest.mark.parametrize("options", [{"frame": "incident"}, {"factors": 3}, {"output_order": 4}])
def test_options_of_glossy_transfer_are_refused_where_nothing_is_glossy(options):
    with pytest.raises(InputError, match="glossy"):
        quiet(load(square()), **options)


def test_an_order_too_small_for_the_material_is_told_with_its_figure():
    with pytest.warns(OrderWarning, match=r"order 3 .*phong:200.* \d+%"):
        transfer = quiet(load(square(), material=shiny("phong:200")), order=3, rays=16)
    assert transfer.exit_error == brdf.exit_error(brdf.parse("phong:200"), 3, 3)
    assert transfer.exit_error > 0.1


@pytest.mark.parametrize("options", [{"frame": "incident"}, {"factors": 2}])
def test_what_holds_no_exit_functions_is_not_warned_of_their_order(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error", OrderWarning)
        quiet(load(square(), material=shiny("phong:60")), order=3, rays=16, **options)


def test_a_diffuse_scene_stays_diffuse():
    assert isinstance(quiet(load(square()), rays=16), DiffuseTransfer)


@pytest.mark.parametrize("frame", ["exit", "incident", "visibility"])
@pytest.mark.parametrize("order", [1, 3, 5])
def test_what_nothing_blocks_has_the_closed_form(frame, order):
    scene = load(samples.plane_and_blocker(3).objects[0].mesh, material=shiny("ggx:0.5", albedo=0.1))
    traced = quiet(scene, order=order, rays=257, frame=frame, output_order=4)
    exact = quiet(scene, order=order, shadows=False, frame=frame, output_order=4)
    name = "visibility" if frame == "visibility" else "matrix"
    found, wanted = getattr(traced, name), getattr(exact, name)
    # 257 additions in float32.
    torch.testing.assert_close(found, wanted, atol=257 * EPS * float(wanted.abs().max()), rtol=0)
    assert exact.rays == 0
    assert exact.error is None
    torch.testing.assert_close(traced.diffuse, exact.diffuse, atol=257 * EPS, rtol=0)


@pytest.mark.parametrize("gloss", ["lambert", "phong:10", "blinn:20", "ggx:0.5", "ggx:0.5,0.04", "ward:0.4,0.7"])
def test_a_white_furnace_reads_the_directional_albedo(gloss):
    model = brdf.parse(gloss)
    transfer = quiet(load(square(), material=shiny(model)), order=2, output_order=8, shadows=False)
    reading = exit_radiance(transfer, views())[0, 0, :, 0] * ONE
    wanted = brdf.directional_albedo(model, views())
    # What eight bands cannot hold of it; tangents do not matter here.
    error = brdf.exit_error(model, 8, 1)
    assert float((reading - wanted).norm() / wanted.norm()) < 1.5 * error + 1e-4
    assert error < 0.02


@pytest.mark.parametrize("projection", ["optimal", "reduced", "zero", "odd", "even"])
def test_shadowed_matrices_agree_with_brute_force(projection):
    """Every product of kernel, visibility and harmonic, in double precision, along the same directions."""
    model = brdf.parse("ward:0.3,0.6")
    scene = floor_and_wall(shiny(model), 5)
    transfer = quiet(scene, order=3, output_order=4, rays=200, projection=projection)
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    receivers = vertex_receivers(geometry, tracer)
    turned = tangent_frames(receivers.normals, geometry.tangents)
    directions = hemisphere(200)
    visible = -tracer.visibility(receivers.origins, turned.float(), directions.float()).double()
    kernel = brdf.exit_kernel(model, directions, 4, projection)
    for point in range(0, len(receivers), 7):
        world = sh.basis(directions @ turned[point], 3)
        wanted = (kernel * visible[point]) @ world * (2 * math.pi / 200)
        # The shared correction of the set toward the closed form is all that differs: below the error of the set.
        difference = float((transfer.matrix[0, point].double() - wanted).norm() / wanted.norm().clamp(min=1e-3))
        assert difference < 0.03
    assert 0.1 < float(visible.mean()) < 0.95


def test_exit_radiance_of_a_shadowed_vertex_agrees_with_the_integral():
    model = brdf.parse("phong:10")
    scene = floor_and_wall(shiny(model), 5)
    transfer = quiet(scene, order=4, output_order=9, rays=4096)
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    receivers = vertex_receivers(geometry, tracer)
    directions = hemisphere(16384, seed=9)
    visible = -tracer.visibility(receivers.origins, receivers.frames(), directions.float()).double()
    turned = receivers.frames().double()
    found = sh.exit_functions(torch.einsum("vij,ej->vei", frames_of(transfer), torch.eye(3).double()), 9)
    assert found.shape == (len(receivers), 3, 81)
    reflected = model(views()[:, None], directions) * directions[:, 2] * (2 * math.pi / len(directions))
    for point in (0, 12, 20, 30, 44):
        wanted = (reflected * visible[point]) @ sh.basis(directions @ turned[point], 4)
        # The same eyes in the frame that the matrix is of, which shares only the normal.
        eyes = views() @ turned[point] @ frames_of(transfer)[point].T
        got = sh.hemisphere_basis(eyes, 9) @ transfer.matrix[0, point].double()
        # 4096 rays miss an edge by about a thousandth of the signal; nine bands hold the lobe to less.
        assert float((got - wanted).norm() / wanted.norm()) < 5e-3


def test_the_incident_frame_is_the_symmetric_matrix_of_visibility():
    scene = floor_and_wall(shiny(), 5)
    square_one = quiet(scene, order=4, output_order=4, rays=300, frame="incident")
    wide = quiet(scene, order=4, output_order=3, rays=300, frame="incident")
    tall = quiet(scene, order=3, output_order=4, rays=300, frame="incident")
    turned = frames_of(square_one)
    world = sh.rotate(square_one.matrix[0].double(), turned.mT)
    torch.testing.assert_close(world, world.mT, atol=300 * EPS, rtol=0)
    torch.testing.assert_close(wide.matrix[0], square_one.matrix[0, :, :9], atol=300 * EPS, rtol=0)
    torch.testing.assert_close(tall.matrix[0], square_one.matrix[0, :, :, :9], atol=300 * EPS, rtol=0)
    # Visibility and its square are one function: the trace of V y y^T is at most that of the hemisphere.
    assert float(torch.linalg.eigvalsh(world).min()) > -1e-2
    assert float(torch.linalg.eigvalsh(world).max()) < 1 + 1e-2


@pytest.mark.parametrize("bounces", [0, 1, 3])
@pytest.mark.parametrize("colour", [False, True])
def test_a_glossy_layer_that_is_lambertian_is_the_diffuse_layer(bounces, colour):
    """Half of the albedo as a glossy layer, by matrices and their own bounces: the sum is the diffuse bake."""
    share = (0.3, 0.2, 0.1) if colour else 0.3
    both = (0.6, 0.4, 0.2) if colour else 0.6
    layered = quiet(
        floor_and_wall(shiny("lambert", albedo=share, specular=share), 5), order=3, rays=128, bounces=bounces
    )
    # The same directions as those of the tangent frames.
    plain = quiet(floor_and_wall(Material(both), 5), order=3, rays=4096, bounces=bounces)
    glossy = exit_radiance(layered, views(3))
    # A constant lobe: 1 / pi of irradiance toward every eye, what a diffuse vector of albedo 1 gives.
    for eye in range(3):
        torch.testing.assert_close(glossy[:, :, eye].float(), layered.diffuse.mT, atol=1e-5, rtol=0)
    scale = float(plain.transfer.abs().max())
    assert float((layered.diffuse - plain.transfer).square().mean().sqrt()) < 0.01 * scale
    assert layered.channels == (3 if colour and bounces else 1)


def test_one_bounce_off_a_glossy_wall_agrees_with_brute_force():
    model = brdf.parse("phong:4")
    scene = floor_and_wall(shiny(model), 17, blocker=False)
    transfer = quiet(scene, order=3, output_order=6, rays=2048, bounces=1)
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    receivers = vertex_receivers(geometry, tracer)
    place = surfaces(geometry)
    directions = hemisphere(1024, seed=2)
    solid_angle = 2 * math.pi / len(directions)
    turned = receivers.frames().double()
    visible = -tracer.visibility(receivers.origins, receivers.frames(), directions.float()).double()

    def direct(point, toward):
        """Exit radiance of a receiver toward world directions, for every coefficient: its own integral."""
        eyes = toward @ turned[point].T
        lobes = model(eyes[:, None], directions) * directions[:, 2] * solid_angle
        return (lobes * visible[point]) @ sh.basis(directions @ turned[point], 3)

    checked = 0
    for point in (17 * 8 + 8, 17 * 13 + 5, 17 * 17 + 17 * 2 + 9):
        hits = tracer.hits(
            receivers.origins[point : point + 1], receivers.frames()[point : point + 1], directions.float()
        )
        arriving = torch.zeros(len(directions), 9, dtype=torch.float64)
        for ray in torch.nonzero((hits.triangle[0] >= 0) & hits.front[0])[:, 0].tolist():
            corners = place.front[hits.triangle[0, ray]].tolist()
            u, v = float(hits.u[0, ray]), float(hits.v[0, ray])
            back = -(directions[ray : ray + 1] @ turned[point])
            for corner, weight in zip(corners, (1 - u - v, u, v), strict=True):
                arriving[ray] += weight * direct(corner, back)[0]
        eyes = views(12)
        lobes = model(eyes[:, None], directions) * directions[:, 2] * solid_angle
        wanted = direct(point, eyes @ turned[point]) + lobes @ arriving
        local = eyes @ turned[point] @ frames_of(transfer)[point].T
        got = sh.hemisphere_basis(local, 6) @ transfer.matrix[0, point].double()
        bounced = float((lobes @ arriving).norm() / wanted.norm())
        assert float((got - wanted).norm() / wanted.norm()) < 0.01
        checked += bounced > 0.05
    # The bounce must matter, or nothing was tested.
    assert checked >= 2


@pytest.mark.parametrize("frame", ["exit", "incident", "zero", "factors"])
def test_other_rows_hold_the_same_bounced_light(frame):
    """Unblocked eye-independent check: with a Lambertian gloss the recorded rows give the diffuse layer again."""
    scene = floor_and_wall(shiny("lambert", albedo=0.3, specular=0.4), 5, blocker=False)
    options = {"exit": {}, "incident": {"frame": "incident"}, "zero": {"projection": "zero"}, "factors": {"factors": 1}}
    transfer = quiet(scene, order=3, output_order=5, rays=128, bounces=2, **options[frame])
    assert transfer.bounces == 2
    assert transfer.transport == "interreflected"
    matrix = transfer.matrix[0].double()
    if frame == "incident":
        # Irradiance from incident radiance: the clamped cosine about the normal, whose tail above order 5 is small.
        lobe = sh.zonal(sh.clamped_cosine(5), torch.tensor([0.0, 0, 1], dtype=torch.float64)) / math.pi
        found, tolerance = lobe @ matrix, 0.03
    elif frame == "factors":
        found, tolerance = transfer.factors.double().mean((1, 2)) @ matrix, 1e-3
    elif frame == "zero":
        # A constant that is zero below the horizon, cut at order 5: its mean over the upper hemisphere.
        directions, weights = sh.gauss_legendre_hemisphere(20)
        found = (weights @ sh.basis(directions, 5)) @ matrix / (2 * math.pi)
        constant = sh.basis(directions, 5).mT @ weights
        found, tolerance = found / (float(constant @ constant) / (2 * math.pi)), 1e-3
    else:
        found, tolerance = exit_radiance(transfer, views(1))[0, :, 0], 1e-5
    wanted = transfer.diffuse[0].T.double()
    assert float((found - wanted).norm() / wanted.norm()) < tolerance


def test_factored_rows_tend_to_the_matrices():
    model = brdf.parse("ggx:0.5")
    scene = floor_and_wall(shiny(model), 5)
    whole = quiet(scene, order=3, output_order=9, rays=256)
    errors = []
    for rows in (1, 3, 8):
        factored = quiet(scene, order=3, rays=256, factors=rows)
        assert factored.matrix.shape[2] == rows == len(factored.factors)
        eyes = views()
        found = brdf.sample_hemisphere_map(factored.factors.double(), eyes) @ factored.matrix[0].double()
        wanted = exit_radiance(whole, eyes)[0]
        errors.append(float((found - wanted).norm() / wanted.norm()))
    assert errors[0] > errors[1] > errors[2]
    # The factors are those of unshadowed light; shadows make sharper light of it, of which they hold less.
    assert errors[2] < 0.06
    by_error = quiet(scene, order=3, rays=16, factors=0.5)
    assert by_error.factor_error <= 0.5


def test_visibility_meets_the_light_as_the_matrix_does():
    model = brdf.parse("phong:10")
    scene = floor_and_wall(shiny(model), 5)
    matrices = quiet(scene, order=4, rays=512)
    on_the_fly = quiet(scene, order=4, rays=512, frame="visibility", visibility_order=9)
    assert isinstance(on_the_fly, VisibilityTransfer)
    assert on_the_fly.visibility.shape == (81, 50)
    nodes, _ = sh.gauss_legendre_hemisphere(on_the_fly.degree)
    seen = on_the_fly.visibility.double().T @ sh.hemisphere_basis(nodes, 9).T
    turned = frames_of(on_the_fly)
    lights = sh.basis(torch.einsum("dk,vkj->vdj", nodes, turned), 4)
    found = torch.einsum("md,vd,vdn->vmn", on_the_fly.kernel.double(), seen, lights)
    difference = float((found - matrices.matrix[0].double()).norm() / found.norm())
    # Kernel and light have nine bands between them: what visibility has above them does not count.
    assert difference < 1e-3
    # The stated error is that of all 50 receivers, without the correction toward the closed form of 512 rays.
    assert on_the_fly.product_error == pytest.approx(difference, abs=1e-3)
    coarse = quiet(scene, order=4, rays=512, frame="visibility", visibility_order=2)
    assert coarse.product_error > 0.03


@pytest.mark.parametrize("output_order", [3, 8])
def test_the_error_of_products_is_that_of_the_order_that_is_shaded(output_order):
    scene = floor_and_wall(shiny("phong:20"), 5)
    matrices = quiet(scene, order=4, rays=512, output_order=output_order)
    products = quiet(scene, order=4, rays=512, output_order=output_order, frame="visibility", visibility_order=5)
    nodes, _ = sh.gauss_legendre_hemisphere(products.degree)
    seen = products.visibility.double().T @ sh.hemisphere_basis(nodes, 5).T
    lights = sh.basis(torch.einsum("dk,vkj->vdj", nodes, frames_of(products)), 4)
    found = torch.einsum("md,vd,vdn->vmn", products.kernel.double(), seen, lights)
    difference = float((found - matrices.matrix[0].double()).norm() / found.norm())
    # The matrices have the correction of 512 rays toward the closed form.
    assert products.product_error == pytest.approx(difference, abs=1e-3)


def test_two_materials_and_a_diffuse_object_share_a_scene():
    objects = [
        Object(square(1.0, 4), shiny("phong:10")),
        Object(square(1.0, 4, height=-3.0), Material(0.5)),
        Object(square(1.0, 4, height=-6.0), shiny("ggx:0.5", albedo=0.2, specular=0.5)),
    ]
    transfer = quiet(Scene(objects), order=3, rays=64)
    assert isinstance(transfer, GlossyTransfer)
    assert transfer.vertices == 48
    assert transfer.materials == ["phong:10", "ggx:0.5"]
    assert transfer.glossy.tolist() == [*range(16), *range(32, 48)]
    alone = quiet(Scene(objects[:1]), order=3, rays=64)
    # The first floor has nothing above it: what stands below it changes nothing.
    torch.testing.assert_close(transfer.matrix[:, :16], alone.matrix, atol=64 * EPS, rtol=0)
    assert alone.diffuse.shape == (1, 9, 0), "nothing is diffuse, nothing is stored"
    assert transfer.diffuse.shape == (1, 9, 48)
    assert transfer.specular.shape == (32, 1)


def test_materials_that_alternate_keep_their_order():
    """Chunks hold receivers of several materials; each must get the rows of its own."""
    glosses = ("phong:5", "phong:30")
    # The topmost comes last.
    meshes = [square(1.0, 3, height=-2.0 * index) for index in range(5, -1, -1)]
    mixed = Scene([Object(mesh, shiny(glosses[index % 2])) for index, mesh in enumerate(meshes)])
    options = {"order": 2, "output_order": 4, "rays": 64}
    transfer = quiet(mixed, **options)
    alone = [quiet(load(square(1.0, 3), material=shiny(gloss)), shadows=False, **options) for gloss in glosses]
    # Those below are in the shade of the next: they are compared by the closed form.
    closed = quiet(mixed, shadows=False, **options)
    for index in range(len(meshes)):
        rows = slice(9 * index, 9 * index + 9)
        torch.testing.assert_close(closed.matrix[:, rows], alone[index % 2].matrix, atol=64 * EPS, rtol=0)
    torch.testing.assert_close(transfer.matrix[:, -9:], alone[1].matrix, atol=64 * EPS, rtol=0)
    assert float((alone[0].matrix - alone[1].matrix).abs().max()) > 0.01


@pytest.mark.parametrize("frame", ["exit", "incident", "visibility"])
def test_threads_chunks_and_resuming_do_not_change_a_bit(frame, tmp_path):
    scene = floor_and_wall(shiny(albedo=0.4, specular=0.5), 17)
    assert scene.geometry().receivers > 512, "one chunk alone cannot come in the wrong order"
    bounces = 0 if frame == "visibility" else 1
    first = quiet(scene, order=3, rays=48, bounces=bounces, frame=frame, threads=1)
    for options in ({"threads": 2}, {"checkpoint": tmp_path / "kept", "keep": True}, {"checkpoint": tmp_path / "kept"}):
        again = quiet(scene, order=3, rays=48, bounces=bounces, frame=frame, **options)
        for name in first.layouts:
            assert torch.equal(getattr(first, name), getattr(again, name)), name
        assert (again.error, again.signal) == (first.error, first.signal)


@pytest.mark.parametrize(("scale", "offset"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)])
def test_scale_and_place_do_not_matter(scale, offset):
    def moved(factor, by):
        scene = floor_and_wall(shiny(albedo=0.2, specular=0.7), 5)
        objects = [
            Object(make_mesh(o.mesh.positions * factor + by, o.mesh.faces, name=o.mesh.name), o.material, o.role)
            for o in scene.objects
        ]
        return quiet(Scene(objects), order=3, rays=256, bounces=1)

    here, there = moved(1.0, 0.0), moved(scale, offset)
    # A ray that grazes an edge may fall to either side of it: a handful of 256.
    assert float((here.matrix - there.matrix).abs().max()) < 4 / 256 * float(here.matrix.abs().max())
    assert float((here.diffuse - there.diffuse).abs().max()) < 4 / 256


def test_a_receiver_without_a_normal_sends_nothing():
    mesh = square(1.0, 3)
    positions = torch.cat([mesh.positions, torch.tensor([[5.0, 0, 0]], dtype=torch.float64)])
    transfer = quiet(load(make_mesh(positions, mesh.faces), material=shiny(albedo=0.3, specular=0.5)), rays=32)
    assert float(transfer.matrix[:, -1].abs().max()) == 0 == float(transfer.diffuse[..., -1].abs().max())
    assert float(transfer.matrix[:, 0].abs().max()) > 0


def test_the_error_estimate_is_right():
    scene = floor_and_wall(shiny(), 9)
    coarse, fine = (quiet(scene, order=4, rays=rays) for rays in (128, 16384))
    true = float((coarse.matrix - fine.matrix).double().square().mean().sqrt())
    # A spread of receivers stands for all: within some tens of percent.
    assert coarse.error == pytest.approx(true, rel=0.5)
    assert coarse.signal == pytest.approx(float(coarse.matrix.double().square().mean().sqrt()), rel=1e-5)


def test_membranes_let_the_light_behind_them_through():
    scene = load(square(1.0, 4), material=Material(0.5, translucency=0.3))
    transfer = quiet(scene, order=5, rays=512)
    normals = transfer.normals.double()
    vectors = sh.zonal(brdf.membrane(0.3, 5), normals).T
    assert transfer.vertices == 32
    # Nothing blocks either side: the sum of two closed forms.
    torch.testing.assert_close(transfer.transfer[0].double(), vectors, atol=512 * EPS, rtol=0)
    torch.testing.assert_close(
        quiet(scene, order=5, shadows=False).transfer[0].double(), vectors, atol=16 * EPS, rtol=0
    )
    assert float((vectors - unshadowed(normals, 5)).abs().max()) > 0.05


def test_light_bounces_through_membranes():
    """A membrane over a floor: what the floor gets of a light above comes through the sheet alone."""

    def reading(translucency):
        sheet = square(8.0, 9, height=0.2)
        objects = [
            Object(square(1.0, 3), Material(0.5)),
            Object(sheet, Material(0.5, two_sided=True, translucency=translucency)),
        ]
        transfer = quiet(Scene(objects), order=3, rays=512, bounces=4)
        above = sh.zonal(sh.phong(2.0, 3), torch.tensor([[0.0, 1, 0]], dtype=torch.float64))[0].float()
        return float((above @ transfer.transfer[0])[:9].mean())

    assert reading(0.6) > 3 * abs(reading(0.0))


def test_points_among_glossy_surfaces_receive_what_they_reflect():
    points = Points(torch.tensor([[0.3, 0.3, 0.0], [0.0, 0.1, 0.5]]), torch.tensor([[0.0, 0, -1], [0.0, 1, 0]]))
    plain = quiet(floor_and_wall(Material(0.6), 9), order=3, rays=2048, bounces=2, receivers=points)
    layered = quiet(
        floor_and_wall(shiny("lambert", albedo=0.3, specular=0.3), 9), order=3, rays=2048, bounces=2, receivers=points
    )
    assert isinstance(layered, DiffuseTransfer)
    assert layered.bounces == 2
    # The same directions at the points; the vertices around have other frames: their Monte Carlo error.
    assert float((plain.transfer - layered.transfer).abs().max()) < 2e-3
    direct = quiet(floor_and_wall(shiny(), 9), order=3, rays=64, receivers=points)
    assert isinstance(direct, DiffuseTransfer)


def test_a_bowl_of_white_paint_keeps_its_light():
    """A closed form with every bounce: glossy paint that is Lambertian in a bowl that sees equal areas equally."""
    mesh, opening = bowl(math.pi / 2, rings=12, segments=24)
    scene = load(mesh, material=shiny("lambert", specular=0.5))
    transfer = quiet(scene, order=2, output_order=2, rays=1024, bounces=math.inf)
    reading = exit_radiance(transfer, views(2))[0, :, :, 0] * ONE
    # Form factor 1/2 to the sky: the exit radiance of unit albedo is F / (1 - rho (1 - F)) under a constant light.
    wanted = opening / (1 - 0.5 * (1 - opening))
    assert float(reading.median()) == pytest.approx(wanted, rel=0.01)
