"""Transfer of volumes made by hand, and what is seen of one by definition, in float64 and in loops."""

import itertools
import math

import torch

from torchprt.transfer import Cells, Dense, Diffuse, Phase, Transfer


def cells_of(extinction, origin=(0.0, 0.0, 0.0), spacing=(1.0, 1.0, 1.0)):
    """The receivers of a grid `extinction [X, Y, Z]`."""
    cells = (extinction.flatten() > 0).nonzero()[:, 0]
    return Cells(
        shape=extinction.shape,
        origin=origin,
        spacing=spacing,
        cells=cells.int(),
        extinction=extinction.flatten()[cells].float(),
    )


def random_cells(shape=(3, 4, 2), filled=0.6, seed=0):
    generator = torch.Generator().manual_seed(seed)
    extinction = torch.rand(*shape, generator=generator) + 0.1
    extinction = torch.where(torch.rand(*shape, generator=generator) < filled, extinction, 0.0)
    extinction[0, 0, 0] = 0.5
    return cells_of(extinction, (-0.7, 0.3, 1.1), (0.5, 0.4, 0.9))


def random_volume(kind="diffuse", receivers=None, order=4, channels=1, moments=(1.0, 0.6, 0.3), dtype=torch.float32):
    """Transfer of random numbers; `kind` "diffuse" or "phase"."""
    receivers = random_cells() if receivers is None else receivers
    generator = torch.Generator().manual_seed(7)
    rows = (len(moments) ** 2,) if kind == "phase" else ()
    shape = (receivers.count, *rows, order**2) if rows else (order**2, receivers.count)
    values = torch.randn(channels, *shape, generator=generator, dtype=torch.float64).to(dtype)
    albedo = 0.1 + 0.8 * torch.rand(receivers.count, 3, generator=generator)
    layer = {"signal": Dense(values=values), "albedo": albedo.to(dtype)}
    made = Phase(**layer, moments=list(moments)) if kind == "phase" else Diffuse(**layer)
    return Transfer(receivers=receivers, layers={kind: made})


def seeing_all(receivers, albedo=1.0, order=3):
    """Transfer of cells that all of the light reaches: their source radiance is its mean."""
    values = torch.zeros(1, order**2, receivers.count)
    values[0, 0] = 1 / math.sqrt(4 * math.pi)
    layer = Diffuse(signal=Dense(values=values), albedo=torch.full((1, 1), albedo))
    return Transfer(receivers=receivers, layers={"diffuse": layer})


def ball(cells=16, extinction=1.0, radius=1.0):
    """Cells whose middles are in a ball about the origin."""
    step = 2 * radius / cells
    middles = (torch.arange(cells) + 0.5) * step - radius
    x, y, z = torch.meshgrid(middles, middles, middles, indexing="ij")
    inside = x * x + y * y + z * z < radius * radius
    return cells_of(torch.where(inside, extinction, 0.0), (-radius,) * 3, (step,) * 3)


def puff(cells=24, seed=0):
    """A cloud: a ball with a ragged, soft rim."""
    generator = torch.Generator().manual_seed(seed)
    step = 2 / cells
    middles = (torch.arange(cells) + 0.5) * step - 1
    x, y, z = torch.meshgrid(middles, middles, middles, indexing="ij")
    ragged = torch.zeros(cells, cells, cells)
    for size, share in ((3, 0.25), (6, 0.15), (12, 0.08)):
        noise = torch.randn(1, 1, size, size, size, generator=generator)
        ragged += share * torch.nn.functional.interpolate(noise, (cells,) * 3, mode="trilinear")[0, 0]
    depth = 0.7 - torch.sqrt(x * x + (1.4 * y) ** 2 + z * z) + ragged
    return cells_of(12 * depth.clamp(0, 0.5), (-1.0,) * 3, (step,) * 3)


def by_hand(receivers, source, origin, direction, far=math.inf):
    """Radiance `[3]` and transmittance along one ray, one crossing after the other: what `Composite` computes."""
    extinction = receivers.dense(receivers.extinction.double())
    radiance = receivers.dense(source.double().mT)
    unit = direction.double() / direction.double().norm()
    low, step = (torch.tensor(v, dtype=torch.float64) for v in (receivers.origin, receivers.spacing))
    crossings = {0.0}
    for axis in range(3):
        for plane in range(receivers.shape[axis] + 1):
            if unit[axis] != 0:
                crossings.add(float((low[axis] + plane * step[axis] - origin.double()[axis]) / unit[axis]))
    crossings = sorted(t for t in {*crossings, float(far)} if 0 <= t <= far and t < math.inf)
    seen, through = torch.zeros(3, dtype=torch.float64), 1.0
    for near, end in itertools.pairwise(crossings):
        place = ((origin.double() + (near + end) / 2 * unit - low) / step).floor().long().tolist()
        if all(0 <= i < n for i, n in zip(place, receivers.shape, strict=True)):
            kept = math.exp(-float(extinction[tuple(place)]) * (end - near))
            seen += through * (1 - kept) * radiance[(slice(None), *place)]
            through *= kept
    return seen, through
