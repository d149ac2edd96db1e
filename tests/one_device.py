"""A device that is not the default one, where there is none: tensors on "meta", and a mode that sees all others."""

import traceback
from pathlib import Path

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import torchprt

FOLDER = str(Path(torchprt.__file__).parent)


class OneDevice(TorchDispatchMode):
    """Every operation with, or of, a tensor on another device than "meta" is a fault, named by where it was asked for.

    Constants that are kept between calls are not seen: they are made once and moved. Values cannot be looked at on
    "meta": `bool(tensor)`, `.item()`, `.tolist()`, `.numpy()` and masks that choose how many raise by themselves.
    """

    def __init__(self):
        super().__init__()
        self.faults = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        made = func(*args, **(kwargs or {}))
        tensors = [leaf for leaf in tree_leaves((args, kwargs, made)) if isinstance(leaf, torch.Tensor)]
        if any(tensor.device.type != "meta" for tensor in tensors):
            places = [f"{frame.filename}:{frame.lineno}" for frame in traceback.extract_stack()]
            own = [place for place in places if place.startswith(FOLDER)]
            self.faults.append(f"{func} at {own[-1] if own else places[-3]}")
        return made


def moved(values):
    """Tensors, in containers, on the device that is not the default one."""
    if isinstance(values, torch.Tensor):
        return values.detach().to("meta").requires_grad_(values.requires_grad)
    if isinstance(values, dict):
        return {name: moved(value) for name, value in values.items()}
    return type(values)(moved(value) for value in values) if isinstance(values, list | tuple) else values


def faults_of(function, *arguments, **named):
    """What `function` does on another device than that of its arguments, and its result."""
    arguments, named = moved(arguments), moved(named)
    with OneDevice() as mode:
        made = function(*arguments, **named)
    results = [leaf for leaf in tree_leaves(made) if isinstance(leaf, torch.Tensor)]
    return mode.faults + [f"result on {leaf.device}" for leaf in results if leaf.device.type != "meta"]
