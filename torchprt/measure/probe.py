"""A few receivers of a scene under its lights: what recipes lose there, told in seconds and before any bake."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.light import windowed
from torchprt.measure.model import bake_recipe
from torchprt.measure.recipe import Recipe
from torchprt.measure.sample import receivers_of, sample_scene
from torchprt.progress import Report, Silent
from torchprt.scene import Scene
from torchprt.sh import order_of
from torchprt.shade import shader
from torchprt.transfer import Dense, Transfer

RAYS = 8192
"""Of the reference: its noise is a tenth of that of 512 rays."""
# Rays in all that follow bounces over the whole surface, and the fewest a receiver. What a bounce adds is smooth.
_BOUNCE_RAYS, _FEWEST = 1 << 21, 16
_BOUNCE_ORDER, _BOUNCE_OUTPUT = 5, 3
# A further bounce than these changes nothing that anyone plans for.
_MOST_BOUNCES = 4


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
    it comes from a bake of the whole scene with a few rays, at the first five bands. Their noise is in no figure; that
    of the recipe's rays is, for diffuse scenes, with the relative size that it has in direct light.
    A scene that has few receivers, or translucent ones, is baked whole.

    `bounces`: after how many light is spent. `report` is told of the bakes of the whole scene.
    Raises InputError as `bake`, if the scene is glossy and there is no eye, or if the reference is black.
    """

    def __init__(
        self,
        scene: Scene,
        light: Float[Tensor, "B N 3"],
        eyes: Float[Tensor, "E 3"] | None = None,
        *,
        count: int = 800,
        output_order: int = 8,
        seed: int = 0,
        report: Report | None = None,
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
        self._taken: dict[tuple[object, ...], float] = {}
        self._radiance: dict[tuple[object, ...], Tensor] = {}
        self._bounce_radiance: dict[tuple[object, ...], Tensor] = {}
        # Of the scene that is baked, some more than are looked at.
        self._recording = self.scene.geometry().receivers
        self._bounced = self._bounces(scene, chosen, report or Silent())
        self.bounces = max(self._bounced)
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
        """What the receivers send as the recipe bakes them and in its dtype; clusters and lobes are not looked at."""
        key = (*recipe.part("bake", "light").items(), recipe.dtype)
        if key not in self._radiance:
            stored = self.baked(recipe).to(getattr(torch, recipe.dtype))
            narrow = torch.bfloat16 if recipe.dtype == "bfloat16" else torch.float64
            direct = self._shaded(stored, self._light(recipe, self.order), narrow)
            self._radiance[key] = direct + self._added(recipe)
        return self._radiance[key]

    def error(self, recipe: Recipe) -> Estimate:
        """What the recipe loses at the receivers. What clusters and lobes lose comes on top."""
        squares = (self.radiance(recipe) - self.wanted).square().mean((1, 3)) + self._noise_of_bounces(recipe)
        power = self.wanted.square().mean((1, 2, 3))
        worst = int((squares.mean(1) / power).argmax())
        relative = squares[worst] / power[worst]
        mean, deviation = float(relative.mean()), 0.0
        if 1 < len(relative) < self.receivers:
            # Of a mean over one of each run: from successive differences, as neighbours are alike.
            deviation = float(relative.diff().square().mean() / 2 / len(relative)) ** 0.5
        return Estimate(math.sqrt(mean), math.sqrt(mean + 2 * deviation))

    def _noise_of_bounces(self, recipe: Recipe) -> Tensor | float:
        """Squares `[B, v]` of the noise of what bounces bring: the rays find it with the same relative noise as light.

        Of glossy scenes it is left out: direct light is what makes them noisy.
        """
        if recipe.bounces == 0 or self.glossy:
            return 0.0
        noisy = self.reference.replace(rays=recipe.rays, bounces=0)
        exact = self.radiance(self.reference.replace(bounces=0))
        relative = (self.radiance(noisy) - exact).square().mean((1, 2, 3)) / exact.square().mean((1, 2, 3))
        added = self._added(recipe)
        assert isinstance(added, Tensor)
        return relative[:, None] * added.square().mean((1, 3))

    def baked(self, recipe: Recipe) -> Transfer:
        """The direct transfer of the receivers, of all bands of the light: what lights of fewer bands are put under."""
        asked = recipe.replace(order=self.order, bounces=0, window="none")
        if not asked.shadows:
            asked = asked.replace(rays=1)
        key = (*asked.part("bake").items(),)
        if key not in self._baked:
            # Another seed than that of the reference, which would share its noise.
            seed = self._seed + (recipe.rays != RAYS)
            start = time.perf_counter()
            self._baked[key] = receivers_of(bake_recipe(self.scene, asked, progress=False, seed=seed), self.rows)
            self._taken[key] = time.perf_counter() - start
        return self._baked[key]

    def sized(self, recipe: Recipe, channels: int) -> Transfer:
        """Transfer of the receivers, of just the size that the recipe stores of each."""
        whole = self.baked(recipe)
        layers = {}
        for name, layer in whole.layers.items():
            cut = layer.to_order(recipe.order)
            values = cut.signal.dense().values.float()
            layers[name] = cut.replace(signal=Dense(values=values[:1].expand(channels, *values.shape[1:]).contiguous()))
        return whole.with_layers(**layers)

    def seconds(self, recipe: Recipe) -> float:
        """What the bake of all receivers takes on this machine, about: as long a ray as a bake of the few did."""
        if not recipe.shadows:
            return 0.0
        few, many = (self._seconds(recipe.replace(rays=rays)) for rays in (_FEWEST, RAYS))
        a_ray = max(0.0, many - few) / (RAYS - _FEWEST) / self._recording
        direct, spent, rays = self._whole_seconds
        bounce = max(0.0, spent - direct) / max(1, self.bounces) / (rays * self.receivers)
        return self.receivers * recipe.rays * (a_ray + recipe.bounces * bounce)

    def _seconds(self, recipe: Recipe) -> float:
        asked = recipe.replace(order=self.order, bounces=0, window="none")
        self.baked(asked)
        return self._taken[(*asked.part("bake").items(),)]

    def _light(self, recipe: Recipe, order: int) -> Float[Tensor, "B N 3"]:
        """The light that the recipe uses, in `order` bands, those that it lacks zero."""
        kept = min(recipe.order, order)
        used = windowed(self.light[:, : recipe.order**2], recipe.window)[:, : kept**2]
        return torch.cat([used, used.new_zeros(len(used), order**2 - kept**2, 3)], 1)

    def _shaded(
        self, transfer: Transfer, light: Tensor, dtype: torch.dtype = torch.float64
    ) -> Float[Tensor, "B E v 3"]:
        module = shader(transfer, dtype=dtype)
        light = light if dtype == torch.float64 else light.float()
        with torch.no_grad():
            if "eye" not in module.needs:
                found = module(light).double()[:, None]
                return found.expand(-1, 1 if self.eyes is None else len(self.eyes), -1, -1)
            assert self.eyes is not None
            # One after the other: the vectors toward an eye are as large as those of a diffuse layer.
            return torch.stack([module(light, eye=eye).double() for eye in self.eyes.double()], 1)

    @property
    def bounce_counts(self) -> list[int]:
        """How many bounces are told apart: the first few, and as many as light takes to be spent."""
        return sorted(self._bounced)

    def _bounces(self, scene: Scene, chosen: Tensor, told: Report) -> dict[int, Transfer]:
        """The whole scene with the first few bounces and with all, to be shaded at the chosen receivers."""
        rays = min(256, max(_FEWEST, _BOUNCE_RAYS // max(1, self.receivers)))
        order = min(self.order, _BOUNCE_ORDER)
        recipe = Recipe(
            order, rays, frame="exit" if self.glossy else None, output_order=_BOUNCE_OUTPUT if self.glossy else None
        )
        taken: list[float] = []

        def bounced(bounces: int | float) -> Transfer:
            start = time.perf_counter()
            made = bake_recipe(scene, recipe, progress=False, seed=self._seed, bounces=bounces)
            taken.append(time.perf_counter() - start)
            return receivers_of(made, chosen)

        spent = bounced(math.inf)
        last = int(spent.bounces)
        found = {}
        told.start("bounces", min(last, _MOST_BOUNCES + 1) + 1, 1)
        for number in range(min(last, _MOST_BOUNCES + 1)):
            found[number] = bounced(number)
            told.advance(1)
        self._whole_seconds = (taken[-1] if len(taken) == 1 else taken[1], taken[0], rays)
        return {**found, last: spent}

    def _added(self, recipe: Recipe) -> Tensor | float:
        """What the bounces of the recipe add to direct light."""
        if recipe.bounces == 0 or not recipe.shadows:
            return 0.0
        last = max(count for count in self._bounced if count <= recipe.bounces)
        key = last, min(recipe.order, _BOUNCE_ORDER), recipe.window, recipe.order * (recipe.window != "none")
        if key not in self._bounce_radiance:
            light = self._light(recipe, self._bounced[0].order)
            with_, without = (self._shaded(self._bounced[each], light) for each in (last, 0))
            self._bounce_radiance[key] = with_ - without
        return self._bounce_radiance[key]
