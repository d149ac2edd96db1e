"""A mesh, its material, and what it does in a scene."""

from dataclasses import dataclass, field

from jaxtyping import Float32
from torch import Tensor

from torchprt.errors import InputError

from .material import Material, differs
from .mesh import Mesh


@dataclass(frozen=True, eq=False)
class Object:
    """A mesh with a material and a role.

    A "receiver" records, blocks and reflects light; a "blocker" is black and only blocks it.

    Raises InputError if the role is not known or if the material does not fit the mesh.
    """

    mesh: Mesh
    material: Material = field(default_factory=Material)
    role: str = "receiver"

    def __post_init__(self) -> None:
        if self.role not in ("receiver", "blocker"):
            raise InputError(f'role {self.role!r} is not known: give "receiver" or "blocker"')
        if self.receives:
            self.material.albedo_of(self.mesh)

    @property
    def receives(self) -> bool:
        return self.role == "receiver"

    @property
    def albedo(self) -> Float32[Tensor, "V C"]:
        """Albedo of every vertex, C = 1 or 3."""
        return self.material.albedo_of(self.mesh)

    @property
    def coloured(self) -> bool:
        """Whether light that it reflects changes colour."""
        return self.receives and differs(self.albedo)
