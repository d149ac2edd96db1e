import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError


def lights(*shape, seed=6):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_refuses_orders_below_one_and_counts_that_are_not_square():
    with pytest.raises(InputError, match="orders"):
        sh.gaunt(3, 0, 3)
    with pytest.raises(InputError, match="order"):
        sh.product(lights(4, 1), lights(4, 1), 0)
    with pytest.raises(InputError, match="square"):
        sh.product(lights(5, 1), lights(4, 1))
    with pytest.raises(InputError, match="square"):
        sh.product_matrix(lights(5), 2, 2)


@pytest.mark.parametrize(("order", "count"), [(1, 1), (3, 83), (5, 1158), (6, 2907), (11, 65913)])
def test_counts_the_gaunt_coefficients_that_do_not_vanish(order, count):
    assert int(sh.gaunt(order, order, order).count_nonzero()) == count


def test_gaunt_is_the_integral_of_three_basis_functions():
    directions, weights = sh.lebedev(15)
    a, b, c = (sh.basis(directions, order) for order in (3, 5, 2))
    expected = torch.einsum("d,di,dj,dk->ijk", weights, a, b, c)
    torch.testing.assert_close(sh.gaunt(3, 5, 2), expected, atol=1e-14, rtol=0)


def test_gaunt_is_symmetric():
    tensor = sh.gaunt(4, 4, 4)
    for other in ((0, 2, 1), (1, 0, 2), (2, 1, 0)):
        torch.testing.assert_close(tensor, tensor.permute(other), atol=1e-14, rtol=0)


def test_a_caller_may_write_into_the_gaunt_tensor():
    sh.gaunt(2, 2, 2).zero_()
    assert sh.gaunt(2, 2, 2).any()


@pytest.mark.parametrize(("order_a", "order_b"), [(1, 1), (3, 3), (2, 6), (6, 6), (12, 20)])
def test_the_whole_product_is_the_product_of_the_values(order_a, order_b):
    a, b = lights(order_a**2, 3), lights(order_b**2, 3, seed=7)
    directions, _ = sh.fibonacci(50)
    values = sh.evaluate(a, directions) * sh.evaluate(b, directions)
    whole = sh.evaluate(sh.product(a, b, order_a + order_b - 1), directions)
    # Values of size order_a * order_b, each good to about 1e-14 an order.
    torch.testing.assert_close(whole, values, atol=1e-14 * (order_a * order_b + 1) * 32, rtol=0)


@pytest.mark.parametrize("order", [1, 4, 8])
def test_a_shorter_product_is_the_beginning_of_the_whole(order):
    a, b = lights(2, 1, 16, 3), lights(4, 9, 3)
    whole, part = sh.product(a, b, 6), sh.product(a, b, order)
    count = min(order, 6) ** 2
    assert part.shape == (2, 4, order**2, 3)
    torch.testing.assert_close(part[..., :count, :], whole[..., :count, :], atol=1e-13, rtol=0)
    # Above the sum of the orders nothing is left.
    torch.testing.assert_close(part[..., count:, :], torch.zeros_like(part[..., count:, :]), atol=1e-13, rtol=0)


def test_channels_broadcast():
    visibility, light = lights(16, 1), lights(16, 3)
    each = [sh.product(visibility, light[:, c : c + 1]) for c in range(3)]
    torch.testing.assert_close(sh.product(visibility, light), torch.cat(each, -1), atol=1e-14, rtol=0)


@pytest.mark.parametrize(("order_in", "order_out"), [(1, 1), (4, 4), (5, 2), (2, 5)])
def test_the_matrix_multiplies(order_in, order_out):
    a, b = lights(3, 9), lights(3, order_in**2, seed=8)
    matrix = sh.product_matrix(a, order_in, order_out)
    assert matrix.shape == (3, order_out**2, order_in**2)
    expected = sh.product(a.unsqueeze(-1), b.unsqueeze(-1), order_out)
    torch.testing.assert_close(matrix @ b.unsqueeze(-1), expected, atol=1e-13, rtol=0)
    if order_in == order_out:
        torch.testing.assert_close(matrix, matrix.mT, atol=1e-14, rtol=0)


def test_gradients_flow_to_both_factors():
    a, b = lights(4, 1).requires_grad_(), lights(4, 2).requires_grad_()
    assert torch.autograd.gradcheck(sh.product, (a, b))
    assert torch.autograd.gradcheck(lambda v: sh.product_matrix(v, 2, 2), lights(4).requires_grad_())
