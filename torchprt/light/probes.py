"""Sample points about an object, at which its incident light is captured, and weights that blend between them."""

from __future__ import annotations

import dataclasses
import math

import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer import Transfer, Vertices

# Of a spacing of the points: how far off the surface they lie, so that more of it is in their hull.
LIFT = 0.1
# Up to so many points are the centres of what they stand for, in the model. Measured, as LIFT, under lamps one radius
# from a sphere.
FEW = 4
# Of the weights in units of the spacing: how fast they fall with the square of the distance, and how much the points of
# the surface that are out of the hull are kept from leaning on the nearest corner alone.
FALLOFF, RIDGE = 3.0, 1e-2
SAMPLES, RESTARTS, ROUNDS, NEWTON = 4096, 4, 40, 60
# Powers of the plastic number: a low-discrepancy sequence of the square (Roberts 2018).
SEQUENCE = 0.7548776662466927, 0.5698402909980532
# Numbers that are worked on at once.
PIECE = 1 << 23


def sample_points(
    positions: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], count: int, *, seed: int = 0
) -> Float[Tensor, "S 3"]:
    """S = `count` points close to a surface and spread evenly over it, where its incident light is captured.

    Centres of equal shares of the area (Lloyd's iteration over points of the surface, the best of some beginnings),
    brought back to the surface and moved off it, the way that its faces look, by a tenth of their spacing. Few points
    stay where the centres are, as each stands for all of a side, one for the whole; 16 go 94 % of the way.
    Without faces the positions themselves are shared out, and are not moved off.
    The same points for the same `seed`, wherever vertices are doubled; where the surface is in the world and how large
    it is makes no other difference than rounding. float64 inside, the result has the dtype of `positions`.

    Raises InputError if `count` is below 1, there is no vertex, one is not finite, or all areas are zero.
    Source: Sloan, Kautz and Snyder 2002, section 6.1; Lloyd 1982, "Least squares quantization in PCM".
    """
    if count < 1:
        raise InputError(f"{count} sample points: give 1 or more")
    if len(positions) == 0 or not bool(positions.isfinite().all()):
        raise InputError("positions must be one or more finite points: there is no surface to put sample points about")
    where, scale, placed = _normalised(positions, positions)
    samples, normals, area = _on_surface(placed, faces.long(), max(SAMPLES, 32 * count), seed)
    if count == 1:
        found = samples.mean(0, keepdim=True)
    else:
        centres, nearest = _shared_out(samples, count, seed)
        off = samples[nearest] + LIFT * math.sqrt(area / count) * normals[nearest]
        found = torch.lerp(centres, off, max(0.0, 1 - (FEW / count) ** 2))
    return (found * scale + where).to(positions.dtype)


def blend_weights(
    points: Float[Tensor, "S 3"], positions: Float[Tensor, "V 3"], *, gradients: bool = False
) -> Float[Tensor, "V K"]:
    """What the light of every one of K = S sample points counts at every position: its blend.

    Weights that are 0 or more, sum to 1 and vary smoothly; in the hull of the points sum_s w_s P_s = p, so that light
    which varies linearly over the object is blended exactly. They are those of the largest entropy that lie closest,
    w_s ~ exp(-b |p - P_s|^2 + lambda . (p - P_s)); lambda is found by Newton's method, and held back a little so that
    there is one out of the hull too. One point has the weight 1.

    With `gradients` K = 4 S: behind the weight of a point those of the derivatives of its light along x, y and z (per
    unit of length, as `incident` and `capture` give them). Light that varies linearly is then exact to half a spacing
    of the points beyond their hull, and quadratically in it: half a step along the gradient of each point cancels what
    their blend is off. Farther out, as on a ground, it goes on by at most a spacing: nothing is extrapolated wildly.

    Moved, turned or scaled together, points and positions give the same weights (those of derivatives grow with the
    unit of length). float64 inside, the result has the dtype of `positions`.
    Raises InputError if there is no point, or one of them or a position is not finite.
    Source: Arroyo and Ortiz 2006, "Local maximum-entropy approximation schemes"; Annen, Kautz, Durand and Seidel 2004,
    "Spherical harmonic gradients for mid-range illumination"; the half step: Guessab, Nouisser and Schmeisser 2006.
    """
    if len(points) == 0:
        raise InputError("there is no sample point: give one or more")
    for name, given in (("points", points), ("positions", positions)):
        if not bool(given.isfinite().all()):
            raise InputError(f"{name} hold NaN or infinity: give finite numbers")
    where, scale, placed = _normalised(points, positions)
    centres = (points.to(torch.float64) - where) / scale
    spacing = _spacing(centres)
    centres, placed = centres / spacing, placed / spacing
    pieces = placed.split(max(1, PIECE // (16 * len(points))))
    found = torch.cat([_blended(centres, piece, gradients, scale * spacing) for piece in pieces])
    return found.to(positions.dtype)


def with_sample_points(transfer: Transfer, count: int, *, gradients: bool = False, seed: int = 0) -> Transfer:
    """The same transfer with `count` sample points about its subject and their blend at every receiver.

    They are stored with its receivers, as `sample_points [S, 3]` and `blend [V, S]` (`[V, 4 S]` with `gradients`);
    `shade.LocalLightShader` and graphs exported with `local` read them. The points lie about all but the ground, and
    the ground takes its light from them too.
    Raises InputError as `sample_points`, for the texels of a patch, which has no place of its own, and
    for a volume.
    """
    vertices = transfer.receivers
    if not vertices.on_surface:
        raise InputError("sample points are for surfaces: a volume is lit by one light from far away")
    if vertices.surface_uv is not None:
        raise InputError("sample points are of vertices: take the transfer there with transfer.to_vertices")
    if not isinstance(vertices, Vertices):
        raise InputError("the transfer is of the texels of a patch, which lies nowhere yet: light it after it is laid")
    subject = vertices
    ground = vertices.ground()
    if bool(ground.any()) and not bool(ground.all()):
        subject = vertices.take((~ground).nonzero()[:, 0])
    points = sample_points(subject.positions, subject.faces, count, seed=seed)
    blend = blend_weights(points, vertices.positions, gradients=gradients)
    return dataclasses.replace(transfer, receivers=vertices.replace(sample_points=points, blend=blend))


def spacing_of(points: Float[Tensor, "S 3"]) -> float:
    """How far sample points are apart: the root of the mean squared distance to the nearest neighbour."""
    _, scale, placed = _normalised(points)
    return _spacing(placed) * scale


def _normalised(*given: Tensor) -> tuple[Tensor, float, Float64[Tensor, "V 3"]]:
    """The middle and the size of all that is given, and the last of them where the middle is 0 and the size 1."""
    points = torch.cat([each.detach().to(torch.float64) for each in given])
    low, high = points.amin(0), points.amax(0)
    where, extent = (low + high) / 2, float((high - low).max())
    scale = 2.0 ** math.ceil(math.log2(extent)) if extent > 0 else 1.0
    return where, scale, (given[-1].to(torch.float64) - where) / scale


def _on_surface(positions: Tensor, faces: Tensor, count: int, seed: int) -> tuple[Tensor, Tensor, float]:
    """Points spread evenly over the area, the unit normals of their faces, and the area."""
    if len(faces) == 0:
        extent = positions.amax(0) - positions.amin(0)
        return positions, torch.zeros_like(positions), float(extent.square().sum())
    corners = positions[faces]
    across = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = torch.linalg.vector_norm(across, dim=-1) / 2
    total = areas.sum()
    if not float(total) > 0:
        raise InputError("the surface has no area: give faces that are not slivers, or no faces")
    generator = torch.Generator().manual_seed(seed)
    first = torch.rand(3, generator=generator, dtype=torch.float64).to(positions.device)
    steps = torch.arange(count, dtype=torch.float64, device=positions.device)
    # Every face gets its share: places along the sum of the areas, and a low-discrepancy sequence within the faces.
    along = (steps + first[0]) / count * total
    face = torch.searchsorted(areas.cumsum(0), along).clamp(max=len(faces) - 1)
    u, v = ((steps * ratio + start) % 1 for ratio, start in zip(SEQUENCE, first[1:], strict=True))
    over = u + v > 1
    u, v = torch.where(over, 1 - u, u), torch.where(over, 1 - v, v)
    shares = torch.stack([1 - u - v, u, v], -1)
    normals = across / (2 * areas[:, None]).clamp(min=torch.finfo(torch.float64).tiny)
    return (shares[..., None] * corners[face]).sum(1), normals[face], float(total)


def _shared_out(
    samples: Float64[Tensor, "M 3"], count: int, seed: int
) -> tuple[Float64[Tensor, "S 3"], Int[Tensor, "S"]]:
    """Centres of `count` equal shares of the samples, and which sample is closest to each."""
    restarts = max(1, min(RESTARTS, PIECE // (4 * len(samples) * count)))
    generator = torch.Generator().manual_seed(seed)
    chosen = [torch.randperm(len(samples), generator=generator) for _ in range(restarts)]
    # More points than samples: some then lie at the same places.
    begin = torch.stack(chosen)[:, torch.arange(count) % len(samples)].to(samples.device)
    centres = samples[begin]
    sums = samples.expand(restarts, *samples.shape)
    for _ in range(ROUNDS):
        nearest = torch.cdist(centres, samples[None], compute_mode="donot_use_mm_for_euclid_dist").argmin(1)
        index = nearest[..., None].expand(-1, -1, 3)
        held = torch.zeros_like(centres[..., 0]).scatter_add_(1, nearest, torch.ones_like(sums[..., 0]))[..., None]
        means = torch.zeros_like(centres).scatter_add_(1, index, sums) / held.clamp(min=1)
        centres = torch.where(held > 0, means, centres)
    distances = torch.cdist(centres, samples[None], compute_mode="donot_use_mm_for_euclid_dist")
    best = distances.amin(1).square().sum(1).argmin()
    return centres[best], distances[best].argmin(1)


def _spacing(points: Float64[Tensor, "S 3"]) -> float:
    """Root of the mean squared distance from a point to its nearest neighbour at another place; 1 if there is none."""
    apart = torch.cdist(points, points, compute_mode="donot_use_mm_for_euclid_dist")
    nearest = torch.where(apart > 0, apart, math.inf).amin(1)
    return float(nearest.square().mean().sqrt()) if bool(nearest.isfinite().all()) else 1.0


def _blended(points: Tensor, positions: Float64[Tensor, "v 3"], gradients: bool, unit: float) -> Tensor:
    """Weights at some positions; all in units of the spacing, which is `unit` long."""
    steps = positions[:, None] - points
    weights = _entropy_weights(steps)
    if not gradients:
        return weights
    left = (weights[..., None] * steps).sum(1, keepdim=True)
    # Far out a light goes on no longer: half a spacing in full, one at the most, without a kink.
    length = torch.linalg.vector_norm(left, dim=-1, keepdim=True)
    far = length.clamp(min=0.5)
    reach = left * torch.where(length > 0.5, (0.5 + 0.5 * (2 * far - 1).tanh()) / far, 1.0)
    slopes = weights[..., None] * ((steps - left) / 2 + reach) * unit
    return torch.cat([weights[..., None], slopes], -1).flatten(1)


def _entropy_weights(steps: Float64[Tensor, "v S 3"]) -> Float64[Tensor, "v S"]:
    """Of the steps d from the points: the softmax of -b |d|^2 + lambda . d, where the logarithm of the sum that it is
    divided by, plus ridge |lambda|^2 / 2, is least. Newton's method with halved steps."""
    far = -FALLOFF * steps.square().sum(-1)
    ridge = RIDGE * torch.eye(3, dtype=steps.dtype, device=steps.device)

    def value(slope: Tensor) -> tuple[Tensor, Tensor]:
        exponents = far + (steps @ slope[..., None])[..., 0]
        return exponents.logsumexp(1) + RIDGE / 2 * slope.square().sum(-1), exponents

    slope = torch.zeros_like(steps[:, 0])
    now, exponents = value(slope)
    for _ in range(NEWTON):
        weights = exponents.softmax(1)
        mean = (weights[..., None] * steps).sum(1)
        gradient = mean + RIDGE * slope
        spread = steps - mean[:, None]
        curved = (weights[..., None] * spread).mT @ spread + ridge
        step = -torch.linalg.solve(curved, gradient)
        falls = (gradient * step).sum(-1)
        length = torch.ones_like(now)
        for _ in range(30):
            following, exponents = value(slope + length[:, None] * step)
            short = following <= now + 1e-4 * length * falls + 1e-14 * now.abs()
            if bool(short.all()):
                break
            length = torch.where(short, length, length / 2)
        slope, now = slope + length[:, None] * step, following
        if bool((-falls <= 1e-18).all()):
            break
    return exponents.softmax(1)
