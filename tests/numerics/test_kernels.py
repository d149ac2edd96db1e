"""Does every kernel keep its digits, and have gradients, at every extreme of every argument?"""

import pytest
import torch
from numerics.kernels import KERNELS
from numerics.measured import cases, loss, losses

from torchprt.errors import InputError

# Thousands of small calls: the checks of shapes would take most of the time.
pytestmark = pytest.mark.usefixtures("untyped")

NARROW = [torch.float16, torch.bfloat16]
WIDE = [torch.float32, torch.float64]
# The least, one that is used and a high one; up to 32 they are measured for docs/numerics.md.
TRIED = (1, 5, 12)
BY_ORDER = [
    (kernel, order)
    for kernel in KERNELS
    for order in (TRIED if len(kernel.orders) > 2 else kernel.orders)
    if order <= max(kernel.orders)
]


def named(value):
    return str(value).removeprefix("torch.")


def test_every_kernel_has_a_name_of_its_own():
    names = [kernel.name for kernel in KERNELS]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("kernel", "which"), [(k, i) for k in KERNELS for i in range(len(k.ends))], ids=lambda value: named(value)
)
def test_what_it_cannot_do_is_refused_in_a_sentence(kernel, which):
    with pytest.raises(InputError, match=r".{20,}"):
        kernel.ends[which]()


@pytest.mark.parametrize("dtype", WIDE, ids=named)
@pytest.mark.parametrize(("kernel", "order"), BY_ORDER, ids=named)
def test_every_extreme_keeps_its_digits(kernel, order, dtype):
    lost = losses(kernel, order, dtype)
    # Each entry of the table says how many epsilons; written so that NaN fails.
    assert not {name: eps for name, eps in lost.items() if not eps <= kernel.budget * order}


@pytest.mark.parametrize("dtype", NARROW, ids=named)
@pytest.mark.parametrize(("kernel", "order"), [one for one in BY_ORDER if one[0].narrow], ids=named)
def test_narrow_types_lose_a_rounding_or_two(kernel, order, dtype):
    lost = losses(kernel, order, dtype)
    # Half an epsilon of what goes in, and of what comes out; products of many numbers are rounded by their parts.
    assert not {name: eps for name, eps in lost.items() if not eps <= 2}


def gradients(kernel, order, arguments, dtype):
    """By argument; empty if no gradient is asked of the kernel."""
    given = {key: value.to(dtype).clone().requires_grad_() for key, value in arguments.items()}
    value = kernel.call(order, **given)
    if not value.requires_grad:
        return {}
    # Of one size, so that no product with 1e30 leaves float32, and of one sign, so that sums do not cancel.
    upward = torch.linspace(0.5, 1.5, value.numel(), dtype=dtype).reshape(value.shape)
    found = torch.autograd.grad(value, list(given.values()), upward, allow_unused=True)
    return {key: gradient for key, gradient in zip(given, found, strict=True) if gradient is not None}


@pytest.mark.parametrize("kernel", KERNELS, ids=named)
def test_gradients_are_finite_and_right_at_every_extreme(kernel):
    order = min(5, max(kernel.orders))
    for name, arguments in cases(kernel, order, torch.float32):
        found, exact = (gradients(kernel, order, arguments, dtype) for dtype in (torch.float32, torch.float64))
        for key, gradient in found.items():
            assert not gradient.isnan().any(), f"{key}: {name}"
            if "denormal" in name:
                # Of the direction of a vector of length a it is of the size of 1 / a: out of range.
                continue
            assert gradient.isfinite().all(), f"{key}: {name}"
            assert exact[key].isfinite().all(), f"{key}: {name}"
            if not any(name == f"{argument} {extreme}" for argument, extreme in kernel.loses | kernel.faint):
                # A derivative of a function of order n is of the size of n.
                assert loss(gradient, exact[key], torch.float32) <= 8 * kernel.budget * order**2, f"{key}: {name}"


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
