"""Texture patches: transfer at the texels of a small piece of surface, in its tangent frame."""

from __future__ import annotations

import dataclasses
from typing import Any

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from torchprt.brdf import Brdf
from torchprt.compression import fit
from torchprt.errors import InputError
from torchprt.progress import Report
from torchprt.scene import Material, Mesh, Object, Points, Scene, Subsurface, make_mesh, tiled
from torchprt.scene.material import Albedo
from torchprt.trace import Tracer
from torchprt.transfer import Dense, Diffuse, Layer, Texels, Transfer, Vertices
from torchprt.transport.bake import bake
from torchprt.transport.bake_glossy import Frame
from torchprt.transport.patch_subsurface import Below, at_vertices, below, leaving

# Half the side of the floor under a patch, in tiles: a ray that leaves a relief of depth .1 sideways and downward meets
# it unless it sinks less than one part in six hundred.
FLOOR = 64.0


def bake_patch(
    mesh: Mesh,
    *,
    size: int | tuple[int, int] = 64,
    lobes: int = 4,
    smooth: bool = False,
    restarts: int = 0,
    **options: Any,
) -> Transfer:
    """A map of `lobes` zonal lobes a texel from a patch: `patch_transfer` with its `options`, then `compression.fit`.

    Raises InputError as both do.
    Source: Sloan, Luna and Snyder 2005, sections 5 and 6.
    """
    rows, columns = (size, size) if isinstance(size, int) else size
    vectors = patch_transfer(mesh, size=size, **options)
    progress = options.get("progress", False)
    report = None if isinstance(progress, bool) else progress
    fitted = fit(vectors, lobes=lobes, smooth=smooth, restarts=restarts, report=report)
    tiles = bool(options.get("tiles", True))
    # The frames of a gloss are about the normals of the relief.
    relief = vectors.normals.contiguous() if "eye" in vectors.needs else None
    texels = Texels(rows=rows, columns=columns, tiles_u=tiles, tiles_v=tiles, relief=relief)
    return dataclasses.replace(fitted, receivers=texels)


def patch_transfer(
    mesh: Mesh,
    *,
    size: int | tuple[int, int] = 64,
    tiles: bool = True,
    around: int = 1,
    order: int = 6,
    rays: int = 1024,
    bounces: int | float = 0,
    shadows: bool = True,
    albedo: Albedo | None = None,
    gloss: Brdf | str | None = None,
    specular: Albedo = 1.0,
    frame: Frame = "exit",
    output_order: int | None = None,
    factors: int | float | None = None,
    subsurface: Subsurface | str | None = None,
    millimetres: float | int | None = None,
    thickness: float | int | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: bool | Report = False,
) -> Transfer:
    """Transfer at the texels of a patch over the unit square, row after row: x is u, y is v, z the normal.

    `size` (rows, columns) of the map; texel (row, column) records where its centre ((column + .5) / columns,
    (row + .5) / rows) meets the uppermost surface. A patch that `tiles` is baked amid `around` copies of itself on
    every side, so that its map is periodic; it must fill the square. Else texels beside the surface repeat the nearest
    one on it: gutters, so that the edge of a chart does not bleed. A floor far around and below blocks what comes from
    under the horizon.

    The vectors are in the tangent frame of what the patch will be laid on, which is that of the square. Positions and
    normals are those of the relief; faces join neighbouring texels, also around the square if it tiles. `albedo`,
    `gloss` and `specular` are one paint of the whole patch, as of a `Material`; tangents follow u. With `bounces`
    copies reflect too, the floor is black.
    `subsurface`: the medium below the relief, as text "marble" (see `read_subsurface`), instead of an albedo: what
    arrives at its vertices diffuses before it leaves; `millimetres` is how wide a tile is. `thickness`, in tiles, of
    the patch at its lowest point: light then comes through from a level back, which gets all that is below its horizon.
    Light that is reflected on between walls meets the reflectance of a half-space of the medium there.
    `order`, `rays`, `bounces`, `shadows`, `frame`, `output_order`, `factors`, `seed`, `threads`, `progress`: as in
    `bake`; visibility cannot be held in lobes. A few factors cost a fit a row each, exit functions 25 at order 5.
    Raises InputError as `bake` and `tiled` do, if `size` is below 2, or if no texel meets the patch.
    """
    rows, columns = (size, size) if isinstance(size, int) else size
    if min(rows, columns) < 2:
        raise InputError(f"size is {rows} x {columns}: give at least 2 texels a side")
    many = tiled(mesh, around) if tiles else mesh
    if frame not in ("exit", "incident"):
        raise InputError(f"frame '{frame}' cannot be held in lobes, which patches are of: give 'exit' or 'incident'")
    inside = below(subsurface, millimetres, thickness)
    if inside is not None and albedo is not None:
        raise InputError("albedo and subsurface are both given: the medium has its own colour, leave one of them out")
    material = Material(0.0 if inside else albedo, gloss=gloss, specular=specular)
    if len(torch.as_tensor(material.albedo_of(mesh)).unique(dim=0)) > 1:
        raise InputError(f"albedo of {mesh.name} differs from vertex to vertex: give one colour for the patch")
    receivers, covered, corners, weights = _texels(many, rows, columns, material)
    if not bool(covered.any()):
        raise InputError(f"{mesh.name} is beside the unit square of the patch: scale and move it there")
    common: dict[str, Any] = {"order": order, "rays": rays, "bounces": bounces, "shadows": shadows, "seed": seed}
    common |= {"threads": threads, "progress": progress}

    def recorded(paint: Material, receivers: Points, **options: Any) -> Transfer:
        floor = Object(_floor(many), Material(0.0), "blocker")
        return bake(Scene([Object(many, paint), floor]), receivers=receivers, **common, **options)

    paint = material if inside is None else Material(inside.paint.albedo, gloss=gloss, specular=specular)
    glossy: dict[str, Any] = {"frame": frame, "output_order": output_order, "factors": factors}
    if inside is None:
        baked = recorded(paint, receivers, **glossy)
    else:
        arriving = recorded(inside.paint, at_vertices(mesh))
        layers = {} if gloss is None else recorded(paint, receivers, **glossy).layers
        baked = dataclasses.replace(
            arriving,
            receivers=Vertices(positions=receivers.positions, normals=receivers.normals.float(), faces=_none()),
            layers={
                "diffuse": _diffusing(mesh, arriving, inside, corners, weights, tiles, threads, progress),
                **layers,
            },
        )
    nearest = _nearest(covered.view(rows, columns))
    return dataclasses.replace(
        baked,
        receivers=Vertices(
            positions=baked.positions[nearest],
            normals=baked.normals[nearest],
            faces=_neighbours(rows, columns, tiles),
        ),
        layers={name: layer.take(nearest, None) for name, layer in baked.layers.items()},
    )


def _none() -> Tensor:
    return torch.zeros(0, 3, dtype=torch.int32)


def _diffusing(
    mesh: Mesh,
    arriving: Transfer,
    inside: Below,
    corners: Int64[Tensor, "T 3"],
    weights: Float64[Tensor, "T 3 1"],
    tiles: bool,
    threads: int | None,
    progress: bool | Report,
) -> Layer:
    """What leaves texels in between vertices, after it has diffused below them."""
    vectors = arriving.layers["diffuse"].signal.dense().values
    left = leaving(mesh, vectors, inside, tiles=tiles, threads=threads, progress=progress)
    # Copies of the tile send what it does.
    at_corners = left[..., corners % len(mesh.positions)]
    return Diffuse(albedo=torch.ones(1, 1), signal=Dense(values=(at_corners * weights[..., 0].float()).sum(-1)))


def _texels(
    mesh: Mesh, rows: int, columns: int, material: Material
) -> tuple[Points, Bool[Tensor, "T"], Int64[Tensor, "T 3"], Float64[Tensor, "T 3 1"]]:
    """Where the centre of every texel meets the surface from above, whether it does, and between which vertices."""
    top = float(mesh.positions[:, 2].max())
    extent = float((mesh.positions.amax(0) - mesh.positions.amin(0)).max())
    places = texel_centres(rows, columns)
    above = torch.cat([places, torch.full_like(places[:, :1], top + 0.01 * extent)], 1)
    tracer = Tracer(mesh.positions, mesh.faces)
    frames = torch.eye(3).expand(len(above), 3, 3)
    hits = tracer.hits(tracer.local(above).float(), frames, torch.tensor([[0.0, 0.0, -1.0]]))
    covered = hits.triangle[:, 0] >= 0
    corners = mesh.faces[hits.triangle[:, 0].long().clamp(min=0)]
    s, t = hits.u.double(), hits.v.double()
    weights = torch.cat([1 - s - t, s, t], 1)[..., None]
    positions = (mesh.positions[corners] * weights).sum(1)
    normals = torch.nn.functional.normalize((mesh.normals[corners] * weights).sum(1), dim=-1)
    # A texel that meets nothing records nothing.
    positions = torch.where(covered[:, None], positions, above)
    normals = torch.where(covered[:, None], normals, 0.0)
    albedo = material.albedo_of(mesh)[:1].expand(len(positions), -1)
    along_u = torch.tensor([1.0, 0.0, 0.0]).expand(len(positions), 3)
    return Points(positions, normals, albedo, material.gloss, material.specular, along_u), covered, corners, weights


def _floor(mesh: Mesh) -> Mesh:
    """A level square a little below the patch, far around it."""
    low = mesh.positions.amin(0)
    extent = float((mesh.positions.amax(0) - low).max())
    z = float(low[2]) - 1e-4 * extent
    corners = [[-FLOOR, -FLOOR, z], [FLOOR, -FLOOR, z], [FLOOR, FLOOR, z], [-FLOOR, FLOOR, z]]
    return make_mesh(torch.tensor(corners), torch.tensor([[0, 1, 2], [0, 2, 3]]), name="floor")


def _nearest(covered: Bool[Tensor, "H W"]) -> Int64[Tensor, "T"]:
    """For every texel the number of the nearest covered one: itself where it is."""
    from scipy.ndimage import distance_transform_edt

    _, (row, column) = distance_transform_edt(~covered.numpy(), return_indices=True)
    return (torch.from_numpy(row).long() * covered.shape[1] + torch.from_numpy(column).long()).flatten()


def _neighbours(rows: int, columns: int, around: bool) -> Int64[Tensor, "F 3"]:
    """Two triangles between each four neighbouring texels; around the square too if it tiles."""
    number = torch.arange(rows * columns).view(rows, columns)
    if around:
        number = torch.cat([number, number[:1]])
        number = torch.cat([number, number[:, :1]], 1)
    a, b, c, d = (part.flatten() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    return torch.cat([torch.stack([a, b, c], -1), torch.stack([a, c, d], -1)])


def texel_centres(rows: int, columns: int) -> Float64[Tensor, "T 2"]:
    """Texture coordinates of the centres of texels, row after row."""
    v, u = torch.meshgrid(
        (torch.arange(rows, dtype=torch.float64) + 0.5) / rows,
        (torch.arange(columns, dtype=torch.float64) + 0.5) / columns,
        indexing="ij",
    )
    return torch.stack([u, v], -1).reshape(-1, 2)
