"""Which recipes a sweep tries: one factor at a time around a base, and the crossings in which they meet."""

from __future__ import annotations

from dataclasses import dataclass

from torchprt.light import WINDOWS
from torchprt.measure.recipe import Recipe

ORDERS = (2, 3, 4, 5, 6, 8, 10, 12, 14)
# The orders at which other factors are tried too: few bands, those of most bakes, many.
CROSSED = (3, 5, 8)
RAYS = (16, 64, 256, 1024)
CLUSTERS = ((64, 8), (256, 4), (256, 8), (256, 16))
_WIDE = (256, 8)
LOBES = (1, 2, 3)
OUTPUTS = (2, 3, 4, 5, 6, 8)
FACTORS = (2, 4, 8)
VISIBILITIES = (5, 8, 10)
THRESHOLDS = (0.005, 0.01, 0.02)
# Orders below have too few levels above the first.
_ADAPTED = 6
# Receivers a cluster, at least: below, its representatives take more than they save.
_FULL = 16
_BASE = Recipe()


@dataclass(frozen=True)
class Choice:
    """What there is to choose from.

    - `reference`: the recipe that errors are against; no other has more bands, rays or bounces.
    - `receivers`: how many there are. `glosses`: how many different ones lie on them; 0 for a diffuse scene.
    - `baked`: a bake is given, only what comes after it can be chosen; `dense`: it can be compressed.
    """

    reference: Recipe
    receivers: int
    glosses: int = 0
    baked: bool = False
    dense: bool = True

    @property
    def base(self) -> Recipe:
        """What the others differ from: what a bake makes unless it is told otherwise, or the bake that is given."""
        best = self.reference
        if self.baked:
            return best
        order = min(_BASE.order, best.order)
        # Fewer rays than the reference has, whose noise the base would share.
        return best.replace(
            order=order,
            rays=min(_BASE.rays, max(1, best.rays // 4)),
            output_order=None if best.output_order is None else min(order, best.output_order),
        )


def sweep(choice: Choice, quick: bool = False) -> list[Recipe]:
    """The recipes to try, each once: the base first, and last the reference unless it is the base.

    A quick sweep has about a third of them.
    """
    found = [choice.base, *_orders(choice, quick), *_stored(choice, quick), *_run(choice, quick)]
    if not quick:
        found += _windowed(choice)
    if not choice.baked:
        found += [*_rays(choice, quick), *_transport(choice, quick), *_frames(choice, quick)]
    last = [] if choice.baked else [choice.reference]
    return list(dict.fromkeys([*(each for each in found if each not in last), *last]))


def _at(choice: Choice, quick: bool) -> list[Recipe]:
    """The base, and it at the orders that are crossed with other factors."""
    base = choice.base
    orders = [] if quick else [order for order in CROSSED if order < choice.reference.order]
    return [base, *(base.replace(order=order) for order in orders if order != base.order)]


def _orders(choice: Choice, quick: bool) -> list[Recipe]:
    base, best = choice.base, choice.reference
    orders = [order for order in ORDERS if order < best.order and not (quick and order in (4, 8))]
    return [base.replace(order=order) for order in (*orders, best.order)]


def _windowed(choice: Choice) -> list[Recipe]:
    return [each.replace(window=window) for each in _at(choice, False) for window in WINDOWS if window != "none"]


def _narrow(choice: Choice) -> tuple[str, ...]:
    # A file that is narrow already, or compressed, stays as it is.
    return ("float16", "bfloat16") if choice.dense and choice.base.dtype == "float32" else ()


def _stored(choice: Choice, quick: bool) -> list[Recipe]:
    found = [each.replace(dtype=dtype) for each in _orders(choice, quick) for dtype in _narrow(choice)]
    if not choice.dense:
        return found
    plain = choice.base.replace(dtype="float32")
    # As many weights as numbers compress nothing.
    sizes = [each for each in CLUSTERS if each[0] * _FULL <= choice.receivers and each[1] < choice.base.order**2]
    for size in sizes[:1] if quick else sizes:
        # Wide weights lose no less: one of them shows it.
        for bits in (32, 8) if size == _WIDE and not quick else (8,):
            found.append(plain.replace(**dict(zip(("clusters", "components"), size, strict=True)), bits=bits))
    if _WIDE in sizes and not quick:
        for each in _at(choice, quick)[1:]:
            components = min(_WIDE[1], each.order**2 // 2)
            found.append(each.replace(dtype="float32", clusters=_WIDE[0], components=components, bits=8))
    if plain.frame is None:
        found += [plain.replace(lobes=lobes) for lobes in (LOBES[:1] if quick else LOBES)]
    return found


def _run(choice: Choice, quick: bool) -> list[Recipe]:
    base = choice.base if choice.base.dtype != "bfloat16" else choice.base.replace(dtype="float32")
    orders = _at(choice, quick) if quick else _orders(choice, quick)
    found = [each.replace(dtype=base.dtype, runtime="onnx") for each in orders]
    found += [each.replace(runtime="onnx") for each in _stored(choice, True) if each.clusters or each.lobes]
    if not quick:
        found.append(base.replace(runtime="compiled"))
    if choice.reference.order < _ADAPTED or not choice.dense:
        return found
    many = base.replace(order=choice.reference.order)
    return found + [many.replace(adaptive=threshold) for threshold in (THRESHOLDS[1:2] if quick else THRESHOLDS)]


def _rays(choice: Choice, quick: bool) -> list[Recipe]:
    counts = [count for count in (RAYS[2:] if quick else RAYS) if count < choice.reference.rays]
    return [each.replace(rays=count) for each in _at(choice, quick) for count in counts]


def _transport(choice: Choice, quick: bool) -> list[Recipe]:
    """Without the light that surfaces send each other, and without shadows."""
    fewer = [count for count in (0, 1, 2) if count < choice.reference.bounces and not (quick and count)]
    found = [each.replace(bounces=count) for each in _at(choice, quick) for count in fewer]
    plain = choice.base.replace(bounces=0, shadows=False)
    return [*found, *(plain.replace(order=order) for order in (2, 3, plain.order) if order <= plain.order)]


def _frames(choice: Choice, quick: bool) -> list[Recipe]:
    """The ways to hold gloss."""
    base, best = choice.base, choice.reference
    if not choice.glosses:
        return []
    most = best.output_order or best.order
    outputs = [order for order in (OUTPUTS[1::2] if quick else OUTPUTS) if order <= most]
    found = [base.replace(output_order=order) for order in outputs]
    if choice.glosses == 1:
        bare = base.replace(output_order=None)
        found += [bare.replace(factors=count) for count in (FACTORS[1:2] if quick else FACTORS)]
        seen = base.replace(output_order=None, bounces=0, frame="visibility")
        found += [seen.replace(visibility_order=order) for order in (VISIBILITIES[:1] if quick else VISIBILITIES)]
    return found
