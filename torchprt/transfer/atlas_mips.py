"""Smaller versions of a map, in which no texel is of two charts."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.atlas import Atlas

RINGS = 2
"""How many texels around the charts of a level are filled: filters read one beside, and one more at an angle."""
BESIDE = ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1))


def mips(atlas: Atlas, values: Float[Tensor, "*B V D"], smallest: int = 8) -> list[Float[Tensor, "*B H W D"]]:
    """The map of values of the receivers and each half of it, as long as both sides have `smallest` texels or more.

    Level k has rows // 2^k x columns // 2^k texels. Each is the mean of those texels of one chart that fall into it:
    of the chart that has most of them there, of several the one of the lowest number. Around the charts of a level two
    rings of texels are filled from what lies beside them. The rest is zero, level 0 is `Atlas.image`.
    Laws: no texel of a chart has anything of another; the mean of a constant is that constant.
    A filter that is linear between texels reads nothing of another chart in level k if charts lie 3/2 * 2^k texels of
    level 0 apart or more.

    Raises InputError unless `smallest` is 1 or more.
    """
    if smallest < 1:
        raise InputError(f"the smallest level is to have {smallest} texels a side: give 1 or more")
    levels = [atlas.image(values)]
    rows, columns = atlas.rows // 2, atlas.columns // 2
    while min(rows, columns) >= max(smallest, 1):
        levels.append(_level(atlas, values, rows, columns))
        rows, columns = rows // 2, columns // 2
    return levels


def _level(atlas: Atlas, values: Tensor, rows: int, columns: int) -> Tensor:
    texel, chart = atlas.texel.long(), atlas.chart.long()
    place = texel // atlas.columns * rows // atlas.rows * columns + texel % atlas.columns * columns // atlas.columns
    charts = int(chart.amax()) + 1 if len(chart) else 1
    # Ascending by place, then by chart.
    key, number, size = torch.unique(place * charts + chart, return_inverse=True, return_counts=True)
    means = values.new_zeros(*values.shape[:-2], len(key), values.shape[-1]).index_add(-2, number, values)
    means = means / size[:, None].to(values.dtype)
    there = key // charts
    # Of equals the first.
    order = torch.argsort(-size, stable=True)
    order = order[torch.argsort(there[order], stable=True)]
    first = torch.ones_like(order, dtype=torch.bool)
    first[1:] = there[order][1:] != there[order][:-1]
    won = order[first]
    whole = values.new_zeros(*values.shape[:-2], rows * columns, values.shape[-1])
    whole[..., there[won], :] = means[..., won, :]
    filled = torch.zeros(rows * columns, dtype=torch.bool, device=values.device)
    filled[there[won]] = True
    whole, filled = whole.unflatten(-2, (rows, columns)), filled.view(rows, columns)
    for _ in range(RINGS):
        whole, filled = _dilated(whole, filled)
    return whole


def _dilated(
    image: Float[Tensor, "*B H W D"], filled: Bool[Tensor, "H W"]
) -> tuple[Float[Tensor, "*B H W D"], Bool[Tensor, "H W"]]:
    """One ring of texels more, each the copy of one beside it, so that it is of one chart."""
    rows, columns = filled.shape
    source = torch.full((rows, columns), -1, device=filled.device)
    number = torch.arange(rows * columns, device=filled.device).view(rows, columns)
    for down, right in BESIDE:
        here, there = _shifted(rows, down), _shifted(rows, -down)
        left, far = _shifted(columns, right), _shifted(columns, -right)
        free = (source[here, left] < 0) & filled[there, far] & ~filled[here, left]
        source[here, left] = torch.where(free, number[there, far], source[here, left])
    taken: Int[Tensor, "H W"] = torch.where(source >= 0, source, number)
    flat = image.flatten(-3, -2)
    return flat[..., taken.flatten(), :].unflatten(-2, (rows, columns)), filled | (source >= 0)


def _shifted(length: int, by: int) -> slice:
    """The places that have one at a distance `by` before them."""
    return slice(max(by, 0), length + min(by, 0))
