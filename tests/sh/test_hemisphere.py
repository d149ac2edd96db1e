"""What is lost when a function is known above the horizon alone? The published figures, digit for digit."""

import math

import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError


@pytest.mark.parametrize("order", [0, -1])
def test_refuses_an_order_below_one(order):
    with pytest.raises(InputError, match="order"):
        sh.hemisphere_gram(order)


def test_refuses_what_cannot_be_solved_or_is_not_known():
    with pytest.raises(InputError, match="ridge"):
        sh.hemisphere_projection(14)
    with pytest.raises(InputError, match="ridge"):
        sh.hemisphere_projection(5, ridge=-1.0)
    with pytest.raises(InputError, match="kind"):
        # The run-time type checks of the tests would refuse it first.
        getattr(sh.hemisphere_projection, "__wrapped__", sh.hemisphere_projection)(5, "mirror")
    with pytest.raises(InputError, match="order 6"):
        sh.hemisphere_error(sh.hemisphere_projection(5), sh.hemisphere_gram(5), order=6)


@pytest.mark.parametrize("order", [1, 2, 5, 9])
def test_the_gram_matrix_agrees_with_quadrature_by_brute_force(order):
    directions, weights = sh.fibonacci(200_000)
    values = sh.basis(directions, order) * (directions[:, 2:] > 0)
    # An edge at the equator under a Fibonacci set: the error of the set times the largest product.
    torch.testing.assert_close(
        sh.hemisphere_gram(order), values.mT @ (weights[:, None] * values), atol=2e-4 * order, rtol=0
    )


def test_the_two_hemispheres_make_the_sphere():
    gram = sh.hemisphere_gram(6)
    band = sh.bands(6)
    sign = (-1.0) ** (band + (torch.arange(36) - band * (band + 1)).abs())
    identity = torch.eye(36, dtype=torch.float64)
    torch.testing.assert_close(gram + sign[:, None] * gram * sign, identity, atol=1e-14, rtol=0)


def test_singular_values_of_the_gram_matrix():
    values = torch.linalg.svdvals(sh.hemisphere_gram(5)).flip(0)
    assert f"{values[0]:.4e}" == "6.5921e-06"
    assert f"{values[1]:.4e}" == f"{values[2]:.4e}" == "3.0962e-04"
    assert f"{values[-1]:.8f}" == "0.99999341"
    torch.testing.assert_close(values + values.flip(0), torch.ones(25, dtype=torch.float64), atol=1e-14, rtol=0)


def test_condition_by_order():
    conditions = {3: 254, 4: 5.9e3, 5: 1.5e5, 6: 4.2e6, 8: 3.5e9}
    for order, published in conditions.items():
        assert float(torch.linalg.cond(sh.hemisphere_gram(order))) == pytest.approx(published, rel=0.02)


def test_the_function_to_discard_and_what_it_costs():
    cost = 1 / torch.linalg.inv(sh.hemisphere_gram(5)).diagonal()
    assert int(cost.argmin()) == 2
    assert f"{cost[2]:.4e}" == "1.4768e-05"
    worst, _ = sh.hemisphere_error(sh.hemisphere_projection(5, reduced=True), sh.hemisphere_gram(5))
    assert worst == pytest.approx(float(cost[2]), rel=1e-6)


def test_the_zero_hemisphere():
    worst, mean = sh.hemisphere_error(sh.hemisphere_projection(5, "zero"), sh.hemisphere_gram(5))
    assert (f"{worst:.6f}", f"{mean:.6f}") == ("0.125000", "0.040207")
    assert (f"{100 * math.sqrt(worst):.2f}", f"{100 * math.sqrt(mean):.2f}") == ("35.36", "20.05")


@pytest.mark.parametrize(
    ("kind", "order", "worst", "mean"),
    [
        ("odd", 8, "0.14527", "0.044378"),
        ("even", 7, "0.022005", "0.0035779"),
        ("even", 5, "0.19295", "0.030414"),
    ],
)
def test_reflected_signals(kind, order, worst, mean):
    found = sh.hemisphere_error(sh.hemisphere_projection(order, kind), sh.hemisphere_gram(order), order=5)
    assert (f"{found[0]:.5g}", f"{found[1]:.5g}") == (f"{float(worst):.5g}", f"{float(mean):.5g}")


@pytest.mark.parametrize("order", [1, 3, 5, 8])
def test_the_optimal_projection_gives_a_band_limited_function_back(order):
    gram = sh.hemisphere_gram(order)
    # The error is the condition times epsilon.
    tolerance = 16 * float(torch.linalg.cond(gram)) * torch.finfo(torch.float64).eps
    back = sh.hemisphere_projection(order) @ gram
    torch.testing.assert_close(back, torch.eye(order**2, dtype=torch.float64), atol=tolerance, rtol=0)


def test_no_projection_fits_better_than_the_optimal_one():
    """Of a function that is not band-limited: a narrow lobe."""
    directions, weights = sh.gauss_legendre_hemisphere(120)
    lobe = torch.exp(8 * (directions @ torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64) - 1))
    values = sh.basis(directions, 5)
    products = values.mT @ (weights * lobe)

    def error(projection):
        return float((weights * (values @ (projection @ products) - lobe).square()).sum())

    best = error(sh.hemisphere_projection(5))
    for kind in ("zero", "odd", "even"):
        assert error(sh.hemisphere_projection(5, kind)) > 2 * best
    assert best < error(sh.hemisphere_projection(5, reduced=True)) < error(sh.hemisphere_projection(5, "even"))
    assert best < error(sh.hemisphere_projection(5, ridge=1e-4))


@pytest.mark.parametrize("degree", [0, 1, 7, 20])
def test_the_rule_of_the_hemisphere_sums_to_two_pi_and_stays_above(degree):
    directions, weights = sh.gauss_legendre_hemisphere(degree)
    assert (directions[:, 2] > 0).all()
    sh.check_directions(directions)
    assert float(weights.sum()) == pytest.approx(2 * math.pi, rel=1e-14)
