"""Do the verbs together do what they promise: bake, shade, light, export, info?"""

import math

import numpy as np
import onnxruntime
import PIL.Image
import pytest
import torch
import trimesh
from environments import lamp, save_exr

from torchprt.scene import read_mesh
from torchprt.transfer import load

EPSILON = np.finfo(np.float32).eps


@pytest.fixture
def shaded(done, folder, tmp_path):
    """Radiance by way of an .npy file."""

    def shaded(light, *options, transfer=folder / "ball.safetensors"):
        done("shade", transfer, "--light", light, "-o", tmp_path / "shaded.npy", *options)
        return np.load(tmp_path / "shaded.npy")

    return shaded


def test_a_mesh_goes_all_the_way(done, folder, tmp_path, untyped):
    said = done("bake", folder / "ball.ply", "-o", tmp_path / "b.safetensors", "--order", 4, "--rays", 64, "--seed", 3)
    assert "162 vertices, 320 faces in 1 piece" in said
    assert "order 4" in said
    assert "Monte Carlo estimate" in said
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["b.safetensors"]

    said = done("info", tmp_path / "b.safetensors")
    for word in ("diffuse, shadowed, order 4, 1 channel, 162 vertices", "320 faces", "64 rays", "seed 3", "albedo 0.5"):
        assert word in said

    said = done("light", folder / "lamp.exr", "-o", tmp_path / "l.npy", "--order", 4)
    assert "order 4" in said
    assert "light of order 4" in done("info", tmp_path / "l.npy")
    assert np.load(tmp_path / "l.npy").shape == (16, 3)
    assert np.load(tmp_path / "l.npy").dtype == np.float32

    said = done("export", tmp_path / "b.safetensors", "-o", tmp_path / "b.onnx")
    assert "opset 18" in said
    said = done("info", tmp_path / "b.onnx")
    for word in ("order: 4", "source: light", "vertices: 162", "('B', 162, 3)"):
        assert word in said

    for name, light in (("image.npy", folder / "lamp.exr"), ("light.npy", tmp_path / "l.npy")):
        done("shade", tmp_path / "b.safetensors", "--light", light, "-o", tmp_path / name, "--rotate", "-30,20,10")
    radiance = np.load(tmp_path / "image.npy")
    assert radiance.dtype == np.float32
    assert radiance.shape == (162, 3)
    assert radiance.flags.c_contiguous
    np.testing.assert_array_equal(np.load(tmp_path / "light.npy"), radiance)

    from torchprt import sh

    turn = sh.yaw_pitch_roll(torch.tensor([-30.0, 20.0, 10.0], dtype=torch.float64)).float().numpy()
    session = onnxruntime.InferenceSession(tmp_path / "b.onnx", providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {"light": np.load(tmp_path / "l.npy")[None], "rotation": turn[None]})
    # Sums of 16 products of a turned light: some tens of epsilon of the largest radiance.
    np.testing.assert_allclose(found[0], radiance, rtol=0, atol=64 * EPSILON * radiance.max())


def test_info_tells_of_meshes_and_images_too(done, folder):
    assert "The surface is closed and consistently wound" in done("info", folder / "ball.ply")
    assert "64 x 32 pixels" in done("info", folder / "lamp.exr")


def test_an_export_from_an_environment_says_so(done, folder, tmp_path, untyped):
    done("export", folder / "ball.safetensors", "-o", tmp_path / "b.onnx", "--from", "environment", "--size", 4)
    said = done("info", tmp_path / "b.onnx")
    assert "source: environment" in said
    assert "('B', 6, 4, 4, 3)" in said


def test_suffixes_in_capitals_are_the_same(done, folder, tmp_path):
    done("bake", folder / "ball.ply", "-o", tmp_path / "B.SAFETENSORS", "--unshadowed")
    done("light", folder / "lamp.exr", "-o", tmp_path / "L.NPY")
    done("shade", tmp_path / "B.SAFETENSORS", "--light", tmp_path / "L.NPY", "-o", tmp_path / "R.NPY")
    assert np.load(tmp_path / "R.NPY").shape == (162, 3)
    assert len(list(tmp_path.iterdir())) == 3


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
    assert "2 of 8 vertices have no normal and read 0" in said
    radiance = np.load(tmp_path / "r.npy")
    assert radiance.shape == (8, 3)
    assert (radiance[[0, 4]] == 0).all()
    # A convex body of albedo .5 under a light of 1 everywhere; the projection of 16 rows is off by a hundredth.
    np.testing.assert_allclose(radiance[[1, 2, 3, 5, 6, 7]], 0.5, atol=0.01)
    mesh = read_mesh(tmp_path / "a.obj")
    assert torch.equal(load(tmp_path / "a.safetensors").positions.double(), mesh.positions)


def test_several_meshes_follow_each_other(done, folder, tmp_path):
    trimesh.creation.box(transform=trimesh.transformations.translation_matrix([0, -3, 0])).export(tmp_path / "box.ply")
    done("bake", folder / "ball.ply", tmp_path / "box.ply", "-o", tmp_path / "a.safetensors", "--rays", 16)
    transfer = load(tmp_path / "a.safetensors")
    assert transfer.vertices == 162 + 8
    assert float(transfer.positions[162:, 1].max()) < -2


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


def test_a_lit_model_reloads_elsewhere_as_it_was(done, shaded, folder, tmp_path):
    done(
        "shade", folder / "ball.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "a.ply", "--tone", "none"
    )
    there, ball = (trimesh.load(path, process=False) for path in (tmp_path / "a.ply", folder / "ball.ply"))
    np.testing.assert_array_equal(there.vertices, ball.vertices)
    np.testing.assert_array_equal(there.faces, ball.faces)
    linear = shaded(folder / "lamp.exr").astype(float).clip(0, 1)
    # IEC 61966-2-1.
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055) * 255
    np.testing.assert_allclose(there.visual.vertex_colors[:, :3], encoded, atol=0.51)


# Windows


def test_a_window_takes_ringing_away_and_says_how_much_it_leaves(run, folder, tmp_path):
    light = save_exr(tmp_path / "a.exr", lamp((0, 1, 0), radiance=1e4))
    arguments = ["shade", folder / "ball.safetensors", "--light", light, "-o", tmp_path / "a.npy"]
    plain = run(*arguments)
    assert "have negative radiance" in plain.out
    assert "--window auto" in plain.out
    ringing = np.load(tmp_path / "a.npy").min()
    assert ringing < 0
    lowest = {}
    for window in ("auto", "hann", "lanczos", "gauss"):
        ended = run(*arguments, "--window", window)
        assert ended.code == 0
        lowest[window] = np.load(tmp_path / "a.npy").min()
        assert ("least window" in ended.out) == (window == "auto")
    # A light that is nowhere negative gives no negative radiance; rounding of radiance up to a thousand.
    assert lowest["auto"] > -64 * EPSILON * 1e3
    assert min(lowest.values()) > ringing


# Options of a bake


@pytest.fixture
def corner(tmp_path):
    """A floor and a red wall on it, the colours in the file; sRGB 255 is albedo 1."""
    wall = trimesh.Trimesh([[-1, 0, -1], [1, 0, -1], [1, 2, -1], [-1, 2, -1]], [[0, 1, 2], [0, 2, 3]], process=False)
    floor = trimesh.Trimesh([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], [[0, 1, 2], [0, 2, 3]], process=False)
    wall = wall.subdivide().subdivide()
    floor = floor.subdivide().subdivide()
    wall.visual.vertex_colors = [[255, 0, 0, 255]] * len(wall.vertices)
    floor.visual.vertex_colors = [[255, 255, 255, 255]] * len(floor.vertices)
    trimesh.util.concatenate([floor, wall]).export(tmp_path / "corner.ply")
    return tmp_path / "corner.ply", len(floor.vertices)


def baked(done, path, *options, rays=256):
    output = path.with_suffix(".safetensors")
    said = done("bake", path, "-o", output, "--order", 3, "--rays", rays, *options)
    return load(output), said


def test_bounces_need_three_channels_only_if_albedo_has_colour(done, corner):
    path, _ = corner
    cases = [
        ([], 1, 1, 0),
        (["--bounces", 1], 1, 1, 1),
        (["--albedo", "0.5,0.5,0.5", "--bounces", 1], 1, 1, 1),
        (["--albedo", "0.9,0.1,0.1"], 1, 3, 0),
        (["--albedo", "0.9,0.1,0.1", "--bounces", 2], 3, 3, 2),
        (["--albedo", "vertex"], 1, 3, 0),
        (["--albedo", "vertex", "--bounces", 1], 3, 3, 1),
    ]
    for options, channels, colours, bounces in cases:
        transfer, said = baked(done, path, *options, rays=16)
        assert (transfer.channels, transfer.albedo.shape[1], transfer.bounces) == (channels, colours, bounces), options
        assert f"{channels} channel" in said


def test_light_takes_the_colour_of_a_wall_along(done, corner, tmp_path):
    path, floor = corner
    transfer, _ = baked(done, path, "--albedo", "vertex", "--bounces", "inf")
    assert transfer.bounces > 1
    save_exr(tmp_path / "white.exr", np.ones((16, 32, 3)))
    radiance = {}
    for bounces in ("0", "inf"):
        baked(done, path, "--albedo", "vertex", "--bounces", bounces)
        arguments = ["--light", tmp_path / "white.exr", "-o", tmp_path / "r.npy"]
        done("shade", path.with_suffix(".safetensors"), *arguments)
        radiance[bounces] = np.load(tmp_path / "r.npy")[:floor].mean(0)
    np.testing.assert_allclose(radiance["0"], radiance["0"][0], rtol=1e-5)
    assert radiance["inf"][0] > 1.02 * radiance["0"][0]
    # The wall reflects no green and no blue.
    np.testing.assert_allclose(radiance["inf"][1:], radiance["0"][1:], rtol=1e-5)


def test_a_blocker_casts_shadow_and_records_nothing(done, folder, tmp_path):
    trimesh.creation.box((8, 0.1, 8), trimesh.transformations.translation_matrix([0, 1.5, 0])).export(
        tmp_path / "b.ply"
    )
    arguments = ["bake", folder / "ball.ply", "--order", 4, "--rays", 64, "-o", tmp_path / "a.safetensors"]
    said = done(*arguments, "--blocker", tmp_path / "b.ply")
    assert "b.ply (blocker)" in said
    transfer, free = load(tmp_path / "a.safetensors"), load(folder / "ball.safetensors")
    assert transfer.vertices == free.vertices == 162
    top = int(free.positions[:, 1].argmax())
    # The mean of what the top of the ball sees of a constant sky.
    assert float(transfer.transfer[0, 0, top]) < 0.3 * float(free.transfer[0, 0, top])
    bottom = int(free.positions[:, 1].argmin())
    assert torch.equal(transfer.transfer[..., bottom], free.transfer[..., bottom])


def test_two_sided_surfaces_record_both_sides(done, corner, tmp_path):
    path, _ = corner
    transfer, _ = baked(done, path, "--two-sided", rays=16)
    single, _ = baked(done, path, rays=16)
    count = single.vertices
    assert transfer.vertices == 2 * count
    assert torch.equal(transfer.normals[count:], -transfer.normals[:count])
    assert torch.equal(transfer.positions[:count], single.positions)


def test_unshadowed_traces_nothing_and_is_the_closed_form(done, corner, tmp_path):
    path, _ = corner
    transfer, _ = baked(done, path, "--unshadowed")
    assert (transfer.transport, transfer.rays, transfer.error) == ("unshadowed", 0, None)
    # A cosine over a hemisphere, over pi: sqrt(4 pi) / 4 pi * pi / pi.
    expected = 1 / math.sqrt(4 * math.pi)
    torch.testing.assert_close(transfer.transfer[0, 0], torch.full((transfer.vertices,), expected), rtol=1e-6, atol=0)
    assert not list(tmp_path.glob("*.partial"))


def test_half_stores_half_the_bytes_and_shades_nearly_the_same(done, shaded, corner, folder, tmp_path):
    path, _ = corner
    whole, _ = baked(done, path, rays=16)
    half, said = baked(done, path, "--half", rays=16)
    assert half.transfer.dtype == torch.float16
    assert 2 * half.bytes == whole.bytes
    assert "float16" in said
    assert torch.equal(half.transfer, whole.transfer.half())
    assert shaded(folder / "lamp.exr", transfer=path.with_suffix(".safetensors")).dtype == np.float32


def test_seed_and_threads_do_what_they_say(done, corner):
    path, _ = corner
    first, again, other = (
        baked(done, path, *options, rays=16)[0]
        for options in (["--seed", 1, "--threads", 1], ["--seed", 1, "--threads", 3], ["--seed", 2])
    )
    assert torch.equal(first.transfer, again.transfer)
    assert not torch.equal(first.transfer, other.transfer)
    assert (first.seed, other.seed) == (1, 2)
