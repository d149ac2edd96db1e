"""A few receivers of a scene under its lights: what recipes lose there, told in seconds and before any bake."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.measure.model import bake_recipe, windowed
from torchprt.measure.recipe import Recipe
from torchprt.measure.sample import sample_scene
from torchprt.scene import Scene
from torchprt.sh import order_of
from torchprt.shade import shader
from torchprt.transfer import Transfer

RAYS = 8192
"""Of the reference: its noise is a tenth of that of 512 rays."""
# Rays in all that follow bounces over the whole surface, and the fewest a receiver. What a bounce adds is smooth.
_BOUNCE_RAYS, _FEWEST = 1 << 22, 16
_BOUNCE_ORDER, _BOUNCE_OUTPUT = 5, 3
# A further bounce than these changes nothing that anyone plans for.
_MOST_BOUNCES = 5


@dataclass(frozen=True)
class Estimate:
    """An `error` found at a sample of receivers; `bound`: what the error of all exceeds in about one case of forty."""

    error: float
    bound: float


class Probe:
    """`count` receivers of `scene`, their radiance under `light [B, N, 3]` toward `eyes [E, 3]`, and what recipes give.

    The reference has the bands of the light without a window, 8192 rays, bounces until a further one adds less than
    1e-4, and for gloss exit functions of `output_order`. Errors are relative RMS over the receivers and eyes under one
    light; of several lights the largest counts.
    Direct light is baked at the receivers alone. What bounces add is the same for all recipes that follow as many:
    it comes from a bake of the whole scene with a few rays, at the first five bands, and its noise is in no figure.
    A scene that has few receivers, or translucent ones, is baked whole.

    `bounces`: after how many light is spent. Raises InputError as `bake`, if the scene is glossy and there is no eye,
    or if the reference is black.
    """

    def __init__(
        self,
        scene: Scene,
        light: Float[Tensor, "B N 3"],
        eyes: Float[Tensor, "E 3"] | None = None,
        *,
        count: int = 400,
        output_order: int = 8,
        seed: int = 0,
    ):
        self.order = order_of(light.shape[-2])
        self.glossy = scene.requires().kind == "glossy"
        if self.glossy and eyes is None:
            raise InputError("the scene is glossy: give eyes")
        self.light, self.eyes, self._seed = light.double(), eyes if self.glossy else None, seed
        geometry = scene.geometry()
        self.receivers = geometry.receivers
        whole = geometry.receivers <= 3 * count or bool((geometry.partner >= 0).any())
        self.scene: Scene
        self.rows: Int64[Tensor, "v"]
        if whole:
            self.scene, self.rows = scene, torch.arange(geometry.receivers)
            chosen = self.rows
        else:
            self.scene, self.rows, chosen = sample_scene(scene, count, seed)
        self._baked: dict[tuple[object, ...], Transfer] = {}
        self._radiance: dict[tuple[object, ...], Tensor] = {}
        self._bounced = self._bounces(scene, chosen)
        self.bounces = len(self._bounced) - 1
        self.output_order = output_order
        self.reference = Recipe(
            self.order,
            RAYS,
            bounces=self.bounces,
            frame="exit" if self.glossy else None,
            output_order=output_order if self.glossy else None,
        )
        self.wanted = self.radiance(self.reference)
        power = self.wanted.square().mean((1, 2, 3))
        if not bool((power > 0).all()):
            raise InputError("the scene is black under the light: there is no error to plan for, give another light")

    def radiance(self, recipe: Recipe) -> Float[Tensor, "B E v 3"]:
        """What the receivers send as the recipe bakes them; how it is stored and run is not looked at."""
        key = (*recipe.part("bake", "light").items(),)
        if key not in self._radiance:
            direct = self._shaded(self.baked(recipe), self._light(recipe, self.order), self.rows)
            self._radiance[key] = direct + self._added(recipe)
        return self._radiance[key]

    def error(self, recipe: Recipe) -> Estimate:
        """What the recipe loses at the receivers. What clusters, lobes and narrow types lose comes on top."""
        squares = (self.radiance(recipe) - self.wanted).square().mean((1, 3))
        power = self.wanted.square().mean((1, 2, 3))
        worst = int((squares.mean(1) / power).argmax())
        relative = squares[worst] / power[worst]
        # Of the mean of the squares, whose own error is that of a mean of so many.
        mean = float(relative.mean())
        deviation = float(relative.std()) / math.sqrt(len(relative)) if len(relative) < self.receivers else 0.0
        return Estimate(math.sqrt(mean), math.sqrt(mean + 2 * deviation))

    def baked(self, recipe: Recipe) -> Transfer:
        """The direct transfer of the few, of all bands of the light: what lights of fewer bands are put under."""
        asked = recipe.replace(order=self.order, bounces=0, window="none")
        if not asked.shadows:
            asked = asked.replace(rays=1)
        key = (*asked.part("bake").items(),)
        if key not in self._baked:
            # Another seed than that of the reference, which would share its noise.
            seed = self._seed + (recipe.rays != RAYS)
            self._baked[key] = bake_recipe(self.scene, asked, progress=False, seed=seed)
        return self._baked[key]

    def _light(self, recipe: Recipe, order: int) -> Float[Tensor, "B N 3"]:
        """The light that the recipe uses, in `order` bands, those that it lacks zero."""
        kept = min(recipe.order, order)
        used = windowed(self.light[:, : recipe.order**2], recipe.window)[:, : kept**2]
        return torch.cat([used, used.new_zeros(len(used), order**2 - kept**2, 3)], 1)

    def _shaded(self, transfer: Transfer, light: Tensor, rows: Tensor) -> Float[Tensor, "B E v 3"]:
        module = shader(transfer, dtype=torch.float64)
        with torch.no_grad():
            if "eye" not in module.needs:
                found = module(light)[:, None]
                return found[:, :, rows].expand(-1, 1 if self.eyes is None else len(self.eyes), -1, -1)
            assert self.eyes is not None
            # One after the other: the vectors toward an eye are as large as those of a diffuse layer.
            return torch.stack([module(light, eye=eye)[:, rows] for eye in self.eyes.double()], 1)

    def _bounces(self, scene: Scene, chosen: Tensor) -> list[Transfer]:
        """The whole scene with 0, 1, 2, ... bounces, at the chosen receivers alone; as many as light takes to be spent."""
        self._chosen = chosen
        rays = min(256, max(_FEWEST, _BOUNCE_RAYS // max(1, self.receivers)))
        order = min(self.order, _BOUNCE_ORDER)
        recipe = Recipe(
            order, rays, frame="exit" if self.glossy else None, output_order=_BOUNCE_OUTPUT if self.glossy else None
        )
        spent = bake_recipe(scene, recipe, progress=False, seed=self._seed, **{"bounces": math.inf})
        count = min(int(spent.bounces), _MOST_BOUNCES)
        found = [
            bake_recipe(scene, recipe.replace(bounces=number), progress=False, seed=self._seed)
            for number in range(count)
        ]
        return [*found, spent]

    def _added(self, recipe: Recipe) -> Tensor | float:
        """What the bounces of the recipe add to direct light."""
        if recipe.bounces == 0 or not recipe.shadows:
            return 0.0
        last = self._bounced[min(recipe.bounces, self.bounces)]
        light = self._light(recipe, last.order)
        with_, without = (self._shaded(each, light, self._chosen) for each in (last, self._bounced[0]))
        return with_ - without
