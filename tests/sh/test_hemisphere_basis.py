"""Do the functions of the hemisphere span the harmonics there, orthonormal at any order and precision?"""

import mpmath
import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError

ORDERS = [1, 2, 3, 5, 8, 12, 24]


def upper(count: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    directions = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    directions = directions / directions.norm(dim=-1, keepdim=True)
    directions[:, 2].abs_()
    return directions.to(dtype)


def test_refuses_an_order_below_one_and_an_unknown_projection():
    for function in (sh.hemisphere_basis, sh.exit_functions):
        with pytest.raises(InputError, match="order"):
            function(upper(1), 0)
    with pytest.raises(InputError, match="order"):
        sh.exit_count(0)
    with pytest.raises(InputError, match="'mirror'"):
        getattr(sh.exit_count, "__wrapped__", sh.exit_count)(5, "mirror")


def test_no_directions_are_no_values():
    assert sh.hemisphere_basis(torch.zeros(0, 3), 4).shape == (0, 16)
    assert sh.hemisphere_basis(torch.zeros(2, 0, 3), 4).shape == (2, 0, 16)


@pytest.mark.parametrize("order", ORDERS)
def test_orthonormal_on_the_hemisphere(order):
    directions, weights = sh.gauss_legendre_hemisphere(2 * (order - 1))
    values = sh.hemisphere_basis(directions, order)
    gram = values.mT @ (weights[:, None] * values)
    # The values reach the order; a sum of order^2 rounded products of them.
    torch.testing.assert_close(gram, torch.eye(order**2, dtype=torch.float64), atol=64 * order * 2.3e-16, rtol=0)


@pytest.mark.parametrize("order", [1, 2, 3, 5, 7])
def test_spans_what_the_harmonics_span(order):
    directions, weights = sh.gauss_legendre_hemisphere(2 * (order - 1))
    values, harmonics = sh.hemisphere_basis(directions, order), sh.basis(directions, order)
    change = values.mT @ (weights[:, None] * harmonics)
    elsewhere = upper(100)
    found = sh.hemisphere_basis(elsewhere, order) @ change
    torch.testing.assert_close(found, sh.basis(elsewhere, order), atol=1e-13 * order, rtol=0)


@pytest.mark.parametrize("order", [2, 4, 5, 6])
def test_its_integrals_are_the_optimal_projection(order):
    directions, weights = sh.gauss_legendre_hemisphere(60)
    signal = torch.exp(3 * directions[:, 0] - directions[:, 2]) * (directions[:, 1] + 0.3)
    optimal = sh.hemisphere_projection(order) @ (sh.basis(directions, order).mT @ (weights * signal))
    ours = sh.hemisphere_basis(directions, order).mT @ (weights * signal)
    points = upper(200)
    wanted, found = sh.basis(points, order) @ optimal, sh.hemisphere_basis(points, order) @ ours
    # The Gram matrix loses as many digits as its condition has: 4.2e6 at order 6.
    torch.testing.assert_close(found, wanted, atol=1e-8, rtol=0)


@pytest.mark.parametrize("m", [0, 1, 3])
def test_agrees_with_orthogonal_polynomials_in_forty_digits(m):
    order = 9
    with mpmath.workdps(40):

        def inner(p, q):
            return mpmath.quad(lambda z: mpmath.polyval(p, z) * mpmath.polyval(q, z) * (1 - z * z) ** m, [0, 1])

        polynomials: list[list] = []
        for degree in range(order - m):
            # Gram-Schmidt on z^k.
            new = [mpmath.mpf(1)] + [mpmath.mpf(0)] * degree
            for old in polynomials:
                share = inner(new, old)
                padded = [mpmath.mpf(0)] * (len(new) - len(old)) + old
                new = [a - share * b for a, b in zip(new, padded, strict=True)]
            size = mpmath.sqrt(inner(new, new))
            polynomials.append([a / size for a in new])
        for point in upper(5, seed=m).tolist():
            x, y, z = (mpmath.mpf(value) for value in point)
            around = mpmath.re(mpmath.mpc(x, y) ** m) / mpmath.sqrt((2 if m == 0 else 1) * mpmath.pi)
            values = sh.hemisphere_basis(torch.tensor([point], dtype=torch.float64), order)[0]
            for degree, polynomial in enumerate(polynomials):
                l = m + degree
                wanted = (-1) ** m * around * mpmath.polyval(polynomial, z)
                assert abs(float(wanted) - float(values[l * (l + 1) + m])) < 1e-12


@pytest.mark.parametrize("order", [5, 8, 12])
def test_float32_keeps_its_digits(order):
    points = upper(1000)
    wanted, found = sh.hemisphere_basis(points, order), sh.hemisphere_basis(points.float(), order)
    # The values reach order; the slopes of the functions and the recurrence lose a few digits more.
    assert float((found.double() - wanted).abs().max()) < 16 * order**2 * torch.finfo(torch.float32).eps


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_with_gradients_it_is_the_same_and_they_are_finite_at_pole_and_horizon(dtype):
    points = torch.tensor([[0, 0, 1], [1, 0, 0], [0, -1, 0], [0.6, 0, 0.8], [0, 0, 0]], dtype=dtype)
    recorded = points.clone().requires_grad_()
    values = sh.hemisphere_basis(recorded, 6)
    torch.testing.assert_close(
        values.detach(), sh.hemisphere_basis(points, 6), atol=1e2 * torch.finfo(dtype).eps, rtol=0
    )
    (gradient,) = torch.autograd.grad(values.square().sum(), recorded)
    assert gradient.isfinite().all()


def test_gradients_are_right():
    points = upper(3).requires_grad_()
    assert torch.autograd.gradcheck(lambda d: sh.hemisphere_basis(d, 5), points)


def test_leading_dimensions_are_kept():
    points = upper(6).reshape(2, 3, 3)
    torch.testing.assert_close(sh.hemisphere_basis(points, 4)[1, 2], sh.hemisphere_basis(points[1, 2], 4))


@pytest.mark.parametrize("projection", ["optimal", "reduced", "zero", "odd", "even"])
@pytest.mark.parametrize("order", [1, 2, 5])
def test_there_are_as_many_exit_functions_as_promised(order, projection):
    assert sh.exit_functions(upper(4), order, projection).shape == (4, sh.exit_count(order, projection))


def test_the_reduced_functions_are_the_harmonics_but_one():
    points = upper(10)
    reduced = sh.exit_functions(points, 5, "reduced")
    kept = [index for index in range(25) if index != 2]
    torch.testing.assert_close(reduced, sh.basis(points, 5)[:, kept])
    assert sh.exit_count(5, "reduced") == 24


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_directions_below_the_horizon_come_up_to_it(scale):
    points = torch.tensor([[0.0, 0, 2], [3, 0, 4], [3, 4, -1], [0, 0, -1], [0, 0, 0]]) * scale
    wanted = torch.tensor([[0.0, 0, 1], [0.6, 0, 0.8], [0.6, 0.8, 0], [0, 0, 1], [0, 0, 1]])
    # A division, a root and a product.
    torch.testing.assert_close(sh.to_horizon(points), wanted, atol=4 * torch.finfo(torch.float32).eps, rtol=0)
    points.requires_grad_()
    (gradient,) = torch.autograd.grad(sh.to_horizon(points)[:, 0].sum(), points)
    assert gradient.isfinite().all()
