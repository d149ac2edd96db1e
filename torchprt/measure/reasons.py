"""Why a recipe is as it is: each of its parts against the next cheaper one, in a line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from torchprt.measure.probe import Probe
from torchprt.measure.recipe import Recipe
from torchprt.words import count


def reasons(probe: Probe, recipe: Recipe, error: float) -> Iterator[str]:
    """A line for each part of `recipe` that there is a cheaper one of, with what that would lose."""

    def without(**changes: Any) -> str:
        return f"{probe.error(recipe.replace(**changes)).error:.2%}"

    lost = f"{probe.error(recipe).error:.2%}"
    if recipe.order > 1:
        yield f"order {recipe.order}: {count(recipe.order - 1, 'band')} would lose {without(order=recipe.order - 1)}"
    if recipe.shadows:
        yield f"shadows: without them {without(shadows=False, bounces=0)} is lost"
        yield f"{recipe.rays} rays: {recipe.rays // 2} would lose {without(rays=recipe.rays // 2)}"
    if recipe.bounces:
        fewer = max(number for number in probe.bounce_counts if number < recipe.bounces)
        yield f"{count(recipe.bounces, 'bounce')}: {fewer or 'none'} would lose {without(bounces=fewer)}"
    if recipe.output_order and recipe.output_order > 1:
        rows = recipe.output_order - 1
        yield f"exit functions of order {recipe.output_order}: {rows} would lose {without(output_order=rows)}"
    elif recipe.factors and recipe.factors > 1:
        yield f"{recipe.factors} factors: {recipe.factors // 2} would lose {without(factors=recipe.factors // 2)}"
    elif recipe.frame == "visibility":
        yield "visibility and a product at run time: a number of coefficients instead of a matrix a receiver"
    if recipe.clusters is not None:
        size = f"{recipe.clusters} clusters of {count(recipe.components or 0, 'component')} in {recipe.bits} bits"
        yield f"{size}: the fewest bytes that lose no more"
    if recipe.dtype != "float32":
        yield f"stored in {recipe.dtype}: half of the bytes, {lost} instead of {without(dtype='float32')} is lost"
    yield f"all in all {lost} of {error:.2%} that may be lost" + (", before clusters" if recipe.clusters else "")


def not_required(probe: Probe, recipe: Recipe) -> Iterator[str]:
    """A line for each thing that a recipe can have and this one leaves out, with what it would bring."""
    if not recipe.shadows:
        yield f"no shadows, and no rays: the closed form loses {probe.error(recipe).error:.2%}"
    if recipe.bounces == 0:
        spent = "nothing reflects light to anything" if probe.bounces == 0 else _bounced(probe, recipe)
        yield f"no bounces: {spent}"
    elif recipe.bounces < probe.bounces:
        yield f"no more bounces: {_bounced(probe, recipe)}"
    if recipe.order < probe.order:
        more = probe.error(recipe.replace(order=probe.order)).error
        yield f"no bands from {recipe.order} to {probe.order - 1}: with all of them {more:.2%} is lost"
    if not probe.glossy:
        yield "no matrices and no eye: nothing is glossy"


def _bounced(probe: Probe, recipe: Recipe) -> str:
    if not recipe.shadows or recipe.frame == "visibility":
        whole = probe.reference.replace(bounces=0)
        return f"all of them are {probe.error(whole).error:.2%} of the radiance"
    more = probe.error(recipe.replace(bounces=probe.bounces)).error
    return f"with all of them {more:.2%} is lost"
