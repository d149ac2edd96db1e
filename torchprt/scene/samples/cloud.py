"""A cumulus: flat below, like a cauliflower above."""

import numpy as np
from jaxtyping import Float

from torchprt.errors import InputError

from ..volume import Volume

ALBEDO = 0.99
DEPTH = 12.0
"""Optical depth of the cloud from its base to its top, over its middle."""
_PUFFS = [
    (0.0, -0.2, 0.0, 0.56),
    (-0.4, -0.36, 0.08, 0.38),
    (0.36, -0.34, -0.1, 0.4),
    (0.1, -0.3, 0.34, 0.38),
    (-0.08, -0.34, -0.44, 0.37),
    (0.1, 0.26, -0.03, 0.42),
    (-0.22, 0.1, 0.14, 0.38),
    (0.54, -0.46, 0.16, 0.22),
    (-0.56, -0.48, -0.08, 0.21),
]
"""Middle and radius of the balls that the cloud is heaped up of."""
_BASE, _EDGE = -0.62, 0.09
"""Height of the flat underside, and over what distance density rises at an edge."""
_OCTAVES = 4


def cloud(resolution: int = 32, optical_depth: float | int = DEPTH, phase: float | int = 0.0, seed: int = 2) -> Volume:
    """A cumulus in the cube from -1 to 1, `resolution` cells a side, +y up, of albedo .99.

    About a fifth of the cells hold something, densest inside, thin over an edge. `optical_depth` from base to top
    over its middle; `phase` as `Volume` takes it. The same cloud at every resolution, smoother at a low one; another
    `seed` has other billows.

    Raises InputError if `resolution` is below 4 or above 512, or `optical_depth` is not above 0.
    Source: the subject of Sloan, Kautz and Snyder 2002, figure 6; the shape is the project's own, its billows are
    gradient noise (Perlin 1985, and 2002 for the fade).
    """
    if not 4 <= resolution <= 512:
        raise InputError(f"resolution is {resolution}: give a number from 4 to 512")
    if not 0 < optical_depth < np.inf:
        raise InputError(f"optical depth is {optical_depth:g}: give a number above 0")
    # A cell holds the mean over itself: of many points where cells are coarser than billows.
    finer = max(1, -(-64 // resolution))
    middles = (np.arange(resolution * finer) + 0.5) * 2 / (resolution * finer) - 1
    # A sheet of x at a time: few points are in memory at once.
    lattices = [lattice(seed + number) for number in range(_OCTAVES + 1)]
    sheets = [_density(x, middles, lattices) for x in middles]
    density = np.stack([sheet.reshape(resolution, finer, resolution, finer).mean((1, 3)) for sheet in sheets])
    density = density.reshape(resolution, finer, resolution, resolution).mean(1)
    # Hardly anything counts as nothing: such cells would cost as much as others.
    density[density < 0.01] = 0
    across = np.abs((np.arange(resolution) + 0.5) * 2 / resolution - 1) < max(0.2, 1.1 / resolution)
    through = density[across][:, :, across].sum(1).mean() * 2 / resolution
    extinction = (density * (optical_depth / through)).astype(np.float32)
    return Volume(extinction, ALBEDO, origin=(-1.0, -1.0, -1.0), spacing=2 / resolution, phase=phase, name="cloud")


def _density(x: float, middles: Float[np.ndarray, "n"], lattices: list[np.ndarray]) -> Float[np.ndarray, "n n"]:
    """Density in a sheet at x over y and z, from 0 to 1."""
    y, z = np.meshgrid(middles, middles, indexing="ij")
    points = np.stack([np.full_like(y, x), y, z], -1)
    inside = np.full_like(y, -np.inf)
    for *middle, radius in _PUFFS:
        inside = np.maximum(inside, radius - np.linalg.norm(points - np.array(middle), axis=-1))
    # Billows reach no farther.
    near = (inside > -0.25) & (y > _BASE - _EDGE)
    density = np.zeros_like(y)
    if not near.any():
        return density
    chosen = points[near]
    billows = np.zeros(len(chosen))
    for octave in range(_OCTAVES):
        # Folded noise is round outward and creased inward.
        billows += 0.5**octave * np.abs(noise(chosen * 2.7 * 2.1**octave, lattices[octave]))
    depth = inside[near] + 0.55 * (billows - 0.3)
    below = (chosen[:, 1] - _BASE + 0.05 * noise(chosen * 3.0, lattices[_OCTAVES])) / _EDGE
    density[near] = _fade(depth / (2 * _EDGE)) * _fade(below)
    return density


def lattice(seed: int) -> Float[np.ndarray, "64 64 64 3"]:
    """Unit vectors at random."""
    gradients = np.random.default_rng(seed).normal(size=(64, 64, 64, 3))
    return gradients / np.linalg.norm(gradients, axis=-1, keepdims=True)


def noise(points: Float[np.ndarray, "P 3"], gradients: Float[np.ndarray, "64 64 64 3"]) -> Float[np.ndarray, "P"]:
    """Gradient noise, about -.7 to .7, over the `lattice` of the whole numbers, which repeats after 64."""
    corner = np.floor(points).astype(np.int64)
    within = points - corner
    fade = within**3 * (within * (6 * within - 15) + 10)
    total = np.zeros(len(points))
    for offset in np.ndindex(2, 2, 2):
        at = (corner + offset) & 63
        value = (gradients[at[:, 0], at[:, 1], at[:, 2]] * (within - offset)).sum(-1)
        total += value * np.where(offset, fade, 1 - fade).prod(-1)
    return total


def _fade(values: Float[np.ndarray, "P"]) -> Float[np.ndarray, "P"]:
    """From 0 to 1, level at both ends."""
    clipped = np.clip(values, 0, 1)
    return clipped * clipped * (3 - 2 * clipped)
