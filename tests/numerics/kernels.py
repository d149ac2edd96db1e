"""Every kernel in one table: what it is called with, what it should give, how many epsilons it may lose.

A new kernel is one entry. The tests here try it at every extreme of every argument, and `scripts/published_numerics.py`
measures it for docs/numerics.md.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field

import every_shader
import torch
from numerics import exact
from torch import Tensor
from zonal_transfers import bumpy

from torchprt import brdf, light, pose, sh
from torchprt.shade import agx, filmic, neutral, shader, srgb

ORDERS = (1, 2, 5, 8, 16, 32)


@dataclass(frozen=True)
class Kernel:
    """`call(order, **arguments)`, with one argument of each kind that `takes` names (`extremes.KINDS`).

    - `reference(order, **arguments)`: the same to float64 at least, by formulas or an algorithm of its own, said in
      `against`. Without one the kernel in float64 stands for it, and nothing is said of its float64.
    - `budget`: epsilons of the dtype that it may lose, a multiple of the order, relative to the largest value.
    - `linear`: the argument it is linear in, so that 1e-30 and 1e30 give the same digits.
    - `narrow`: takes float16 and bfloat16, and is worked out in float32: what it loses is the last rounding.
    - `loses`: arguments that have too few digits for the answer, by kind and extreme: finite is all that is asked.
    - `faint`: those where a gradient is so small beside what it is a difference of that it loses digits.
    - `ends`: calls that must be refused, in a sentence that the page repeats.
    """

    name: str
    call: Callable[..., Tensor]
    takes: dict[str, str]
    reference: Callable[..., Tensor] | None = None
    against: str = ""
    orders: tuple[int, ...] = ORDERS
    budget: float = 8.0
    linear: str | None = None
    narrow: bool = True
    loses: frozenset[tuple[str, str]] = frozenset()
    faint: frozenset[tuple[str, str]] = frozenset()
    ends: tuple[Callable[[], object], ...] = field(default=())

    def __str__(self) -> str:
        return self.name


def _rotate_by_quadrature(order: int, light: Tensor, rotation: Tensor) -> Tensor:
    return sh.Rotation(order, light.dtype)(light, rotation)


def _by_matrices(order: int, light: Tensor, rotation: Tensor) -> Tensor:
    return sh.rotation_matrix(rotation, order) @ light


def _turned_functions(order: int, rotation: Tensor) -> Tensor:
    """The projection of the turned basis, by a rule that is exact for it: no algebra of rotations."""
    directions, weights = sh.gauss_legendre(2 * (order - 1))
    return (sh.basis(directions @ rotation.mT, order).mT * weights) @ sh.basis(directions, order)


def _turned_lights(order: int, light: Tensor, rotation: Tensor) -> Tensor:
    return _turned_functions(order, rotation) @ light


def _product_by_quadrature(order: int, light: Tensor, other: Tensor) -> Tensor:
    directions, weights = sh.gauss_legendre(3 * (order - 1) + 8)
    table = sh.basis(directions, order)
    return table.mT @ (weights[:, None] * (table @ light) * (table @ other))


def _each_texel(order: int, image: Tensor) -> Tensor:
    return sh.latlong_basis(order, 8, 16, torch.float64) @ image.reshape(-1, 3)


def _each_texel_of_a_cube(order: int, cube: Tensor) -> Tensor:
    weights = sh.cube_weights(4).reshape(-1, 1)
    return sh.basis(sh.cube_directions(4).reshape(-1, 3), order).mT @ (weights * cube.reshape(-1, 3))


REFLECTION = torch.diag(torch.tensor([1.0, 1.0, -1.0]))
STRETCHED = 1.001 * torch.eye(3)
ONES = torch.ones(9, 3)
NOT_ROTATIONS = (lambda: sh.rotate(ONES, REFLECTION), lambda: sh.rotate(ONES, STRETCHED))

ALGEBRA = (
    Kernel(
        "sh.basis",
        lambda order, directions: sh.basis(directions, order),
        {"directions": "directions"},
        exact.basis,
        "50 digits",
        budget=4,
        ends=(lambda: sh.basis(torch.eye(3), 0), lambda: sh.check_directions(1.001 * torch.eye(3))),
    ),
    Kernel(
        "sh.evaluate",
        lambda order, light, directions: sh.evaluate(light, directions),
        {"light": "light", "directions": "directions"},
        lambda order, light, directions: exact.basis(order, directions) @ light,
        "the basis in 50 digits",
        linear="light",
        ends=(lambda: sh.evaluate(torch.ones(8, 3), torch.eye(3)),),
    ),
    Kernel(
        "sh.rotate, values",
        lambda order, light, rotation: sh.rotate(light.detach(), rotation.detach()),
        {"light": "light", "rotation": "rotation"},
        _turned_lights,
        "the turned basis projected",
        linear="light",
        loses=frozenset({("rotation", "not quite orthogonal")}),
        ends=NOT_ROTATIONS,
    ),
    Kernel(
        "sh.rotate, with gradients",
        _rotate_by_quadrature,
        {"light": "light", "rotation": "rotation"},
        _turned_lights,
        "the turned basis projected",
        linear="light",
        loses=frozenset({("rotation", "not quite orthogonal")}),
        ends=(lambda: sh.check_rotation(REFLECTION), lambda: sh.check_rotation(STRETCHED)),
    ),
    Kernel(
        "sh.rotation_matrix",
        lambda order, rotation: sh.rotation_matrix(rotation, order),
        {"rotation": "rotation"},
        lambda order, rotation: _turned_functions(order, rotation).mT.mT,
        "the turned basis projected",
        loses=frozenset({("rotation", "not quite orthogonal")}),
        ends=(lambda: sh.rotation_matrix(torch.eye(3), 0),),
    ),
    Kernel(
        "sh.yaw_pitch_roll",
        lambda order, degrees: sh.yaw_pitch_roll(degrees),
        {"degrees": "degrees"},
        orders=(1,),
        loses=frozenset({("degrees", "many turns"), ("degrees", "half turns")}),
        narrow=False,
    ),
    Kernel(
        "sh.clamped_cosine",
        lambda order, directions: sh.clamped_cosine(order, dtype=directions.dtype),
        {"directions": "directions"},
        lambda order, directions: exact.clamped_cosine(order),
        "50 digits",
        budget=1,
    ),
    Kernel(
        "sh.phong",
        lambda order, exponent: sh.phong(exponent, order),
        {"exponent": "exponent"},
        exact.phong,
        "50 digits",
        budget=1,
        narrow=False,
        faint=frozenset({("exponent", "1e6")}),
        ends=(lambda: sh.phong(-1.0, 5),),
    ),
    Kernel(
        "sh.disc",
        lambda order, angle: sh.disc(angle, order),
        {"angle": "angle"},
        exact.disc,
        "200 digits",
        narrow=False,
        ends=(lambda: sh.disc(4.0, 5),),
    ),
    Kernel(
        "sh.zonal",
        lambda order, bands, directions: sh.zonal(bands, directions),
        {"bands": "bands", "directions": "directions"},
        lambda order, bands, directions: exact.basis(order, directions) * bands[sh.bands(order)],
        "the basis in 50 digits",
        budget=4,
    ),
    Kernel(
        "sh.convolve, sh.window",
        lambda order, light, bands: sh.convolve(light, bands),
        {"light": "light", "bands": "bands"},
        budget=1,
        linear="light",
        ends=(lambda: sh.convolve(ONES, torch.ones(4)),),
    ),
    Kernel(
        "sh.product",
        lambda order, light, other: sh.product(light, other),
        {"light": "light", "other": "light"},
        _product_by_quadrature,
        "a finer rule",
        linear="light",
        loses=frozenset({("other", "1e30 bright")}),
    ),
    Kernel(
        "sh.hemisphere_basis",
        lambda order, above: sh.hemisphere_basis(above, order),
        {"above": "above"},
        lambda order, above: exact.hemisphere_basis(order, above),
        "50 digits",
        budget=32,
    ),
    Kernel(
        "sh.hemisphere_projection",
        lambda order, above: sh.hemisphere_projection(order).to(above.dtype),
        {"above": "above"},
        orders=(1, 2, 5, 8),
        narrow=False,
        ends=(lambda: sh.hemisphere_projection(10),),
    ),
    Kernel(
        "sh.to_horizon",
        lambda order, vectors: sh.to_horizon(vectors),
        {"vectors": "vectors"},
        orders=(1,),
        narrow=False,
    ),
    Kernel(
        "sh.project_latlong",
        lambda order, image: sh.project_latlong(image, order),
        {"image": "image"},
        _each_texel,
        "the sum over texels",
        budget=32,
        linear="image",
    ),
    Kernel(
        "sh.project_cube",
        lambda order, cube: sh.project_cube(cube, order),
        {"cube": "cube"},
        _each_texel_of_a_cube,
        "the sum over texels",
        linear="cube",
    ),
    Kernel(
        "sh.least_window",
        lambda order, lit: sh.least_window(lit)[0],
        {"lit": "lit"},
        orders=(1, 3),
        budget=1e4,
        narrow=False,
        ends=(lambda: sh.least_window(-ONES), lambda: sh.least_window(ONES / 0)),
    ),
)

LIGHTS = (
    Kernel(
        "light.project",
        lambda order, image: light.project(image, order),
        {"image": "image"},
        _each_texel,
        "the sum over texels",
        budget=32,
        linear="image",
        ends=(lambda: light.project(-torch.ones(4, 8, 3), 3), lambda: light.project(torch.ones(4, 8, 3) / 0, 3)),
    ),
    Kernel(
        "light.directional",
        lambda order, vectors, colour: light.directional(vectors[:, None], colour, order=order),
        {"vectors": "vectors", "colour": "colour"},
        linear="colour",
        narrow=False,
        ends=(lambda: light.directional((0, 0, 0), order=3),),
    ),
    Kernel(
        "light.disc",
        lambda order, vectors, angle: light.disc(vectors[:, None], angle, 1.0, order),
        {"vectors": "vectors", "angle": "angle"},
        narrow=False,
        ends=(lambda: light.disc((0, 0, 1), 0.0, 1.0, 3),),
    ),
    Kernel(
        "light.dominant",
        lambda order, lit: torch.cat(light.dominant(lit)),
        {"lit": "lit"},
        orders=(2, 5, 8),
        budget=64,
        narrow=False,
    ),
    Kernel(
        "light.latlong_to_cube",
        lambda order, image: light.latlong_to_cube(image, 4),
        {"image": "image"},
        orders=(1,),
        budget=64,
        linear="image",
        narrow=False,
    ),
    Kernel(
        "light.cube_to_latlong",
        lambda order, cube: light.cube_to_latlong(cube, 4),
        {"cube": "cube"},
        orders=(1,),
        budget=64,
        linear="cube",
        narrow=False,
    ),
)


def _reflectance(name: str, model: brdf.Brdf, budget: float) -> Kernel:
    """Every pair of directions."""
    return Kernel(
        f"brdf {name}",
        lambda order, facing: model(facing[:, None], facing[None]),
        {"facing": "facing"},
        orders=(1,),
        budget=budget,
        narrow=False,
    )


# A power k turns an epsilon of the cosine into k, a roughness a turns one of a slope into 1 / a^2.
REFLECTANCE = (
    _reflectance("phong:1", brdf.Phong(1.0), 8),
    _reflectance("phong:100", brdf.Phong(100.0), 400),
    _reflectance("phong:1e4", brdf.Phong(1e4), 4e4),
    _reflectance("blinn:1e4", brdf.BlinnPhong(1e4), 4e4),
    _reflectance("ggx:0.3,0.04", brdf.GGX(0.3, 0.04), 64),
    _reflectance("ggx:0.01", brdf.GGX(0.01), 4e4),
    _reflectance("ward:0.1,0.4", brdf.Ward(0.1, 0.4), 400),
    _reflectance(
        "a table", brdf.Tabulated(torch.rand(6, 6, 9, generator=torch.Generator().manual_seed(0)).double() + 0.1), 64
    ),
)

REST, FACES = bumpy(3)
UV = REST[:, [0, 2]]
# Poses that leave no digits, or no surface, to turn by.
FLAT = frozenset(("positions", name) for name in ("1e4 away", "a needle", "on one line", "in one point", "folded over"))

POSES = (
    Kernel(
        "pose.deformed_frames",
        lambda order, positions: pose.deformed_frames(REST.to(positions), FACES, positions),
        {"positions": "pose"},
        orders=(1,),
        budget=64,
        loses=FLAT,
        narrow=False,
    ),
    Kernel(
        "pose.surface_frames",
        lambda order, positions: pose.surface_frames(positions, FACES, UV.to(positions)),
        {"positions": "pose"},
        orders=(1,),
        budget=64,
        loses=FLAT,
        narrow=False,
    ),
    Kernel(
        "pose.nearest_rotation",
        lambda order, rotation: pose.nearest_rotation(rotation * 1.01),
        {"rotation": "rotation"},
        orders=(1,),
        budget=64,
        narrow=False,
    ),
)


def _tone(name: str, curve: Callable[[Tensor], Tensor]) -> Kernel:
    return Kernel(
        f"shade.{name}",
        lambda order, colour: curve(colour),
        {"colour": "colour"},
        orders=(1,),
        budget=64,
        faint=frozenset({("colour", "one channel 1e6")}),
        narrow=False,
    )


TONES = tuple(_tone(curve.__name__, curve) for curve in (neutral, agx, filmic, srgb))

TRANSFERS = every_shader.every_transfer()
CHOICES = {"reflectance": {"exponent": 20.0}}


@functools.cache
def _module(name: str, dtype: torch.dtype) -> torch.nn.Module:
    transfer = TRANSFERS[name]
    more = {key: value for need, one in CHOICES.items() if need in transfer.needs for key, value in one.items()}
    return shader(transfer, dtype=dtype, **more)


def _shader(name: str) -> Kernel:
    needs = TRANSFERS[name].needs
    takes = {"light": "light", "rotation": "rotation"}
    takes |= {"view": "view"} if "eye" in needs else {}
    takes |= {"frames": "frames"} if "pose" in needs else {}
    return Kernel(
        f"shade {name}",
        lambda order, light, rotation, **more: _module(name, light.dtype)(light, rotation, **more),
        takes,
        orders=(every_shader.ORDER,),
        budget=64,
        linear="light",
        loses=frozenset({("rotation", "not quite orthogonal"), ("frames", "not quite orthogonal")}),
    )


# Each layer with each signal once; numbers of channels in turn.
SHADERS = tuple(_shader(name) for i, name in enumerate(TRANSFERS) if (i % 2 == 0) == name.endswith("1"))

KERNELS = (*ALGEBRA, *LIGHTS, *REFLECTANCE, *POSES, *TONES, *SHADERS)
