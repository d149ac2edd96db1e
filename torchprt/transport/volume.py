"""From a volume to what its cells scatter."""

from __future__ import annotations

import contextlib
import math
import os
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.progress import Report, Silent
from torchprt.scene import Object, Scene, Volume
from torchprt.scene.geometry import gather
from torchprt.trace import Tracer
from torchprt.transfer import Cells, Dense, Diffuse, Layer, Phase, Transfer
from torchprt.transport.bake import check_numbers, kept_in
from torchprt.transport.bounces import SPENT, UNSEEN, Bounces
from torchprt.transport.checkpoint import Checkpoint, place_of
from torchprt.transport.cluster import Cluster, on_clusters
from torchprt.transport.passes import State, VolumeWarning, counted, endless
from torchprt.transport.progress import Bar
from torchprt.transport.stages import Stages
from torchprt.transport.task import Runner
from torchprt.transport.track_surfaces import Blockers
from torchprt.transport.tracks import Medium
from torchprt.transport.volume_tasks import BOTH, GROUPS, Enter, Inside, Scatter
from torchprt.transport.workers import Threads, torch_on_one_thread
from torchprt.version import VERSION

if TYPE_CHECKING:
    from distributed import Client

    from torchprt.transport.object_store import ObjectCheckpoint

NARROW = 0.8
"""Moment of the first band of a phase function that is left out, above which that is warned of: with .77 radiance of a
cloud under a light of order 5 still agreed with a path tracer within 2 %."""
THICK = 2.0
"""Optical depth of a cell above which the coarseness of the grid is warned of."""
# What the cells send varies less with the direction than the light does.
_FEWER = 16
_FEWEST, _A_ROW = 64, 8


@on_clusters
@torch_on_one_thread()
def bake_volume(
    volume: Volume,
    *,
    blockers: Scene | Sequence[Object] = (),
    order: int = 5,
    output_order: int | None = None,
    rays: int = 4096,
    bounces: Bounces = "auto",
    seed: int = 0,
    threads: int | None = None,
    runner: Runner | None = None,
    on: Client | Cluster | str | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    keep: bool = False,
    progress: bool | Report = True,
) -> Transfer:
    """What the cells of a volume scatter of a light: receivers `Cells`, with a layer `Diffuse` if it scatters alike in
    all directions, else `Phase`.

    - `blockers`: a scene or objects whose surfaces block the light; they are black.
    - `order` of the light; `output_order` of what arrives in a cell (that of the light by default, no larger), which a
      phase function needs.
    - `rays`: directions that all cells are swept along, for the light; what cells send to each other is swept along a
      sixteenth of them, but no fewer than 64 and eight a row.
    - `bounces`: how often what was scattered is scattered again: 0, a count, `math.inf` until a pass adds less than
      1e-4 of the transfer (RMS), or "auto", 1e-2. Without end they are not made one by one, see `passes.endless`;
      `bounces` of the result is how many there were.
    - `seed`, `threads`, `runner`, `on`, `checkpoint`, `keep`, `progress` as for `bake`.

    Light is followed exactly through cells that are uniform, along tracks that sample each cell by its volume
    (`tracks`); what a cell gets is its mean along them. A cell that holds nothing costs nothing. `error` of the result
    is half the difference of what each half of the directions says, which is more than that of both.
    Laws: as for `bake`: the same bits whoever runs it and after any interruption, the same at any scale. Under a light
    that is 1 everywhere what arrives in a volume of albedo 1 is 1, up to the `error` and to what passes leave; a pass
    keeps energy to rounding: what cells send is taken by cells or leaves.
    Memory, G being cells that hold something and M rows (1, or the square of the output order): `4 G C M N` bytes for
    the result, and some dozen of its size while it is made; for 309 000 isotropic cells at order 5, with two threads,
    1.6 GB in all. On disk, with a checkpoint, twelve of that size for the light and as much for the passes.

    Warns (`VolumeWarning`) if cells take most of the light, or bands of the phase function are cut off that matter.
    Raises InputError if an argument is out of range or does not fit, as `bake`.
    Source: Sloan, Kautz and Snyder 2002, section 7.
    """
    check_numbers(order, rays, bounces, True, seed, threads, runner)
    moments = _moments(volume, order, output_order)
    _warn_of_depth(volume)
    receivers = _cells(volume)
    albedo = volume.albedo if len(volume.albedo) == 1 else volume.albedo[receivers.cells.long()]
    inside = _inside(volume, receivers, blockers, order, moments, rays, seed)
    channels = 3 if volume.coloured and bounces else 1
    folder = place_of(checkpoint)
    with contextlib.ExitStack() as stack:
        report: Report = progress if not isinstance(progress, bool) else Silent()
        if progress is True:
            report = stack.enter_context(Bar())
        store = stack.enter_context(_store(folder, inside, albedo, bounces))
        if runner is None:
            runner = stack.enter_context(Threads(threads or os.cpu_count() or 1))
        stages = Stages(runner, report, store)
        baked, count, difference = _solved(inside, albedo, channels, bounces, stages)
        if store is not None and not keep:
            store.discard()
    columns = baked.unflatten(2, (channels, -1))
    layer: Layer
    if len(moments) == 1:
        layer = Diffuse(albedo=albedo, signal=Dense(values=columns[0].permute(1, 2, 0).contiguous()))
    else:
        signal = Dense(values=columns.permute(2, 1, 0, 3).contiguous())
        layer = Phase(albedo=albedo, signal=signal, moments=list(moments))
    return Transfer(
        receivers=receivers,
        layers={layer.kind: layer},
        transport="interreflected" if count else "shadowed",
        bounces=count,
        rays=rays,
        seed=seed,
        error=_root_mean_square(difference) / 2,
        signal=_root_mean_square(baked),
        version=VERSION,
    )


def _moments(volume: Volume, order: int, output_order: int | None) -> tuple[float, ...]:
    """Of the phase function, as many as are followed."""
    if output_order is not None and not 1 <= output_order <= order:
        raise InputError(f"output_order is {output_order}: give a number from 1 to {order}, the order of the light")
    if volume.isotropic:
        return (1.0,)
    kept = volume.moments[: output_order or order]
    left = max(map(abs, volume.moments[len(kept) :]), default=0.0)
    if left > NARROW:
        warnings.warn(
            f"{volume.name} scatters more narrowly than {len(kept)} bands can say: the next band of its phase function "
            f"has the moment {left:.2f}; give a larger order, or a phase function that is wider",
            VolumeWarning,
            stacklevel=4,
        )
    return kept


def _warn_of_depth(volume: Volume) -> None:
    deepest = float(volume.extinction.max()) * max(volume.spacing)
    if deepest > THICK:
        warnings.warn(
            f"cells of {volume.name} are up to {deepest:.2g} mean free paths thick: light falls off inside of them, of "
            "which only the mean is kept; give a finer grid, or less extinction",
            VolumeWarning,
            stacklevel=4,
        )


def _cells(volume: Volume) -> Cells:
    number = torch.nonzero(volume.occupied.flatten())[:, 0]
    return Cells(
        shape=volume.shape,
        origin=volume.origin,
        spacing=volume.spacing,
        cells=number.to(torch.int32),
        extinction=volume.extinction.flatten()[number].contiguous(),
    )


def _inside(
    volume: Volume,
    receivers: Cells,
    blockers: Scene | Sequence[Object],
    order: int,
    moments: tuple[float, ...],
    rays: int,
    seed: int,
) -> Inside:
    places = receivers.places().long()
    lowest = places.amin(0)
    extent = (places.amax(0) - lowest + 1).tolist()
    spacing = torch.tensor(volume.spacing, dtype=torch.float64)
    unit = float(spacing.log().mean().exp())
    extinction = (receivers.extinction.double() * unit).to(torch.float32)
    medium = Medium(places - lowest, (extent[0], extent[1], extent[2]), extinction, spacing / unit)
    surfaces = None
    objects = blockers.objects if isinstance(blockers, Scene) else tuple(blockers)
    if objects:
        geometry = gather(objects)
        corner = torch.tensor(volume.origin, dtype=torch.float64) + lowest * spacing
        surfaces = Blockers(Tracer(geometry.positions, geometry.faces), corner, spacing)
    return Inside(medium, order, moments, rays, seed, surfaces)


def _solved(
    inside: Inside, albedo: Float[Tensor, "rows C"], channels: int, bounces: Bounces, stages: Stages
) -> tuple[Float[Tensor, "M G W"], int, Float[Tensor, "M G W"]]:
    """What arrives, after how many passes, and the difference between the two halves of all directions."""
    halves = [
        _summed(
            "light",
            [Enter(slice(0, inside.order**2), g, inside.rays, half) for g in range(6)],
            stages,
            6 * half,
            inside,
        )
        for half in (0, 1)
    ]
    direct, difference = (halves[0] + halves[1]) / 2, halves[1] - halves[0]
    if bounces == 0 or not bool(albedo.any()):
        return direct.repeat(1, 1, channels), 0, difference
    direct, difference = direct.repeat(1, 1, channels), difference.repeat(1, 1, channels)
    factors = albedo.expand(-1, channels).repeat_interleave(inside.order**2, 1)
    rays = max(_FEWEST, _A_ROW * inside.rows, inside.rays // _FEWER)
    tasks = [
        Scatter(slice(first, first + inside.order**2), group, rays, BOTH)
        for first in range(0, direct.shape[2], inside.order**2)
        for group in range(len(GROUPS))
    ]

    def once(number: int, arrived: Tensor, half: int = BOTH) -> Tensor:
        some = tasks if half == BOTH else [Scatter(each.rows, each.group, rays, half) for each in tasks]
        return _summed(f"pass {number}", some, stages, None, inside, arrived * factors)

    def kept(state: State) -> None:
        if stages.store is not None:
            stages.store.save(_STATE + state.count % 2, state.tensors())

    state = _latest(stages)
    if isinstance(bounces, int) or bounces not in (math.inf, "auto"):
        state = counted(direct, once, int(bounces) - 1, state, kept)
    else:
        # Per unit of volume, which all cells have alike.
        weight = (inside.medium.extinction.double()[:, None] * factors.double())[None]
        state = endless(direct, once, weight, UNSEEN if bounces == "auto" else SPENT, state, kept)
    # The sum of all passes is one more from the sum of all but the last, also where they were not made one by one; and
    # its halves tell the error of the directions.
    last = [once(state.count + 1, state.arrived, half) for half in (0, 1)]
    return direct + (last[0] + last[1]) / 2, state.count + 1, difference + last[1] - last[0]


# The numbers in the store of the last two states, after those of the light.
_STATE = 12


def _latest(stages: Stages) -> State | None:
    """Where a bake that was stopped had come to."""
    found = [] if stages.store is None else [stages.store.load(_STATE + parity) for parity in (0, 1)]
    states = [State.of(each) for each in found if each is not None]
    return max(states, key=lambda state: state.count, default=None)


def _summed(stage: str, tasks: Sequence[Enter | Scatter], stages: Stages, first: int | None, *shared: object) -> Tensor:
    """The sum of what all groups of directions bring, in their order whoever was first, columns side by side."""
    waiting: dict[int, Tensor] = {}
    number = {id(task): place for place, task in enumerate(tasks)}
    parts: list[Tensor] = []
    due = 0
    for task, found in stages.run(stage, tasks, *shared, first=first):
        waiting[number[id(task)]] = found["arrives"]
        while due in waiting:
            if due % len(GROUPS):
                parts[-1] += waiting.pop(due)
            else:
                parts.append(waiting.pop(due).clone())
            due += 1
    return torch.cat(parts, 2)


def _root_mean_square(values: Tensor) -> float:
    return float(torch.linalg.vector_norm(values, dtype=torch.float64)) / math.sqrt(values.numel())


@contextlib.contextmanager
def _store(
    folder: Path | str | None, inside: Inside, albedo: Tensor, bounces: Bounces
) -> Iterator[Checkpoint | ObjectCheckpoint | None]:
    """The named folder, if any."""
    if folder is None:
        yield None
        return
    medium = inside.medium
    contents = [medium.places, medium.extinction, medium.spacing, albedo, torch.tensor(inside.moments)]
    if inside.blockers is not None:
        contents += [inside.blockers.tracer.corners(), inside.blockers.corner, inside.blockers.spacing]
    parameters: dict[str, object] = {"order": inside.order, "rays": inside.rays, "seed": inside.seed}
    parameters |= {"bounces": str(bounces), "version": VERSION}
    with kept_in(folder, contents, parameters) as store:
        yield store
