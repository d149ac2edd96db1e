"""What a sweep is of: a scene, baked as recipes say and no more often than they differ, or a bake that is given."""

from __future__ import annotations

import math
import time
from typing import Protocol, runtime_checkable

import torch

from torchprt.errors import InputError
from torchprt.measure.keep import Kept, key_of, key_of_scene, key_of_transfer
from torchprt.measure.model import bake_recipe
from torchprt.measure.recipe import Recipe, StoredType
from torchprt.measure.sweep import Choice
from torchprt.progress import Report
from torchprt.scene import Scene
from torchprt.transfer import Dense, Receivers, Transfer
from torchprt.transport import result

# Directions of candidates and of the reference: of one set they would share its noise.
_SEED, _REFERENCE_SEED = 0, 1
# Of the base, baked at it as well to tell what bands cost.
_LOWEST = 2
_BOUNCES = 4
# Seconds that a million rays of one bake take, about; and of a bake apart from its rays.
_A_MILLION, _A_BAKE = 0.15, 1.0


@runtime_checkable
class Subject(Protocol):
    """What can be measured."""

    key: str
    choice: Choice
    receivers: Receivers

    def key_of_bake(self, recipe: Recipe) -> str:
        """What the dense transfer of a recipe is taken from: the same for recipes that share it."""

    def expected(self, recipe: Recipe) -> float:
        """Seconds until `baked` of the recipe answers, about."""

    def begin(self, report: Report) -> Transfer:
        """The transfer of the reference; `choice` is complete when it is there."""

    def baked(self, recipe: Recipe, report: Report) -> Transfer:
        """The dense transfer of the recipe, of its order."""

    def seconds(self, recipe: Recipe) -> tuple[float | None, str]:
        """CPU seconds of a bake of this recipe alone, and how they are known.

        "timed", "interpolated", "given" if it was not made here, or "unknown".
        """

    def compare(self, base: Recipe) -> None:
        """`base` is what other recipes are compared with."""

    @property
    def more_seconds(self) -> float:
        """How long `more` takes, about."""

    def more(self, report: Report) -> None:
        """What `seconds` needs beside the bakes that were made."""

    def channels(self, recipe: Recipe) -> int: ...


class SceneSubject:
    """A scene. A bake has the bands of the reference: of fewer bands it is the first columns, to the bit.

    (Between glossy surfaces to the rounding of float32: products of other shapes add up in another order.)

    What a bake of fewer bands would take is timed at the order of the reference and, for the base, at the lowest; in
    between, and for other rays and bounces in the same proportion, it is interpolated by the number of coefficients.
    """

    def __init__(self, scene: Scene, kept: Kept, *, order: int, rays: int, threads: int | None):
        self.scene, self.kept, self._threads = scene, kept, threads
        self.key = key_of_scene(scene)
        geometry = scene.geometry()
        self.receivers: Receivers = result.vertices(geometry)
        self._glossy = scene.requires().kind == "glossy"
        frame, shown = ("exit", order) if self._glossy else (None, None)
        self._first = Recipe(order, rays, bounces=0, frame=frame, output_order=shown)
        self._glosses = len(geometry.gloss)
        # Until `begin` knows: most scenes have light for so many bounces.
        guess = self._first.replace(bounces=_BOUNCES if bool((geometry.albedo > 0).any()) else 0)
        self.choice = Choice(guess, geometry.receivers, self._glosses)
        self._base = self.choice.base
        self._last: tuple[str, Transfer] | None = None

    def begin(self, report: Report) -> Transfer:
        """Bakes the reference, with bounces until light is spent, and so learns how many there are."""
        transfer = self._whole(self._first, math.inf, report)
        self.choice = Choice(self._first.replace(bounces=transfer.bounces), self.receivers.count, self._glosses)
        self._base = self.choice.base
        return transfer

    def compare(self, base: Recipe) -> None:
        self._base = base

    def channels(self, recipe: Recipe) -> int:
        return self.scene.requires(recipe.bounces).channels

    def key_of_bake(self, recipe: Recipe) -> str:
        whole, bounces = self._of(recipe)
        return self._key(whole, bounces)

    def expected(self, recipe: Recipe) -> float:
        whole, bounces = self._of(recipe)
        if self.kept.has_transfer(self._key(whole, bounces)):
            return 0.05
        return self._bake_seconds(whole, bounces)

    def _bake_seconds(self, whole: Recipe, bounces: int | float) -> float:
        rows = 1 if not self._glossy else (whole.output_order or whole.order) ** 2 / 4
        rays = 0 if not whole.shadows else whole.rays * self.receivers.count / 1e6
        return _A_BAKE + _A_MILLION * rays * (1 + 0.2 * min(bounces, 5)) * max(1.0, rows)

    def baked(self, recipe: Recipe, report: Report) -> Transfer:
        whole, bounces = self._of(recipe)
        return self._whole(whole, bounces, report).to_order(recipe.order)

    @property
    def more_seconds(self) -> float:
        low = self._lowest()
        known = self.kept.record(self._key(low, low.bounces)) is not None
        return 0.0 if known else self._bake_seconds(low, low.bounces)

    def more(self, report: Report) -> None:
        """Times the base at a low order as well."""
        if self.more_seconds:
            low = self._lowest()
            self._bake(low, low.bounces, report)

    def _lowest(self) -> Recipe:
        base = Recipe(**self._base.part("bake"))
        return base.replace(order=min(_LOWEST, self._first.order), output_order=_output(base))

    def seconds(self, recipe: Recipe) -> tuple[float | None, str]:
        whole, bounces = self._of(recipe)
        found = self._timed(whole, bounces)
        if found is None or whole.order == recipe.order:
            return found, "timed" if found is not None else "unknown"
        lowest = self._lowest()
        low = self._timed(lowest, lowest.bounces)
        top, followed = self._of(self._base)
        high = self._timed(top, followed)
        if low is None or not high or top.order == lowest.order:
            return None, "unknown"
        share = (1 - low / high) * (top.order**2 - recipe.order**2) / (top.order**2 - lowest.order**2)
        return found * (1 - share), "interpolated"

    def _timed(self, recipe: Recipe, bounces: int | float) -> float | None:
        record = self.kept.record(self._key(recipe, bounces))
        return None if record is None else float(record["seconds"])

    def _of(self, recipe: Recipe) -> tuple[Recipe, int | float]:
        """The bake that a recipe is taken from, and its bounces."""
        best = self.choice.reference
        plain = Recipe(**recipe.part("bake"))
        if not plain.shadows:
            plain = plain.replace(rays=1)
        # Factors, and what visibility is multiplied to, are made for an order.
        shared = plain.factors is None and plain.frame != "visibility"
        if shared:
            plain = plain.replace(order=best.order, output_order=_output(recipe))
        # That of the reference went on until light was spent, whatever the count came to be.
        same = plain == best
        return plain, math.inf if same else plain.bounces

    def _key(self, recipe: Recipe, bounces: int | float) -> str:
        counted = {**recipe.part("bake"), "bounces": str(bounces), "seed": self._seed(recipe)}
        return key_of("bake", scene=self.key, **counted)

    def _seed(self, recipe: Recipe) -> int:
        return _REFERENCE_SEED if recipe.rays >= self._first.rays else _SEED

    def _whole(self, recipe: Recipe, bounces: int | float, report: Report) -> Transfer:
        key = self._key(recipe, bounces)
        if self._last is None or self._last[0] != key:
            # Before the next is there: they may be large.
            self._last = None
            found = self.kept.transfer(key) if self.kept.has_transfer(key) else self._bake(recipe, bounces, report)
            self._last = key, found
        return self._last[1]

    def _bake(self, recipe: Recipe, bounces: int | float, report: Report) -> Transfer:
        key = self._key(recipe, bounces)
        folder = self.kept.partial(key) if recipe.shadows else None
        before = self.kept.record(key + "-spent") or {"seconds": 0.0}
        start = time.process_time()
        try:
            transfer = bake_recipe(
                self.scene,
                recipe,
                bounces=bounces,
                seed=self._seed(recipe),
                threads=self._threads,
                progress=report,
                checkpoint=folder,
                keep=True,
            )
        finally:
            # A bake that is stopped goes on later; both parts count.
            spent = before["seconds"] + time.process_time() - start
            self.kept.keep(key + "-spent", {"seconds": spent})
        self.kept.keep_transfer(key, transfer)
        self.kept.keep(key, {"seconds": spent, "recipe": recipe.name})
        self.kept.done(key)
        return transfer


class FileSubject:
    """A bake that is given: itself the reference, and what comes after a bake can be chosen."""

    def __init__(self, transfer: Transfer):
        if "reflectance" in transfer.needs:
            raise InputError(
                f"{transfer.kind} transfer leaves the reflectance open, so there is nothing to compare pictures of: "
                "bake with frame exit"
            )
        self.key, self.receivers = key_of_transfer(transfer), transfer.receivers
        self._transfer, self.more_seconds = transfer, 0.0
        dense = all(isinstance(layer.signal, Dense) for layer in transfer.layers.values())
        stored: dict[torch.dtype, StoredType] = {torch.float16: "float16", torch.bfloat16: "bfloat16"}
        widths = {layer.signal.dtype for layer in transfer.layers.values()} if dense else set()
        rows = {layer.metadata().get("output_order") for layer in transfer.eye_layers.values()}
        recipe = Recipe(
            transfer.order,
            max(1, transfer.rays),
            bounces=transfer.bounces,
            shadows=transfer.transport != "unshadowed",
            frame="exit" if transfer.eye_layers else None,
            output_order=max((each for each in rows if each), default=None) if transfer.eye_layers else None,
            dtype=next((stored[each] for each in widths if each in stored), "float32"),
        )
        self.choice = Choice(recipe, transfer.vertices, len(transfer.eye_layers), baked=True, dense=dense)

    def channels(self, recipe: Recipe) -> int:
        return self._transfer.channels

    def key_of_bake(self, recipe: Recipe) -> str:
        return self.key

    def expected(self, recipe: Recipe) -> float:
        return 0.0

    def baked(self, recipe: Recipe, report: Report) -> Transfer:
        return self._transfer if recipe.order == self._transfer.order else self._transfer.to_order(recipe.order)

    def begin(self, report: Report) -> Transfer:
        return self._transfer

    def compare(self, base: Recipe) -> None: ...

    def seconds(self, recipe: Recipe) -> tuple[float | None, str]:
        return None, "given"

    def more(self, report: Report) -> None: ...


def _output(recipe: Recipe) -> int | None:
    """Bands toward the eye that a recipe of frame exit has, also where it says them by its order."""
    if recipe.frame != "exit" or recipe.factors is not None:
        return recipe.output_order
    return recipe.output_order or recipe.order
