"""Is a bake lit from where the light is, in the order of the file, in numbers, pictures and models?"""

import math

import numpy as np
import PIL.Image
import pytest
import torch
import trimesh
from environments import lamp, save_exr
from PIL import Image
from transfers import random_glossy, replaced

from torchprt.preview import automatic_exposure, built_in_environment, colours, linear_colours
from torchprt.scene import read_mesh
from torchprt.scene.gltf import Document, pieces
from torchprt.transfer import load, save

EPSILON = np.finfo(np.float32).eps


# The order of vertices


def test_radiance_comes_in_the_order_of_the_file_with_duplicates_and_strays(done, shaded, tmp_path):
    """A tetrahedron in a shuffled file: a vertex is there three times, two belong to no face."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    rows = [(9, 9, 9), *corners[[2, 0]], corners[0], (8, 8, 8), corners[3], corners[0], corners[1]]
    # Corner 0 is vertex 2, 3 and 6, one for each face that meets there.
    faces = [(2, 7, 1), (3, 5, 7), (6, 1, 5), (7, 5, 1)]
    text = "".join("v {} {} {}\n".format(*row) for row in rows) + "".join(
        "f {} {} {}\n".format(*(corner + 1 for corner in face)) for face in faces
    )
    (tmp_path / "a.obj").write_text(text)
    said = done("bake", tmp_path / "a.obj", "-o", tmp_path / "a.safetensors", "--rays", 64)
    assert "2 vertices named by no face" in said
    save_exr(tmp_path / "white.exr", np.ones((16, 32, 3)))
    done("shade", tmp_path / "a.safetensors", "--light", tmp_path / "white.exr", "-o", tmp_path / "r.npy")
    said = done("shade", tmp_path / "a.safetensors", "--light", tmp_path / "white.exr", "-o", tmp_path / "r.npy")
    assert "2 of 8 vertices without a normal read 0" in said
    radiance = np.load(tmp_path / "r.npy")
    assert radiance.shape == (8, 3)
    assert (radiance[[0, 4]] == 0).all()
    # A convex body of albedo .5 under a light of 1 everywhere; the projection of 16 rows is off by a hundredth.
    np.testing.assert_allclose(radiance[[1, 2, 3, 5, 6, 7]], 0.5, atol=0.01)
    mesh = read_mesh(tmp_path / "a.obj")
    assert torch.equal(load(tmp_path / "a.safetensors").positions.double(), mesh.positions)


def test_vertices_without_a_normal_that_a_bake_filled_are_not_said_to_be_dark(done, tmp_path):
    """Vertex 5 is where vertex 1 is, on a face without area; vertex 6 is on none."""
    corners = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1), (1, 1, 1), (9, 9, 9)]
    faces = [(1, 2, 3), (1, 4, 2), (1, 3, 4), (2, 4, 3), (5, 1, 2)]
    text = "".join("v {} {} {}\n".format(*row) for row in corners) + "".join(
        "f {} {} {}\n".format(*row) for row in faces
    )
    (tmp_path / "a.obj").write_text(text)
    for option, dark in (([], "1 of 6 vertices without a normal read 0"), (["--raw"], "2 of 6 vertices without a")):
        done("bake", tmp_path / "a.obj", "-o", tmp_path / "a.safetensors", "--rays", 64, *option)
        said = done("shade", tmp_path / "a.safetensors", "--light", "white", "-o", tmp_path / "r.npy")
        assert dark in said
        radiance = np.load(tmp_path / "r.npy")
        assert (radiance[4] > 0.3).all() == (not option)
        assert (radiance[5] == 0).all()


# Which way is which


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 2, -3)])
def test_a_lamp_lights_the_side_that_it_is_on(direction, shaded, folder, tmp_path):
    radiance = shaded(save_exr(tmp_path / "a.exr", lamp(direction)))
    ball = trimesh.load(folder / "ball.ply", process=False).vertices
    brightest = ball[radiance[:, 0].argmax()]
    # The vertices of this ball are 18 degrees apart.
    assert brightest @ direction / np.linalg.norm(direction) > math.cos(math.radians(12))


def test_yaw_turns_from_z_to_x_pitch_from_y_to_z_roll_from_x_to_y(shaded, tmp_path):
    cases = [("90,0,0", (0, 0, 1), (1, 0, 0)), ("0,90,0", (0, 1, 0), (0, 0, 1)), ("0,0,90", (1, 0, 0), (0, 1, 0))]
    for text, before, after in cases:
        turned = shaded(save_exr(tmp_path / "a.exr", lamp(before, height=64)), "--rotate", text)
        there = shaded(save_exr(tmp_path / "a.exr", lamp(after, height=64)))
        # The lamp's rim falls on other texels: a hundredth of its light.
        np.testing.assert_allclose(turned, there, rtol=0, atol=0.02 * there.max())
        assert np.abs(there - shaded(save_exr(tmp_path / "a.exr", lamp(before)))).max() > 0.5 * there.max()


def test_yaw_is_the_image_with_its_columns_rolled(shaded, tmp_path):
    """Photographs turn with `numpy.roll`: the columns lie around +y, and +z is toward the ends of the rows."""
    image = lamp((0.3, 0.5, 1.0))
    turned = shaded(save_exr(tmp_path / "a.exr", image), "--rotate", "90,0,0")
    # The column of +z, the first, becomes that of +x, three quarters along: a quarter to the left.
    rolled = shaded(save_exr(tmp_path / "a.exr", np.roll(image, -16, axis=1)))
    # The same sums in another order, turned.
    np.testing.assert_allclose(turned, rolled, rtol=0, atol=64 * EPSILON * rolled.max())
    assert np.abs(turned - shaded(save_exr(tmp_path / "a.exr", np.roll(image, 16, axis=1)))).max() > 0.5


# Pictures


def pixels_of(path):
    with PIL.Image.open(path) as opened:
        return np.asarray(opened.convert("RGB")).astype(float)


@pytest.mark.parametrize(
    ("direction", "view", "side"),
    [
        ((1, 0, 0), "0,0,1", "right"),
        ((-1, 0, 0), "0,0,1", "left"),
        ((0, 1, 0), "0,0,1", "top"),
        ((0, -1, 0), "0,0,1", "bottom"),
        ((0, 0, -1), "1,0,0", "right"),
        ((1, 0, 0), "0,0,-1", "left"),
        ((1, 0, 0), "0,1,0", "right"),
        ((0, 0, -1), "0,1,0", "top"),
    ],
)
def test_a_lamp_lights_that_side_of_the_picture(direction, view, side, done, folder, tmp_path):
    light = save_exr(tmp_path / "a.exr", lamp(direction))
    arguments = ["shade", folder / "ball.safetensors", "--light", light, "-o", tmp_path / "a.png"]
    done(*arguments, "--view", view, "--size", "90x60", "--tone", "none", "--exposure", -1)
    picture = pixels_of(tmp_path / "a.png").mean(-1)
    assert picture.shape == (60, 90)
    halves = {"left": picture[:, :45], "right": picture[:, 45:], "top": picture[:30], "bottom": picture[30:]}
    other = {"left": "right", "right": "left", "top": "bottom", "bottom": "top"}[side]
    assert halves[side].mean() > 1.3 * halves[other].mean()


@pytest.mark.parametrize("size", ["1x1", "64x48", "31x77"])
def test_a_picture_has_the_size_that_was_asked_for(size, done, folder, tmp_path):
    arguments = ["shade", folder / "ball.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "a.png"]
    done(*arguments, "--size", size)
    picture = pixels_of(tmp_path / "a.png")
    assert "{1}x{0}".format(*picture.shape) == size
    assert len(np.unique(picture)) > (20 if size != "1x1" else 0)


def test_exposure_and_tone_change_the_picture_and_not_the_radiance(done, shaded, folder, tmp_path):
    levels = []
    for options in ([], ["--exposure", "2"], ["--exposure", "-2"], ["--tone", "none"]):
        arguments = ["shade", folder / "ball.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "a.png"]
        done(*arguments, "--size", "40x30", *options)
        levels.append(pixels_of(tmp_path / "a.png").mean())
    assert levels[2] < levels[0] < levels[1]
    assert levels[3] != levels[0]
    radiance = shaded(folder / "lamp.exr")
    np.testing.assert_array_equal(shaded(folder / "lamp.exr", "--exposure", "3", "--tone", "none"), radiance)


# Each option by which a picture differs; a camera beside the model and a sun in it, so that all of it shows.
SAME = (
    [],
    ["--light", "sunset"],
    ["--light", "three-point", "--window", "none"],
    ["--light", "sky", "--background", "--view", "-0.3,0.2,-1", "--rotate", "40"],
    ["--light", "LAMP", "--exposure", "-1.5", "--tone", "agx"],
    ["--light", "overcast", "--tone", "filmic", "--backdrop", "transparent"],
    ["--light", "white", "--tone", "none", "--backdrop", "#336699"],
    ["--target", "0.3,0.1,0", "--distance", "3.5", "--fov", "50", "--samples", "7"],
    ["--rotate", "30,20,10", "--window", "hann"],
)


@pytest.mark.parametrize("options", SAME, ids=lambda options: " ".join(options) or "as it is")
def test_shade_and_render_give_the_same_picture_byte_for_byte(done, folder, tmp_path, options):
    given = [folder / "lamp.exr" if each == "LAMP" else each for each in options]
    for verb in ("shade", "render"):
        done(verb, folder / "ball.safetensors", "-o", tmp_path / f"{verb}.png", "--size", "60x44", *given)
    assert (tmp_path / "shade.png").read_bytes() == (tmp_path / "render.png").read_bytes()
    if options:
        done("render", folder / "ball.safetensors", "-o", tmp_path / "plain.png", "--size", "60x44")
        assert (tmp_path / "plain.png").read_bytes() != (tmp_path / "render.png").read_bytes()


def test_shade_and_render_give_the_same_picture_of_gloss(done, make_transfer, tmp_path):
    flat = make_transfer(side=4, order=4)
    glossy = replaced(random_glossy("exit", vertices=16, glossy=9), positions=flat.positions, faces=flat.faces)
    save(glossy, tmp_path / "a.safetensors")
    for verb in ("shade", "render"):
        said = done(verb, tmp_path / "a.safetensors", "-o", tmp_path / f"{verb}.png", "--size", "40x30", "--fov", 20)
        assert "exposure" in said
    assert (tmp_path / "shade.png").read_bytes() == (tmp_path / "render.png").read_bytes()


def test_colours_of_a_model_are_those_of_its_picture(done, shaded, folder, tmp_path):
    """One exposure and one tone for `.ply` and `.png`."""
    radiance = torch.from_numpy(shaded("sunset"))
    done("shade", folder / "ball.safetensors", "--light", "sunset", "-o", tmp_path / "a.ply")
    stops = automatic_exposure(built_in_environment("sunset", 4).light)
    there = trimesh.load(tmp_path / "a.ply", process=False).visual.vertex_colors[:, :3]
    np.testing.assert_array_equal(there, colours(radiance, stops))


def test_one_number_turns_as_a_yaw_and_two_as_yaw_and_pitch(shaded, folder):
    for short, whole in (("90", "90,0,0"), ("20,30", "20,30,0")):
        turned = shaded(folder / "lamp.exr", "--rotate", short)
        np.testing.assert_array_equal(turned, shaded(folder / "lamp.exr", "--rotate", whole))
        assert np.abs(turned - shaded(folder / "lamp.exr")).max() > 0.1


def test_a_target_in_the_middle_of_the_picture_and_an_angle_that_holds_less(done, folder, tmp_path):
    """The ball of radius 1, seen beside itself, nearer and farther."""
    covered = {}
    for name, more in (("all", []), ("far", ["--distance", 30]), ("wide", ["--fov", 90, "--distance", 3])):
        picture = tmp_path / f"{name}.png"
        done(
            "render", folder / "ball.safetensors", "-o", picture, "--size", "64x64", "--backdrop", "transparent", *more
        )
        with PIL.Image.open(picture) as opened:
            covered[name] = np.asarray(opened)[..., 3].mean() / 255
    # Radius over distance over the tangent of half the angle of view, of the square of side 2.
    assert covered["far"] == pytest.approx(math.pi / 4 / (30 * math.tan(math.radians(17.5))) ** 2, rel=0.06)
    assert covered["wide"] == pytest.approx(math.pi / 4 * (1 / 9) / (1 - 1 / 9), rel=0.06)
    assert 0.5 < covered["all"] < 0.8
    beside = ["--target", "5,0,0", "--view", "0,0,1", "--distance", 8, "--fov", 90, "--backdrop", "transparent"]
    done("render", folder / "ball.safetensors", "-o", tmp_path / "b.png", "--size", "64x64", *beside)
    with PIL.Image.open(tmp_path / "b.png") as opened:
        alpha = np.asarray(opened)[..., 3]
    # 5 to the left at distance 8: 5/8 of the half picture.
    assert (alpha.mean(0) * np.arange(64)).sum() / alpha.mean(0).sum() == pytest.approx(31.5 - 5 / 8 * 32, abs=1)


def test_a_lit_model_reloads_elsewhere_as_it_was(done, shaded, folder, tmp_path):
    done(
        "shade",
        folder / "ball.safetensors",
        "--light",
        folder / "lamp.exr",
        "-o",
        tmp_path / "a.ply",
        "--tone",
        "none",
        "--exposure",
        0,
    )
    there, ball = (trimesh.load(path, process=False) for path in (tmp_path / "a.ply", folder / "ball.ply"))
    np.testing.assert_array_equal(there.vertices, ball.vertices)
    np.testing.assert_array_equal(there.faces, ball.faces)
    linear = shaded(folder / "lamp.exr").astype(float).clip(0, 1)
    # IEC 61966-2-1.
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055) * 255
    np.testing.assert_allclose(there.visual.vertex_colors[:, :3], encoded, atol=0.51)


def test_a_fixed_light_leaves_as_gltf_with_linear_colours(done, folder, tmp_path):
    options = ["--light", folder / "lamp.exr", "--exposure", 0.5]
    done("shade", folder / "ball.safetensors", "-o", tmp_path / "a.glb", *options)
    done("shade", folder / "ball.safetensors", "-o", tmp_path / "a.npy", *options)
    (mesh,) = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    bake = load(folder / "ball.safetensors")
    np.testing.assert_array_equal(mesh.vertices, bake.positions)
    np.testing.assert_array_equal(mesh.faces, bake.faces)
    expected = linear_colours(torch.from_numpy(np.load(tmp_path / "a.npy")), 0.5)
    np.testing.assert_array_equal(mesh.visual.vertex_attributes["color"], expected)


def test_a_fixed_light_keeps_the_gltf_that_was_baked(done, folder, tmp_path):
    ball = trimesh.load(folder / "ball.ply", process=False)
    grey = Image.new("RGB", (2, 2), (188, 188, 188))
    ball.visual = trimesh.visual.TextureVisuals(uv=ball.vertices[:, :2], image=grey)
    ball.export(tmp_path / "ball.glb")
    done("bake", tmp_path / "ball.glb", "-o", tmp_path / "a.safetensors", "--unshadowed", "--order", 3)
    options = ["--light", folder / "lamp.exr", "--exposure", -3, "--tone", "none"]
    said = done("shade", tmp_path / "a.safetensors", *options, "-o", tmp_path / "lit.glb")
    assert f"keeps what {tmp_path / 'ball.glb'} holds" in said
    done("shade", tmp_path / "a.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "a.npy")
    content = (tmp_path / "lit.glb").read_bytes()
    assert b"KHR_materials_unlit" in content
    assert b"TEXCOORD_0" in content
    expected = linear_colours(torch.from_numpy(np.load(tmp_path / "a.npy")), -3.0, "none")
    (piece,) = pieces(Document.read(tmp_path / "lit.glb")).pieces
    # 188 of 255 in sRGB is .5028865 in linear numbers, and times COLOR_0 it is what is seen.
    np.testing.assert_allclose(0.5028865 * piece.colours, expected, rtol=1e-5, atol=1e-7)


# Windows


def test_a_window_takes_ringing_away_and_says_how_much_it_leaves(run, folder, tmp_path):
    light = save_exr(tmp_path / "a.exr", lamp((0, 1, 0), radiance=1e4))
    arguments = ["shade", folder / "ball.safetensors", "--light", light, "-o", tmp_path / "a.npy"]
    plain = run(*arguments)
    assert "negative radiance at " in plain.out
    assert "--window auto" in plain.out
    ringing = np.load(tmp_path / "a.npy").min()
    assert ringing < 0
    lowest = {}
    for window in ("auto", "least", "hann", "lanczos", "gauss"):
        ended = run(*arguments, "--window", window)
        assert ended.code == 0
        lowest[window] = np.load(tmp_path / "a.npy").min()
        assert ("keeps the light positive" in ended.out) == (window == "least")
        assert ("keeps what it lights positive" in ended.out) == (window == "auto")
    # A light that is nowhere negative gives no negative radiance, and on a ball neither does what a lobe gathers;
    # rounding of radiance up to a thousand.
    assert lowest["least"] > -64 * EPSILON * 1e3
    assert lowest["auto"] > -64 * EPSILON * 1e3
    assert min(lowest.values()) > ringing


def test_a_light_that_needs_no_window_is_told_to_have_none(run, folder, tmp_path):
    ended = run(
        "shade", folder / "ball.safetensors", "--light", "overcast", "--window", "auto", "-o", tmp_path / "a.npy"
    )
    assert "no window: nothing that this light shines on turns negative" in ended.out
