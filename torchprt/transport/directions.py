"""The set of directions that all receivers share, and the local frames that carry it to the world."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh import fibonacci

GOLDEN = (math.sqrt(5) - 1) / 2


def hemisphere(count: int, seed: int = 0) -> Float[Tensor, "D 3"]:
    """`count` directions spread evenly over the hemisphere z > 0 (spherical Fibonacci), float64.

    Each stands for the solid angle `2 pi / count`. `seed` turns the set about z. One shared set gives every receiver
    the same small bias, which is not seen, where sets of their own would give neighbours different noise, which is.
    Raises InputError for less than one direction or a negative seed.
    """
    if count < 1:
        raise InputError(f"rays is {count}: give at least 1")
    if seed < 0:
        raise InputError(f"seed is {seed}: give a number from 0")
    index = torch.arange(count, dtype=torch.float64)
    z = 1 - (index + 0.5) / count
    # The fractional part first: a large angle would lose digits in the sine.
    turn = np.random.default_rng(seed).random()
    angle = 2 * math.pi * torch.frac(index * GOLDEN + turn)
    radius = torch.sqrt(1 - z * z)
    return torch.stack([radius * torch.cos(angle), radius * torch.sin(angle), z], dim=-1)


def sphere(count: int, seed: int = 0) -> Float[Tensor, "D 3"]:
    """`count` directions spread evenly over the whole sphere, each for the solid angle `4 pi / count`, as `hemisphere`.

    Raises InputError as that.
    """
    if count < 1:
        raise InputError(f"rays is {count}: give at least 1")
    if seed < 0:
        raise InputError(f"seed is {seed}: give a number from 0")
    points, _ = fibonacci(count)
    angle = torch.tensor(2 * math.pi * np.random.default_rng(seed).random(), dtype=torch.float64)
    x, y, z = points.unbind(-1)
    return torch.stack([angle.cos() * x - angle.sin() * y, angle.sin() * x + angle.cos() * y, z], -1)


def frames(normals: Float[Tensor, "v 3"]) -> Float[Tensor, "v 3 3"]:
    """Right-handed orthonormal frames whose rows are tangent, bitangent and normal.

    World direction = local direction @ frame. Smooth in the normal but at straight down (-y), where no smooth field
    could go on: neighbours share the small bias of the direction set, so a jump of the frame would show as a seam.
    A zero normal gets the frame of +y; such a receiver has no transfer.
    Source: Frisvad 2012, Building an Orthonormal Basis from a 3D Unit Vector Without Normalization.
    """
    up = torch.tensor([0.0, 1.0, 0.0], dtype=normals.dtype, device=normals.device)
    normals = torch.where((normals == 0).all(-1, keepdim=True), up, normals)
    x, y, z = normals.unbind(-1)
    # 1 + y without cancellation near the pole.
    height = torch.where(y < 0, (x * x + z * z) / (1 - y), 1 + y)
    above = height > 0
    a = torch.where(above, -1 / torch.where(above, height, 1), 0)
    b = x * z * a
    tangent = torch.stack([b, -z, 1 + z * z * a], -1)
    bitangent = torch.stack([torch.where(above, 1 + x * x * a, -1), -x, b], -1)
    return torch.stack([tangent, bitangent, normals], -2)
