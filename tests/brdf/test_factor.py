"""Do a few products stand for a reflectance as well as its singular values say?"""

import itertools
import math

import pytest
import torch

from torchprt import sh
from torchprt.brdf import (
    GGX,
    Factors,
    Lambert,
    Tabulated,
    exit_error,
    factor,
    hemisphere_map,
    sample_hemisphere_map,
)
from torchprt.errors import InputError


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"rows": 3, "error": 0.1}, "both"),
        ({"rows": 0}, "rows is 0"),
        ({"rows": 26}, "1 to 25"),
        ({"error": -1.0}, "smallest that can be reached"),
        ({"rows": 3, "size": 1}, "size"),
        ({"rows": 1, "light_order": 0}, "light"),
    ],
)
def test_refuses_what_cannot_be_had(options, match):
    with pytest.raises(InputError, match=match):
        factor(GGX(0.3), **options)


def test_refuses_a_black_surface():
    with pytest.raises(InputError, match="black"):
        factor(Tabulated(torch.zeros(2, 2, 2)))


def test_a_map_has_texels():
    with pytest.raises(InputError, match="size"):
        hemisphere_map(0)


def test_view_factors_are_orthonormal_and_the_table_holds_them():
    factors = factor(GGX(0.3), rows=9)
    assert isinstance(factors, Factors)
    assert factors.rows == 9
    views, weights = sh.gauss_legendre_hemisphere(60)
    values = factors.views(views)
    gram = values.mT @ (weights[:, None] * values)
    torch.testing.assert_close(gram, torch.eye(9, dtype=torch.float64), atol=1e-12, rtol=0)
    assert factors.table.shape == (9, 32, 32)
    torch.testing.assert_close(factors.table.movedim(0, -1), factors.views(hemisphere_map(32)), atol=1e-13, rtol=0)
    assert factors.kernel(torch.zeros(0, 3)).shape == (9, 0)


@pytest.mark.parametrize("brdf", [GGX(0.5), GGX(0.3)], ids=lambda brdf: brdf.spec)
def test_the_errors_are_those_of_the_exit_radiance(brdf):
    """Recomputed from the kernels and the view factors alone, on another rule than the factorisation used."""
    order = 3
    factors = factor(brdf, rows=6, light_order=order)
    views, view_weights = sh.gauss_legendre_hemisphere(40)
    lights, weights = sh.gauss_legendre_hemisphere(80)
    exact = torch.cat(
        [
            (brdf(part[:, None], lights) * (weights * lights[:, 2])) @ sh.basis(lights, order)
            for part in views.split(500)
        ]
    )
    power = float((view_weights[:, None] * exact**2).sum())
    matrix = factors.kernel(lights) @ (weights[:, None] * sh.basis(lights, order))
    values = factors.views(views)
    for rows in (1, 3, 6):
        rest = exact - values[:, :rows] @ matrix[:rows]
        found = math.sqrt(float((view_weights[:, None] * rest**2).sum()) / power)
        # 9e-5 at most was measured at degree 80, 3e-6 at 140: near the horizon the lobe is narrow.
        assert found == pytest.approx(factors.errors[rows - 1], abs=2e-4)


def test_no_other_functions_of_the_view_lose_less():
    """Three of the exit functions of order 2 are also orthonormal."""
    brdf, order = GGX(0.4), 4
    factors = factor(brdf, rows=4, light_order=order)
    assert factors.errors[3] < exit_error(brdf, 2, light_order=order)


def test_as_few_rows_as_the_error_allows():
    tight, loose = factor(GGX(0.3), error=0.05), factor(GGX(0.3), error=0.5)
    assert loose.rows < tight.rows
    for factors, error in ((tight, 0.05), (loose, 0.5)):
        assert factors.errors[factors.rows - 1] <= error < factors.errors[factors.rows - 2]
    assert factor(GGX(0.3)).rows == tight.rows
    assert all(later <= earlier for earlier, later in itertools.pairwise(tight.errors))


def test_a_diffuse_surface_is_one_constant():
    factors = factor(Lambert(), error=1e-3)
    assert factors.rows == 1
    # 1e-4 is the promise of the integrals.
    expected = torch.full((1, 32, 32), 1 / math.sqrt(2 * math.pi), dtype=torch.float64)
    torch.testing.assert_close(factors.table, expected, rtol=1e-4, atol=0)


def test_tables_of_every_order_of_light():
    for order in (1, 2, 8):
        factors = factor(GGX(0.5), rows=1, light_order=order)
        assert len(factors.errors) >= 1
        assert factors.table.isfinite().all()


@pytest.mark.parametrize("size", [1, 2, 5, 32])
def test_texels_are_unit_above_the_horizon_and_equally_large(size):
    directions = hemisphere_map(size)
    assert directions.shape == (size, size, 3)
    sh.check_directions(directions)
    assert (directions[..., 2] > 0).all()
    # The mean of z over the hemisphere is 1/2, up to the squared size of a texel.
    assert float(directions[..., 2].mean()) == pytest.approx(0.5, abs=1 / size**2 + 1e-12)


def test_every_texel_holds_the_same_part_of_the_hemisphere():
    """Of many directions that are uniform on the hemisphere, as many fall into one texel as into another."""
    directions, _ = sh.fibonacci(400_000)
    directions = directions[directions[:, 2] > 0]
    centres = (2 * torch.arange(4, dtype=torch.float64) + 1) / 4 - 1
    # What is read is the place on the square.
    y, x = torch.meshgrid(centres, centres, indexing="ij")
    place = sample_hemisphere_map(torch.stack([x, y]), directions)
    column, row = ((place + 1) * 2).floor().long().clamp(0, 3).unbind(-1)
    counts = torch.bincount(row * 4 + column, minlength=16) / len(directions)
    # 12500 each: the spiral is off by a few at every side of a texel.
    torch.testing.assert_close(counts.double(), torch.full((16,), 1 / 16, dtype=torch.float64), rtol=2e-3, atol=0)


def test_the_centre_is_the_normal_the_border_the_horizon_and_columns_go_along_x():
    directions = hemisphere_map(33)
    torch.testing.assert_close(directions[16, 16], torch.tensor([0, 0, 1], dtype=torch.float64))
    assert float(directions[:, -1, 2].max()) < 0.07
    torch.testing.assert_close(directions[16, 20, 1], torch.tensor(0.0).double(), atol=1e-15, rtol=0)
    assert float(directions[16, 20, 0]) > 0 < float(directions[20, 16, 1])


@pytest.mark.parametrize("size", [2, 5, 32])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_map_read_at_its_texels_gives_them_back(size, dtype):
    table = torch.randn(3, size, size, generator=torch.Generator().manual_seed(0), dtype=dtype)
    found = sample_hemisphere_map(table, hemisphere_map(size, dtype))
    # The place of a texel is lost by a few epsilon of the size of the map.
    tolerance = 32 * size * torch.finfo(dtype).eps
    torch.testing.assert_close(found, table.movedim(0, -1), atol=tolerance, rtol=0)


def test_reading_undoes_the_map_everywhere_also_at_its_kinks_and_its_border():
    """A table of the square's own coordinates is linear: what is read is where the direction lies."""
    ticks = (2 * torch.arange(16, dtype=torch.float64) + 1) / 16 - 1
    y, x = torch.meshgrid(ticks, ticks, indexing="ij")
    # Odd, so that some lie on the axes and on the diagonals exactly; the outermost 1/257 from the horizon.
    fine = 257
    ticks = (2 * torch.arange(fine, dtype=torch.float64) + 1) / fine - 1
    wanted = torch.stack(torch.meshgrid(ticks, ticks, indexing="ij")[::-1], -1)
    found = sample_hemisphere_map(torch.stack([x, y]), hemisphere_map(fine))
    torch.testing.assert_close(found, wanted, rtol=0, atol=16 * torch.finfo(torch.float64).eps)


def around_the_hemisphere(azimuths):
    theta = torch.linspace(0, 90, 91, dtype=torch.float64).deg2rad()[1:, None]
    phi = torch.as_tensor(azimuths, dtype=torch.float64).deg2rad()
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos() + 0 * phi], -1)


def test_what_is_read_is_continuous_across_the_kinks():
    table = torch.randn(1, 32, 32, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    # Axes and diagonals, where the map has another formula on the other side.
    azimuths = torch.arange(0, 360, 45, dtype=torch.float64)
    before, after = (sample_hemisphere_map(table, around_the_hemisphere(azimuths + side * 1e-7)) for side in (-1, 1))
    # 2e-7 degrees are 2e-8 texels at most.
    assert float((after - before).abs().max()) < 1e-6


def test_a_map_of_a_smooth_function_is_right_everywhere_also_at_the_border():
    axis = torch.tensor([0.5, 0.3, 0.8], dtype=torch.float64)
    azimuths = torch.arange(0, 360, 5)
    views = around_the_hemisphere(azimuths)
    errors = []
    for size in (32, 64):
        table = (hemisphere_map(size) @ axis)[None]
        errors.append((sample_hemisphere_map(table, views)[..., 0] - views @ axis).abs())
    # Away from the kinks of the map, its centre and its diagonals, linear interpolation is of second order, at the
    # border too: here 6 / size^2.
    smooth = (azimuths % 90 - 45).abs() > 10
    coarse, fine = (float(error[15:, smooth].max()) for error in errors)
    assert coarse < 6 / 32**2
    assert fine < coarse / 3.5
    # At the kinks it is of first order, worst in the corners, where it goes on beyond the last texels: 2.4 / size.
    assert float(errors[0].max()) < 2.5 / 32
    assert float(errors[1].max()) < 2.5 / 64
    below = views * torch.tensor([1.0, 1.0, -1.0])
    assert sample_hemisphere_map(table, below).isfinite().all()


def test_gradients_flow_to_the_map_and_the_view_and_are_finite_at_the_pole():
    table = torch.randn(2, 4, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64, requires_grad=True)
    view = torch.tensor([[0.3, 0.1, 0.9], [-0.2, 0.7, 0.6]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(sample_hemisphere_map, (table, view))
    extreme = torch.tensor(
        [[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, -1], [1e-30, 0, 1]], dtype=torch.float32
    ).requires_grad_()
    sample_hemisphere_map(table.float(), extreme).sum().backward()
    assert extreme.grad is not None
    assert extreme.grad.isfinite().all()


def test_no_view_reads_nothing():
    assert sample_hemisphere_map(torch.ones(3, 4, 4), torch.zeros(0, 3)).shape == (0, 3)


def test_a_map_exports_in_plain_operators(untyped):
    table = torch.randn(2, 8, 8, generator=torch.Generator().manual_seed(0))

    class Reader(torch.nn.Module):
        def forward(self, view):
            return sample_hemisphere_map(table, view)

    views = torch.nn.functional.normalize(torch.rand(7, 3, generator=torch.Generator().manual_seed(1)), dim=-1)
    exported = torch.export.export(Reader(), (views,))
    torch.testing.assert_close(exported.module()(views), sample_hemisphere_map(table, views))
    assert "grid_sampler" not in str(exported.graph)
