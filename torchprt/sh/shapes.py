"""Shapes that broadcast."""

from collections.abc import Sequence

import numpy as np
import torch


def broadcast_shapes(*shapes: Sequence[int]) -> torch.Size:
    """`torch.broadcast_shapes`, which loads sympy and torch's symbolic shapes, a sixth of the time that torch takes.

    Sizes that are numbers need neither; those of a graph that is traced are left to torch. Same errors.
    """
    if not (torch.compiler.is_compiling() or torch.jit.is_tracing()):
        try:
            if all(type(size) is int for shape in shapes for size in shape):
                return torch.Size(np.broadcast_shapes(*map(tuple, shapes)))
        except ValueError:
            pass  # Told by torch, as its callers expect it.
    return torch.broadcast_shapes(*shapes)
