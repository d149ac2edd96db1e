"""What arguments of each kind are like at their worst, by name; "plain" is as they mostly are."""

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchprt import sh

DARK, HOT = 1e-3, 1e6


def extremes(kind: str, order: int, dtype: torch.dtype) -> dict[str, Tensor]:
    """Values of one kind of argument in `dtype`, those left out that it cannot hold."""
    info = torch.finfo(dtype)
    made = {name: value.to(dtype) for name, value in KINDS[kind](order, info).items()}
    if kind in ("vectors", "view"):
        made = {name: value for name, value in made.items() if bool(value.abs().amax(-1).gt(0).all())}
    return {name: value for name, value in made.items() if bool(value.isfinite().all())}


def plain(kind: str, order: int, dtype: torch.dtype) -> Tensor:
    return KINDS[kind](order, torch.finfo(dtype))["plain"].to(dtype)


def _random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def directions(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Of unit length to rounding."""
    axes = torch.cat([torch.eye(3), -torch.eye(3)]).double()
    poles = torch.tensor([[0, 0, 1], [0, 0, -1]]).double()

    def off(distance: float) -> Tensor:
        sideways = torch.tensor([[1, 0, 0], [-0.6, 0.8, 0], [0, 1, 0]]).double() * distance
        return normalize((poles[:, None] + sideways).reshape(-1, 3), dim=-1)

    return {
        "plain": sh.fibonacci(9)[0],
        "axes and poles": axes,
        "1e-4 off a pole": off(1e-4),
        "an epsilon off a pole": off(info.eps),
        "1e-20 off a pole": off(1e-20),
        "a denormal off a pole": poles + torch.tensor([info.tiny / 8, -info.tiny / 4, 0.0]).double(),
        "1e-4 off the equator": normalize(torch.tensor([[1, 0, 1e-4], [0, -1, -1e-4]]).double(), dim=-1),
        "a denormal off the equator": torch.tensor([[1, 0, info.tiny / 8], [0.6, -0.8, -info.tiny / 8]]).double(),
    }


def above(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Of unit length, in the upper hemisphere or on its edge."""
    made = directions(order, info)
    made = {name: value[value[:, 2] >= 0] for name, value in made.items()}
    made["grazing"] = normalize(torch.tensor([[1, 0, 1e-7], [-0.6, 0.8, 1e-3], [0, 1, 1e-12]]).double(), dim=-1)
    return made


def facing(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Clear of the horizon, where reflectance ends and is defined by dtype."""
    return {name: value[value[:, 2] > 1e-3] for name, value in above(order, info).items() if (value[:, 2] > 1e-3).any()}


def vectors(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Of any length above zero."""
    some = sh.fibonacci(5)[0]
    return {
        "plain": some * torch.tensor([1.0, 0.3, 7.0, 2.0, 0.5]).double()[:, None],
        "1e-30 long": some * 1e-30,
        "1e30 long": some * 1e30,
        "denormal": some * (info.tiny / 2),
        "as long as can be": some * (info.max / 2),
        "axes and poles": directions(order, info)["axes and poles"] * 3,
        "1e-20 off a pole": directions(order, info)["1e-20 off a pole"] * 3,
    }


def view(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """One of `vectors` at a time."""
    return {name: value[1] for name, value in vectors(order, info).items()}


def light(order: int, info: torch.finfo) -> dict[str, Tensor]:
    fall = (1 + sh.bands(order)).double() ** -2.0
    some = _random(order**2, 3) * fall[:, None]
    hot = DARK + HOT * sh.basis(normalize(torch.tensor([0.5, 0.7, -0.4]).double(), dim=-1), order)
    return {
        "plain": some,
        "black": torch.zeros_like(some),
        "1e-30 bright": some * 1e-30,
        "1e30 bright": some * 1e30,
        "denormal": some * info.tiny / 4,
        "one hot texel": hot[:, None].expand(-1, 3).contiguous(),
    }


def lit(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Lights whose means are positive."""
    made = light(order, info)
    for value in made.values():
        value[0] = value[0].abs()
    return made


def image(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Latitude-longitude maps of 8 x 16 texels."""
    some = _random(8, 16, 3).abs() + 0.01
    hot = torch.full_like(some, DARK)
    hot[5, 3] = HOT
    return {
        "plain": some,
        "black": torch.zeros_like(some),
        "1e-30 bright": some * 1e-30,
        "1e30 bright": some * 1e30,
        "denormal": some * info.tiny / 4,
        "one hot texel": hot,
        "a hot pole": hot.roll(-5, 0),
    }


def cube(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Cube maps of 6 x 4 x 4 texels, of the same values."""
    made = {name: value.reshape(-1, 3)[:96].reshape(6, 4, 4, 3) for name, value in image(order, info).items()}
    del made["a hot pole"]
    return made


def rotation(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Proper rotations, and what is let through beside them."""
    spin = _random(3, 3, seed=3)
    some = torch.linalg.matrix_exp(spin - spin.T)
    little = torch.linalg.matrix_exp(1e-8 * (spin - spin.T))
    halves = {
        f"half a turn about {axis}": torch.diag(2 * torch.eye(3, dtype=torch.float64)[i] - 1)
        for i, axis in enumerate("xyz")
    }
    made = {
        "plain": some,
        "identity": torch.eye(3, dtype=torch.float64),
        **halves,
        "1e-8 from the identity": little,
        "1e-8 from half a turn": little @ halves["half a turn about y"],
        "a quarter turn, where angles lock": sh.yaw_pitch_roll(torch.tensor([90.0, 90.0, 0.0]).double()),
        "a denormal from the identity": torch.eye(3, dtype=torch.float64)
        + info.tiny / 8 * torch.tensor([[0, -1, 0], [1, 0, 0], [0, 0, 0]]).double(),
        "not quite orthogonal": some @ (torch.eye(3).double() + 4e-5 * torch.diag(_random(3).sign())),
    }
    return made


def degrees(order: int, info: torch.finfo) -> dict[str, Tensor]:
    return {
        "plain": torch.tensor([[30.0, -50.0, 70.0]]),
        "none": torch.zeros(1, 3),
        "denormal": torch.full((1, 3), info.tiny / 4),
        "half turns": torch.tensor([[180.0, -180.0, 360.0]]),
        "many turns": torch.tensor([[7200.0, -3600.0, 1e4]]),
    }


def angle(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Half angles of caps, in radians; those that keep their relative accuracy one a row."""
    return {
        "plain": torch.tensor([0.2, 1.0]),
        "1e-8": torch.tensor([1e-8]),
        "the sun": torch.tensor([0.00465]),
        "a right angle": torch.tensor([torch.pi / 2], dtype=torch.float64),
        "nearly all": torch.tensor([3.14]),
    }


def exponent(order: int, info: torch.finfo) -> dict[str, Tensor]:
    return {
        "plain": torch.tensor([1.0, 40.0]),
        "0": torch.tensor([0.0]),
        "1e-30": torch.tensor([1e-30], dtype=torch.float64),
        "1e4": torch.tensor([1e4]),
        "1e6": torch.tensor([1e6]),
    }


def bands(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """A kernel or window: a factor a band."""
    falls = 1 / (1 + torch.arange(order, dtype=torch.float64))
    return {"plain": falls, "none": torch.ones_like(falls), "nothing": torch.zeros_like(falls), "1e-30": falls * 1e-30}


def pose(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Positions of a bumpy square of nine vertices (`zonal_transfers.bumpy`), well and badly treated."""
    from zonal_transfers import bumpy

    rest, _ = bumpy(3)
    some = rest @ rotation(order, info)["plain"].T
    return {
        "plain": some,
        "at rest": rest,
        "1e-6 in size": some * 1e-6,
        "1e6 in size": some * 1e6,
        "1e-15 in size": some * 1e-15,
        "1e15 in size": some * 1e15,
        "1e4 away": some + 1e4,
        "in one point": torch.zeros_like(some),
        "on one line": some * torch.tensor([1.0, 0.0, 0.0]),
        "in a plane": some * torch.tensor([1.0, 0.0, 1.0]),
        "a needle": some * torch.tensor([1.0, 1e-12, 1e-12]),
        "inside out": some * torch.tensor([1.0, 1.0, -1.0]),
        "folded over": some * torch.tensor([1.0, 1.0, 1.0]).where(some[:, :1] > 0, torch.tensor([-1.0, 1.0, 1.0])),
    }


def steady_pose(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Poses in which every vertex has turned by a rotation, as shaders ask for."""
    wanted = ("plain", "at rest", "1e-6 in size", "1e6 in size")
    return {name: value for name, value in pose(order, info).items() if name in wanted}


def frames(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """One rotation for each of nine receivers."""
    return {name: value.expand(9, 3, 3).contiguous() for name, value in rotation(order, info).items()}


def colour(order: int, info: torch.finfo) -> dict[str, Tensor]:
    """Radiance, or weights."""
    some = torch.tensor([[0.2, 0.5, 0.9], [3.0, 1.0, 0.1]])
    return {
        "plain": some,
        "black": torch.zeros_like(some),
        "1e-30": some * 1e-30,
        "1e30": some.double() * 1e30,
        "denormal": some.double() * info.tiny / 4,
        "one channel 1e6": torch.tensor([[1e-3, 1e-3, 1e6]]),
    }


KINDS = {
    function.__name__: function
    for function in (
        directions, above, facing, vectors, view, light, lit, image, cube, rotation, degrees, angle, exponent, bands,
        pose, steady_pose, frames, colour,
    )
}  # fmt: skip
