"""Where transfer is recorded, and how its radiance gets back to what is drawn."""

from __future__ import annotations

import abc
import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layout import REAL, WHOLE, Layout, Part, check_indices

if TYPE_CHECKING:
    from torchprt.transfer.atlas import Atlas
    from torchprt.transfer.cells import Cells
    from torchprt.transfer.grid import Grid

R = TypeVar("R", bound="Receivers")


@dataclass(kw_only=True, repr=False)
class Receivers(Part, abc.ABC):
    """V receivers: `positions [V, 3]`, unit `normals [V, 3]` (zero where there is none), `faces [F, 3]` to draw."""

    family: ClassVar[dict[str, type[Any]]] = {}
    # Whether they are on something that can turn, and transfer with it.
    on_surface: ClassVar[bool] = True

    positions: Any
    normals: Any
    faces: Any

    @property
    def count(self) -> int:
        """Number of receivers V."""
        return len(self.positions)

    def in_mesh_order(self, values: Float[Tensor, "*B V D"]) -> Float[Tensor, "*B V D"]:
        """Values of the receivers in the order that they have in what was baked."""
        return values

    @property
    def surface(self) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"], Int[Tensor, "F 3"]]:
        """What is drawn: positions, normals and faces. `at` says what is seen on it."""
        return self.positions, self.normals, self.faces

    @property
    def surface_uv(self) -> Float[Tensor, "F 3 2"] | None:
        """Where the corners of faces of `surface` are on the map of the receivers; None if they are its
        vertices, and what they have is what these have."""
        return None

    def at(
        self, values: Float[Tensor, "*B V D"], face: Int[Tensor, "E"], weights: Float[Tensor, "E 3"]
    ) -> Float[Tensor, "*B E D"]:
        """Values of the receivers at points of the faces of `surface`, with the weights of their three corners."""
        corners = self.faces.long()[face.long()]
        parts = (values[..., corners[:, k], :] * weights[:, k, None].to(values.dtype) for k in range(3))
        return sum(parts, values.new_zeros(()))

    def parts(self) -> Sequence[dict[str, Any]]:
        """What they are of, with its `name` and `role`; empty if nothing is known of it."""
        return ()

    def of_objects(self, names: Sequence[str]) -> Bool[Tensor, "V"]:
        """Which of them are of the objects whose meshes have these names."""
        return torch.zeros(self.count, dtype=torch.bool, device=self.positions.device)

    def take(self: R, index: Int[Tensor, "v"]) -> R:
        """Those that `index` names, each once and ascending, and what is drawn of them."""
        raise InputError("receivers of this kind are not of objects that could be taken apart: use them as a whole")

    def ground(self) -> Bool[Tensor, "V"]:
        """Which of them are of a ground: pictures are about the others."""
        return torch.zeros(self.count, dtype=torch.bool, device=self.positions.device)

    def surface_ground(self) -> Bool[Tensor, "P"]:
        """Which vertices of `surface` are of a ground."""
        return self.ground()

    @property
    def subject(self) -> Float[Tensor, "v 3"]:
        """The places that pictures are about and frame: all of `surface` but the ground, or that alone."""
        model, positions = ~self.surface_ground(), self.surface[0]
        return positions[model] if bool(model.any()) else positions

    def sampled(self) -> tuple[Float[Tensor, "S 3"], Float[Tensor, "V K"]]:
        """The sample points of their light and its blend at each; InputError, which says how to get them, if none."""
        raise InputError(
            "the transfer has no sample points: bake it with --sample-points, or make them with "
            "light.with_sample_points"
        )

    @property
    def mirrors(self) -> tuple[Tensor, Tensor, Tensor, Tensor] | None:
        """What is drawn beside them and records nothing: positions, normals and reflectance of the vertices of mirrors,
        and their faces; None if there are none."""
        return None

    def as_texels(self) -> Texels:
        """These, if they are the texels of a patch; InputError if not."""
        raise InputError(
            "the transfer is recorded at vertices, not at the texels of a patch: bake one, as bake_patch does"
        )

    def as_atlas(self) -> Atlas:
        """These, if they are the texels of surfaces; InputError if not."""
        raise InputError("the transfer is not recorded at the texels of a map: bake it with --texels 512, say")

    def as_grid(self) -> Grid:
        """These, if they are the nodes of a grid around an object; InputError if not."""
        raise InputError(
            "the transfer is recorded on a surface, not around an object: bake one, as bake_neighbourhood does"
        )

    def as_cells(self) -> Cells:
        """These, if they are the cells of a volume; InputError if not."""
        raise InputError("the transfer is not recorded in a volume: bake one, as bake_volume does")


class Sight(enum.IntEnum):
    """How a receiver came to its transfer: what lightmap bakers call validity."""

    VALID = 0
    """By its own rays, as any."""
    TURNED = 1
    """By its own rays about another normal: its faces cancel or oppose each other, and it looks along others."""
    MOVED = 2
    """By its own rays from another origin, in front of all of its faces: its own surface covered it."""
    FILLED = 3
    """From its neighbours along the surface: it lies under its own surface or in a solid, and its rays say nothing."""
    BLIND = 4
    """Not at all: as those that are filled, but no neighbour sees either."""


def called(object: str, name: str) -> bool:
    """Whether an object goes by a name: that of its mesh, or of the file without its folder."""
    return name in (object, Path(object).name)


MIRROR = ("mirror_positions", "mirror_normals", "mirror_reflectance", "mirror_faces")


@dataclass(kw_only=True, repr=False)
class Vertices(Receivers):
    """Vertices of meshes one after the other, or loose points, in the world frame.

    - `positions [V, 3]`, `normals [V, 3]`, `faces [F, 3]`: what to draw; `faces` is empty for loose points. Two-sided
      objects record twice: the receivers of all first sides come first, then the reverse sides.
    - `original [V]`: which vertex of the mesh every one was, if `compression.reorder` put them in another order; else
      None.
    - `sight [V]`: how each came to its transfer, a number of `Sight`, uint8; None if all are valid or nobody looked.
    - `sample_points [S, 3]`, `blend [V, S]`: where the light about them is captured, and what the light of every point
      counts at every receiver: weights of 0 or more that sum to 1. Or `blend [V, 4 S]`: behind the weight of a point
      those of the derivatives of its light along x, y and z. Both or none; see `light.with_sample_points`.
    - `mirror_positions`, `mirror_normals`, `mirror_reflectance [P, 3]`, `mirror_faces [T, 3]`: the mirrors of the
      scene, which record nothing, to be drawn; None without.
    - `objects`: what they are of, one after the other, as a dictionary each: `name` of the mesh, `role` ("receiver" or
      "ground"), `side` ("front" or "back") and its `rows`, [first, one past the last], in the order of the mesh. Empty
      if nothing is known of it.
    """

    kind: ClassVar[str] = "vertices"
    layouts: ClassVar[dict[str, Layout]] = {
        "positions": Layout(("V", "3"), REAL),
        "normals": Layout(("V", "3"), REAL),
        "faces": Layout(("F", "3"), WHOLE),
        "original": Layout(("V",), WHOLE, optional=True),
        "sight": Layout(("V",), (torch.uint8,), optional=True),
        "sample_points": Layout(("S", "3"), REAL, optional=True),
        "blend": Layout(("V", "K"), REAL, optional=True),
        "mirror_positions": Layout(("P", "3"), REAL, optional=True),
        "mirror_normals": Layout(("P", "3"), REAL, optional=True),
        "mirror_reflectance": Layout(("P", "3"), REAL, optional=True),
        "mirror_faces": Layout(("T", "3"), WHOLE, optional=True),
    }

    positions: Tensor
    normals: Tensor
    faces: Tensor
    original: Tensor | None = None
    sight: Tensor | None = None
    sample_points: Tensor | None = None
    blend: Tensor | None = None
    mirror_positions: Tensor | None = None
    mirror_normals: Tensor | None = None
    mirror_reflectance: Tensor | None = None
    mirror_faces: Tensor | None = None
    objects: Sequence[dict[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len({getattr(self, name) is None for name in MIRROR}) > 1:
            raise InputError(f"mirrors of the transfer lack some of {', '.join(MIRROR)}: give all or none")

    @property
    def mirrors(self) -> tuple[Tensor, Tensor, Tensor, Tensor] | None:
        found = [getattr(self, name) for name in MIRROR]
        return None if found[0] is None else (found[0], found[1], found[2], found[3])

    def metadata(self) -> dict[str, Any]:
        return {"objects": list(self.objects)} if self.objects else {}

    def ground(self) -> Bool[Tensor, "V"]:
        return self._where(lambda each: each["role"] == "ground")

    def parts(self) -> Sequence[dict[str, Any]]:
        return self.objects

    def of_objects(self, names: Sequence[str]) -> Bool[Tensor, "V"]:
        return self._where(lambda each: any(called(each["name"], name) for name in names))

    def _where(self, wanted: Callable[[dict[str, Any]], bool]) -> Bool[Tensor, "V"]:
        found = torch.zeros(self.count, dtype=torch.bool, device=self.positions.device)
        for each in self.objects:
            if wanted(each):
                found[slice(*each["rows"])] = True
        return found if self.original is None else found[self.original.long()]

    def take(self, index: Int[Tensor, "v"]) -> Vertices:
        place = torch.full((self.count,), -1, device=index.device)
        place[index] = torch.arange(len(index), device=index.device)
        corners = place[self.faces.long()]
        taken = {
            name: getattr(self, name)[index]
            for name, layout in self.layouts.items()
            if layout.shape[0] == "V" and getattr(self, name) is not None
        }
        kept = torch.zeros(self.count, dtype=torch.long, device=index.device)
        kept[index if self.original is None else self.original[index].long()] = 1
        before = [0, *kept.cumsum(0).tolist()]
        if self.original is not None:
            taken["original"] = taken["original"].argsort().argsort().to(self.original.dtype)
        objects = [{**each, "rows": [before[row] for row in each["rows"]]} for each in self.objects]
        return self.replace(
            **taken,
            faces=corners[(corners >= 0).all(-1)].to(self.faces.dtype),
            objects=[each for each in objects if each["rows"][0] < each["rows"][1]],
        )

    def in_mesh_order(self, values: Float[Tensor, "*B V D"]) -> Float[Tensor, "*B V D"]:
        return values if self.original is None else values[..., self.original.argsort(), :]

    def check(self, of: str = "") -> None:
        """InputError if a tensor holds NaN or infinity, or an index names no vertex."""
        super().check(of)
        check_indices("faces", self.faces, self.count)
        if self.mirrors is not None:
            check_indices("mirror_faces", self.mirrors[3], len(self.mirrors[0]))
        for each in self.objects:
            if not {"name", "role", "side", "rows"} <= each.keys() or not 0 <= each["rows"][0] <= each["rows"][1]:
                raise InputError(f"objects of the transfer hold {each}, which names no rows: bake it again")
            if each["rows"][1] > self.count:
                raise InputError(f"objects of the transfer name receiver {each['rows'][1]} of {self.count}: bake again")
        if self.sight is not None and bool((self.sight > max(Sight)).any()):
            raise InputError(f"sight of the transfer has numbers above {max(Sight):d}: a newer torchprt wrote it")
        self._check_blend()
        order = self.original
        if order is not None and not torch.equal(order.sort().values.long(), torch.arange(len(order)).to(order.device)):
            raise InputError("original of the transfer does not name every vertex once: compress it again")

    def sampled(self) -> tuple[Float[Tensor, "S 3"], Float[Tensor, "V K"]]:
        if self.sample_points is None or self.blend is None:
            return super().sampled()
        return self.sample_points, self.blend

    def _check_blend(self) -> None:
        if (self.sample_points is None) != (self.blend is None):
            raise InputError("the transfer has sample_points or blend without the other: give both or none")
        if self.sample_points is None or self.blend is None:
            return
        points, columns = len(self.sample_points), self.blend.shape[1]
        if points == 0 or columns not in (points, 4 * points):
            raise InputError(
                f"blend of the transfer has {columns} columns for {points} sample points: it must have one a point, or "
                "four with gradients; make them with light.with_sample_points"
            )
        weights = self.blend[:, :: columns // points]
        if bool((weights < 0).any()) or bool(((weights.sum(1) - 1).abs() > 1e-3).any()):
            raise InputError(
                "blend of the transfer has weights below 0, or that do not sum to 1: make it with "
                "light.with_sample_points"
            )


@dataclass(kw_only=True, repr=False)
class Texels(Receivers):
    """The H x W texels of a patch that surfaces are covered with (`shade.lay`), row after row, in its tangent frame.

    x runs along u, y along v, z along the normal of whatever the patch is laid on. Texel (row, column) is centred at
    v = (row + .5) / rows, u = (column + .5) / columns: that is where its place on the flat patch is.
    `tiles_u`, `tiles_v`: whether the patch repeats itself beyond 0 and 1; else its border goes on.
    `relief [V, 3]`: unit normals of the relief, which the frames of glossy layers are about; None where they are all z.
    Raises InputError without texels.
    """

    kind: ClassVar[str] = "texels"
    layouts: ClassVar[dict[str, Layout]] = {"relief": Layout(("V", "3"), REAL, optional=True)}

    rows: int
    columns: int
    tiles_u: bool = True
    tiles_v: bool = True
    relief: Tensor | None = None
    positions: Any = None
    normals: Any = None
    faces: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rows < 1 or self.columns < 1:
            raise InputError(f"map of the transfer has {self.rows} x {self.columns} texels: it must have 1 x 1 or more")
        self.positions, self.faces = _grid(self.rows, self.columns)
        if self.relief is not None and len(self.relief) != self.count:
            raise InputError(
                f"tensor 'relief' of the transfer holds {len(self.relief)} normals for {self.rows} x {self.columns} "
                "texels: bake the patch again"
            )
        self.normals = torch.tensor([0.0, 0.0, 1.0]).expand(self.count, 3) if self.relief is None else self.relief

    def metadata(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("rows", "columns", "tiles_u", "tiles_v")}

    def as_texels(self) -> Texels:
        return self


def _grid(rows: int, columns: int) -> tuple[Float[Tensor, "V 3"], Int[Tensor, "F 3"]]:
    """Places of texels on the unit square, and two triangles between each four."""
    v, u = torch.meshgrid((torch.arange(rows) + 0.5) / rows, (torch.arange(columns) + 0.5) / columns, indexing="ij")
    number = torch.arange(rows * columns, dtype=torch.int32).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    faces = torch.cat([torch.stack([a, b, c], -1).reshape(-1, 3), torch.stack([a, c, d], -1).reshape(-1, 3)])
    return torch.stack([u, v, torch.zeros_like(u)], -1).reshape(-1, 3), faces
