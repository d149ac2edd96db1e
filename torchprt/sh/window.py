"""Windows against ringing: a factor a band, and the smallest one that leaves no negative radiance."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import basis, order_of, values_are_at_hand
from torchprt.sh.constant import remembered
from torchprt.sh.precision import without_autocast
from torchprt.sh.quadrature import fibonacci
from torchprt.sh.zonal import convolve

# The search for the lowest value: directions per coefficient, valleys followed, and how each is closed in on.
_DENSITY, _VALLEYS, _STEPS, _SHRINK = 64, 8, 12, 0.4
_BISECTIONS = 30
# Directions that are compared each with each: those of order 6, in 42 MB.
_FEW = _DENSITY * 6 * 6


def hann(order: int, width: float | int | None = None, dtype: torch.dtype = torch.float64) -> Float[Tensor, " n"]:
    """(1 + cos(pi l / width)) / 2 up to band `width` (by default `order`), zero from there on.

    Raises InputError if `order` is below 1 or `width` is not positive.
    Source: Sloan 2008, "Stupid spherical harmonics tricks", windowing.
    """
    l, width = _bands_and_width(order, width, dtype)
    return torch.where(l < width, (1 + torch.cos(math.pi * l / width)) / 2, 0.0)


def lanczos(order: int, width: float | int | None = None, dtype: torch.dtype = torch.float64) -> Float[Tensor, " n"]:
    """sin(pi l / width) / (pi l / width) up to band `width` (by default `order`), zero from there on.

    Raises InputError if `order` is below 1 or `width` is not positive.
    Source: Sloan 2008, "Stupid spherical harmonics tricks", windowing.
    """
    l, width = _bands_and_width(order, width, dtype)
    return torch.where(l < width, torch.sinc(l / width), 0.0)


def gauss(order: int, width: float | int | None = None, dtype: torch.dtype = torch.float64) -> Float[Tensor, " n"]:
    """exp(-pi^2 l (l + 1) / (2 width^2)), the Gaussian of the sphere; `width` is by default `order`.

    A positive kernel (heat diffused for a time): a wider-spread one never lowers the least value of a light.
    Raises InputError if `order` is below 1 or `width` is not positive.
    """
    l, width = _bands_and_width(order, width, dtype)
    return torch.exp(-0.5 * (math.pi / width) ** 2 * l * (l + 1))


def window(light: Float[Tensor, "*#B N C"], factors: Float[Tensor, "*#B n"]) -> Float[Tensor, "... N C"]:
    """`light` with every band multiplied by its factor; leading dimensions broadcast.

    Raises InputError if N is not a square number or `factors` does not have one factor a band.
    """
    return convolve(light, factors)


@without_autocast
def least_window(
    light: Float[Tensor, "*B N C"], kernel: Float[Tensor, " n"] | None = None
) -> tuple[Float[Tensor, "*B N C"], Float[Tensor, "*B n"]]:
    """The light under the weakest Gaussian window that leaves it nowhere negative, and its factors.

    With a `kernel` (band coefficients A_l, as of `convolve`) it is the light convolved with it that is nowhere
    negative: with `phong(k, n)` whatever gathers the light in a lobe cos^k or a wider one.

    One window a light, the same for all channels, so colours keep. Because the Gaussian is a positive kernel
    the least value grows with its strength, so bisection finds the weakest. A light that is non-negative
    already comes back bit for bit, with factors of one.
    Guarantee: the least value is at least -max(16 n eps, 1e-9) times the largest, eps of the light's dtype; it is
    looked for in float64 on 64 N directions and closed in on from the 8 lowest valleys among them.
    No gradient flows through the choice of the window. Sets up a light: not for every frame.

    Raises InputError if N is not a square number, the kernel does not have one coefficient a band or, outside a traced
    graph and torch.func, a value is not finite or the mean of a channel is negative, which no window mends.
    """
    order = order_of(light.shape[-2])
    seen = values_are_at_hand(light)
    if seen and not bool(light.isfinite().all()):
        raise InputError("light holds values that are not finite: repair the image it came from")
    if seen and bool(light[..., 0, :].lt(0).any()):
        raise InputError("light has a channel whose mean is negative: no window makes it non-negative")
    exact = light.detach().double().flatten(0, -3) if light.dim() > 2 else light.detach().double().unsqueeze(0)
    tolerance = 4 * order * torch.finfo(light.dtype).eps
    l = torch.arange(order, dtype=torch.float64, device=light.device)
    exponent = l * (l + 1) / 2
    if kernel is not None:
        exact = convolve(exact, kernel.detach())

    def is_non_negative(factors: Tensor, tolerance: float) -> Tensor:
        least, largest = _least_and_largest(convolve(exact, factors))
        return least >= -tolerance * largest

    ones = torch.ones(len(exact), 1, dtype=torch.float64, device=light.device)
    kept = is_non_negative(ones**exponent, tolerance)
    weak, strong = ones.clone(), torch.zeros_like(ones)
    if not (seen and bool(kept.all())):
        for _ in range(_BISECTIONS):
            middle = (weak + strong) / 2
            enough = is_non_negative(middle**exponent, 0.0).unsqueeze(-1)
            weak, strong = torch.where(enough, weak, middle), torch.where(enough, middle, strong)
    factors = torch.where(kept.unsqueeze(-1), 1.0, strong**exponent)
    factors = factors.reshape(*light.shape[:-2], order).to(light.dtype)
    return window(light, factors), factors


def _least_and_largest(light: Tensor) -> tuple[Tensor, Tensor]:
    """Least value over directions and channels, and largest absolute value, of lights [B, N, C], each [B]."""
    order = order_of(light.shape[-2])
    directions, table, neighbours = _search_set(light.device, order)
    values = (table @ light).mT
    valley = (values <= values[..., neighbours].amin(-1)).flatten(1)
    lowest = torch.where(valley, values.flatten(1), torch.inf).topk(min(_VALLEYS, valley.shape[1]), largest=False)
    channel, place = lowest.indices // len(directions), lowest.indices % len(directions)
    coefficients = light.mT.gather(1, channel.unsqueeze(-1).expand(-1, -1, order * order)).unsqueeze(-1)
    least = _descend(coefficients, directions[place], 2 / (order * math.sqrt(_DENSITY)))
    return torch.minimum(least.amin(-1), values.flatten(1).amin(-1)), values.flatten(1).abs().amax(-1)


def _descend(coefficients: Tensor, start: Tensor, reach: float) -> Tensor:
    """The lowest values near `start` [B, K, 3] by a pattern of 25 directions that closes in on them."""
    step = torch.linspace(-1, 1, 5, dtype=start.dtype, device=start.device)
    pattern = torch.cartesian_prod(step, step)
    best = start.new_full(start.shape[:2], torch.inf)
    for _ in range(_STEPS):
        # Any axis far from the direction gives a tangent frame.
        # As `one_hot`, which looks at values.
        away = (torch.arange(3, device=start.device) == start.abs().argmin(-1, keepdim=True)).to(start.dtype)
        tangent = torch.nn.functional.normalize(torch.linalg.cross(start, away), dim=-1)
        frame = torch.stack([tangent, torch.linalg.cross(start, tangent)], -2)
        around = start.unsqueeze(-2) + reach * pattern @ frame
        around = torch.nn.functional.normalize(around, dim=-1)
        value, index = (basis(around, math.isqrt(coefficients.shape[-2])) @ coefficients).squeeze(-1).min(-1)
        start = around.gather(-2, index[..., None, None].expand(*index.shape, 1, 3)).squeeze(-2)
        best = torch.minimum(best, value)
        reach *= _SHRINK
    return best


@remembered(8)
def _search_set(order: int) -> tuple[Tensor, Tensor, Tensor]:
    directions, _ = fibonacci(_DENSITY * order * order)
    return directions, basis(directions, order).contiguous(), neighbours(directions)


def neighbours(directions: Float[Tensor, "D 3"]) -> Int[Tensor, "D 8"]:
    """The numbers of the eight directions nearest to each, the nearest first."""
    if len(directions) <= _FEW:
        # Sooner done than a tree is loaded. The nearest of all is the direction itself.
        return (directions @ directions.mT).topk(9).indices[:, 1:].contiguous()
    from scipy.spatial import cKDTree

    _, nearest = cKDTree(directions.numpy()).query(directions.numpy(), k=9)
    return torch.from_numpy(nearest[:, 1:].copy())


def _bands_and_width(order: int, width: float | int | None, dtype: torch.dtype) -> tuple[Tensor, float]:
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    width = float(order) if width is None else float(width)
    if not width > 0:
        raise InputError(f"width of a window must be positive, not {width}")
    return torch.arange(order, dtype=dtype), width
