"""Glossy transfer of a chunk of receivers: direct light, and what arrives from the surfaces around."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.brdf import Brdf
from torchprt.sh import hemisphere_basis, to_horizon
from torchprt.trace import Hits, Tracer
from torchprt.transport.bounce import Surfaces
from torchprt.transport.diffuse import cosine_weights, projection, to_world
from torchprt.transport.mirrors import ByMirrors, by_way_of_mirrors
from torchprt.transport.receivers import Receivers, tangent_frames
from torchprt.transport.rows import Recording, Rows
from torchprt.transport.through_volume import Seen

# Hits shaded at a time: the functions of the eye at their corners stay in a core's cache.
_HITS = 1 << 13


@dataclass
class Glossy:
    """The glossy receivers of a bake: `receivers [G]`, and of all receivers `number [V]` (g, or -1) and
    `material [V]` (an index into `brdfs`, or -1); `frames [G, 3, 3]`, float32."""

    receivers: Int[Tensor, "G"]
    number: Int[Tensor, "V"]
    material: Int[Tensor, "V"]
    frames: Float[Tensor, "G 3 3"]
    brdfs: tuple[Brdf, ...]

    def among(self, rows: slice | Tensor) -> Int[Tensor, "g"]:
        """The glossy receivers among `rows` of all receivers, in their order."""
        number = self.number[rows]
        return number[number >= 0]


def glossy(receivers: Receivers, chosen: Tensor, tangents: Tensor, material: Tensor, brdfs: tuple[Brdf, ...]) -> Glossy:
    """The glossy receivers `chosen [G]` of all `receivers`, with their tangents and materials `[G]`."""
    number = torch.full((len(receivers),), -1)
    number[chosen] = torch.arange(len(chosen))
    of_receiver = torch.full((len(receivers),), -1)
    of_receiver[chosen] = material
    turned = tangent_frames(receivers.normals[chosen], tangents).to(torch.float32)
    return Glossy(chosen, number, of_receiver, turned, brdfs)


@dataclass
class Tables:
    """What a set of directions needs: the diffuse projection `[N, D]`, the cosine `[D]`, and the rows by material."""

    directions: Float[Tensor, "D 3"]
    project: Float[Tensor, "N D"]
    cosine: Float[Tensor, "D"]
    rows: list[Rows]


def tables(directions: Tensor, order: int, recording: Recording, brdfs: tuple[Brdf, ...]) -> Tables:
    """Tables of a recording along `directions`, float64."""
    return Tables(
        directions.to(torch.float32),
        projection(directions, order),
        cosine_weights(directions).to(torch.float32),
        [recording.rows(brdf, directions) for brdf in brdfs],
    )


@dataclass
class Arrivals:
    """Rays of a chunk that hit a surface which reflects: how many a receiver has (`counts [v]`), and of each its
    direction `column [E]`, `triangle [E]`, barycentrics `u`, `v`, and side.

    Where some came by way of mirrors or through a volume also what is left of each, `share [E, A]`; where by way of
    mirrors its last leg in the world, `leg [E, 3]`. Else these have no rows.
    """

    counts: Int[Tensor, "v"]
    column: Int[Tensor, "E"]
    triangle: Int[Tensor, "E"]
    u: Float[Tensor, "E"]
    v: Float[Tensor, "E"]
    front: Tensor
    share: Float[Tensor, "_ A"]
    leg: Float[Tensor, "_ 3"]


@dataclass
class Exitant:
    """What all receivers send out: one table of rows over channels and light coefficients.

    Row q of the first V is the diffuse exit radiance of receiver q, row V + g M + i the coefficient i of glossy
    receiver g in `hemisphere_basis(order)`; albedo and specular are in it.
    """

    table: Float[Tensor, "rows W"]
    order: int


def shadowed(
    tracer: Tracer,
    surfaces: Surfaces,
    receivers: Receivers,
    material: Int[Tensor, "v"],
    set_of: Tables,
    *more: list[Rows],
    keep_hits: bool,
) -> tuple[Float[Tensor, "A N v"], list[Float[Tensor, "g _ _"]], Arrivals | None, Float[Tensor, "v"]]:
    """Diffuse transfer of a chunk, the matrices of its glossy receivers, with `keep_hits` what its rays hit, and what
    was cut off among mirrors. The matrices have A times the columns.

    `more` rows by material along the same directions give further matrices.

    A pure function of its arguments, as `diffuse.shadowed`.
    Source: Sloan, Kautz and Snyder 2002, section 5, shadow pass; Sloan, Hall, Hart and Snyder 2003, section 3.
    """
    turned = receivers.frames()
    local = torch.empty(len(set_of.project), len(receivers), dtype=torch.float32)
    sets = (set_of.rows, *more)
    matrices: list[list[Tensor]] = [[] for _ in sets]
    arrivals: list[Arrivals] = []
    mirrors, order = surfaces.mirrors, math.isqrt(len(set_of.project))
    more_direct = torch.zeros(surfaces.channels, len(set_of.project), len(receivers))
    lost = torch.zeros(len(receivers))
    for rows in receivers.blocks(len(set_of.directions)):
        lit = receivers.normals[rows].abs().sum(-1) > 0
        here = turned[rows]
        seen: ByMirrors | None = None
        through: Seen | None = None
        if keep_hits or surfaces.sent:
            hits = tracer.hits(receivers.origins[rows], turned[rows], set_of.directions)
            visible = (hits.triangle < 0).to(torch.float32)
            if mirrors is not None:
                seen = by_way_of_mirrors(tracer, mirrors, hits, turned[rows], set_of.directions)
                more_direct[..., rows] = seen.direct(set_of.cosine, order, len(lit)) * lit
                lost[rows] = seen.lost(set_of.cosine, len(lit)) * lit
            if surfaces.volume is not None:
                shiny = bool((material[rows] >= 0).any())
                through = surfaces.volume.seen(
                    tracer, receivers.origins[rows], here, set_of.directions, hits, set_of.cosine, along_rays=shiny
                )
                visible = visible * through.left
                more_direct[..., rows] = through.direct() * lit
            if keep_hits:
                arrivals.append(reflecting(hits, surfaces, lit, here, set_of.directions, seen, through))
        else:
            visible = tracer.visibility(receivers.origins[rows], turned[rows], set_of.directions)
            if surfaces.volume is not None:
                wanted = visible != 0
                visible *= surfaces.volume.left(tracer, receivers.origins[rows], here, set_of.directions, wanted)
        local[:, rows] = set_of.project @ visible.T
        mirrored: Tensor | None = None if through is None else through.radiance
        if seen is not None and len(seen.row):
            mirrored = seen.radiance(order, len(lit), len(set_of.directions))
        for each, found in zip(sets, matrices, strict=True):
            parts = _by_material(each, material[rows])
            found += _in_order(
                [(which, _direct(of, visible, here, which, mirrored, surfaces.channels)) for of, which in parts]
            )
    dark = receivers.normals[material >= 0].abs().sum(-1) == 0
    joined = [_joined(found).masked_fill_(dark[:, None, None], 0) for found in matrices]
    direct = to_world(local, turned, receivers.normals)[None]
    direct = direct + more_direct if surfaces.sent else direct
    return direct, joined, _join(arrivals) if keep_hits else None, lost


def _direct(
    of: Rows, visible: Tensor, turned: Tensor, which: Tensor, mirrored: Tensor | None, channels: int
) -> Float[Tensor, "g R W"]:
    """Matrices of what comes straight, and by way of mirrors or from cells."""
    matrix = of.shadowed(visible[which], turned[which])
    matrix = matrix if channels == 1 else matrix.repeat(1, 1, channels)
    return matrix if mirrored is None else matrix + of.table @ mirrored[which]


def gathered(
    arrivals: Arrivals,
    exitant: Exitant,
    everything: Glossy,
    surfaces: Surfaces,
    receivers: Receivers,
    material: Int[Tensor, "v"],
    set_of: Tables,
) -> tuple[Float[Tensor, "v W"], Float[Tensor, "g _ _"]]:
    """What arrives at a chunk from the surfaces around it: one bounce, diffuse and glossy from the same hits.

    Source: Sloan, Kautz and Snyder 2002, section 5, interreflection pass, with the exit radiance of a hit surface
    from its own exit matrix in place of a convolution.
    """
    turned = receivers.frames()
    width = exitant.table.shape[1]
    diffuse = torch.empty(len(receivers), width)
    matrices: list[Tensor] = []
    ends = torch.cumsum(arrivals.counts, 0).tolist()
    for rows in receivers.blocks(len(set_of.directions)):
        part = slice(ends[rows.start - 1] if rows.start else 0, ends[rows.stop - 1])
        row = torch.repeat_interleave(torch.arange(rows.stop - rows.start), arrivals.counts[rows].long())
        column = arrivals.column[part].long()
        radiance = torch.zeros(rows.stop - rows.start, len(set_of.directions), width)
        if surfaces.mirrors is None:
            toward = -(set_of.directions[column][:, None] @ turned[rows][row])[:, 0]
        else:
            toward = -arrivals.leg[part]
        found = exit_radiance_at(arrivals, part, toward, exitant, everything, surfaces)
        if surfaces.mirrors is not None or surfaces.volume is not None:
            share = arrivals.share[part]
            found = (found.unflatten(1, (share.shape[1], -1)) * share[..., None]).flatten(1)
        radiance[row, column] = found
        diffuse[rows] = (set_of.cosine @ radiance.movedim(1, 0).flatten(1)).view(-1, width)
        parts = _by_material(set_of.rows, material[rows])
        matrices += _in_order([(which, of.table @ radiance[which]) for of, which in parts])
    return diffuse, _joined(matrices)


def _joined(matrices: list[Tensor]) -> Tensor:
    return torch.cat(matrices) if matrices else torch.zeros(0, 1, 1)


def _by_material(rows: list[Rows], material: Tensor) -> list[tuple[Rows, Tensor]]:
    """The rows of every material that occurs, and which receivers are of it."""
    found = [(of_material, torch.nonzero(material == index)[:, 0]) for index, of_material in enumerate(rows)]
    return [(of_material, which) for of_material, which in found if len(which)]


def _in_order(parts: list[tuple[Tensor, Tensor]]) -> list[Tensor]:
    """Results of several materials in the order of the receivers."""
    if len(parts) < 2:
        return [matrix for _, matrix in parts]
    back = torch.argsort(torch.cat([which for which, _ in parts]))
    return [torch.cat([matrix for _, matrix in parts])[back]]


def reflecting(
    hits: Hits,
    surfaces: Surfaces,
    lit: Tensor,
    turned: Tensor,
    directions: Tensor,
    seen: ByMirrors | None,
    through: Seen | None = None,
) -> Arrivals:
    """Of the rays of a block those that end on a surface which reflects, by way of mirrors if `seen` is given, through
    a volume if that is."""
    hits = hits if seen is None else seen.hits
    reflects = surfaces.reflect
    triangle = hits.triangle.clamp(min=0).long()
    wanted = (hits.triangle >= 0) & lit[:, None] & torch.where(hits.front, reflects[0][triangle], reflects[1][triangle])
    row, column = torch.nonzero(wanted, as_tuple=True)
    share, leg = torch.zeros(0, 1), torch.zeros(0, 3)
    if seen is not None:
        share = seen.shares(len(lit), len(directions))[row, column]
        leg = seen.toward(directions @ turned)[row, column]
    if through is not None:
        share = through.left[row, column][:, None]
    return Arrivals(
        torch.bincount(row, minlength=len(lit)).to(torch.int32),
        column.to(torch.int32),
        hits.triangle[row, column].to(torch.int32),
        hits.u[row, column],
        hits.v[row, column],
        hits.front[row, column],
        share,
        leg,
    )


def _join(parts: list[Arrivals]) -> Arrivals:
    return Arrivals(*(torch.cat([getattr(part, name) for part in parts]) for name in Arrivals.__dataclass_fields__))


def exit_radiance_at(
    arrivals: Arrivals, part: slice, toward: Tensor, exitant: Exitant, everything: Glossy, surfaces: Surfaces
) -> Float[Tensor, "E W"]:
    """Exit radiance of the points that rays hit, toward where the rays came from."""
    triangle, front = arrivals.triangle[part].long(), arrivals.front[part]
    u, v = arrivals.u[part], arrivals.v[part]
    found = []
    for some in _pieces(len(triangle)):
        corners, weights = surfaces.senders(triangle[some], u[some], v[some], front[some])
        share = torch.where(corners >= 0, weights, 0)
        corners = corners.clamp(min=0)
        radiance = _sum_of_rows(corners, share, exitant.table)
        number = torch.where(share > 0, everything.number[corners], -1)
        shiny = torch.nonzero((number >= 0).any(-1))[:, 0]
        if len(shiny):
            radiance[shiny] += _glossy_radiance(number[shiny], share[shiny], toward[some][shiny], exitant, everything)
        found.append(radiance)
    return torch.cat(found) if found else exitant.table.new_zeros(0, exitant.table.shape[1])


def _glossy_radiance(
    number: Tensor, share: Tensor, toward: Tensor, exitant: Exitant, everything: Glossy
) -> Float[Tensor, "E W"]:
    count = exitant.order**2
    share = torch.where(number >= 0, share, 0)
    number = number.clamp(min=0)
    local = (everything.frames[number] @ toward[:, None, :, None])[..., 0]
    values = hemisphere_basis(to_horizon(local), exitant.order) * share[..., None]
    first = len(everything.number) + number * count
    rows = first[..., None] + torch.arange(count)
    return _sum_of_rows(rows.flatten(1), values.flatten(1), exitant.table)


def _sum_of_rows(rows: Int[Tensor, "E L"], weights: Float[Tensor, "E L"], table: Float[Tensor, "rows W"]) -> Tensor:
    return torch.nn.functional.embedding_bag(rows.to(torch.int32), table, mode="sum", per_sample_weights=weights)


def _pieces(count: int) -> Iterator[slice]:
    return (slice(start, min(start + _HITS, count)) for start in range(0, count, _HITS))
