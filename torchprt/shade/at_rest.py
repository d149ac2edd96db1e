"""Transfer that follows a pose as transfer that stands still."""

from __future__ import annotations

import torch

from torchprt.shade.dense import DenseSignal
from torchprt.shade.layer import layer_module
from torchprt.shade.signal import Making
from torchprt.transfer import Dense, Transfer


def at_rest(transfer: Transfer) -> Transfer:
    """The same in the rest pose: signals that follow one become the vectors and matrices that they stand for there.

    Others stay as they are. In float32, or float64 if they are stored so.
    """
    made = {}
    with torch.no_grad():
        for name, layer in transfer.layers.items():
            if layer.signal.follows_pose:
                dtype = torch.promote_types(layer.signal.dtype, torch.float32)
                still = layer_module(layer, Making(transfer.receivers, dtype)).posed(None, None).signal
                assert isinstance(still, DenseSignal)
                made[name] = layer.replace(signal=Dense(values=still.values))
    return transfer.with_layers(**made)
