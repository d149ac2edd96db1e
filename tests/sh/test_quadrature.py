import math

import numpy as np
import pytest
import torch
from scipy.integrate import lebedev_rule

from torchprt import sh
from torchprt.errors import InputError


@pytest.mark.parametrize(
    ("rule", "bad"), [(sh.gauss_legendre, -1), (sh.lebedev, -1), (sh.lebedev, 132), (sh.fibonacci, 0)]
)
def test_refuses_degrees_and_counts_that_do_not_exist(rule, bad):
    with pytest.raises(InputError, match=str(bad)):
        rule(bad)


@pytest.mark.parametrize("rule", [sh.gauss_legendre, sh.lebedev])
@pytest.mark.parametrize("degree", [0, 1, 2, 5, 10, 20, 33, 41])
def test_integrates_every_harmonic_up_to_its_degree_exactly(rule, degree):
    directions, weights = rule(degree)
    sh.check_directions(directions)
    integrals = weights @ sh.basis(directions, degree + 1)
    integrals[0] -= math.sqrt(4 * math.pi)
    # The basis itself is exact to about 4e-15 an order (docs: 3e-13 at order 65).
    assert integrals.abs().max() < 1e-14 * (degree + 2)


def test_a_product_rule_is_not_exact_one_degree_further():
    directions, weights = sh.gauss_legendre(6)
    assert (weights @ sh.basis(directions, 9))[1:].abs().max() > 1e-3


@pytest.mark.parametrize("degree", [4, 7, 33])
def test_gives_the_next_larger_lebedev_rule(degree):
    larger = {4: 5, 7: 7, 33: 35}[degree]
    torch.testing.assert_close(sh.lebedev(degree), sh.lebedev(larger), atol=0, rtol=0)


@pytest.mark.parametrize("degree", range(3, 18, 2))
def test_rules_of_low_degree_are_those_of_scipy(degree):
    directions, weights = lebedev_rule(degree)
    # In an order of their own.
    theirs, ours = directions.T + 0.0, sh.lebedev(degree)[0].numpy()
    one, other = np.lexsort(theirs.round(12).T), np.lexsort(ours.round(12).T)
    assert ours.shape == theirs.shape
    # Of a coordinate near 1/3 one unit in the last place.
    np.testing.assert_allclose(ours[other], theirs[one], rtol=0, atol=2**-53)
    assert np.array_equal(sh.lebedev(degree)[1].numpy()[other], weights[one])


@pytest.mark.parametrize("count", [1, 2, 1000])
def test_fibonacci_directions_weigh_the_same_and_fill_the_sphere(count):
    directions, weights = sh.fibonacci(count)
    sh.check_directions(directions)
    assert weights.sum().item() == pytest.approx(4 * math.pi, rel=1e-12)
    assert torch.equal(weights, weights[:1].expand(count))
    # Bands up to 5 integrate to nothing, up to the fourth power of the spacing.
    if count == 1000:
        assert (weights @ sh.basis(directions, 6))[1:].abs().max() < 1e-2


def test_float32_rules_are_the_rounded_float64_rules():
    for rule, argument in ((sh.gauss_legendre, 9), (sh.lebedev, 9), (sh.fibonacci, 9)):
        for single, double in zip(rule(argument, torch.float32), rule(argument), strict=True):
            assert torch.equal(single, double.float())


def test_a_caller_may_write_into_what_it_got():
    directions, weights = sh.gauss_legendre(4)
    directions.zero_(), weights.zero_()
    assert sh.gauss_legendre(4)[1].sum().item() == pytest.approx(4 * math.pi)
