"""Speed for accuracy on a scene: recipes measured side by side."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.measure.front import Cost, Halved, Point, front, fronts, halved
from torchprt.measure.keep import Kept, default_folder
from torchprt.measure.recipe import Recipe
from torchprt.measure.subject import FileSubject, SceneSubject, Subject
from torchprt.measure.sweeping import Sweeping
from torchprt.measure.views import Views, check_flip
from torchprt.progress import Report, Silent
from torchprt.scene import Scene
from torchprt.sh import order_of
from torchprt.transfer import Transfer
from torchprt.transport.progress import Bar
from torchprt.transport.workers import torch_on_one_thread

ORDER, GLOSSY_ORDER, RAYS = 10, 8, 4096
"""Of the reference: bands for diffuse and for glossy scenes, rays a receiver."""


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """What a sweep found: `points` in the order in which they were tried, the base first.

    `reference`: what errors are against. `base`: what a bake makes unless told otherwise, or the bake that was given.
    `lights` by name, and the `views` that pictures are of; `radiance(point)` is what it gives under the first light.
    """

    name: str
    points: tuple[Point, ...]
    reference: Recipe
    lights: Mapping[str, Float[Tensor, "N 3"]]
    views: Views
    wanted: Float[Tensor, "V 3"]
    radiance: Callable[[Point], Float[Tensor, "V 3"]]

    @property
    def base(self) -> Point:
        """The point that others are compared with."""
        return self.points[0]

    @property
    def candidates(self) -> tuple[Point, ...]:
        """All but the reference, whose error is none by definition."""
        return tuple(point for point in self.points if point.recipe != self.reference)

    def front(self, by: Cost) -> list[Point]:
        """The candidates that none beats in error and seconds, or bytes; see `front`."""
        return front(self.candidates, by)

    def fronts(self) -> list[Point]:
        """The candidates on either front, the least error first; see `fronts`."""
        return fronts(self.candidates)

    def halved(self, by: Cost, times: int = 2) -> Halved:
        """What is lost where a frame takes 1/`times` of the time of the base, or a model so many of its bytes."""
        return halved(self.candidates, self.base, by, times)


@torch_on_one_thread()
def tradeoff(
    source: Scene | Transfer,
    lights: Mapping[str, Float[Tensor, "N 3"]],
    eyes: Float[Tensor, "E 3"] | None = None,
    *,
    order: int | None = None,
    rays: int = RAYS,
    recipes: Sequence[Recipe] | None = None,
    quick: bool = False,
    keep: str | os.PathLike[str] | None = None,
    threads: int | None = None,
    progress: bool | Report = True,
    name: str = "",
) -> Tradeoff:
    """Sweeps what can be chosen for a scene, or for a bake after it was made, and measures each choice.

    - `lights [N, 3]` by name, without a window, of the order of the reference or more: `order`, by default 10, for a
      glossy scene 8, for a bake its own. The reference has so many bands, in glossy scenes also toward the eye, `rays`
      a receiver, and bounces until light is spent; a bake is its own reference.
    - `eyes`: where pictures are seen from, and for what glossy surfaces are shaded; the usual camera if omitted.
    - `recipes`: which to try, the first being what others are compared with; those of `sweep` if omitted, fewer of
      them if `quick`.
    - `keep`: a folder that keeps bakes and measurements by what they are of; `torchprt/tradeoff` in XDG_CACHE_HOME
      or `~/.cache` if omitted. What it holds is not measured again, whatever the sweep; a sweep that is stopped goes
      on from there.
    - `threads` of bakes. Frames are timed on one thread.
    The error of a recipe is that under the light which it serves worst, see `error_under`, over all receivers and
    eyes, by what the recipe runs: in its types and its runtime.

    Raises InputError without lights, if one has too few bands, if recipes ask for more than the reference has, if a
    bake leaves its reflectance open, as `bake`, `compress` and `fit`, without flip-evaluator, and if the folder cannot
    be written; KeyboardInterrupt with all that was measured kept.
    """
    if not lights:
        raise InputError("a sweep needs a light: give one or more")
    check_flip()
    kept = Kept(default_folder() if keep is None else keep)
    subject: Subject
    if isinstance(source, Scene):
        order = order or default_order(source)
        subject = SceneSubject(source, kept, order=order, rays=rays, threads=threads)
    else:
        order = source.order
        subject = FileSubject(source)
    for each, light in lights.items():
        if order_of(len(light)) < order:
            raise InputError(
                f"light '{each}' has {order_of(len(light))} bands, the reference {order}: project it again"
            )
    with _reported(progress) as report:
        sweeping = Sweeping(subject, lights, eyes, recipes, quick, kept, report)
        points = sweeping.points()
    return Tradeoff(
        name or ("scene" if isinstance(source, Scene) else "bake"),
        tuple(points),
        subject.choice.reference,
        lights,
        sweeping.views,
        sweeping.wanted[0][0],
        sweeping.radiance,
    )


def default_order(source: Scene | Transfer) -> int:
    """Bands of the reference where nobody says how many."""
    if isinstance(source, Transfer):
        return source.order
    return GLOSSY_ORDER if source.requires().kind == "glossy" else ORDER


@contextlib.contextmanager
def _reported(progress: bool | Report) -> Iterator[Report]:
    if progress is True:
        with Bar() as bar:
            yield bar
    else:
        yield Silent() if progress is False else progress
