"""The real spherical-harmonic basis and the reconstruction of functions from their coefficients."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.constant import a_mode_replaces_tensors, remembered
from torchprt.sh.precision import widened

_CONSTANT = math.sqrt(0.25 / math.pi)
_LINEAR = math.sqrt(0.75 / math.pi)


def basis(directions: Float[Tensor, "*D 3"], order: int) -> Float[Tensor, "*D N"]:
    """Every basis function y_lm, l < `order`, at unit `directions`; index i = l(l + 1) + m.

    Real, orthonormal, with the Condon-Shortley sign (docs/conventions.md). The result is a view of memory
    with components first, `[N, *D]`, the layout in which both evaluation and the product with a light are
    fast. Polynomials in x, y, z through a normalised recurrence, without angles: exact at the poles, with
    finite gradients everywhere. Directions are not checked (see `check_directions`): where they are not of
    unit length the result means nothing. Of directions narrower than float32 it is worked out in float32.

    Raises InputError if `order` is below 1.
    Source: Sloan, Kautz and Snyder 2002, section 3, equation 1, written as Q_l^m(z) times the real or
    imaginary part of (x + iy)^m; Sloan 2013, "Efficient spherical harmonic evaluation".
    """
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    wide = widened(directions)
    along, across = _recurrence(directions.device, order, wide.dtype)
    build = _in_place if only_values_are_wanted(directions) else _functional
    components = build(wide.reshape(-1, 3).T.contiguous(), along, across, order).to(directions.dtype)
    return components.reshape(order * order, *directions.shape[:-1]).movedim(0, -1)


def evaluate(coefficients: Float[Tensor, "*B N C"], directions: Float[Tensor, "D 3"]) -> Float[Tensor, "*B D C"]:
    """The functions with the given `coefficients`, reconstructed at unit `directions` shared by the batch.

    Raises InputError if N is not a square number.
    Source: Sloan, Kautz and Snyder 2002, section 3, equation 2.
    """
    return basis(directions, order_of(coefficients.shape[-2])) @ coefficients


def order_of(count: int) -> int:
    """The order n of `count` = n^2 coefficients. Raises InputError if `count` is not a square number."""
    order = math.isqrt(max(count, 0))
    if order < 1 or order * order != count:
        raise InputError(
            f"{count} coefficients are not a square number 1, 4, 9, 16, ...: check the axis that holds them"
        )
    return order


def bands(order: int) -> Int[Tensor, " N"]:
    """The band l of each of the `order`^2 coefficients."""
    return torch.tensor([l for l in range(order) for _ in range(2 * l + 1)])


@remembered(64)
def band_of(order: int) -> Int[Tensor, " N"]:
    """`bands`, kept, on a device: not to be written into."""
    return bands(order)


def check_directions(directions: Float[Tensor, "*D 3"], name: str = "directions") -> None:
    """Raises InputError unless every direction has unit length within 1e-4, or the epsilon of a narrow type (zero and
    NaN included). Nothing is checked where values cannot be looked at: in a traced graph, under torch.func."""
    if not values_are_at_hand(directions):
        return
    tolerance = max(1e-4, torch.finfo(directions.dtype).eps)
    if not bool((torch.linalg.vector_norm(widened(directions), dim=-1) - 1).abs().le(tolerance).all()):
        raise InputError(f"{name} must be finite and of unit length: normalise them and remove zero vectors")


def _functional(xyz: Tensor, along: Tensor, across: Tensor, order: int) -> Tensor:
    x, y, z = xyz
    bands = [torch.full_like(xyz[:1], _CONSTANT)]
    if order > 1:
        bands.append(torch.stack([-_LINEAR * y, _LINEAR * z, -_LINEAR * x]))
    for l in range(2, order):
        before, last = bands[l - 2], bands[l - 1]
        sine, cosine = last[:1], last[-1:]
        sectoral = -math.sqrt((2 * l + 1) / (2 * l))
        a, b = along[l * l + 1 : (l + 1) ** 2 - 1], across[l * l + 2 : (l + 1) ** 2 - 2]
        risen = last * z * a
        lowest = (x * sine + y * cosine) * sectoral
        highest = (x * cosine - y * sine) * sectoral
        bands.append(torch.cat([lowest, risen[:1], risen[1:-1] - b * before, risen[-1:], highest]))
    return torch.cat(bands)


def _in_place(xyz: Tensor, along: Tensor, across: Tensor, order: int) -> Tensor:
    """`_functional` written straight into the result: three times faster, without gradients."""
    x, y, z = xyz
    rows = xyz.new_empty(order * order, xyz.shape[1])
    rows[0].fill_(_CONSTANT)
    if order > 1:
        for row, axis, factor in zip(rows[1:4], (y, z, x), (-_LINEAR, _LINEAR, -_LINEAR), strict=True):
            torch.mul(axis, factor, out=row)
    for l in range(2, order):
        start, end = l * l, (l + 1) ** 2
        before, last = rows[(l - 2) ** 2 : (l - 1) ** 2], rows[(l - 1) ** 2 : start]
        sine, cosine = last[0], last[-1]
        sectoral = -math.sqrt((2 * l + 1) / (2 * l))
        torch.mul(last, z, out=rows[start + 1 : end - 1]).mul_(along[start + 1 : end - 1])
        rows[start + 2 : end - 2].addcmul_(across[start + 2 : end - 2], before, value=-1)
        torch.mul(x, sine, out=rows[start]).addcmul_(y, cosine).mul_(sectoral)
        torch.mul(x, cosine, out=rows[end - 1]).addcmul_(y, sine, value=-1).mul_(sectoral)
    return rows


def only_values_are_wanted(*arguments: Tensor) -> bool:
    """No graph is traced, no gradient recorded, no torch.func transform active: none of them knows `out=`."""
    return _nothing_is_traced() and not (
        (torch.is_grad_enabled() and any(argument.requires_grad for argument in arguments))
        or torch.autograd.forward_ad._current_level >= 0
    )


def values_are_at_hand(*values: Tensor) -> bool:
    """Whether values may be looked at, to check them: no graph is traced or captured (by the compiler, by export, by
    CUDA), no torch.func transform is active, and none of `values` is on the meta device or a fake."""
    return (
        _nothing_is_traced()
        and not (torch._C._len_torch_dispatch_stack() and a_mode_replaces_tensors())
        and not (torch.cuda.is_initialized() and torch.cuda.is_current_stream_capturing())
        and all(value.device.type != "meta" and not _is_fake(value) for value in values)
    )


def _nothing_is_traced() -> bool:
    return not torch.compiler.is_compiling() and torch._C._functorch.peek_interpreter_stack() is None


def _is_fake(value: Tensor) -> bool:
    if type(value) in (Tensor, torch.nn.Parameter):
        return False
    from torch._subclasses.fake_tensor import FakeTensor

    return isinstance(value, FakeTensor)


def plain_recurrence(order: int, dtype: torch.dtype) -> tuple[Float[Tensor, "N 1"], Float[Tensor, "N 1"]]:
    """`a [N, 1]` and `b [N, 1]` of y_lm = a z y_(l-1)m - b y_(l-2)m, on the CPU."""
    return _recurrence(torch.device("cpu"), order, dtype)


@remembered(64)
def _recurrence(order: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """a, b of y_lm = a z y_(l-1)m - b y_(l-2)m for every index; zero where the recurrence does not apply."""
    along, across = [], []
    for l in range(order):
        for m in range(-l, l + 1):
            a = math.sqrt((4 * l * l - 1) / (l * l - m * m)) if abs(m) < l else 0.0
            b = a * math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1)) if abs(m) < l - 1 else 0.0
            along.append(a)
            across.append(b)
    return (
        torch.tensor(along, dtype=dtype).unsqueeze(-1),
        torch.tensor(across, dtype=dtype).unsqueeze(-1),
    )
