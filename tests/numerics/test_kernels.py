"""Does every kernel keep its digits, and have gradients, at every extreme of every argument?"""

import pytest
import torch
from numerics.kernels import KERNELS
from numerics.measured import cases, loss, losses

from torchprt.errors import InputError

NARROW = [torch.float16, torch.bfloat16]
WIDE = [torch.float32, torch.float64]
# The least and one that is used; the largest stands in docs/numerics.md, and takes most of the time.
TRIED = (1, 2, 5, 12)
BY_ORDER = [(kernel, order) for kernel in KERNELS for order in (TRIED if len(kernel.orders) > 2 else kernel.orders)]


def named(value):
    return str(value).removeprefix("torch.")


def test_every_kernel_has_a_name_of_its_own():
    names = [kernel.name for kernel in KERNELS]
    assert len(set(names)) == len(names)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize(
    ("kernel", "which"), [(k, i) for k in KERNELS for i in range(len(k.ends))], ids=lambda value: named(value)
)
def test_what_it_cannot_do_is_refused_in_a_sentence(kernel, which):
    with pytest.raises(InputError, match=".{20,}"):
        kernel.ends[which]()


@pytest.mark.parametrize("dtype", WIDE, ids=named)
@pytest.mark.parametrize(("kernel", "order"), BY_ORDER, ids=named)
def test_every_extreme_keeps_its_digits(kernel, order, dtype):
    if order > max(kernel.orders):
        pytest.skip(f"{kernel.name} ends at order {max(kernel.orders)}")
    lost = losses(kernel, order, dtype)
    # Each entry of the table says how many epsilons; written so that NaN fails.
    assert not {name: eps for name, eps in lost.items() if not eps <= kernel.budget * order}


@pytest.mark.parametrize("dtype", NARROW, ids=named)
@pytest.mark.parametrize(("kernel", "order"), [one for one in BY_ORDER if one[0].narrow], ids=named)
def test_narrow_types_lose_a_rounding_or_two(kernel, order, dtype):
    lost = losses(kernel, order, dtype)
    # Half an epsilon of what goes in, and of what comes out; products of many numbers are rounded by their parts.
    assert not {name: eps for name, eps in lost.items() if not eps <= 2}


@pytest.mark.parametrize("dtype", WIDE, ids=named)
@pytest.mark.parametrize("kernel", KERNELS, ids=named)
def test_values_and_gradients_are_finite_at_every_extreme(kernel, dtype):
    order = min(5, max(kernel.orders))
    for name, arguments in cases(kernel, order, dtype):
        given = {key: value.clone().requires_grad_() for key, value in arguments.items()}
        value = kernel.call(order, **given)
        assert value.isfinite().all(), name
        if not value.requires_grad:
            continue
        # Of the size of one, so that a product with 1e30 stays within float32.
        upward = torch.linspace(-1, 1, value.numel(), dtype=dtype).reshape(value.shape)
        found = torch.autograd.grad(value, list(given.values()), upward, allow_unused=True)
        for key, gradient in zip(given, found, strict=True):
            assert gradient is None or gradient.isfinite().all(), f"{key}: {name}"


@pytest.mark.parametrize("scale", [2.0**-90, 2.0**90])
@pytest.mark.parametrize("kernel", [kernel for kernel in KERNELS if kernel.linear], ids=named)
def test_what_is_linear_has_the_same_digits_at_any_brightness(kernel, scale):
    """Powers of two leave every digit where it is: 1e-27 and 1e27."""
    order = min(5, max(kernel.orders))
    (_, usual), *_ = cases(kernel, order, torch.float32)
    scaled = usual | {kernel.linear: usual[kernel.linear] * scale}
    torch.testing.assert_close(kernel.call(order, **scaled), kernel.call(order, **usual) * scale, rtol=0, atol=0)


def test_a_loss_that_is_none_and_one_of_an_epsilon_are_told():
    exact = torch.tensor([1.0, -3.0], dtype=torch.float64)
    assert loss(exact.float(), exact, torch.float32) == 0
    assert loss(exact * (1 + 2**-23), exact, torch.float32) == pytest.approx(1)
    assert not loss(exact * torch.nan, exact, torch.float32) <= 1e30
