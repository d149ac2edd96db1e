"""Does a preview show what its state says, and is every change to it the one that was asked for?"""

import math
from dataclasses import replace

import pytest
import torch
from shapes import square
from transfers import random_glossy, replaced
from zonal_transfers import bumpy, random_zonal

from torchprt import light, sh
from torchprt.compression import compress, decompress, fit
from torchprt.errors import InputError
from torchprt.light import WINDOWS, windowed
from torchprt.preview import Environment, Session, automatic_exposure
from torchprt.preview.animation import PERIOD
from torchprt.preview.session import BACKDROPS, LOBE, MODES, PLAIN
from torchprt.scene import Material, Object, Scene
from torchprt.shade import display, shader
from torchprt.transport import bake

ORDER = 4
EPS = torch.finfo(torch.float32).eps


@pytest.fixture(scope="module")
def scene():
    """A square above another: the lower one has a shadow."""
    ground, roof = square(2.0, 9), square(0.8, 5, height=0.5)
    return Scene([Object(ground, Material((0.8, 0.4, 0.2))), Object(roof, Material(0.6))])


@pytest.fixture(scope="module")
def shadowed(scene):
    return bake(scene, order=ORDER, rays=64, progress=False)


@pytest.fixture(scope="module")
def bounced(scene):
    return bake(scene, order=ORDER, rays=64, bounces=1, progress=False)


@pytest.fixture(scope="module")
def glossy(scene):
    gloss = Scene([Object(each.mesh, Material(0.3, gloss="phong:2", specular=0.5)) for each in scene.objects])
    return bake(gloss, order=ORDER, rays=64, progress=False)


def environments():
    image = light.studio(32)
    lamp = light.directional((0.4, 1.0, 0.2), 2.0, order=ORDER).float() + light.constant(0.3, ORDER).float()
    return [Environment("studio", light.project(image, ORDER), image), Environment("lamp", lamp)]


@pytest.fixture
def session(shadowed, bounced):
    return Session({"shadowed": shadowed, "bounced": bounced}, environments())


def shown(session, transfer, coefficients, **more):
    """What a screen shows of a bake under a light, by the room `shade` alone."""
    with torch.no_grad():
        radiance = shader(transfer)(coefficients, **more)
    return display(radiance, exposure=session.stops, tone=session.tone)


def close(found, wanted):
    # sRGB is steep near black: 13 times the rounding of radiance, summed over some tens of products.
    torch.testing.assert_close(found, wanted, rtol=0, atol=2000 * EPS)


# What it refuses


def test_refuses_to_show_nothing(shadowed):
    for bakes, lights in (({}, environments()), ({"a": shadowed}, [])):
        with pytest.raises(InputError, match="nothing to preview"):
            Session(bakes, lights)


def test_refuses_bakes_of_different_meshes(shadowed, make_transfer):
    with pytest.raises(InputError, match=r"other has 25 vertices.*one mesh"):
        Session({"shadowed": shadowed, "other": make_transfer(order=ORDER)}, environments())


def test_refuses_loose_points(make_transfer):
    transfer = make_transfer(order=ORDER)
    points = replaced(transfer, faces=transfer.faces[:0])
    with pytest.raises(InputError, match="needs faces"):
        Session({"points": points}, environments())


def test_refuses_a_mode_that_is_not_there(session):
    with pytest.raises(InputError, match=r"mode 'x' is unknown: use one of transfer"):
        session.set_mode("x")


# What it shows


def test_it_begins_with_the_transfer_of_the_first_file(session, shadowed):
    assert session.mode == "transfer"
    close(session.colours(), shown(session, shadowed, environments()[0].light))


def test_the_turned_light_is_the_one_that_is_shown(session, shadowed):
    session.turn_light(0.7, -0.4)
    assert not torch.equal(session.rotation, torch.eye(3))
    close(session.colours(), shown(session, shadowed, environments()[0].light, rotation=session.rotation))
    session.reset()
    close(session.colours(), shown(session, shadowed, environments()[0].light))


def test_every_environment_comes_in_turn_and_has_its_own_exposure(session, shadowed):
    for place in (1, 0, 1):
        line = session.next_environment()
        wanted = environments()[place]
        assert line == f"environment: {wanted.name}"
        assert session.stops == automatic_exposure(wanted.light)
        close(session.colours(), shown(session, shadowed, wanted.light))
    assert session.next_environment(-1) == "environment: studio"


@pytest.mark.parametrize("name", WINDOWS)
@pytest.mark.parametrize("bands", [1, 2, 3, 4])
def test_fewer_bands_under_a_window_are_the_light_of_that_order_under_it(session, shadowed, bands, name):
    for _ in range(ORDER - bands):
        session.change_order(-1)
    while session.window != name:
        session.next_window()
    assert session.order == bands
    lamp = windowed(environments()[0].light[: bands**2], name)
    close(session.colours(), shown(session, shadowed.to_order(bands), lamp))


def test_bands_end_at_one_and_at_those_of_the_bake(session):
    assert [session.change_order(-1) for _ in range(5)][-1] == "order: 1"
    assert [session.change_order(1) for _ in range(6)][-1] == f"order: {ORDER}"


def test_exposure_is_in_stops(session):
    before = session.radiance()
    line = session.expose(1.5)
    assert line == f"exposure: {automatic_exposure(environments()[0].light) + 1.5:+.1f} stops"
    close(session.colours(), display(before, exposure=automatic_exposure(environments()[0].light) + 1.5))


def test_interreflection_is_the_other_file(session, bounced, shadowed):
    assert session.next_bake() == "bake: bounced, interreflected, 1 bounce"
    close(session.colours(), shown(session, bounced, environments()[0].light))
    session.next_bake()
    close(session.colours(), shown(session, shadowed, environments()[0].light))


def test_the_ways_without_transfer_see_no_shadow(session):
    for mode in ("unshadowed", "one lamp"):
        assert session.set_mode(mode) == f"mode: {mode}"
        ground = session.radiance()[: 9 * 9]
        # A level square in one colour, without the roof above it.
        torch.testing.assert_close(ground, ground[:1].expand_as(ground), rtol=1e-5, atol=0)
    session.set_mode("transfer")
    ground = session.radiance()[: 9 * 9]
    assert float(ground.std(0).min()) > 0.01


def test_the_modes_are_pictures_of_their_own(session):
    pictures = [session.colours()]
    for mode in MODES[1:]:
        assert session.next_mode().startswith(f"mode: {mode}")
        pictures.append(session.colours())
    for one in range(len(MODES)):
        for other in range(one):
            assert not torch.allclose(pictures[one], pictures[other], atol=1e-6, rtol=0)
    assert session.next_mode() == "mode: transfer"
    close(session.colours(), pictures[0])


def test_the_map_of_sight_is_told_in_words(shadowed, bounced):
    sight = torch.zeros(bounced.vertices, dtype=torch.uint8)
    sight[3] = 4
    marked = replace(bounced, receivers=replace(bounced.receivers, sight=sight))
    session = Session({"bounced": marked, "shadowed": shadowed}, environments())
    assert session.set_mode("sight") == "mode: sight"
    red, grey = session.colours()[3], session.colours()[4]
    assert red[0] > 2 * red[1]
    assert float(grey.std()) < 0.05
    assert session.status()[-1] == "red: 1 vertex, lit not at all, and dark"
    session.next_bake()
    assert "no vertex is marked" in session.status()[-1]
    torch.testing.assert_close(session.colours()[3], grey, atol=0.2, rtol=0)


def test_compressed_is_the_file_that_was_given(shadowed):
    packed = compress(shadowed, clusters=3, components=1)
    session = Session({"packed": packed, "shadowed": shadowed}, environments())
    assert session.mode == "transfer"
    close(session.colours(), shown(session, shadowed, environments()[0].light))
    assert session.set_mode("compressed") == "mode: compressed, packed"
    close(session.colours(), shown(session, decompress(packed), environments()[0].light))


def test_compressed_again_goes_on_to_the_next(shadowed):
    packed = {f"{count}": compress(shadowed, clusters=count, components=1) for count in (2, 4)}
    session = Session({"shadowed": shadowed, **packed}, environments())
    lines = [session.set_mode("compressed") for _ in range(3)]
    assert lines == ["mode: compressed, 2", "mode: compressed, 4", "mode: compressed, 2"]
    session.set_mode("error")
    few = session.colours(), session.worst
    session.set_mode("compressed")
    session.set_mode("compressed")
    session.set_mode("error")
    session.colours()
    assert session.worst < few[1]


def test_the_error_is_that_of_the_compressed_radiance(session, shadowed):
    packed = compress(shadowed, clusters=3, components=1)
    session = Session({"shadowed": shadowed, "packed": packed}, environments())
    session.set_mode("error")
    session.colours()
    with torch.no_grad():
        wanted, found = (shader(each)(environments()[0].light) for each in (shadowed, packed))
    error = (found - wanted).square().mean().sqrt() / wanted.square().mean().sqrt()
    assert session.worst == pytest.approx(float(error), rel=1e-3)
    assert any(f"error {session.worst:.2%} RMS" in line for line in session.status())


def test_a_compressed_file_alone_has_nothing_to_be_compared_with(shadowed):
    session = Session({"packed": compress(shadowed, clusters=3, components=1)}, environments())
    assert session.mode == "compressed"
    for mode in ("transfer", "error"):
        assert "before it was compressed" in session.set_mode(mode)
        assert session.mode == "compressed"
    session.set_mode("unshadowed")
    session.colours()


# Glossy


def test_a_glossy_picture_follows_the_eye_and_a_diffuse_one_does_not(session, glossy):
    gloss = Session({"glossy": glossy}, environments())
    for each, follows in ((gloss, True), (session, False)):
        before = each.colours()
        each.turn_camera(0.8, 0.1)
        assert (each.colours() is not before) == follows
        assert each.follows_eye == follows
    eye = torch.tensor(gloss.camera.eye)
    close(gloss.colours(), shown(gloss, glossy, environments()[0].light, eye=eye))
    gloss.set_mode("unshadowed")
    assert not gloss.follows_eye


# Shading only when something changed


def test_nothing_is_shaded_twice(session):
    first = session.colours()
    session.next_backdrop()
    session.turn_camera(0.4, 0.1)
    session.zoom(2)
    session.advance(0.1)
    session.status()
    assert session.colours() is first
    session.turn_light(0.01, 0)
    assert session.colours() is not first


# What is behind


def test_behind_the_model_is_nothing_the_photograph_or_its_bands(session):
    assert session.backdrop_image() is None
    assert session.next_backdrop() == f"behind: {BACKDROPS[1]}"
    close(session.backdrop_image(), display(environments()[0].image, exposure=session.stops))
    session.next_backdrop()
    session.change_order(-2)
    bands = session.backdrop_image()
    directions = sh.latlong_directions(64, 128, dtype=torch.float32)
    wanted = (sh.basis(directions, 2) @ environments()[0].light[:4]).clamp(min=0)
    close(bands, display(wanted, exposure=session.stops))
    session.next_backdrop()
    assert session.backdrop_image() is None


def test_a_light_without_a_photograph_is_shown_in_its_bands(session):
    session.next_environment()
    session.next_backdrop()
    assert session.backdrop_image().shape == (64, 128, 3)


# Picking


def place_of(session, point, size):
    """The pixel at which a point of the world is seen."""
    camera = session.camera
    forward, right, above = camera.axes()
    offset = point - session.eye
    reach = math.tan(math.radians(camera.field) / 2) * float(offset @ forward)
    width, height = size
    x = (float(offset @ right) / reach * height / width + 1) * width / 2
    return x, (1 - float(offset @ above) / reach) * height / 2


def test_a_click_picks_the_vertex_that_is_there(session):
    size = (640, 480)
    for vertex in (0, 8, 80, 81, 105):
        point = session.rest[vertex] * 0.999
        point[1] = session.rest[vertex, 1]
        line = session.pick(*place_of(session, point, size), *size)
        assert session.picked == vertex
        assert f"vertex {vertex}:" in line


def test_a_click_beside_the_model_or_on_its_reverse_picks_nothing(session):
    session.pick(*place_of(session, session.rest[0] * 0.99, (640, 480)), 640, 480)
    assert session.picked is not None
    assert session.pick(0, 0, 640, 480) == "no vertex picked"
    assert session.picked is None
    session.turn_camera(0, -10)
    session.pick(320, 240, 640, 480)
    assert session.picked is None


def test_the_lobe_stands_at_the_picked_vertex_and_shows_its_bands(session):
    assert session.lobe() is None
    session.picked = 40
    whole = session.lobe()
    assert float((whole.positions - session.rest[40]).norm(dim=-1).max()) == pytest.approx(LOBE * session.radius)
    for _ in range(ORDER - 1):
        session.change_order(-1)
    ball = session.lobe()
    # One band is a sphere.
    distance = (ball.positions - session.rest[40]).norm(dim=-1)
    torch.testing.assert_close(distance, distance[:1].expand_as(distance), rtol=1e-9, atol=0)


# Models that move


def test_only_transfer_that_follows_the_pose_is_animated(session):
    assert "stands still" in session.play()
    assert not session.playing


def test_zonal_transfer_moves_and_comes_back():
    session = Session({"lobes": random_zonal(side=4, order=ORDER)}, environments())
    assert session.play() == "animation: on"
    still = session.colours()
    session.advance(PERIOD / 4)
    assert not torch.equal(session.positions, session.rest)
    assert not torch.allclose(session.colours(), still, atol=1e-3)
    transfer = random_zonal(side=4, order=ORDER)
    close(session.colours(), shown(session, transfer, environments()[0].light, positions=session.positions))
    session.play()
    held = session.positions
    session.advance(1.0)
    assert session.positions is held
    session.reset()
    session.advance(1.0)
    assert session.positions is session.rest
    close(session.colours(), still)


def test_other_transfer_of_a_model_that_has_moved_is_at_rest(make_transfer):
    lobes = random_zonal(side=5, order=ORDER)
    flat = replaced(make_transfer(side=5, order=ORDER), positions=lobes.positions, faces=lobes.faces)
    session = Session({"vectors": flat, "lobes": lobes}, environments())
    still = {mode: session.set_mode(mode) and session.colours() for mode in ("transfer", "unshadowed")}
    session.set_mode("compressed")
    session.play()
    session.advance(PERIOD / 4)
    assert session.positions is not session.rest
    for mode, wanted in still.items():
        session.set_mode(mode)
        close(session.colours(), wanted)
        session.advance(0.1)
        assert session.positions is session.rest
        close(session.colours(), wanted)
        session.set_mode("compressed")
        session.advance(0.1)


def test_exit_rows_in_lobes_follow_the_eye_and_the_pose():
    positions, faces = bumpy(4)
    baked = random_glossy("exit", vertices=16, glossy=9, order=ORDER, output_order=2)
    transfer = fit(replaced(baked, positions=positions.float(), faces=faces), lobes=2)
    session = Session({"lobes": transfer}, environments())
    assert session.follows_eye
    assert session.play() == "animation: on"
    session.advance(PERIOD / 4)
    moved = session.colours()
    more = {"positions": session.positions, "eye": torch.tensor(session.camera.eye)}
    close(moved, shown(session, transfer, environments()[0].light, **more))
    session.turn_camera(0.8, 0.1)
    assert not torch.allclose(session.colours(), moved, atol=1e-3)


def test_normals_follow_the_pose_in_the_ways_without_transfer():
    session = Session({"lobes": random_zonal(side=5, order=ORDER)}, environments())
    session.set_mode("unshadowed")
    still = session.colours()
    session.play()
    session.advance(PERIOD / 4)
    assert not torch.allclose(session.colours(), still, atol=1e-3)


def test_given_poses_come_one_after_the_other():
    transfer = random_zonal(side=4, order=ORDER)
    poses = torch.stack([transfer.positions.double() * scale for scale in (1.0, 1.5, 2.0)])
    session = Session({"lobes": transfer}, environments(), poses=poses)
    session.play()
    session.advance(1 / 24)
    torch.testing.assert_close(session.positions, poses[1])
    session.advance(0.5 / 24)
    torch.testing.assert_close(session.positions, (poses[1] + poses[2]) / 2)
    session.advance(1.5 / 24)
    torch.testing.assert_close(session.positions, poses[0])


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (torch.zeros(0, 16, 3), "poses are 0"),
        (torch.zeros(2, 5, 3), "of 5 vertices"),
        (torch.full((1, 16, 3), math.nan), "NaN"),
    ],
)
def test_refuses_poses_of_another_mesh(poses, words):
    with pytest.raises(InputError, match=words):
        Session({"lobes": random_zonal(side=4, order=ORDER)}, environments(), poses=poses)


def test_a_ground_is_not_framed_and_becomes_the_plain_background_at_its_edge(scene):
    plain, stood = (bake(each, order=ORDER, shadows=False) for each in (scene, scene.on_ground(albedo=0.9)))
    alone, session = Session({"plain": plain}, environments()), Session({"stood": stood}, environments())
    assert session.orbit == alone.orbit
    assert session.radius == alone.radius
    model = plain.vertices
    assert torch.allclose(session.colours()[:model], alone.colours(), atol=1e-5)
    ground = stood.positions[model:]
    far = (ground - ground.mean(0)).norm(dim=-1)
    rim = far > 0.999 * far.max()
    assert (session.colours()[model:][rim] - PLAIN).abs().max() < 1e-5
    # Before an environment that would be wrong.
    session.next_backdrop()
    assert (session.colours()[model:][rim] - PLAIN).abs().min() > 0.05
    assert torch.allclose(session.colours()[:model], alone.colours(), atol=1e-5)
