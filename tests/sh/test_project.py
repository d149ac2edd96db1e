import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError


def lights(*shape, seed=3):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_refuses_a_function_of_the_wrong_shape():
    with pytest.raises(InputError, match=r"return \[D, C\]"):
        sh.project_function(lambda s: s[:, 0], 3)


def test_refuses_too_few_samples():
    directions, _ = sh.fibonacci(8)
    with pytest.raises(InputError, match="8 samples do not determine the 9 coefficients"):
        sh.project_samples(torch.zeros(8, 1, dtype=torch.float64), directions, 3)
    with pytest.raises(InputError, match="0 samples"):
        sh.project_samples(torch.zeros(0, 1, dtype=torch.float64), directions[:0], 1)


def test_refuses_samples_that_leave_a_coefficient_open():
    directions = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand(50, 3)
    with pytest.raises(InputError, match="do not determine"):
        sh.project_samples(torch.zeros(50, 1, dtype=torch.float64), directions, 2)


def test_refuses_negative_weights():
    directions, weights = sh.fibonacci(50)
    with pytest.raises(InputError, match="weights"):
        sh.project_samples(torch.zeros(50, 1, dtype=torch.float64), directions, 2, -weights)


@pytest.mark.parametrize("order", [1, 6, 20])
def test_projection_brings_back_the_coefficients_of_a_function(order):
    light = lights(order * order, 2)
    found = sh.project_function(lambda s: sh.evaluate(light, s), order)
    # Error of the basis squared into the projection: about 1e-14 an order.
    torch.testing.assert_close(found, light, atol=3e-14 * order, rtol=0)


def test_the_default_rule_keeps_higher_bands_out():
    light = lights(15 * 15, 1)
    found = sh.project_function(lambda s: sh.evaluate(light, s), 5)
    torch.testing.assert_close(found, light[:25], atol=3e-13, rtol=0)
    # The smallest rule for order 5 lets band 14 in.
    found = sh.project_function(lambda s: sh.evaluate(light, s), 5, degree=8)
    assert (found - light[:25]).abs().max() > 0.1


@pytest.mark.parametrize("weighted", [False, True])
def test_samples_bring_back_the_coefficients_of_a_function(weighted):
    light = lights(2, 25, 3)
    directions = torch.nn.functional.normalize(lights(200, 3, seed=4), dim=-1)
    weights = torch.rand(200, dtype=torch.float64, generator=torch.Generator().manual_seed(5)) if weighted else None
    found = sh.project_samples(sh.evaluate(light, directions), directions, 5, weights)
    torch.testing.assert_close(found, light, atol=1e-12, rtol=0)


def test_samples_are_fitted_as_the_normal_equations_say():
    directions, _ = sh.fibonacci(60)
    values, weights = lights(60, 2), torch.linspace(0, 1, 60, dtype=torch.float64)
    table = sh.basis(directions, 3)
    expected = torch.linalg.solve((table.mT * weights) @ table, (table.mT * weights) @ values)
    torch.testing.assert_close(sh.project_samples(values, directions, 3, weights), expected, atol=1e-13, rtol=0)


def test_gradients_flow_to_the_samples():
    directions, _ = sh.fibonacci(12)
    values = lights(12, 1).requires_grad_()
    assert torch.autograd.gradcheck(lambda v: sh.project_samples(v, directions, 2), values)
