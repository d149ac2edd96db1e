"""What textures are over the surface that a vertex stands for: integrals against its hat function."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int
from torch import Tensor

STEPS = np.array([4, 5, 6, 7, *(int(m * 2**e) for e in range(3, 16) for m in (1, 1.25, 1.5, 1.75))])
"""How many samples there may be along a side, so that few patterns of samples serve all faces."""

DENSITY = 2.0
"""Samples for a texel, along each direction. At two the linear interpolation between texels leaves no alias of any
pattern above .1 % of its contrast."""

LEAST = 16
"""Samples along a side of a face that lies within a texel: colours between texels are curved, too."""

LARGEST = 2**16
"""Samples of a face: 256 across, so that a smaller picture, where it takes one, is blurred by less than half a percent
of the face."""

TOTAL = 2**27
"""Samples of all faces together, some seconds."""

CHUNK = 2**15
"""Samples at a time: what is computed of them fits a processor's cache."""

Sample = Callable[[Int[np.ndarray, "f"], Float32[np.ndarray, "S 3"], Sequence[int]], Float32[Tensor, "Q points"]]


def surface_means(
    faces: Int[np.ndarray, "F 3"],
    areas: Float[np.ndarray, "F"],
    count: int,
    texels: Sequence[Float[np.ndarray, "F 3 2"]],
    sample: Sample,
    width: int,
) -> Float64[np.ndarray, "count width"]:
    """Sums of a function over faces, weighted by area and the hat function of each of `count` vertices.

    Element v is int f(x) b_v(x) dA over the faces around v, where b_v is 1 at v, 0 at the other corners and linear
    between: the weights by which a linear interpolation of the values at vertices is f, in the mean over each one-ring.
    Divide by the same of f = 1.

    `faces` are the vertices of the faces' corners; `texels`, of each texture, where their corners are, in texels:
    they say how many samples a face needs. `sample(which faces, barycentric coordinates, level of each texture)` gives
    the function, of `width` numbers, at those points of each of those faces, the points of one face after those of the
    other. There are no random numbers in it.
    """
    total = np.zeros((width, len(faces), 3))
    along, across, first, level = _plan(texels, len(faces))
    key = np.stack([along, across, *level], axis=1) if len(faces) else np.zeros((0, 2), int)
    kinds, which = np.unique(key, axis=0, return_inverse=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    starts = np.searchsorted(which.reshape(-1)[order], np.arange(len(kinds) + 1))
    for number, kind in enumerate(kinds):
        places, weights = _pattern(int(kind[0]), int(kind[1]))
        some = order[starts[number] : starts[number + 1]]
        for shift in range(3):
            # The pattern's rows lie along one side of a face: its longest in texels.
            turned = some[first[some] == shift]
            points = np.roll(places, shift, axis=1)
            hats = torch.from_numpy(points * weights[:, None])
            for at in range(0, len(turned), max(1, CHUNK // len(points))):
                part = turned[at : at + max(1, CHUNK // len(points))]
                values = sample(part, points, kind[2:].tolist()).reshape(width, len(part), len(points))
                total[:, part] = (values @ hats).double().numpy() * areas[part][:, None]
    corner = faces.ravel()
    return np.stack([np.bincount(corner, each.ravel(), minlength=count) for each in total], axis=1)


def _plan(
    texels: Sequence[Float[np.ndarray, "F 3 2"]], count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Samples along a side and across it, which corner that side starts at, and how much smaller each picture is."""
    spans = []
    for corners in texels:
        sides = np.roll(corners, -1, axis=1) - corners
        twice_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        spans.append((np.linalg.norm(sides, axis=2), twice_area))
    if not spans:
        fixed = np.full(count, LEAST)
        return fixed, fixed, np.zeros(count, int), []
    finest = max(range(len(spans)), key=lambda number: float(spans[number][1].sum()))
    first = spans[finest][0].argmax(axis=1)
    row = np.arange(count)
    lengths = [sides[row, first] for sides, _ in spans]
    heights = [area / np.maximum(length, 1e-12) for (_, area), length in zip(spans, lengths, strict=True)]
    along = np.maximum(DENSITY * np.max(lengths, axis=0), LEAST)
    across = np.maximum(DENSITY * np.max(heights, axis=0), LEAST)
    most = float(LARGEST)
    while np.minimum(along * across / 2, most).sum() > TOTAL and most > STEPS[0] ** 2:
        most /= 2
    shrink = np.sqrt(np.minimum(1, most / (along * across / 2)))
    along, across = (STEPS[np.searchsorted(STEPS[:-1], each * shrink)] for each in (along, across))
    level = [
        np.ceil(np.log2(np.maximum(DENSITY * np.maximum(length / along, height / across), 1)) - 1e-6).astype(int)
        for length, height in zip(lengths, heights, strict=True)
    ]
    return along, across, first, level


@lru_cache(maxsize=64)
def _pattern(along: int, across: int) -> tuple[Float32[np.ndarray, "S 3"], Float32[np.ndarray, "S"]]:
    """Barycentric coordinates of samples in rows, and the share of the area that each stands for.

    Rows lie along the side from corner 0 to corner 1, evenly, and have fewer samples the nearer corner 2 is.
    """
    height = (np.arange(across) + 0.5) / across
    count = np.ceil(along * (1 - height)).astype(int)
    row = np.repeat(np.arange(across), count)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    t = height[row]
    s = (place + 0.5) / count[row] * (1 - t)
    weights = (1 - t) / count[row]
    return np.stack([1 - s - t, s, t], axis=1).astype(np.float32), (weights / weights.sum()).astype(np.float32)
