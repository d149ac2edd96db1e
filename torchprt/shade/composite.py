"""Compositing: what is seen of a volume along rays, from the source radiance of its cells."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import embedding_bag, grid_sample, pad

from torchprt.errors import InputError
from torchprt.sh.basis import values_are_at_hand
from torchprt.sh.derivatives import with_all_derivatives
from torchprt.sh.precision import KeepsSingle, at_least_single
from torchprt.sh.shapes import broadcast_shapes
from torchprt.shade.signal import Making, hold
from torchprt.transfer import Cells

Reading = Literal["exact", "trilinear", "nearest"]
READINGS: tuple[Reading, ...] = ("exact", "trilinear", "nearest")
# Rays of one piece: what is made of them stays in the cache, which is up to twice as fast.
_RAYS = 1024
# Steps a cell along the longest side, if their number is not given.
STEPS = {"trilinear": 1.0, "nearest": 2.0}


class Composite(KeepsSingle):
    """Source radiance of the cells of a volume to radiance along rays, from front to back (emission and absorption).

    A ray that crosses a piece of length d of extinction sigma and source radiance J gains `T (1 - e^(-sigma d)) J` and
    keeps `e^(-sigma d)` of T, the share that is let through of what comes from behind. `reading`:
    - "exact": the pieces are the cells, each uniform: every plane between them is met, X + Y + Z + 2 pieces a ray. This
      is the volume that was baked, to rounding; near by its cells are seen.
    - "trilinear": `samples` equal steps in which extinction, and extinction times source radiance, are interpolated
      between the middles of cells (and to nothing half a cell outside): smooth to look at. Optical depths are those
      of the cells on average.
    - "nearest": so many steps, each as the cell in its middle.
    `samples`: if omitted as many as cells along the longest side of what holds anything, twice that for "nearest".

    Empty cells around what holds anything are not met, and rays that miss it cost nothing, except in a traced graph.
    Buffers: `extinction [V]`, a parameter if `learn` names it; places are float32 at least, and rays are brought near
    the volume in their own dtype if that is wider: for scenes far from the origin give them in float64.

    Laws: linear in the source radiance; a ray that is cut in two and composited again is the same (exact); nothing
    under a source of 0; the transmittance does not depend on the source.
    Source: Sloan, Kautz and Snyder 2002, section 7; Max 1995, "Optical models for direct volume rendering", equation 9;
    Amanatides and Woo 1987 for the planes.
    """

    single = ("extinction", "low", "high", "step")
    extinction: Tensor
    low: Tensor
    high: Tensor
    step: Tensor
    rows: Tensor
    held: Tensor

    def __init__(
        self,
        cells: Cells,
        *,
        reading: Reading = "exact",
        samples: int | None = None,
        dtype: torch.dtype = torch.float32,
        learn: Collection[str] = (),
    ) -> None:
        """Raises InputError if the volume is empty, or `reading`, `samples` or `learn` cannot be used."""
        super().__init__()
        if reading not in READINGS:
            raise InputError(f"reading is '{reading}': use one of {', '.join(READINGS)}")
        if samples is not None and (reading == "exact" or samples < 1):
            raise InputError(
                f"samples is {samples} with reading '{reading}': give 1 or more steps, and none with 'exact'"
            )
        if set(learn) - {"extinction"}:
            raise InputError(f"learn names {sorted(learn)}: a composite can learn 'extinction'")
        if not cells.count:
            raise InputError("the volume has no cells that hold anything: there is nothing to see")
        self.reading: Reading = reading
        places = cells.places().long()
        first, last = places.amin(0), places.amax(0) + 1
        self.shape: tuple[int, int, int] = tuple((last - first).tolist())  # type: ignore[assignment]
        self.samples = samples
        if samples is None and reading != "exact":
            self.samples = math.ceil(STEPS[reading] * max(self.shape))
        wide = at_least_single(dtype)
        hold(self, "extinction", cells.extinction, Making(cells, dtype, learn))
        device = cells.extinction.device
        step = torch.tensor(cells.spacing, dtype=torch.float64, device=device)
        low = torch.tensor(cells.origin, dtype=torch.float64, device=device) + first * step
        # The middle is kept apart: what is relative to it can be narrow.
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("high", low + step * (last - first), persistent=False)
        self.register_buffer("step", step.to(wide), persistent=False)
        _, ny, nz = self.shape
        where = places - first
        number = (where[:, 0] * ny + where[:, 1]) * nz + where[:, 2]
        rows = torch.full((math.prod(self.shape),), cells.count, dtype=torch.int32, device=device)
        rows[number] = torch.arange(cells.count, dtype=torch.int32, device=device)
        self.register_buffer("rows", rows, persistent=False)
        held = torch.zeros([count + 2 for count in self.shape], dtype=torch.bool, device=device)
        held[tuple((where + 1).unbind(1))] = True
        # Between which middles of eight cells there is anything.
        for axis in range(3):
            count = self.shape[axis] + 1
            held = held.narrow(axis, 0, count) | held.narrow(axis, 1, count)
        self.register_buffer("held", held.flatten(), persistent=False)

    def extra_repr(self) -> str:
        steps = "" if self.samples is None else f", samples={self.samples}"
        return f"cells={len(self.extinction)}, reading={self.reading}{steps}"

    def forward(
        self,
        source: Float[Tensor, "*#B V 3"],
        origins: Float[Tensor, "*#B #R 3"],
        directions: Float[Tensor, "*#B #R 3"],
        far: Float[Tensor, "*#B #R"] | None = None,
    ) -> tuple[Float[Tensor, "... R 3"], Float[Tensor, "... R"]]:
        """Radiance along rays, and their transmittance: a picture is `radiance + transmittance * background`.

        `source`: of every cell, what a shader of the volume gives. `origins` and `directions`, of any length above
        zero, in the world, one for all rays where a size is 1; an origin may be inside. `far`: the distance of a
        surface along each ray, beyond which nothing is seen (infinity, or omitted, for none).
        Batches broadcast: rays without one are met once for all sources. Everything is worked out in float32 at
        least, and the result has the dtype of `source`; gradients flow to all arguments and to the extinction; where a
        ray moves from cell to cell they jump.

        Raises InputError if shapes do not fit or, outside of a traced graph, if rays are not finite, a direction is
        zero, or `far` is NaN.
        """
        self._check(source, origins, directions, far)
        wanted, source = source.dtype, source.to(self.extinction.dtype)
        origins, directions = torch.broadcast_tensors(origins, directions)
        count, batch = origins.shape[-2], origins.shape[:-2]
        if far is not None:
            batch = broadcast_shapes(batch, far.shape[:-1])
        everyone = broadcast_shapes(batch, source.shape[:-2])
        # All sources as channels of one, which every ray reads at once.
        shared = math.prod(batch) == 1
        lights = math.prod(source.shape[:-2])
        if shared:
            sources = source.reshape(lights, *source.shape[-2:]).transpose(0, 1).flatten(1).unsqueeze(0)
        else:
            batch = everyone
            sources = source.expand(*everyone, *source.shape[-2:]).reshape(math.prod(everyone), *source.shape[-2:])
        rays = len(sources)
        start = origins.expand(*batch, count, 3).reshape(rays, count, 3)
        toward = directions.expand(*batch, count, 3).reshape(rays, count, 3)
        end = None if far is None else far.expand(*batch, count).reshape(rays, count)
        seen, through = self._along(sources, start, toward, end)
        if shared:
            seen = seen.reshape(count, lights, 3).transpose(0, 1)
        seen, through = seen.to(wanted), through.to(wanted)
        return seen.reshape(*everyone, count, 3), through.reshape(*batch, count).expand(*everyone, count)

    def _along(
        self, sources: Float[Tensor, "S V D"], start: Tensor, toward: Tensor, end: Tensor | None
    ) -> tuple[Float[Tensor, "S R D"], Float[Tensor, "S R"]]:
        """Of `S` batches of rays, each with its own sources, flat."""
        place, unit, near, far = self._met(start, toward, end)
        table = self._table(sources)
        number = torch.arange(len(sources), dtype=torch.int32, device=start.device).view(-1, 1)
        flat = (place, unit, near, far, number.expand(-1, start.shape[1]))
        rays = [part.reshape(-1, *part.shape[2:]) for part in flat]
        size = (*start.shape[:2], sources.shape[-1])
        if not values_are_at_hand(start, sources):
            seen, through = self._composited(table, sources.shape[1], *rays)
            return seen.reshape(size), through.reshape(size[:2])
        hit = (rays[3] > rays[2]).nonzero()[:, 0]
        found = [
            self._composited(table, sources.shape[1], *(part[some] for part in rays))
            for some in hit.split(_RAYS)
            if len(some)
        ]
        seen, through = sources.new_zeros(size).flatten(0, 1), sources.new_ones(size[:2]).flatten()
        if found:
            seen = seen.index_copy(0, hit, torch.cat([each for each, _ in found]))
            through = through.index_copy(0, hit, torch.cat([each for _, each in found]))
        return seen.reshape(size), through.reshape(size[:2])

    def _met(
        self, start: Float[Tensor, "S R 3"], toward: Float[Tensor, "S R 3"], end: Float[Tensor, "S R"] | None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Rays from where they are nearest to the middle of the volume, in cells from its corner: places and unit
        directions `[S, R, 3]`, distances `[S, R]` from there at which they enter and leave."""
        dtype = self.step.dtype
        wide = torch.promote_types(torch.promote_types(start.dtype, toward.dtype), dtype)
        start, toward = start.to(wide), toward.to(wide)
        unit = toward / toward.detach().abs().amax(-1, keepdim=True)
        unit = unit / torch.linalg.vector_norm(unit, dim=-1, keepdim=True)
        middle = (self.low + self.high).to(wide) / 2
        away = ((middle - start) * unit).sum(-1)
        place = start + away.unsqueeze(-1) * unit - self.low.to(wide)
        place, pace = (part.to(dtype) / self.step for part in (place, unit))
        # What runs along a plane meets it nowhere.
        tiny = torch.finfo(dtype).tiny ** 0.5
        pace = torch.where(pace.abs() > tiny, pace, tiny)
        rim = 0.5 if self.reading == "trilinear" else 0.0
        size = torch.tensor(self.shape, dtype=dtype, device=place.device)
        first, second = (-rim - place) / pace, (size + rim - place) / pace
        near = torch.maximum(_most(torch.minimum(first, second)), -away.to(dtype))
        far = -_most(-torch.maximum(first, second))
        if end is not None:
            far = torch.minimum(far, (end.to(wide) - away).to(dtype))
        return place, pace, near, torch.maximum(near, far)

    def _table(self, sources: Float[Tensor, "S V D"]) -> Tensor:
        """What rays read: rows of cells `[S (V + 1), D]`, of which the last of each is nothing; or, for "trilinear",
        the volume `[S, 1 + D, X, Y, Z]` of extinction and its product with the source."""
        if self.reading != "trilinear":
            return pad(sources, (0, 0, 0, 1)).flatten(0, 1)
        density = self.extinction.unsqueeze(-1)
        both = torch.cat([density.expand(len(sources), -1, 1), density * sources], -1)
        return pad(both, (0, 0, 0, 1)).mT.index_select(-1, self.rows.long()).unflatten(-1, self.shape)

    def _composited(
        self, table: Tensor, cells: int, place: Tensor, pace: Tensor, near: Tensor, far: Tensor, number: Tensor
    ) -> tuple[Float[Tensor, "R D"], Float[Tensor, "R"]]:
        if self.reading == "exact":
            planes = [torch.arange(count + 1, device=place.device) for count in self.shape]
            met = [(planes[axis] - place[:, axis, None]) / pace[:, axis, None] for axis in range(3)]
            at = torch.minimum(torch.maximum(torch.cat(met, -1), near.unsqueeze(-1)), far.unsqueeze(-1))
            # The ends too, as a ray may begin or end inside.
            at = torch.cat([near.unsqueeze(-1), at, far.unsqueeze(-1)], -1).sort(-1).values
            length, middle = at.diff(dim=-1), (at[:, 1:] + at[:, :-1]) / 2
        else:
            assert self.samples is not None
            steps = (torch.arange(self.samples, device=place.device, dtype=place.dtype) + 0.5) / self.samples
            length = ((far - near) / self.samples).unsqueeze(-1)
            middle = near.unsqueeze(-1) + (far - near).unsqueeze(-1) * steps
        if self.reading == "trilinear":
            return self._between(table, place, pace, middle, length, number)
        with torch.no_grad():
            index = torch.zeros_like(middle, dtype=torch.int32)
            for axis, count in enumerate(self.shape):
                there = place[:, axis, None] + middle * pace[:, axis, None]
                index = index * count + there.clamp(0, count - 1).int()
            row = self.rows[index]
        density = pad(self.extinction, (0, 1))
        depth = density.index_select(0, row.flatten()).view(row.shape) * length.to(density.dtype)
        behind = depth.cumsum(-1)
        weights = torch.exp(depth - behind) * -torch.expm1(-depth)
        seen = with_all_derivatives(_bags, _gathered, table, weights, row + (cells + 1) * number.unsqueeze(-1))
        return seen, torch.exp(-behind[:, -1])

    def _between(
        self, table: Tensor, place: Tensor, pace: Tensor, middle: Tensor, length: Tensor, number: Tensor
    ) -> tuple[Float[Tensor, "R D"], Float[Tensor, "R"]]:
        if values_are_at_hand(place, table):
            read = self._read_where_held(table, place, pace, middle, number)
        else:
            there = place.unsqueeze(-2) + middle.unsqueeze(-1) * pace.unsqueeze(-2)
            read = with_all_derivatives(_interpolated, _corners, table, self._relative(there), number)
        density, glow = read[0], read[1:]
        length = length.to(density.dtype)
        depth = density * length
        behind = depth.cumsum(-1)
        # (1 - e^(-x)) / x, and what it is near to where x rounds it away.
        thin = depth < 1e-3
        safe = torch.where(thin, 1.0, depth)
        share = torch.where(thin, 1 - depth / 2 * (1 - depth / 3), -torch.expm1(-safe) / safe)
        weights = torch.exp(depth - behind) * share * length
        return (glow * weights).sum(-1).mT, torch.exp(-behind[:, -1])

    def _read_where_held(
        self, table: Tensor, place: Tensor, pace: Tensor, middle: Tensor, number: Tensor
    ) -> Float[Tensor, "D R S"]:
        """What is read at all steps, looked up only where there is anything."""
        with torch.no_grad():
            index = torch.zeros_like(middle, dtype=torch.int32)
            for axis, count in enumerate(self.shape):
                there = place[:, axis, None] + middle * pace[:, axis, None] + 0.5
                index = index * (count + 1) + there.clamp(0, count).int()
            kept = self.held[index.flatten()].nonzero()[:, 0]
            ray = kept // middle.shape[1]
        there = place[ray] + middle.flatten()[kept].unsqueeze(-1) * pace[ray]
        read = with_all_derivatives(
            _interpolated, _corners, table, self._relative(there).unsqueeze(0), number[ray].unsqueeze(0)
        )
        whole = read.new_zeros(read.shape[0], middle.numel()).index_copy(1, kept, read[:, 0])
        return whole.view(len(whole), *middle.shape)

    def _relative(self, there: Float[Tensor, "*R 3"]) -> Float[Tensor, "*R 3"]:
        """Places in cells as `grid_sample` has them, from -1 to 1."""
        size = torch.tensor(self.shape, dtype=there.dtype, device=there.device)
        return 2 * there / size - 1

    def _check(self, source: Tensor, origins: Tensor, directions: Tensor, far: Tensor | None) -> None:
        if source.ndim < 2 or source.shape[-2:] != (len(self.extinction), 3):
            raise InputError(
                f"source has shape {list(source.shape)}: the volume has {len(self.extinction)} cells, give "
                f"[..., {len(self.extinction)}, 3]"
            )
        for name, rays in (("origins", origins), ("directions", directions)):
            if rays.ndim < 2 or rays.shape[-1] != 3:
                raise InputError(f"{name} have shape {list(rays.shape)}: give [..., R, 3]")
            if values_are_at_hand(rays) and not bool(rays.isfinite().all()):
                raise InputError(f"{name} hold NaN or infinity: give finite numbers")
        if values_are_at_hand(directions) and not bool(directions.abs().amax(-1).gt(0).all()):
            raise InputError("directions hold a zero vector: give directions in which rays go")
        if far is not None and values_are_at_hand(far) and bool(far.isnan().any()):
            raise InputError("far holds NaN: give distances, infinity where there is no surface")


def _most(values: Tensor) -> Tensor:
    """The largest of three, component by component."""
    return torch.maximum(torch.maximum(values[..., 0], values[..., 1]), values[..., 2])


def _bags(table: Tensor, weights: Tensor, index: Tensor) -> Tensor:
    return embedding_bag(index, table, mode="sum", per_sample_weights=weights)


def _gathered(table: Tensor, weights: Tensor, index: Tensor) -> Tensor:
    return (table.index_select(0, index.flatten()).unflatten(0, index.shape) * weights.unsqueeze(-1)).sum(1)


def _interpolated(table: Float[Tensor, "S D X Y Z"], there: Float[Tensor, "R K 3"], number: Tensor) -> Tensor:
    """`[D, R, K]`: between the middles of cells, nothing outside; z is the fastest, as memory has it."""
    if len(table) == 1:
        return grid_sample(table, there.flip(-1)[None, None].to(table.dtype), align_corners=False)[0, :, 0]
    return _corners(table, there, number)


def _corners(table: Tensor, there: Tensor, number: Tensor) -> Tensor:
    sizes = table.shape[2:]
    total: Tensor | None = None
    lows, parts = [], []
    for axis, count in enumerate(sizes):
        at = ((there[..., axis] + 1) * count - 1) / 2
        low = at.detach().floor()
        lows.append(low.long())
        parts.append(at - low)
    flat = table.flatten(2).movedim(1, 0).flatten(1)
    first = number.long().view(*there.shape[:-2], -1) * math.prod(sizes)
    for corner in range(8):
        weight: Any = 1.0
        index: Any = 0
        inside: Any = True
        for axis, count in enumerate(sizes):
            side = corner >> axis & 1
            place = lows[axis] + side
            weight = weight * (parts[axis] if side else 1 - parts[axis])
            inside = inside & (place >= 0) & (place < count)
            index = index * count + place.clamp(0, count - 1)
        kept = torch.where(inside, weight, 0.0).to(flat.dtype)
        read = flat.index_select(1, (first + index).flatten()).view(len(flat), *there.shape[:-1]) * kept
        total = read if total is None else total + read
    assert total is not None
    return total
