"""What a surface does with light: diffuse reflectance for now."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32
from torch import Tensor

from torchprt.errors import InputError

from .mesh import Mesh

Albedo = float | int | Sequence[float] | Float[Tensor, "..."] | str
"""One number, three numbers (linear RGB), a tensor [V, 1] or [V, 3], or "vertex" for the colours of the mesh."""


@dataclass(frozen=True, eq=False)
class Material:
    """A diffuse surface.

    `albedo` is the share of light that is reflected, in [0, 1]: one number, three numbers (linear RGB),
    a tensor with a row for every vertex ([V, 1] or [V, 3]), or "vertex" for the colours of the mesh.
    A `two_sided` surface receives and reflects light on both of its sides, each by itself (a leaf, a sheet of paper).

    Raises InputError if an albedo is outside [0, 1], not a number, or of another shape.
    """

    albedo: Albedo = 0.5
    two_sided: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.albedo, str):
            if self.albedo != "vertex":
                raise InputError(
                    f'albedo {self.albedo!r} is not known: give numbers, or "vertex" for the colours of the mesh'
                )
            return
        check_albedo(table(self.albedo), "albedo")

    @property
    def coloured(self) -> bool:
        """Whether the channels differ; "vertex" counts as coloured until an `Object` has met the mesh."""
        return isinstance(self.albedo, str) or differs(table(self.albedo))

    def albedo_of(self, mesh: Mesh) -> Float32[Tensor, "V C"]:
        """Albedo of every vertex of `mesh`, C = 1 or 3.

        Raises InputError, naming the mesh, if it has no colours or another number of vertices.
        """
        vertices = len(mesh.positions)
        if isinstance(self.albedo, str):
            if mesh.colours is None:
                raise InputError(f'{mesh.name} has no vertex colours for albedo "vertex": give the albedo as numbers')
            check_albedo(mesh.colours, f"{mesh.name} as albedo")
            return mesh.colours
        return rows(table(self.albedo), vertices, mesh.name)


def table(albedo: float | int | Sequence[float] | Float[Tensor, "..."]) -> Float32[Tensor, "rows C"]:
    """Albedo as a float32 tensor [1, 1], [1, 3], [V, 1] or [V, 3], whatever it was given as."""
    try:
        values = torch.as_tensor(albedo).detach().to("cpu", torch.float32)
    except (TypeError, ValueError, RuntimeError) as fault:
        raise InputError("albedo is not made of numbers: give one, three, or a tensor [V, 1] or [V, 3]") from fault
    if values.ndim < 2:
        values = values.reshape(1, -1)
    if values.ndim != 2 or values.shape[1] not in (1, 3) or not len(values):
        raise InputError(f"albedo has shape {list(values.shape)}: give one number, three, or a tensor [V, 1] or [V, 3]")
    return values


def check_albedo(values: Float[Tensor, "rows C"], name: str) -> None:
    """Raises InputError if anything in `values` is not a number in [0, 1]."""
    # Written so that NaN is refused too.
    if not bool(((values >= 0) & (values <= 1)).all()):
        low, high = float(values.min()), float(values.max())
        raise InputError(f"{name} ranges from {low:g} to {high:g}: give values in [0, 1]")


def rows(values: Float32[Tensor, "rows C"], count: int, name: str) -> Float32[Tensor, "V C"]:
    """`values` with a row for each of `count` receivers."""
    if len(values) not in (1, count):
        raise InputError(f"albedo has {len(values)} rows for the {count} vertices of {name}: give one, or one a vertex")
    return values.expand(count, -1)


def differs(values: Float[Tensor, "rows C"]) -> bool:
    """Whether any row has channels that differ from each other."""
    return bool((values != values[:, :1]).any())
