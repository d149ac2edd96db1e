"""Clusters for a recipe before its bake: foretold from a sample of receivers, and tried on it."""

from __future__ import annotations

import torch
from torch import Tensor

from torchprt.compression import foretell
from torchprt.measure.model import bake_recipe, light_under, store_recipe
from torchprt.measure.probe import Probe
from torchprt.measure.recipe import Recipe
from torchprt.measure.recipe_error import error_under
from torchprt.measure.sample import sample_scene
from torchprt.scene import Scene
from torchprt.shade import shader
from torchprt.transfer import Transfer

# Faces whose corners record: three times as many receivers at most.
_SAMPLE = 4096
_BITS = 8
_TRIES = 4
# What the sample says is less than sure.
_MARGIN = 1.15


def clustered(scene: Scene, probe: Probe, recipe: Recipe, error: float) -> tuple[Recipe, float] | None:
    """The recipe with the clusters of fewest bytes that lose at most `error` of radiance under the lights of the probe,
    and what they lose on the sample; None if none do in fewer bytes than the dense transfer.

    The layer that takes the most bytes is compressed, of direct light: what bounces add is smoother.
    """
    sample = _sample(scene, recipe)
    name = max(sample.layers, key=lambda name: sample.layers[name].bytes)
    count, _, rows, columns = sample.layers[name].signal.shape
    part = sample.vertices / probe.receivers
    points = round(count / part)
    sizes = foretell(sample, points, layer=name, bits=_BITS)
    dense = 4 * points * rows * columns
    wanted = _radiance(sample, probe, recipe)
    goal = error / _MARGIN
    for _ in range(_TRIES):
        fitting = [size for size in sizes if size.error <= goal and size.bytes < dense / 2 and size.components]
        if not fitting:
            return None
        best = min(fitting, key=lambda size: size.bytes)
        made = recipe.replace(
            clusters=best.clusters, components=best.components, shared=best.shared or None, bits=_BITS
        )
        fewer = made.replace(clusters=max(1, round(best.clusters * part)))
        lost = error_under(_radiance(store_recipe(sample, fewer), probe, recipe), wanted)
        if lost * _MARGIN <= error and (lost * _MARGIN * 1.3 >= error or goal >= 1):
            return made, lost * _MARGIN
        # Radiance may lose more or less than the signal: in the same proportion.
        goal = min(1.0, best.error * error / (_MARGIN * max(lost, 1e-9)) * 0.98)
    return (made, lost * _MARGIN) if lost * _MARGIN <= error else None


def _sample(scene: Scene, recipe: Recipe) -> Transfer:
    asked = recipe.replace(bounces=0, window="none", dtype="float32")
    geometry = scene.geometry()
    few = scene
    if geometry.receivers > 3 * _SAMPLE and not bool((geometry.partner >= 0).any()):
        few, _, _ = sample_scene(scene, _SAMPLE)
    return bake_recipe(few, asked, progress=False)


def _radiance(transfer: Transfer, probe: Probe, recipe: Recipe) -> Tensor:
    module = shader(transfer)
    light = light_under(recipe, probe.light).float()
    with torch.no_grad():
        if "eye" not in module.needs:
            return module(light)[:, None]
        assert probe.eyes is not None
        return torch.stack([module(light, eye=eye) for eye in probe.eyes.float()], 1)
