"""Do values at few nodes tell a polynomial of the hemisphere?"""

import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError


def test_refuses_a_negative_degree():
    with pytest.raises(InputError, match="degree is -1: give zero or more"):
        sh.hemisphere_nodes(-1)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 8, 20, 26])
def test_values_give_back_the_coefficients(degree):
    nodes, fit = sh.hemisphere_nodes(degree)
    assert nodes.shape == ((degree + 1) ** 2, 3)
    assert bool((nodes[:, 2] > 0).all())
    sh.check_directions(nodes)
    coefficients = torch.randn((degree + 1) ** 2, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    values = sh.hemisphere_basis(nodes, degree + 1) @ coefficients
    torch.testing.assert_close(fit @ values, coefficients, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("degree", [0, 4, 12, 20, 26])
def test_noise_in_the_values_hardly_grows(degree):
    _, fit = sh.hemisphere_nodes(degree)
    between, weights = sh.gauss_legendre_hemisphere(2 * degree)
    spread = (sh.hemisphere_basis(between, degree + 1) @ fit).square().sum(-1)
    # The mean over the hemisphere of what independent noise of variance 1 becomes.
    assert float((spread * weights).sum() / weights.sum()) ** 0.5 < 2.2


def test_the_product_of_two_functions_is_told():
    generator = torch.Generator().manual_seed(2)
    seen, light = (torch.randn(36, generator=generator, dtype=torch.float64) for _ in range(2))
    nodes, fit = sh.hemisphere_nodes(10)

    def values(at):
        return (sh.hemisphere_basis(at, 6) @ seen) * (sh.basis(at, 6) @ light)

    elsewhere, _ = sh.gauss_legendre_hemisphere(30)
    found = sh.hemisphere_basis(elsewhere, 11) @ (fit @ values(nodes))
    torch.testing.assert_close(found, values(elsewhere), rtol=1e-9, atol=1e-9)


def test_what_is_given_is_the_callers_own():
    nodes, _ = sh.hemisphere_nodes(2)
    nodes.zero_()
    assert float(sh.hemisphere_nodes(2)[0].norm()) > 1
