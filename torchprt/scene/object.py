"""A mesh, its material, and what it does in a scene."""

import warnings
from dataclasses import dataclass, field
from typing import Literal

from jaxtyping import Bool, Float32, Int64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.words import count

from .material import Material, differs
from .mesh import Mesh

ROLES = ("receiver", "blocker", "ground")
FAR = 8
"""Edges so many times the mean free path are warned of."""


class SubsurfaceWarning(UserWarning):
    """A mesh that light cannot diffuse in as its medium has it."""


class TangentWarning(UserWarning):
    """A surface whose streaks have a direction that nothing in its mesh says."""


@dataclass(frozen=True, eq=False)
class Object:
    """A mesh with a material and a role.

    A "receiver" records, blocks and reflects light; a "blocker" is black and only blocks it. A "ground" is a receiver
    that pictures are not about: they frame what stands on it. Whatever the role, a material that is a mirror records
    nothing: light that meets it goes on.

    Warns (`SubsurfaceWarning`), with the numbers, if there is a medium below the surface and the mesh is open or its
    edges are far longer than the mean free path, so that it is shaded as a plain diffuse surface.
    Warns (`TangentWarning`) if the gloss is anisotropic and the mesh has neither texture coordinates nor tangents.
    Raises InputError if the role is not known or if the material does not fit the mesh.
    """

    mesh: Mesh
    material: Material = field(default_factory=Material)
    role: str = "receiver"

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise InputError(f'role {self.role!r} is not known: give "receiver", "blocker" or "ground"')
        if self.material.mirror is not None and self.role == "blocker":
            raise InputError(f"{self.mesh.name} is a mirror and a blocker, which reflects nothing: give one of the two")
        if self.receives:
            self.material.albedo_of(self.mesh)
            self.material.specular_of(self.mesh)
            self.material.two_sided_of(self.mesh)
            self.material.gloss_of(self.mesh)
            self.material.check_energy(self.mesh)
        self._check_body()
        brdf = next((each for each in self.material.glosses if not each.isotropic), None)
        if self.glossy and brdf is not None and self.mesh.tangents is None:
            warnings.warn(
                f"{self.mesh.name} has an anisotropic gloss ({brdf.spec}) and no texture coordinates: its tangents are "
                "a smooth field, guided by the x axis (another where the surface mostly faces along x); on a bumpy "
                "surface it has points that it turns about, and streaks look like hide there: texture coordinates, "
                "or tangents in the file, say which way they run",
                TangentWarning,
                stacklevel=3,
            )

    def _check_body(self) -> None:
        medium, mesh = self.material.medium, self.mesh
        if medium is None or not self.receives or self.material.millimetres is None or not len(mesh.faces):
            return
        if mesh.report.boundary_edges or mesh.report.inside_out:
            fault = "is inside out" if mesh.report.inside_out else "is open"
            warnings.warn(
                f"{mesh.name} {fault} ({count(mesh.report.boundary_edges, 'edge')} with one face), and light diffuses "
                f"in a body: {medium.text} is taken to lie behind its surface all the same",
                SubsurfaceWarning,
                stacklevel=4,
            )
        edge, path = self.median_edge * self.material.millimetres, float(medium.mean_free_path.max())
        if edge > FAR * path:
            warnings.warn(
                f"{mesh.name} has edges of {edge:.3g} mm (median), {edge / path:.0f} times the mean free path of "
                f"{medium.text}, {path:.2g} mm: it will look as a plain diffuse surface that reflects "
                f"{', '.join(f'{share:.2f}' for share in medium.reflectance.tolist())} of what enters; check "
                "millimetres, or use a finer mesh",
                SubsurfaceWarning,
                stacklevel=4,
            )

    @property
    def median_edge(self) -> float:
        """Of the sides of its faces, in its units."""
        corners = self.mesh.positions[self.mesh.faces]
        return float((corners - corners.roll(1, 1)).norm(dim=-1).median())

    @property
    def receives(self) -> bool:
        """Whether it records; blockers and mirrors do not."""
        return self.role != "blocker" and self.material.mirror is None

    @property
    def albedo(self) -> Float32[Tensor, "V C"]:
        """Albedo of every vertex, C = 1 or 3."""
        return self.material.albedo_of(self.mesh)

    @property
    def specular(self) -> Float32[Tensor, "V C"]:
        """Weight of the gloss at every vertex, C = 1 or 3; zero without a gloss."""
        return self.material.specular_of(self.mesh)

    @property
    def gloss_of_vertex(self) -> Int64[Tensor, "V"]:
        """Which of the glosses of its material lies on every vertex, -1 for none."""
        return self.material.gloss_of(self.mesh)

    @property
    def two_sided(self) -> Bool[Tensor, "V"]:
        """Which vertices record on their reverse as well."""
        return self.material.two_sided_of(self.mesh)

    @property
    def glossy(self) -> bool:
        """Whether it records glossy transfer."""
        return self.receives and self.material.gloss is not None

    @property
    def tangent_field(self) -> Literal["", "uv", "smooth"]:
        """Where its tangents come from: texture coordinates or tangents of the mesh ("uv"), or a smooth field.

        Empty if it needs none.
        """
        if not self.glossy:
            return ""
        return "smooth" if self.mesh.tangents is None else "uv"

    @property
    def coloured(self) -> bool:
        """Whether light that it reflects changes colour."""
        if self.material.reflectance is not None:
            return differs(self.material.reflectance)
        return self.receives and (self.material.medium is not None or differs(self.albedo) or differs(self.specular))
