"""What a frame costs before there is a bake: the transfer of a few receivers, repeated for as many as there are."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.measure.model import frame_of, store_recipe
from torchprt.measure.recipe import Recipe
from torchprt.measure.time import Timing, time_it
from torchprt.transfer import Transfer, Vertices


def repeated(transfer: Transfer, receivers: int) -> Transfer:
    """The transfer of about so many receivers, those of `transfer` again and again, without faces."""
    times = max(1, round(receivers / transfer.vertices))
    layers = {}
    for name, layer in transfer.layers.items():
        count = layer.signal.shape[0]
        every = torch.arange(count).repeat(times)
        rows = None
        if layer.receivers is not None:
            starts = torch.arange(times).repeat_interleave(count) * transfer.vertices
            rows = (layer.receivers.long()[every] + starts).to(layer.receivers.dtype)
        layers[name] = layer.take(every, rows)
    places = Vertices(
        positions=transfer.positions.repeat(times, 1),
        normals=transfer.normals.repeat(times, 1),
        faces=transfer.faces[:0],
    )
    return dataclasses.replace(transfer, receivers=places, layers=layers)


def frame_costs(
    baked: Mapping[Recipe, Transfer],
    receivers: int,
    light: Float[Tensor, "N 3"],
    eye: Float[Tensor, "3"] | None = None,
    *,
    rounds: int = 7,
) -> dict[Recipe, tuple[Timing, int]]:
    """CPU time of a frame of one light and one eye, and bytes, of what each recipe would store of so many receivers.

    `baked`: by the recipe what it bakes of a sample of them, of its order. Interleaved, on one thread; both are scaled
    to the exact number of receivers. Representatives of clusters are as many as in the recipe, however few differ.
    Raises InputError as `frame_of`.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        stored = {recipe: store_recipe(repeated(each, receivers), recipe) for recipe, each in baked.items()}
        frames = {
            str(number): frame_of(each, recipe, light[None], eye)
            for number, (recipe, each) in enumerate(stored.items())
        }
        times = time_it(frames, rounds=rounds)
    finally:
        torch.set_num_threads(threads)
    found = {}
    for number, (recipe, each) in enumerate(stored.items()):
        scale, time = receivers / each.vertices, times[str(number)]
        timing = dataclasses.replace(time, median=time.median * scale, best=time.best * scale)
        found[recipe] = timing, round(each.bytes * scale)
    return found
