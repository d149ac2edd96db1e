"""A pair of bat's wings: a thin sheet between fingers, which light shines through and which flaps."""

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from torch import Tensor

from torchprt.errors import InputError

from ..material import Material
from ..mesh import make_mesh
from ..object import Object
from ..rig import Rig
from ..scene import Scene
from .grid import grid

FINGERS = (0.22, 0.46, 0.66, 0.84)
"""Where along the half span fingers carry the sheet."""

FRONT = (-0.22, -0.3, -0.42, -0.55, -0.66, -0.68, -0.6, -0.46, -0.28, -0.06, 0.2)
"""z of the front edge at even distances along the half span."""

REAR = (0.45, 0.72, 0.9, 0.82, 0.6, 0.25)
"""z of the rear edge at the body, at the fingers and at the tip; between them it is drawn in."""

SHOULDER, WRIST = 0.12, 0.85
"""x of the hinges of a wing, of half span 2."""

TRANSLUCENCY = 0.55


def wing(resolution: int = 96) -> Scene:
    """A pair of wings, 4 units wide along x, spread in the plane y = 0 and seen from above (+y): one thin sheet.

    2 `resolution` columns by `resolution` / 2 rows of squares; between fingers the sheet hangs in folds. It records
    on both sides: the receivers of the upper side come first, then those of the lower.

    Raises InputError if `resolution` is below 16.
    """
    positions, faces, bone = _sheet(resolution)
    albedo = torch.from_numpy(_blend(bone, (0.36, 0.12, 0.07), (0.12, 0.07, 0.05))).float()
    mesh = make_mesh(positions, faces, name="wing")
    return Scene([Object(mesh, Material(albedo, translucency=TRANSLUCENCY))])


def wing_translucency(resolution: int = 96) -> Float32[Tensor, "V"]:
    """How much light the wing of that `resolution` lets through at its receivers: little at its fingers."""
    _, _, bone = _sheet(resolution)
    return torch.from_numpy(TRANSLUCENCY * (1 - 0.9 * bone)).float().repeat(2)


def wing_rig(resolution: int = 96) -> Rig:
    """The joints of the wing of that `resolution`, for the receivers of both of its sides.

    Five: the body, and of the left (-x) and right wing shoulder and wrist. Positive angles raise both wings.
    """
    positions, _, _ = _sheet(resolution)
    x = torch.from_numpy(positions[:, 0]).repeat(2)
    out = x.abs()
    arm, hand = _step(out, 0.0, 2 * SHOULDER), _step(out, WRIST - 0.35, WRIST + 0.35)
    body, arm, hand = 1 - arm, arm * (1 - hand), arm * hand
    left, right = (x < 0).double(), (x >= 0).double()
    weights = torch.stack([body, arm * left, hand * left, arm * right, hand * right], -1)
    pivots = torch.zeros(5, 3, dtype=torch.float64)
    pivots[1:, 0] = torch.tensor([-SHOULDER, -WRIST, SHOULDER, WRIST])
    axes = torch.zeros(5, 3, dtype=torch.float64)
    axes[:, 2] = torch.tensor([1.0, -1.0, -1.0, 1.0, 1.0])
    return Rig(weights, pivots, axes, (-1, 0, 1, 0, 3))


def flap(phase: Float[Tensor, "*B"]) -> Float[Tensor, "*B 5"]:
    """Angles of the joints of `wing_rig` through a beat of the wings, which `phase` counts; 0 is at the top."""
    turn = 2 * torch.pi * phase
    # The hand follows the arm a sixth of a beat later.
    arm, hand = 0.2 + 0.75 * turn.cos(), 0.7 * (turn - torch.pi / 3).cos()
    return torch.stack([torch.zeros_like(arm), arm, hand, arm, hand], -1)


def _sheet(
    resolution: int,
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"], Float[np.ndarray, "V"]]:
    """Positions, faces, and how near each vertex is to a finger, from 0 to 1."""
    if resolution < 16:
        raise InputError(f"resolution is {resolution}: give at least 16")
    flat, faces = grid((-1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 1.0), 2 * resolution, max(resolution // 2, 8))
    side, chord = flat[:, 0], flat[:, 2]
    span = np.abs(side)
    gap, between = _between(span)
    bone = np.exp(-((gap / 0.012) ** 2)) + np.exp(-(((1 - chord) / 0.03) ** 2))
    ends = [0.0, *FINGERS, 1.0]
    front = np.interp(span, np.linspace(0, 1, len(FRONT)), FRONT)
    rear = np.maximum(np.interp(span, ends, REAR) - 0.2 * between * (1 - 0.5 * span), front + 0.02)
    z = rear + (front - rear) * chord
    slack = (1 - chord) ** 1.5
    folds = 0.13 * between * slack * (1 - 0.5 * span) + 0.006 * between * slack * np.sin(2 * np.pi * 22 * span)
    camber = 0.16 * chord * (1 - chord) * (1 - span)
    return np.stack([2 * side, camber - folds, z], axis=1), faces, np.clip(bone, 0, 1)


def _between(span: Float[np.ndarray, "V"]) -> tuple[Float[np.ndarray, "V"], Float[np.ndarray, "V"]]:
    """Distance along the span to the nearest finger, and a hump from 0 to 1 between each two."""
    edges = np.array([0.0, *FINGERS, 1.0])
    cell = np.clip(np.searchsorted(edges, span, side="right") - 1, 0, len(edges) - 2)
    low, high = edges[cell], edges[cell + 1]
    hump = np.sin(np.pi * np.clip((span - low) / (high - low), 0, 1))
    return np.abs(span[:, None] - edges[1:-1]).min(1), hump


def _blend(
    share: Float[np.ndarray, "V"], zero: tuple[float, float, float], one: tuple[float, float, float]
) -> Float[np.ndarray, "V 3"]:
    return np.array(zero) + share[:, None] * (np.array(one) - np.array(zero))


def _step(values: Float[Tensor, "V"], low: float, high: float) -> Float[Tensor, "V"]:
    """From 0 below `low` to 1 above `high`, smoothly."""
    t = ((values - low) / (high - low)).clamp(0, 1)
    return t * t * (3 - 2 * t)
