"""Is what a glossy surface sends toward the eye what it should be?"""

import math
import warnings

import pytest
import torch
from contents import differing
from glossy_scenes import exit_radiance, floor_and_wall, frames_of, quiet, shiny, views
from shapes import square
from transfers import gloss, stored

from torchprt import brdf, sh
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Scene, load, make_mesh, samples
from torchprt.trace import Tracer
from torchprt.transport import OrderWarning, hemisphere
from torchprt.transport.receivers import tangent_frames
from torchprt.transport.solve import vertex_receivers

# Small orders and default tangents on purpose: what is baked is compared with what should be.
pytestmark = [
    pytest.mark.filterwarnings("ignore::torchprt.transport.OrderWarning"),
    pytest.mark.filterwarnings("ignore::torchprt.scene.TangentWarning"),
]

EPS = torch.finfo(torch.float32).eps
# A constant light of radiance 1 has this first coefficient.
ONE = math.sqrt(4 * math.pi)


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
    assert gloss(transfer).exit_error == brdf.exit_error(brdf.parse("phong:200"), 3, 3)
    assert gloss(transfer).exit_error > 0.1


@pytest.mark.parametrize("options", [{"frame": "incident"}, {"factors": 2}])
def test_what_holds_no_exit_functions_is_not_warned_of_their_order(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error", OrderWarning)
        quiet(load(square(), material=shiny("phong:60")), order=3, rays=16, **options)


def test_a_diffuse_scene_stays_diffuse():
    assert quiet(load(square()), rays=16).kind == "diffuse"


@pytest.mark.parametrize("frame", ["exit", "incident", "visibility"])
@pytest.mark.parametrize("order", [1, 3, 5])
def test_what_nothing_blocks_has_the_closed_form(frame, order):
    scene = load(samples.plane_and_blocker(3).objects[0].mesh, material=shiny("ggx:0.5", albedo=0.1))
    traced = quiet(scene, order=order, rays=257, frame=frame, output_order=4)
    exact = quiet(scene, order=order, shadows=False, frame=frame, output_order=4)
    found, wanted = stored(traced, frame), stored(exact, frame)
    # 257 additions in float32.
    torch.testing.assert_close(found, wanted, atol=257 * EPS * float(wanted.abs().max()), rtol=0)
    assert exact.rays == 0
    assert exact.error is None
    torch.testing.assert_close(stored(traced, "diffuse"), stored(exact, "diffuse"), atol=257 * EPS, rtol=0)


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
    visible = tracer.visibility(receivers.origins, turned.float(), directions.float()).double()
    kernel = brdf.exit_kernel(model, directions, 4, projection)
    for point in range(0, len(receivers), 7):
        world = sh.basis(directions @ turned[point], 3)
        wanted = (kernel * visible[point]) @ world * (2 * math.pi / 200)
        # The shared correction of the set toward the closed form is all that differs: below the error of the set.
        difference = float((stored(transfer)[0, point].double() - wanted).norm() / wanted.norm().clamp(min=1e-3))
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
    visible = tracer.visibility(receivers.origins, receivers.frames(), directions.float()).double()
    turned = receivers.frames().double()
    found = sh.exit_functions(torch.einsum("vij,ej->vei", frames_of(transfer), torch.eye(3).double()), 9)
    assert found.shape == (len(receivers), 3, 81)
    reflected = model(views()[:, None], directions) * directions[:, 2] * (2 * math.pi / len(directions))
    for point in (0, 12, 20, 30, 44):
        wanted = (reflected * visible[point]) @ sh.basis(directions @ turned[point], 4)
        # The same eyes in the frame that the matrix is of, which shares only the normal.
        eyes = views() @ turned[point] @ frames_of(transfer)[point].T
        got = sh.hemisphere_basis(eyes, 9) @ stored(transfer)[0, point].double()
        # 4096 rays miss an edge by about a thousandth of the signal; nine bands hold the lobe to less.
        assert float((got - wanted).norm() / wanted.norm()) < 5e-3


def test_the_incident_frame_is_the_symmetric_matrix_of_visibility():
    scene = floor_and_wall(shiny(), 5)
    square_one = quiet(scene, order=4, output_order=4, rays=300, frame="incident")
    wide = quiet(scene, order=4, output_order=3, rays=300, frame="incident")
    tall = quiet(scene, order=3, output_order=4, rays=300, frame="incident")
    turned = frames_of(square_one)
    world = sh.rotate(stored(square_one)[0].double(), turned.mT)
    torch.testing.assert_close(world, world.mT, atol=300 * EPS, rtol=0)
    torch.testing.assert_close(stored(wide)[0], stored(square_one)[0, :, :9], atol=300 * EPS, rtol=0)
    torch.testing.assert_close(stored(tall)[0], stored(square_one)[0, :, :, :9], atol=300 * EPS, rtol=0)
    # Visibility and its square are one function: the trace of V y y^T is at most that of the hemisphere.
    assert float(torch.linalg.eigvalsh(world).min()) > -1e-2
    assert float(torch.linalg.eigvalsh(world).max()) < 1 + 1e-2


def test_factored_rows_tend_to_the_matrices():
    model = brdf.parse("ggx:0.5")
    scene = floor_and_wall(shiny(model), 5)
    whole = quiet(scene, order=3, output_order=9, rays=256)
    errors = []
    for rows in (1, 3, 8):
        factored = quiet(scene, order=3, rays=256, factors=rows)
        assert stored(factored).shape[2] == rows == len(gloss(factored).factors)
        eyes = views()
        found = brdf.sample_hemisphere_map(gloss(factored).factors.double(), eyes) @ stored(factored)[0].double()
        wanted = exit_radiance(whole, eyes)[0]
        errors.append(float((found - wanted).norm() / wanted.norm()))
    assert errors[0] > errors[1] > errors[2]
    # The factors are those of unshadowed light; shadows make sharper light of it, of which they hold less.
    assert errors[2] < 0.06
    by_error = quiet(scene, order=3, rays=16, factors=0.5)
    assert gloss(by_error).factor_error <= 0.5


def test_visibility_meets_the_light_as_the_matrix_does():
    model = brdf.parse("phong:10")
    scene = floor_and_wall(shiny(model), 5)
    matrices = quiet(scene, order=4, rays=512)
    on_the_fly = quiet(scene, order=4, rays=512, frame="visibility", visibility_order=9)
    assert on_the_fly.kind == "visibility"
    assert stored(on_the_fly)[0].shape == (81, 50)
    nodes, _ = sh.gauss_legendre_hemisphere(gloss(on_the_fly).degree)
    seen = stored(on_the_fly)[0].double().T @ sh.hemisphere_basis(nodes, 9).T
    turned = frames_of(on_the_fly)
    lights = sh.basis(torch.einsum("dk,vkj->vdj", nodes, turned), 4)
    found = torch.einsum("md,vd,vdn->vmn", gloss(on_the_fly).kernel.double(), seen, lights)
    difference = float((found - stored(matrices)[0].double()).norm() / found.norm())
    # Kernel and light have nine bands between them: what visibility has above them does not count.
    assert difference < 1e-3
    # The stated error is that of all 50 receivers, without the correction toward the closed form of 512 rays.
    assert gloss(on_the_fly).product_error == pytest.approx(difference, abs=1e-3)
    coarse = quiet(scene, order=4, rays=512, frame="visibility", visibility_order=2)
    assert gloss(coarse).product_error > 0.03


@pytest.mark.parametrize("output_order", [3, 8])
def test_the_error_of_products_is_that_of_the_order_that_is_shaded(output_order):
    scene = floor_and_wall(shiny("phong:20"), 5)
    matrices = quiet(scene, order=4, rays=512, output_order=output_order)
    products = quiet(scene, order=4, rays=512, output_order=output_order, frame="visibility", visibility_order=5)
    nodes, _ = sh.gauss_legendre_hemisphere(gloss(products).degree)
    seen = stored(products)[0].double().T @ sh.hemisphere_basis(nodes, 5).T
    lights = sh.basis(torch.einsum("dk,vkj->vdj", nodes, frames_of(products)), 4)
    found = torch.einsum("md,vd,vdn->vmn", gloss(products).kernel.double(), seen, lights)
    difference = float((found - stored(matrices)[0].double()).norm() / found.norm())
    # The matrices have the correction of 512 rays toward the closed form.
    assert gloss(products).product_error == pytest.approx(difference, abs=1e-3)


def test_two_materials_and_a_diffuse_object_share_a_scene():
    objects = [
        Object(square(1.0, 4), shiny("phong:10")),
        Object(square(1.0, 4, height=-3.0), Material(0.5)),
        Object(square(1.0, 4, height=-6.0), shiny("ggx:0.5", albedo=0.2, specular=0.5)),
    ]
    transfer = quiet(Scene(objects), order=3, rays=64)
    assert transfer.kind == "diffuse + exit"
    assert transfer.vertices == 48
    assert gloss(transfer).materials == ["phong:10", "ggx:0.5"]
    assert gloss(transfer).receivers.tolist() == [*range(16), *range(32, 48)]
    alone = quiet(Scene(objects[:1]), order=3, rays=64)
    # The first floor has nothing above it: what stands below it changes nothing.
    torch.testing.assert_close(stored(transfer)[:, :16], stored(alone), atol=64 * EPS, rtol=0)
    assert "diffuse" not in alone.layers, "nothing is diffuse, nothing is stored"
    assert stored(transfer, "diffuse").shape == (1, 9, 48)
    assert gloss(transfer).specular.shape == (32, 1)


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
        torch.testing.assert_close(stored(closed)[:, rows], stored(alone[index % 2]), atol=64 * EPS, rtol=0)
    torch.testing.assert_close(stored(transfer)[:, -9:], stored(alone[1]), atol=64 * EPS, rtol=0)
    assert float((stored(alone[0]) - stored(alone[1])).abs().max()) > 0.01


@pytest.mark.parametrize("frame", ["exit", "incident", "visibility"])
def test_threads_chunks_and_resuming_do_not_change_a_bit(frame, tmp_path):
    scene = floor_and_wall(shiny(albedo=0.4, specular=0.5), 17)
    assert scene.geometry().receivers > 512, "one chunk alone cannot come in the wrong order"
    bounces = 0 if frame == "visibility" else 1
    first = quiet(scene, order=3, rays=48, bounces=bounces, frame=frame, threads=1)
    for options in ({"threads": 2}, {"checkpoint": tmp_path / "kept", "keep": True}, {"checkpoint": tmp_path / "kept"}):
        again = quiet(scene, order=3, rays=48, bounces=bounces, frame=frame, **options)
        assert not differing(first, again)


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
    assert float((stored(here) - stored(there)).abs().max()) < 4 / 256 * float(stored(here).abs().max())
    assert float((stored(here, "diffuse") - stored(there, "diffuse")).abs().max()) < 4 / 256


def test_a_receiver_without_a_normal_sends_nothing():
    mesh = square(1.0, 3)
    positions = torch.cat([mesh.positions, torch.tensor([[5.0, 0, 0]], dtype=torch.float64)])
    transfer = quiet(load(make_mesh(positions, mesh.faces), material=shiny(albedo=0.3, specular=0.5)), rays=32)
    assert float(stored(transfer)[:, -1].abs().max()) == 0 == float(stored(transfer, "diffuse")[..., -1].abs().max())
    assert float(stored(transfer)[:, 0].abs().max()) > 0


def test_the_error_estimate_is_right():
    scene = floor_and_wall(shiny(), 9)
    coarse, fine = (quiet(scene, order=4, rays=rays) for rays in (128, 16384))
    true = float((stored(coarse) - stored(fine)).double().square().mean().sqrt())
    # A spread of receivers stands for all: within some tens of percent.
    assert coarse.error == pytest.approx(true, rel=0.5)
    assert coarse.signal == pytest.approx(float(stored(coarse).double().square().mean().sqrt()), rel=1e-5)
