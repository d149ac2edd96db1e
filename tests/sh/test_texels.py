import math

import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError
from torchprt.sh import texels


def test_refuses_empty_images_faces_that_are_not_square_and_unknown_weights():
    with pytest.raises(InputError, match="at least 1 texel"):
        sh.cube_directions(0)
    with pytest.raises(InputError, match="empty"):
        sh.latlong_directions(0, 4)
    with pytest.raises(InputError, match="square"):
        sh.project_cube(torch.zeros(6, 2, 3, 3), 2)


def test_refuses_unknown_weights(untyped):
    with pytest.raises(InputError, match="'best'"):
        sh.cube_weights(4, "best")


@pytest.mark.parametrize("size", [1, 2, 5, 64])
def test_texels_look_where_the_conventions_say(size):
    directions = sh.cube_directions(size)
    sh.check_directions(directions)
    row, column = 0, size - 1
    s, t = 2 * (column + 0.5) / size - 1, 2 * (row + 0.5) / size - 1
    expected = [(1, -t, -s), (-1, -t, s), (s, 1, t), (s, -1, -t), (s, -t, 1), (-s, -t, -1)]
    corner = torch.nn.functional.normalize(torch.tensor(expected, dtype=torch.float64), dim=-1)
    torch.testing.assert_close(directions[:, row, column], corner, atol=1e-15, rtol=0)


def test_latlong_rows_start_up_and_columns_turn_from_minus_z_toward_x():
    directions = sh.latlong_directions(512, 1024)
    near = 2 * math.pi / 1024
    for (row, column), expected in {
        (0, 17): (0.0, 1.0, 0.0),
        (511, 900): (0.0, -1.0, 0.0),
        (256, 512): (0.0, 0.0, -1.0),
        (256, 768): (1.0, 0.0, 0.0),
        (256, 256): (-1.0, 0.0, 0.0),
        (256, 0): (0.0, 0.0, 1.0),
    }.items():
        assert (directions[row, column] - torch.tensor(expected)).abs().max() < near


@pytest.mark.parametrize("size", [1, 3, 16, 512])
@pytest.mark.parametrize("kind", ["normalised", "exact"])
def test_cube_weights_fill_the_sphere(size, kind):
    # Differences of four angles: rounding of 1 in 6 size^2 numbers.
    assert sh.cube_weights(size, kind).sum().item() == pytest.approx(4 * math.pi, rel=1e-12)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 2), (7, 3), (512, 1024)])
def test_latlong_weights_are_the_exact_solid_angles_of_the_rows(height, width):
    weights = sh.latlong_weights(height, width)
    edge = torch.cos(math.pi * torch.arange(height + 1, dtype=torch.float64) / height)
    expected = (edge[:-1] - edge[1:]) * 2 * math.pi / width
    torch.testing.assert_close(weights, expected[:, None].expand(height, width), atol=1e-15, rtol=0)


@pytest.mark.parametrize(
    ("size", "kind", "mean", "worst"),
    [
        (4, "paper", 0.2652, 1.209),
        (8, "paper", 0.0032, 0.0159),
        (4, "exact", 0.2607, 0.9355),
        (8, "exact", 0.0058, 0.0179),
        (4, "normalised", 0.2347, 0.8698),
        (8, "normalised", 0.0018, 0.0077),
    ],
)
def test_reproduces_the_error_of_projecting_small_cube_maps(size, kind, mean, worst):
    # Sloan, Kautz and Snyder 2002, section 6.2: squared error in percent of order-6 signals.
    table = sh.basis(sh.cube_directions(size).reshape(-1, 3), 6)
    error = sh.cube_basis(6, size, kind, torch.float64) @ table - torch.eye(36)
    squared = error.mT @ error
    assert 100 * squared.trace().item() / 36 == pytest.approx(mean, abs=0.5e-4)
    assert 100 * torch.linalg.eigvalsh(squared)[-1].item() == pytest.approx(worst, abs=0.5e-3 if worst > 1 else 0.5e-4)


@pytest.mark.parametrize("shape", [(), (2,), (2, 3), (0,)])
@pytest.mark.parametrize("kind", ["normalised", "paper", "exact"])
def test_projecting_a_cube_map_is_the_weighted_sum_over_its_texels(shape, kind):
    cube = torch.rand(*shape, 6, 5, 5, 3, dtype=torch.float64)
    weighted = cube * sh.cube_weights(5, kind).unsqueeze(-1)
    expected = sh.basis(sh.cube_directions(5), 4).flatten(0, 2).mT @ weighted.flatten(-4, -2)
    torch.testing.assert_close(sh.project_cube(cube, 4, kind), expected, atol=1e-13, rtol=0)


def test_large_cube_maps_go_through_in_pieces(monkeypatch):
    cube = torch.rand(2, 6, 8, 8, 3, dtype=torch.float64)
    whole = sh.project_cube(cube, 3)
    monkeypatch.setattr(texels, "_LARGEST_TABLE", 0)
    monkeypatch.setattr(texels, "_PIECE", 9 * 8 * 6 * 3)
    torch.testing.assert_close(sh.project_cube(cube, 3), whole, atol=1e-13, rtol=0)


@pytest.mark.parametrize("shape", [(), (2,), (2, 3), (0,)])
@pytest.mark.parametrize("order", [1, 2, 7])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (6, 12), (9, 7)])
def test_projecting_a_latlong_image_is_the_weighted_sum_over_its_texels(shape, order, height, width):
    image = torch.rand(*shape, height, width, 3, dtype=torch.float64)
    expected = sh.latlong_basis(order, height, width, torch.float64) @ image.flatten(-3, -2)
    torch.testing.assert_close(sh.project_latlong(image, order), expected, atol=1e-13, rtol=0)


def test_both_kinds_of_image_hold_the_same_light():
    light = torch.randn(9, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    cube, latlong = sh.cube_directions(64), sh.latlong_directions(64, 128)
    values = [sh.evaluate(light, d.reshape(-1, 3)).reshape(*d.shape[:-1], 3) for d in (cube, latlong)]
    # Midpoint rules: the error falls with the square of the texel's width, here 1/32 and 1/20.
    torch.testing.assert_close(sh.project_cube(values[0], 3), light, atol=2e-3, rtol=0)
    torch.testing.assert_close(sh.project_latlong(values[1], 3), light, atol=5e-3, rtol=0)


def test_gradients_flow_to_the_images():
    for project, shape in ((sh.project_cube, (6, 2, 2, 1)), (sh.project_latlong, (3, 4, 1))):
        image = torch.rand(*shape, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(lambda i, f=project: f(i, 3), image)
