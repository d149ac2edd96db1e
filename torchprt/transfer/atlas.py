"""Texels of surfaces, where texture coordinates put them: a lightmap of transfer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layout import REAL, WHOLE, Layout, check_indices
from torchprt.transfer.receivers import Receivers, called


@dataclass(kw_only=True, repr=False)
class Atlas(Receivers):
    """The V texels of a `rows` x `columns` map that the charts of meshes cover, and the meshes that it lies on.

    - `texel [V]`: their numbers, row * columns + column, ascending. Row 0 is the upper row of a picture, and texel
      (row, column) is centred at u = (column + .5) / columns, v = (row + .5) / rows, v down, as glTF has it.
    - `positions`, `normals [V, 3]`: where on the surface they record, in the mean of their samples.
    - `chart [V]`: which chart each is of. No texel is of two.
    - `mesh_positions`, `mesh_normals [P, 3]`, `mesh_faces [F, 3]`: the meshes, one after the other;
      `mesh_uv [F, 3, 2]`: where the corners of their faces are on the map, NaN for a face that is not on it.
    - `gutter [E]`: texels around the charts that no chart covers and a filter reads beside them, ascending; what is
      there is the sum of `gutter_weights [E, 4]` times the receivers `gutter_sources [E, 4]`: the surface beyond a seam
      where it goes on smoothly, else what is nearest in the same chart.
    - `sight [V]`: as in `Vertices`; None if all are valid.
    - `notes`: how the map was laid out, and what was mended, in sentences.
    - `objects`: what they are of, a dictionary each: `name` of the mesh, `role`, and its `vertices`, `faces` and
      `charts`, [first, one past the last], among those of the map.

    `faces` are two triangles between every four neighbours of a chart: what is near what along the surface. To draw, or
    to read values at places of the surface: `surface` and `at`; as a picture: `image`.
    Raises InputError without texels, or if a number or index names none.
    """

    kind: ClassVar[str] = "atlas"
    layouts: ClassVar[dict[str, Layout]] = {
        "positions": Layout(("V", "3"), REAL),
        "normals": Layout(("V", "3"), REAL),
        "texel": Layout(("V",), WHOLE),
        "chart": Layout(("V",), WHOLE),
        "mesh_positions": Layout(("P", "3"), REAL),
        "mesh_normals": Layout(("P", "3"), REAL),
        "mesh_faces": Layout(("F", "3"), WHOLE),
        "mesh_uv": Layout(("F", "3", "2"), REAL),
        "gutter": Layout(("E",), WHOLE),
        "gutter_sources": Layout(("E", "4"), WHOLE),
        "gutter_weights": Layout(("E", "4"), REAL),
        "sight": Layout(("V",), (torch.uint8,), optional=True),
    }

    rows: int
    columns: int
    positions: Tensor
    normals: Tensor
    texel: Tensor
    chart: Tensor
    mesh_positions: Tensor
    mesh_normals: Tensor
    mesh_faces: Tensor
    mesh_uv: Tensor
    gutter: Tensor
    gutter_sources: Tensor
    gutter_weights: Tensor
    sight: Tensor | None = None
    objects: Sequence[dict[str, Any]] = field(default_factory=list)
    notes: Sequence[str] = ()
    faces: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rows < 1 or self.columns < 1:
            raise InputError(f"map of the transfer has {self.rows} x {self.columns} texels: it must have 1 x 1 or more")
        check_indices("texel", self.texel, self.rows * self.columns)
        check_indices("gutter", self.gutter, self.rows * self.columns)
        check_indices("gutter_sources", self.gutter_sources, self.count)
        check_indices("mesh_faces", self.mesh_faces, len(self.mesh_positions))
        faces = _between(self.texel.long(), self.chart, self.rows, self.columns)
        self.faces = _outward(faces, self.positions, self.normals)

    def metadata(self) -> dict[str, Any]:
        return {"rows": self.rows, "columns": self.columns, "objects": list(self.objects), "notes": list(self.notes)}

    def as_atlas(self) -> Atlas:
        return self

    @property
    def surface(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.mesh_positions, self.mesh_normals, self.mesh_faces

    @property
    def surface_uv(self) -> Float[Tensor, "F 3 2"]:
        return self.mesh_uv.nan_to_num(0.0)

    def parts(self) -> Sequence[dict[str, Any]]:
        return self.objects

    def ground(self) -> Bool[Tensor, "V"]:
        return self._of([each for each in self.objects if each["role"] == "ground"])

    def of_objects(self, names: Sequence[str]) -> Bool[Tensor, "V"]:
        return self._of([each for each in self.objects if any(called(each["name"], name) for name in names)])

    def _of(self, objects: Sequence[dict[str, Any]]) -> Bool[Tensor, "V"]:
        found = torch.zeros(self.count, dtype=torch.bool, device=self.positions.device)
        for each in objects:
            found |= (self.chart >= each["charts"][0]) & (self.chart < each["charts"][1])
        return found

    def take(self, index: Int[Tensor, "v"]) -> Atlas:
        """Those that `index` names, each once and ascending, and the meshes of objects that any of them is of."""
        device = index.device
        place = torch.full((self.count,), -1, device=device)
        place[index] = torch.arange(len(index), device=device)
        used = place[self.gutter_sources.long()]
        whole = ((used >= 0) | (self.gutter_weights == 0)).all(-1)
        chart, objects = self.chart[index], []
        vertices = torch.zeros(len(self.mesh_positions), dtype=torch.bool, device=device)
        faces = torch.zeros(len(self.mesh_faces), dtype=torch.bool, device=device)
        kept = torch.zeros(int(self.chart.max()) + 1 if self.count else 0, dtype=torch.bool, device=device)
        for each in self.objects:
            if bool(((chart >= each["charts"][0]) & (chart < each["charts"][1])).any()):
                objects.append(each)
                vertices[slice(*each["vertices"])], faces[slice(*each["faces"])] = True, True
                kept[slice(*each["charts"])] = True
        before = {
            name: [0, *flags.cumsum(0).tolist()]
            for name, flags in (("vertices", vertices), ("faces", faces), ("charts", kept))
        }
        number = (vertices.cumsum(0) - 1).to(self.mesh_faces.dtype)
        return self.replace(
            positions=self.positions[index],
            normals=self.normals[index],
            texel=self.texel[index],
            chart=(kept.cumsum(0) - 1).to(self.chart.dtype)[chart.long()],
            sight=None if self.sight is None else self.sight[index],
            mesh_positions=self.mesh_positions[vertices],
            mesh_normals=self.mesh_normals[vertices],
            mesh_faces=number[self.mesh_faces[faces].long()],
            mesh_uv=self.mesh_uv[faces],
            gutter=self.gutter[whole],
            gutter_sources=used[whole].clamp(min=0).to(self.gutter_sources.dtype),
            gutter_weights=self.gutter_weights[whole],
            objects=[
                {**each, **{name: [rows[each[name][0]], rows[each[name][1]]] for name, rows in before.items()}}
                for each in objects
            ],
        )

    def surface_ground(self) -> Bool[Tensor, "P"]:
        found = torch.zeros(len(self.mesh_positions), dtype=torch.bool, device=self.positions.device)
        for each in self.objects:
            if each["role"] == "ground":
                found[slice(*each["vertices"])] = True
        return found

    def image(self, values: Float[Tensor, "*B V D"]) -> Float[Tensor, "*B rows columns D"]:
        """The map with values of the receivers, and its gutters; zero elsewhere."""
        whole = values.new_zeros(*values.shape[:-2], self.rows * self.columns, values.shape[-1])
        whole[..., self.texel.long(), :] = values
        if len(self.gutter):
            weights = self.gutter_weights.to(values.dtype)
            parts = (values[..., self.gutter_sources[:, at].long(), :] * weights[:, at, None] for at in range(4))
            whole[..., self.gutter.long(), :] = sum(parts, values.new_zeros(()))
        return whole.unflatten(-2, (self.rows, self.columns))

    def at(
        self, values: Float[Tensor, "*B V D"], face: Int[Tensor, "E"], weights: Float[Tensor, "E 3"]
    ) -> Float[Tensor, "*B E D"]:
        return bilinear(self.image(values), self.uv_at(face, weights).to(values.dtype))

    def uv_at(self, face: Int[Tensor, "E"], weights: Float[Tensor, "E 3"]) -> Float[Tensor, "E 2"]:
        """Where points of faces of the meshes are on the map; faces without texture coordinates at (0, 0)."""
        corners = self.mesh_uv[face.long()]
        return (corners * weights[..., None].to(corners.dtype)).sum(-2).nan_to_num(0.0)

    def check(self, of: str = "") -> None:
        """InputError if a tensor holds NaN or infinity (where texture coordinates are not missing), or texels do not
        ascend."""
        for name, value in self.tensors().items():
            missing = value.isnan().flatten(1).all(-1) if name == "mesh_uv" else None
            kept = value if missing is None else value[~missing]
            if kept.is_floating_point() and not bool(kept.isfinite().all()):
                raise InputError(f"tensor '{of}{name}' of the transfer holds NaN or infinite values: bake it again")
        for each in self.objects:
            if not {"name", "role", "vertices", "faces", "charts"} <= each.keys():
                raise InputError(f"objects of the transfer hold {each}, which names no charts: bake it again")
        for name, numbers in (("texel", self.texel), ("gutter", self.gutter)):
            if len(numbers) > 1 and not bool((numbers[1:] > numbers[:-1]).all()):
                raise InputError(f"{name} of the transfer must be in ascending order, each once: bake it again")


def bilinear(image: Float[Tensor, "*B H W D"], uv: Float[Tensor, "E 2"]) -> Float[Tensor, "*B E D"]:
    """A map between the middles of its texels, linear along u and v; beyond the outermost ones it goes on as they."""
    rows, columns = image.shape[-3], image.shape[-2]
    x = (uv[:, 0] * columns - 0.5).clamp(0, columns - 1)
    y = (uv[:, 1] * rows - 0.5).clamp(0, rows - 1)
    left, upper = x.floor().long().clamp(max=max(columns - 2, 0)), y.floor().long().clamp(max=max(rows - 2, 0))
    s, t = (x - left)[:, None], (y - upper)[:, None]
    right, lower = (left + 1).clamp(max=columns - 1), (upper + 1).clamp(max=rows - 1)
    above = image[..., upper, left, :] * (1 - s) + image[..., upper, right, :] * s
    below = image[..., lower, left, :] * (1 - s) + image[..., lower, right, :] * s
    return above * (1 - t) + below * t


def _between(texel: Int[Tensor, "V"], chart: Int[Tensor, "V"], rows: int, columns: int) -> Int[Tensor, "F 3"]:
    """Two triangles between every four neighbours of one chart."""
    number = torch.full((rows + 1, columns + 1), -1, device=texel.device)
    number[texel // columns, texel % columns] = torch.arange(len(texel), device=texel.device)
    four = torch.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], -1).flatten(0, 1)
    four = four[(four >= 0).all(-1)]
    four = four[(chart[four] == chart[four[:, :1]]).all(-1)].to(torch.int32)
    return torch.cat([four[:, [0, 2, 1]], four[:, [0, 3, 2]]])


def _outward(faces: Int[Tensor, "F 3"], positions: Tensor, normals: Tensor) -> Int[Tensor, "F 3"]:
    """The same wound as the normals have it: charts may be mirrored."""
    a, b, c = (positions[corner.long()] for corner in faces.unbind(-1))
    inside = (torch.linalg.cross(b - a, c - a) * normals[faces[:, 0].long()]).sum(-1) < 0
    return torch.where(inside[:, None], faces.flip(-1), faces)
