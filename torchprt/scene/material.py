"""What a surface does with light: its body reflects diffusely, a gloss may lie on it, light may pass through it."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor

from torchprt.brdf import Brdf, parse
from torchprt.errors import InputError

from .detail import Detail
from .energy import check_balance
from .glosses import Glosses
from .mesh import Mesh
from .subsurface import Subsurface, read_subsurface

Albedo = float | int | Sequence[float] | Float[Tensor, "..."] | str
"""One number, three numbers (linear RGB), a tensor [V, 1] or [V, 3], or "vertex" for the colours of the mesh."""


@dataclass(frozen=True, eq=False)
class Material:
    """A diffuse surface, a glossy one, or both; a thin translucent sheet.

    `albedo` is the share of light that is reflected diffusely, in [0, 1]: one number, three numbers (linear RGB),
    a tensor with a row for every vertex ([V, 1] or [V, 3]), or "vertex" for the colours of the mesh. If it is not
    given it is .5, and 0 under a gloss.
    A `two_sided` surface receives and reflects light on both of its sides, each by itself (a leaf, a sheet of paper);
    a tensor [V] says of every vertex whether it is.
    `gloss` is a BRDF that is added to the diffuse part, or its text, "ggx:0.3,0.04" (see `torchprt.brdf.parse`), and
    `specular` its weight in [0, 1], given as `albedo` is, but for "vertex"; `Glosses` are a different one at different
    vertices.
    `translucency`, in [0, 1], is the share of the irradiance of the other side that comes through, times the albedo:
    exit radiance is albedo / pi (E + translucency E_other). Such a surface is two-sided. Source: Sloan, Luna and
    Snyder 2005, section 5.3 (thin membranes).
    `mirror` is the share of light, one number or three in [0, 1], that a polished metal reflects along its normal; at
    grazing angles it rises to 1. Nothing is recorded on a mirror, light goes on from both of its sides; it has neither
    albedo nor gloss. Source: Sloan, Kautz and Snyder 2002, section 5.

    `subsurface` is a medium below the surface, or its text as `read_subsurface` takes it ("marble", "skin1"): light
    that arrives diffuses in the body and leaves it elsewhere. `millimetres` says how many of them a unit of the mesh
    is: 1000 for glTF, which is in metres; nothing is assumed. The albedo is then a tint of what leaves, 1 by default; a
    gloss may lie over it. Source: Jensen, Marschner, Levoy and Hanrahan 2001; Sloan, Hall, Hart and Snyder 2003, 3.1.

    Warns (`EnergyWarning`) if more light leaves toward some directions than arrives from a uniform light.
    Raises InputError if a number is outside [0, 1], not a number, or of another shape, if the gloss is not known or
    creates energy, if all parts together do (`vertex` albedo: when the `Object` is made), or if specular is given
    without a gloss. `notes` are sentences on where it comes from, for reports.
    """

    albedo: Albedo | None = None
    two_sided: bool | Bool[Tensor, "V"] = False
    gloss: Brdf | Glosses | str | None = None
    specular: Albedo = 1.0
    translucency: float | int = 0.0
    mirror: float | int | Sequence[float] | Float[Tensor, "C"] | None = None
    subsurface: Subsurface | str | None = None
    millimetres: float | int | None = None
    notes: tuple[str, ...] = ()
    detail: Detail | None = None
    """What the pictures of a file say of it between vertices; see `file_material`."""

    def __post_init__(self) -> None:
        if isinstance(self.gloss, str):
            object.__setattr__(self, "gloss", parse(self.gloss))
        if self.mirror is not None:
            self._check_mirror()
        self._check_subsurface()
        if self.albedo is None:
            plain = self.gloss is None and self.mirror is None
            object.__setattr__(self, "albedo", 1.0 if self.medium is not None else 0.5 if plain else 0.0)
        # Written so that NaN is refused too.
        if not 0 <= self.translucency <= 1:
            raise InputError(f"translucency is {self.translucency:g}: give a value in [0, 1]")
        if self.translucency:
            object.__setattr__(self, "two_sided", True)
        if isinstance(self.specular, str):
            raise InputError(f"specular {self.specular!r} is not known: give numbers in [0, 1]")
        weight = table(self.specular, "specular")
        check_albedo(weight, "specular")
        if self.gloss is None and not bool((weight == 1).all()):
            raise InputError('specular is given without gloss: give a gloss too, as "ggx:0.3,0.04"')
        if isinstance(self.albedo, str):
            if self.albedo == "file":
                raise InputError('albedo "file" is what a mesh file says: give it to load, or use read_surface')
            if self.albedo != "vertex":
                raise InputError(
                    f'albedo {self.albedo!r} is not known: give numbers, or "vertex" for the colours of the mesh'
                )
            if self.gloss is not None:
                self._check_balance(torch.zeros(1, 1), "albedo")
            return
        body = table(_numbers(self.albedo))
        check_albedo(body, "albedo")
        self._check_balance(body, "albedo")

    def _check_mirror(self) -> None:
        reflectance = table(_numbers(self.mirror), "mirror")
        check_albedo(reflectance, "mirror")
        if len(reflectance) > 1:
            raise InputError(f"mirror has {len(reflectance)} rows: give one number or three for the whole mirror")
        zero = self.albedo is None or (not isinstance(self.albedo, str) and not bool(table(self.albedo).any()))
        if self.gloss is not None or self.translucency or not zero:
            raise InputError("a mirror has neither albedo, gloss nor translucency: leave them out, or the mirror")

    def _check_subsurface(self) -> None:
        if isinstance(self.subsurface, str):
            object.__setattr__(self, "subsurface", read_subsurface(self.subsurface))
        if self.medium is None:
            if self.millimetres is not None:
                raise InputError(
                    "millimetres is given without subsurface, which alone needs it: give a medium too, as marble"
                )
            return
        if self.millimetres is None:
            raise InputError(
                f"subsurface {self.medium.text} has lengths in mm, and nothing says how large the mesh is: give "
                "millimetres, how many of them a unit of the mesh is, 1000 for glTF, which is in metres, or 100 for a "
                f"head that is 2 units tall and is to be 200 mm; as text, {self.medium.text}@100"
            )
        # Written so that NaN is refused too.
        if not 0 < self.millimetres < float("inf"):
            raise InputError(f"millimetres is {self.millimetres:g}: give a number above 0")
        if self.mirror is not None or self.translucency or self.two_sided is not False:
            raise InputError(
                "subsurface is for a body with an inside: leave mirror, translucency (which is for thin sheets) and "
                "two_sided out"
            )

    @property
    def medium(self) -> Subsurface | None:
        """The medium below its surface; None without one."""
        # Text has become a medium when the material was made.
        return None if isinstance(self.subsurface, str) else self.subsurface

    @property
    def reflectance(self) -> Float32[Tensor, "1 C"] | None:
        """What a mirror reflects along its normal, C = 1 or 3; None if it is none."""
        return None if self.mirror is None else table(self.mirror, "mirror")

    @property
    def glosses(self) -> tuple[Brdf, ...]:
        """The glosses that lie on it, none or one or several."""
        if isinstance(self.gloss, Glosses):
            return self.gloss.models
        # Text has become a model when the material was made.
        return () if self.gloss is None or isinstance(self.gloss, str) else (self.gloss,)

    @property
    def brdf(self) -> Brdf | None:
        """The gloss; None without one, or if there are several."""
        return self.glosses[0] if len(self.glosses) == 1 else None

    def gloss_of(self, mesh: Mesh) -> Int64[Tensor, "V"]:
        """Which of `glosses` lies on every vertex of `mesh`, -1 for none.

        Raises InputError, naming the mesh, if there are several and it has another number of vertices.
        """
        vertices = len(mesh.positions)
        if not isinstance(self.gloss, Glosses):
            return torch.full((vertices,), -1 if self.gloss is None else 0)
        return _fitting(self.gloss.of_vertex, vertices, mesh.name, "gloss")

    def two_sided_of(self, mesh: Mesh) -> Bool[Tensor, "V"]:
        """Whether every vertex of `mesh` has two sides.

        Raises InputError, naming the mesh, if it has another number of vertices.
        """
        vertices = len(mesh.positions)
        if not isinstance(self.two_sided, Tensor):
            return torch.full((vertices,), bool(self.two_sided))
        return _fitting(self.two_sided, vertices, mesh.name, "two_sided")

    @property
    def coloured(self) -> bool:
        """Whether the channels of albedo or specular differ.

        "vertex" counts as coloured until an `Object` has met the mesh.
        """
        if self.medium is not None:
            return True
        if self.gloss is not None and differs(table(_numbers(self.specular), "specular")):
            return True
        return isinstance(self.albedo, str) or differs(table(_numbers(self.albedo)))

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
        return rows(table(_numbers(self.albedo)), vertices, mesh.name)

    def specular_of(self, mesh: Mesh) -> Float32[Tensor, "V C"]:
        """Weight of the gloss at every vertex of `mesh`, C = 1 or 3; zero without a gloss.

        Raises InputError, naming the mesh, if it has another number of vertices.
        """
        if self.gloss is None:
            return torch.zeros(1, 1).expand(len(mesh.positions), 1)
        return rows(table(_numbers(self.specular), "specular"), len(mesh.positions), mesh.name, "specular")

    def check_energy(self, mesh: Mesh) -> None:
        """Checks the energy where the albedo is known only with the mesh, as the material does with numbers."""
        if isinstance(self.albedo, str):
            self._check_balance(self.albedo_of(mesh), f"{mesh.name} with an albedo")

    def _check_balance(self, albedo: Float32[Tensor, "rows C"], name: str) -> None:
        weight = table(_numbers(self.specular), "specular")
        if self.medium is not None:
            leaving = self.medium.entering * self.medium.reflectance.float()
            albedo = albedo * (leaving if albedo.shape[1] == 3 else leaving.max())
        if isinstance(self.gloss, Glosses):
            label = self.gloss.of_vertex
            for number, brdf in enumerate(self.gloss.models):
                here = label == number
                if bool(here.any()):
                    check_balance(_at(albedo, here), _at(weight, here), brdf, float(self.translucency), name)
        elif self.gloss is not None or self.translucency:
            check_balance(albedo, weight, self.brdf, float(self.translucency), name)


def _at(rows: Float32[Tensor, "rows C"], here: Bool[Tensor, "V"]) -> Float32[Tensor, "some C"]:
    """The rows of some vertices; one row is that of all, and one that does not fit is refused with the mesh."""
    return rows[here] if len(rows) == len(here) else rows


def _fitting(values: Tensor, vertices: int, name: str, what: str) -> Tensor:
    if values.shape != (vertices,):
        raise InputError(f"{what} has shape {list(values.shape)} for the {vertices} vertices of {name}: give one each")
    return values


Numbers = float | int | Sequence[float] | Float[Tensor, "..."]


def _numbers(values: Albedo | None) -> Numbers:
    if values is None or isinstance(values, str):
        raise TypeError(f"{values!r} is not made of numbers")
    return values


def table(albedo: Numbers, name: str = "albedo") -> Float32[Tensor, "rows C"]:
    """Albedo as a float32 tensor [1, 1], [1, 3], [V, 1] or [V, 3], whatever it was given as."""
    try:
        values = torch.as_tensor(albedo).detach().to("cpu", torch.float32)
    except (TypeError, ValueError, RuntimeError) as fault:
        raise InputError(f"{name} is not made of numbers: give one, three, or a tensor [V, 1] or [V, 3]") from fault
    if values.ndim < 2:
        values = values.reshape(1, -1)
    if values.ndim != 2 or values.shape[1] not in (1, 3) or not len(values):
        raise InputError(f"{name} has shape {list(values.shape)}: give one number, three, or a tensor [V, 1] or [V, 3]")
    return values


def check_albedo(values: Float[Tensor, "rows C"], name: str) -> None:
    """Raises InputError if anything in `values` is not a number in [0, 1]."""
    # Written so that NaN is refused too.
    if not bool(((values >= 0) & (values <= 1)).all()):
        low, high = float(values.min()), float(values.max())
        raise InputError(f"{name} ranges from {low:g} to {high:g}: give values in [0, 1]")


def rows(values: Float32[Tensor, "rows C"], count: int, name: str, what: str = "albedo") -> Float32[Tensor, "V C"]:
    """`values` with a row for each of `count` receivers."""
    if len(values) not in (1, count):
        raise InputError(f"{what} has {len(values)} rows for the {count} vertices of {name}: give one, or one a vertex")
    return values.expand(count, -1)


def differs(values: Float[Tensor, "rows C"]) -> bool:
    """Whether any row has channels that differ from each other."""
    return bool((values != values[:, :1]).any())
