"""Do environments keep their light from one map to the other and on the way to coefficients?"""

import math

import pytest
import torch

from torchprt import light, sh
from torchprt.errors import InputError

EPS = torch.finfo(torch.float64).eps


def smooth(directions):
    """Radiance without edges, with bands up to 4, different in every channel and positive."""
    x, y, z = directions.unbind(-1)
    return torch.stack([2 + x + y * z, 3 + y * y * z - x, 4 + x * y * z + z**4], dim=-1)


def smooth_latlong(height):
    return smooth(sh.latlong_directions(height, 2 * height))


def smooth_cube(size):
    return smooth(sh.cube_directions(size))


def irradiance_vector(image):
    """Radiance and radiance times direction over the sphere, with exact solid angles: DC and linear light."""
    if image.shape[-4:-3] == (6,) and image.shape[-3] == image.shape[-2]:
        size = image.shape[-2]
        directions, weights = sh.cube_directions(size), sh.cube_weights(size, "exact")
    else:
        directions = sh.latlong_directions(*image.shape[-3:-1])
        weights = sh.latlong_weights(*image.shape[-3:-1])
    moments = torch.cat([torch.ones_like(directions[..., :1]), directions], -1) * weights[..., None]
    return moments.reshape(-1, 4).T @ image.reshape(-1, 3).double()


# Misuse first.


@pytest.mark.parametrize("shape", [(4, 4, 3), (4, 9, 3), (5, 8, 8, 3), (6, 4, 3), (2, 3), (0, 0, 3), (6, 0, 0, 3)])
def test_refuses_an_image_of_another_shape(shape):
    with pytest.raises(InputError, match="shape"):
        light.project(torch.ones(shape), 3)
    if len(shape) > 2:
        with pytest.raises(InputError, match="shape"):
            light.latlong_to_cube(torch.ones(shape), 4)


def test_refuses_faces_that_are_not_six_squares_and_no_size():
    for shape in [(5, 4, 4, 3), (6, 4, 5, 3), (6, 0, 0, 3)]:
        with pytest.raises(InputError, match="six square faces"):
            light.cube_to_latlong(torch.ones(shape), 4)
    with pytest.raises(InputError, match="height"):
        light.cube_to_latlong(torch.ones(6, 4, 4, 3), 0)
    with pytest.raises(InputError, match="size"):
        light.latlong_to_cube(torch.ones(4, 8, 3), 0)


@pytest.mark.parametrize("shape", [(8, 16, 3), (6, 8, 8, 3)])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), -1e-6])
def test_refuses_radiance_that_cannot_be(shape, value):
    image = torch.ones(shape)
    image.view(-1)[77] = value
    with pytest.raises(InputError, match=r"light\.read"):
        light.project(image, 3)


# The convention.


@pytest.mark.parametrize(
    ("direction", "texel", "face"),
    [
        # Column 0 of a map 64 wide begins at -180 degrees: +x is at 3/4 of the width, -z in the middle.
        ((1.0, 0.0, 0.0), (slice(15, 17), slice(47, 49)), 0),
        ((-1.0, 0.0, 0.0), (slice(15, 17), slice(15, 17)), 1),
        ((0.0, 1.0, 0.0), (slice(0, 1), slice(None)), 2),
        ((0.0, -1.0, 0.0), (slice(31, 32), slice(None)), 3),
        ((0.0, 0.0, 1.0), (slice(15, 17), [0, -1]), 4),
        ((0.0, 0.0, -1.0), (slice(15, 17), slice(31, 33)), 5),
    ],
)
def test_a_sun_lies_in_one_direction_for_images_and_formulas(direction, texel, face):
    latlong = torch.zeros(32, 64, 3, dtype=torch.float64)
    latlong[texel] = 1
    cube = torch.zeros(6, 16, 16, 3, dtype=torch.float64)
    cube[face, 7:9, 7:9] = 1
    toward = torch.tensor(direction, dtype=torch.float64)
    wanted = light.directional(toward, order=3)[1:4, 0]
    # By docs/conventions.md: y1,-1 = -.488603 y, y10 = .488603 z, y11 = -.488603 x.
    assert torch.allclose(wanted / wanted.norm(), -toward[[1, 2, 0]] * torch.tensor([1.0, -1, 1.0]).double())
    for image in (latlong, cube, light.latlong_to_cube(latlong, 16), light.cube_to_latlong(cube, 32)):
        linear = light.project(image, 3)[1:4, 0]
        assert torch.allclose(linear / linear.norm(), wanted / wanted.norm(), atol=1e-12)


def test_off_axis_lamps_keep_their_place_through_both_maps():
    for toward in sh.fibonacci(12)[0]:
        image = torch.exp(200 * (sh.latlong_directions(64, 128) @ toward - 1))[..., None].expand(-1, -1, 3)
        for again in (light.latlong_to_cube(image, 32), light.cube_to_latlong(light.latlong_to_cube(image, 32), 64)):
            moment = irradiance_vector(again)[1:, 0]
            # A texel of the cube is 2/32 rad; the lamp stays within a twentieth of that.
            assert (moment / moment.norm() - toward).norm() < 0.05 * 2 / 32


# From map to map.


@pytest.mark.parametrize("size", [1, 2, 7, 16, 64])
@pytest.mark.parametrize("height", [2, 16, 50])
def test_a_constant_stays_constant_in_both_directions(size, height):
    # A mean over k x k samples rounds as a sum of k^2 terms does, which walks k steps at random.
    samples = 10 + max(4 * height / (math.pi * size), math.pi * size / height)
    latlong = torch.full((height, 2 * height, 3), 3.0, dtype=torch.float64)
    cube = torch.full((6, size, size, 3), 3.0, dtype=torch.float64)
    assert (light.latlong_to_cube(latlong, size) - 3).abs().max() < 3 * samples * EPS
    assert (light.cube_to_latlong(cube, height) - 3).abs().max() < 3 * samples * EPS


def test_smooth_radiance_arrives_where_it_was_also_at_the_poles():
    # Bilinear reconstruction and the mean over a texel both err by h^2 / 8 times second derivatives of up to 30.
    bound = 30 * ((2 / 64) ** 2 + (math.pi / 128) ** 2) / 8
    assert (light.latlong_to_cube(smooth_latlong(128), 64) - smooth_cube(64)).abs().max() < bound
    error = (light.cube_to_latlong(smooth_cube(64), 128) - smooth_latlong(128)).abs().amax(-1)
    first, second = sh.latlong_directions(128, 256).abs().topk(2, dim=-1).values.unbind(-1)
    assert error[second < 0.95 * first].max() < bound


def test_faces_meet_without_a_seam():
    error = (light.cube_to_latlong(smooth_cube(32), 128) - smooth_latlong(128)).abs().amax(-1)
    first, second = sh.latlong_directions(128, 256).abs().topk(2, dim=-1).values.unbind(-1)
    seam = second > 0.95 * first
    assert seam.sum() > 1000
    # Beyond an edge stands the neighbour's texel, which near a corner is half a texel aside of where the face's
    # own next one would be; it weighs at most a half, and the radiance has a slope of up to 4.
    assert error[seam].max() < 0.5 * (0.5 * 2 / 32) * 4


@pytest.mark.parametrize("size", [4, 16, 100])
def test_shrinking_a_sky_with_a_sun_of_one_texel_keeps_its_light(size):
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(128, 256, 3, generator=generator, dtype=torch.float64)
    image[37, 91] = 1e4
    before = irradiance_vector(image)
    after = irradiance_vector(light.latlong_to_cube(image, size))
    # Two samples to a texel integrate the tent of a bilinear sun within 1 % of it.
    assert (after[0] / before[0] - 1).abs().max() < 0.01
    # No light moves further than half the diagonal of a texel.
    assert ((after[1:] - before[1:]).norm(dim=0) < before[0] * (0.01 + 1.5 / size)).all()


@pytest.mark.parametrize("height", [4, 16, 100])
def test_shrinking_a_cube_with_a_sun_of_one_texel_keeps_its_light(height):
    generator = torch.Generator().manual_seed(1)
    cube = torch.rand(6, 64, 64, 3, generator=generator, dtype=torch.float64)
    for texel in [(0, 30, 20), (2, 0, 40), (5, 63, 0)]:
        cube[texel] = 1e4
    before = irradiance_vector(cube)
    after = irradiance_vector(light.cube_to_latlong(cube, height))
    # The texels of the corner, over which its sun is spread, differ in size by a few percent.
    assert (after[0] / before[0] - 1).abs().max() < 0.02
    assert ((after[1:] - before[1:]).norm(dim=0) < before[0] * (0.02 + 0.75 * math.pi / height)).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_maps_are_batched_linear_and_keep_their_dtype(dtype):
    image = smooth_latlong(16).to(dtype)
    batch = torch.stack([image, 2 * image, image.flip(0)]).reshape(3, 1, 16, 32, 3)
    cubes = light.latlong_to_cube(batch, 8)
    assert cubes.shape == (3, 1, 6, 8, 8, 3)
    assert cubes.dtype == dtype
    assert torch.allclose(cubes[0, 0], light.latlong_to_cube(image, 8), rtol=8 * torch.finfo(dtype).eps)
    assert torch.allclose(cubes[1], 2 * cubes[0], rtol=8 * torch.finfo(dtype).eps)
    back = light.cube_to_latlong(cubes, 16)
    assert back.shape == batch.shape
    assert torch.allclose(back[2, 0], light.cube_to_latlong(cubes[2, 0], 16), rtol=8 * torch.finfo(dtype).eps)


def test_large_maps_are_taken_in_pieces_with_the_same_result(monkeypatch):
    image, cube = smooth_latlong(32), smooth_cube(24)
    whole = light.latlong_to_cube(image, 9), light.cube_to_latlong(cube, 14)
    monkeypatch.setattr("torchprt.light.environment.CHUNK", 500)
    pieces = light.latlong_to_cube(image, 9), light.cube_to_latlong(cube, 14)
    for one, other in zip(whole, pieces, strict=True):
        assert (one - other).abs().max() < 20 * EPS


def test_gradients_flow_through_both_maps():
    image = torch.rand(4, 8, 1, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda i: light.latlong_to_cube(i, 2), image)
    cube = torch.rand(6, 2, 2, 1, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda c: light.cube_to_latlong(c, 4), cube)


# To coefficients.


@pytest.mark.parametrize("order", [1, 2, 5, 9])
def test_both_maps_project_to_the_coefficients_of_the_function(order):
    exact = sh.project_function(smooth, order)
    from_latlong = light.project(smooth_latlong(256), order)
    from_cube = light.project(smooth_cube(64), order)
    # Midpoint rules: the error falls with the square of the texel.
    assert (from_latlong - exact).abs().max() < 4 * (math.pi / 256) ** 2
    assert (from_cube - exact).abs().max() < 4 * (2 / 64) ** 2


def test_a_batch_of_six_latlong_maps_is_not_a_cube():
    batch = torch.rand(6, 8, 16, 3)
    assert light.project(batch, 3).shape == (6, 9, 3)
    assert light.project(torch.rand(2, 6, 8, 8, 3), 3).shape == (2, 9, 3)


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_projection_keeps_its_accuracy_for_extreme_radiance(scale):
    image = smooth_latlong(16).float()
    wanted = light.project(image, 4)
    assert torch.allclose(light.project(image * scale, 4) / scale, wanted, rtol=1e-5, atol=1e-5)


def test_real_photographs_light_the_same_from_either_map(data):
    for path in sorted((data / "hdri").glob("*.exr")):
        image, _ = light.read_with_report(path)
        direct = light.project(image, 3)
        through = light.project(light.latlong_to_cube(image, 64), 3)
        # Suns of one or two texels: the cube's texel of 2/64 rad moves them by up to a quarter of it.
        assert (direct - through).norm() / direct.norm() < 0.01
