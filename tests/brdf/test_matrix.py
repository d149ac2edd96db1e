"""Are kernels and matrices what brute-force quadrature of the same integrals gives?"""

import functools
import itertools
import math

import numpy as np
import pytest
import torch

from torchprt import sh
from torchprt.brdf import (
    GGX,
    BlinnPhong,
    Lambert,
    Measured,
    Phong,
    Tabulated,
    Ward,
    brdf_matrix,
    exit_chain,
    exit_error,
    exit_kernel,
)
from torchprt.errors import InputError

PROJECTIONS = ["optimal", "reduced", "zero", "odd", "even"]
# Wide enough for a rule of degree 200 that knows nothing of lobes.
BRDFS = [Lambert(), Phong(3), Phong(40), BlinnPhong(30), GGX(0.3), GGX(0.5, 0.04), Ward(0.3, 0.5)]
# The kernels promise 3e-5 of their RMS; the spline and the rule may both use it up, and the matrices add theirs.
TOLERANCE = 1e-4


def lights(count=8):
    """Directions to lights up to 70 degrees from the normal, where the brute-force rule still sees the lobes."""
    directions, _ = sh.fibonacci(3 * count)
    return directions[directions[:, 2] > math.cos(math.radians(70))]


@functools.cache
def rule(degree=100):
    return sh.gauss_legendre_hemisphere(degree)


def brute_kernel(brdf, directions, order, family):
    views, weights = rule(200)
    return family(views, order).mT @ (weights[:, None] * brdf(views[:, None], directions) * directions[:, 2])


def product_rule(theta, theta_weights, phi, phi_weights):
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    directions = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1).reshape(-1, 3)
    return directions, (theta_weights[:, None] * phi_weights).flatten()


def composite(breaks, count):
    """Gauss-Legendre with `count` nodes on every interval between `breaks`."""
    nodes, weights = (torch.from_numpy(part) / 2 for part in np.polynomial.legendre.leggauss(count))
    breaks = torch.tensor(sorted(set(breaks)), dtype=torch.float64)
    steps = breaks[1:] - breaks[:-1]
    return (breaks[:-1, None] + steps[:, None] * (nodes + 0.5)).flatten(), (steps[:, None] * weights).flatten()


def graded_kernel(brdf, light, order):
    """One light, on intervals that halve toward the mirror direction and toward the horizon."""
    tilt, mirror = math.acos(float(light[2])), math.atan2(-float(light[1]), -float(light[0]))
    edges = [0.0, math.pi / 2, tilt] + [math.pi / 2 * (1 - 0.5**k) for k in range(1, 20)]
    edges += [tilt + side * math.pi / 2 * 0.5**k for k in range(14) for side in (1, -1)]
    theta, theta_weights = composite([edge for edge in edges if 0 <= edge <= math.pi / 2], 8)
    phi, phi_weights = composite([0.0] + [math.pi * 0.5**k for k in range(16)], 8)
    phi = torch.cat([mirror + phi, mirror - phi])
    views, weights = product_rule(theta, theta_weights * theta.sin(), phi, phi_weights.repeat(2))
    return sh.hemisphere_basis(views, order).mT @ (weights * brdf(views, light) * light[2])


def brute_matrix(brdf, order_out, order_in, count):
    """By one product rule on both sides, of `count` angles that crowd toward the horizon."""
    steps, weights = composite([0.0, 1.0], count)
    theta = math.pi / 2 * steps * (2 - steps)
    weights = weights * math.pi * (1 - steps) * theta.sin()
    phi = torch.arange(3 * count, dtype=torch.float64) * (2 * math.pi / (3 * count))
    directions, weights = product_rule(theta, weights, phi, torch.full_like(phi, 2 * math.pi / len(phi)))
    out, into = sh.basis(directions, order_out), sh.basis(directions, order_in)
    parts = [
        brdf(directions[some, None], directions) @ (into * (weights * directions[:, 2])[:, None])
        for some in torch.arange(len(directions)).split(500)
    ]
    return out.mT @ (weights[:, None] * torch.cat(parts))


def close(found, expected, tolerance=TOLERANCE):
    assert found.shape == expected.shape
    assert found.dtype == torch.float64
    assert float((found - expected).norm()) <= tolerance * float(expected.norm())


def test_refuses_orders_directions_and_projections_that_are_none():
    for call in (
        lambda: exit_kernel(GGX(0.3), lights(), 0),
        lambda: brdf_matrix(GGX(0.3), 0, 3),
        lambda: brdf_matrix(GGX(0.3), 3, 0),
        lambda: exit_chain(GGX(0.3), 3, 0),
        lambda: exit_error(GGX(0.3), 0),
        lambda: exit_error(GGX(0.3), 3, light_order=0),
    ):
        with pytest.raises(InputError, match="order"):
            call()
    with pytest.raises(InputError, match="directions"):
        exit_kernel(GGX(0.3), torch.zeros(1, 3), 3)
    with pytest.raises(InputError, match="ridge"):
        exit_kernel(GGX(0.3), lights(), 14, "reduced")
    with pytest.raises(InputError, match="roughness holds 2"):
        exit_kernel(GGX(torch.tensor([0.2, 0.3])), lights(), 3)
    with pytest.raises(InputError, match="too narrow"):
        exit_kernel(Measured(lambda v, s: (v * s).sum(-1), "needle", width=1e-3), lights(), 3)


def test_no_direction_has_no_kernel_and_one_below_the_horizon_a_kernel_of_zero():
    assert exit_kernel(GGX(0.3), torch.zeros(0, 3), 4).shape == (16, 0)
    assert exit_kernel(Ward(0.3, 0.5), torch.zeros(0, 3), 4).shape == (16, 0)
    below = torch.tensor([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [1.0, 0.0, 0.0]])
    for brdf in (GGX(0.3), Ward(0.3, 0.5)):
        assert (exit_kernel(brdf, below, 4) == 0).all()


@pytest.mark.parametrize("brdf", BRDFS, ids=lambda brdf: brdf.spec)
@pytest.mark.parametrize("order", [1, 5])
def test_kernels_agree_with_brute_force(brdf, order):
    close(exit_kernel(brdf, lights(), order), brute_kernel(brdf, lights(), order, sh.hemisphere_basis))
    close(exit_kernel(brdf, lights(), order, "zero"), brute_kernel(brdf, lights(), order, sh.basis))


@pytest.mark.parametrize("brdf", [GGX(0.05), Ward(0.1, 0.4)], ids=lambda brdf: brdf.spec)
@pytest.mark.parametrize("azimuth", [0, 40])
def test_narrow_kernels_agree_with_a_rule_graded_toward_the_lobe(brdf, azimuth):
    theta = torch.tensor([45, 70, 85, 88], dtype=torch.float64).deg2rad()
    phi = torch.tensor(math.radians(azimuth), dtype=torch.float64)
    directions = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
    close(exit_kernel(brdf, directions, 5), torch.stack([graded_kernel(brdf, one, 5) for one in directions], 1))


@pytest.mark.parametrize("shape", [(6, 6, 6), (4, 5, 7), (2, 2, 2), (6, 8, 6, 8), (3, 4, 5, 7)])
def test_kernels_of_random_tables_agree_with_brute_force(shape):
    table = Tabulated(torch.rand(shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64))
    # A table has edges, and the rule is as exact as the square of its steps.
    for family, projection in ((sh.hemisphere_basis, "optimal"), (sh.basis, "zero")):
        close(exit_kernel(table, lights(), 4, projection), brute_kernel(table, lights(), 4, family), 5e-4)


def test_a_table_of_entries_that_do_not_vary_is_exactly_diffuse():
    directions = lights()
    for shape in ((3, 4, 5), (3, 4, 5, 6)):
        table = Tabulated(torch.full(shape, 1 / math.pi, dtype=torch.float64))
        first = exit_kernel(table, directions, 9)
        expected = torch.zeros_like(first)
        expected[0] = directions[:, 2] * math.sqrt(2 / math.pi)
        # Sums of some hundred terms.
        torch.testing.assert_close(first, expected, rtol=0, atol=100 * torch.finfo(torch.float64).eps)


def test_kernels_of_a_function_agree_with_brute_force():
    # Back to where the light came from: not about the mirror direction.
    back = Measured(lambda v, s: (v * s).sum(-1).clamp(min=0) ** 30, "back", isotropic=True, width=0.2)
    close(exit_kernel(back, lights(), 4), brute_kernel(back, lights(), 4, sh.hemisphere_basis))


def test_refuses_what_would_take_minutes(monkeypatch):
    monkeypatch.setattr("torchprt.brdf.integrals._MOST", 1_000_000)
    with pytest.raises(InputError, match="'measured:slow' is too narrow or too rough"):
        exit_kernel(Measured(GGX(0.4), "slow"), lights(), 3)


def test_an_isotropic_model_has_the_kernel_of_the_same_function_not_said_to_be_isotropic():
    anonymous = Measured(GGX(0.4), "same", width=0.2)
    close(exit_kernel(anonymous, lights(), 3), exit_kernel(GGX(0.4), lights(), 3))


@pytest.mark.parametrize("order", [1, 4])
def test_a_narrow_lobe_has_its_directional_albedo_as_first_coefficient(order):
    """By reciprocity: the constant function of the exit side times the cosine of the light gives less than 1."""
    directions = lights()
    first = exit_kernel(Phong(5000), directions, order)[0]
    # A mirror: all light leaves along the mirror direction, with the weight f s_z = s_z.
    close(first, directions[:, 2] / math.sqrt(2 * math.pi), 2e-3)


@pytest.mark.parametrize("order", [3, 5])
def test_a_nearly_perfect_mirror_mirrors(order):
    """f s_z tends to s_z times a delta function: K_i(s) = s_z h_i(mirror of s)."""
    directions = lights()
    mirrored = directions * torch.tensor([-1.0, -1.0, 1.0])
    expected = (sh.hemisphere_basis(mirrored, order) * directions[:, 2:]).mT
    # The lobe blurs band l by l (l + 1) / 2 k.
    close(exit_kernel(Phong(1e5), directions, order), expected, 1e-3)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_projections_are_those_of_the_hemisphere(projection):
    """The function that the coefficients stand for is the projection of f s_z, by its definition."""
    brdf, order, directions = GGX(0.5), 4, lights()
    views, _ = rule(60)
    count = sh.exit_count(order, projection)
    found = exit_kernel(brdf, directions, order, projection)
    assert found.shape == (count, len(directions))
    products = brute_kernel(brdf, directions, order, sh.basis)
    kind = "optimal" if projection in ("optimal", "reduced") else projection
    square = sh.hemisphere_projection(order, kind, reduced=projection == "reduced")
    expected = sh.basis(views, order) @ (square @ products)
    close(sh.exit_functions(views, order, projection) @ found, expected, 20 * TOLERANCE)


def test_kernels_near_the_horizon_tend_to_nothing_smoothly():
    theta = torch.linspace(88, 90, 41, dtype=torch.float64).deg2rad()[:-1]
    directions = torch.stack([theta.sin(), torch.zeros_like(theta), theta.cos()], -1)
    values = exit_kernel(GGX(0.3), directions, 4)
    assert float(values[:, -1].norm()) < 0.05 * float(values[:, 0].norm()) + 1e-3
    assert float((values[:, 1:] - values[:, :-1]).norm(dim=0).max()) < 0.1 * float(values[:, 0].norm())


@pytest.mark.parametrize("brdf", BRDFS, ids=lambda brdf: brdf.spec)
def test_matrices_agree_with_brute_force(brdf):
    expected = brute_matrix(brdf, 4, 3, 30)
    if isinstance(brdf, Ward):
        # It has no limit at grazing mirror directions: the error of the rule falls with the square of the count only,
        # and what two counts agree on is nearer.
        coarse = brute_matrix(brdf, 4, 3, 20)
        expected = expected + (expected - coarse) / ((30 / 20) ** 2 - 1)
    # What the rule leaves: that of 24 angles was measured to be 2e-3 at the narrow GGX.
    close(brdf_matrix(brdf, 4, 3), expected, 2e-3)


@pytest.mark.parametrize("brdf", [GGX(0.2), Ward(0.5, 0.8)], ids=lambda brdf: brdf.spec)
def test_matrices_are_integrals_of_the_kernels(brdf):
    directions, weights = rule()
    kernels = exit_kernel(brdf, directions, 4, "zero")
    close(brdf_matrix(brdf, 4, 5), kernels @ (weights[:, None] * sh.basis(directions, 5)))


def test_an_isotropic_matrix_does_not_mix_m():
    matrix = brdf_matrix(GGX(0.3), 5, 4)

    def m(order):
        return torch.arange(order**2) - sh.bands(order) * (sh.bands(order) + 1)

    apart = m(5)[:, None] != m(4)
    assert float(matrix[apart].abs().max()) < 1e-13 * float(matrix.abs().max())
    assert float(brdf_matrix(Ward(0.3, 0.8), 5, 4)[apart].abs().max()) > 1e-2 * float(matrix.abs().max())


def test_the_matrix_of_a_diffuse_surface_is_an_outer_product():
    """of int_H y_i and the clamped cosine, over pi."""
    views, weights = sh.gauss_legendre_hemisphere(10)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    constant = sh.basis(views, 4).mT @ weights
    cosine = sh.zonal(sh.clamped_cosine(5), up)
    close(brdf_matrix(Lambert(), 4, 5), constant.outer(cosine) / math.pi)


@pytest.mark.parametrize("brdf", [GGX(0.4), Ward(0.5, 0.8)], ids=lambda brdf: brdf.spec)
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_the_chain_takes_incident_radiance_to_exit_coefficients(brdf, projection):
    """The kernels integrate against the function that stands for the incident radiance under the projection."""
    order, order_in = 5, 4
    directions, weights = rule()
    incident = torch.randn(order_in**2, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    radiance = sh.basis(directions, order_in) @ incident
    transferred = sh.basis(directions, order_in).mT @ (weights[:, None] * radiance)
    kind = "optimal" if projection in ("optimal", "reduced") else projection
    square = sh.hemisphere_projection(order_in, kind, reduced=projection == "reduced")
    stands = sh.basis(directions, order_in) @ (square @ transferred)
    expected = exit_kernel(brdf, directions, order, projection) @ (weights[:, None] * stands)
    # The optimal projection by A^-1 has the square of the condition.
    close(exit_chain(brdf, order, order_in, projection) @ transferred, expected, 5 * TOLERANCE)
    if projection == "optimal":
        # Nothing is lost on the incident side.
        direct = exit_kernel(brdf, directions, order) @ (weights[:, None] * radiance)
        close(exit_chain(brdf, order, order_in) @ transferred, direct, 5 * TOLERANCE)


def test_the_chain_of_a_high_order_is_still_well_conditioned():
    order = 9
    directions, weights = rule()
    radiance = sh.hemisphere_basis(directions, order)[:, -1]
    transferred = sh.basis(directions, order).mT @ (weights * radiance)
    expected = exit_kernel(GGX(0.3), directions, 5) @ (weights * radiance)
    found = exit_chain(GGX(0.3), 5, order) @ transferred
    assert float((found - expected).norm()) < TOLERANCE


def test_what_an_order_loses_agrees_with_brute_force():
    brdf, order, light_order = GGX(0.4), 3, 4
    views, weights = sh.gauss_legendre_hemisphere(70)
    between = brdf(views[:, None], views) * (weights * views[:, 2])
    exact = between @ sh.basis(views, light_order)
    functions = sh.hemisphere_basis(views, order)
    rest = exact - functions @ (functions.mT @ (weights[:, None] * exact))
    expected = math.sqrt(float((weights[:, None] * rest**2).sum() / (weights[:, None] * exact**2).sum()))
    # Both rules add their error.
    assert exit_error(brdf, order, light_order) == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("brdf", [Phong(20), GGX(0.2)], ids=lambda brdf: brdf.spec)
def test_more_functions_lose_less_and_the_optimal_ones_least(brdf):
    errors = [exit_error(brdf, order) for order in range(1, 11)]
    assert all(later < earlier for earlier, later in itertools.pairwise(errors))
    assert errors[-1] < 0.01 < 0.5 < errors[0]
    for projection in ("reduced", "zero", "odd", "even"):
        assert exit_error(brdf, 5, projection=projection) >= errors[4] * (1 - 1e-6)


def test_a_diffuse_surface_loses_nothing_at_order_one():
    # The kernels' promise.
    assert exit_error(Lambert(), 1) < TOLERANCE


def test_a_black_surface_loses_nothing():
    assert exit_error(Tabulated(torch.zeros(2, 2, 2)), 2) == 0


def test_tensors_stand_for_their_numbers_and_gradients_do_not_flow():
    parameter = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    found = exit_kernel(GGX(parameter), lights().float(), 3)
    assert not found.requires_grad
    torch.testing.assert_close(found, exit_kernel(GGX(0.3), lights().float(), 3), rtol=0, atol=0)


def test_tables_made_in_inference_mode_serve_gradients_later():
    with torch.inference_mode():
        exit_kernel(GGX(0.77), lights(), 2)
    scale = torch.ones(1, dtype=torch.float64, requires_grad=True)
    (exit_kernel(GGX(0.77), lights(), 2) * scale).sum().backward()
    assert scale.grad is not None
