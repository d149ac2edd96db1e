"""The plot of a sweep: error against time and against bytes, with what is lost where either is halved."""

from __future__ import annotations

import math
import os
import textwrap
from typing import TYPE_CHECKING, Any

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.measure.front import COSTS, Cost, Point, amount, apart, percent
from torchprt.measure.recipe import Recipe

if TYPE_CHECKING:
    from torchprt.measure.tradeoff import Tradeoff

# Of every kind of recipe: how it is drawn. The first that fits counts.
_KINDS = {
    "without shadows": ("#8a8a8a", "x"),
    "fewer bounces": ("#8a8a8a", "+"),
    "clusters": ("#d1495b", "s"),
    "lobes": ("#00798c", "^"),
    "factors or visibility": ("#6a4c93", "v"),
    "adaptive": ("#2b2d42", "P"),
    "narrow types": ("#edae49", "D"),
    "dense": ("#30638e", "o"),
}
_LABELS = {"seconds": "milliseconds a frame, one thread", "bytes": "megabytes"}
_UNITS = {"seconds": 1e3, "bytes": 2.0**-20}
# Errors below, as of what only rounds otherwise than the bake that was given, are drawn here.
_LEAST = 1e-4
# In costs of the dearest point of the front: what costs more stands here, beside what it costs.
_EDGE = 10.0


def save_plot(found: Tradeoff, path: str | os.PathLike[str]) -> None:
    """Writes the two panels and their key as .png: numbers are those of `fronts`, filled marks run in ONNX Runtime.

    Raises InputError if matplotlib is not installed or the file cannot be written.
    """
    check_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    numbered = {point.recipe: number for number, point in enumerate(found.fronts(), 1)}
    lines = _key(found, numbered)
    half = (len(lines) + 1) // 2
    tall = 0.18 * half + 0.1
    figure = Figure(figsize=(13, 6.2 + tall), layout="constrained", dpi=100)
    FigureCanvasAgg(figure)
    panels, words = figure.subfigures(2, 1, height_ratios=(6.2, tall))
    for axes, by in zip(panels.subplots(1, 2), COSTS, strict=True):
        _panel(axes, found, by, numbered)
    for column, part in enumerate((lines[:half], lines[half:])):
        place = 0.012 + 0.5 * column
        words.text(place, 0.98, "\n".join(part), va="top", fontsize=8.5, family="DejaVu Sans Mono", linespacing=1.35)
    lights = ", ".join(found.lights)
    said = f"{found.name} under {lights}. Base: {found.base.recipe.name}. Errors against {found.reference.name}."
    figure.suptitle(said, fontsize=10)
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def check_matplotlib() -> None:
    """Raises InputError if matplotlib is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as fault:
        raise InputError("the plot needs matplotlib: install torchprt[tradeoff]") from fault


def kind_of(recipe: Recipe) -> str:
    """How a recipe is drawn."""
    if not recipe.shadows:
        return "without shadows"
    if recipe.clusters is not None:
        return "clusters"
    if recipe.lobes is not None:
        return "lobes"
    if recipe.factors is not None or recipe.frame == "visibility":
        return "factors or visibility"
    if recipe.adaptive is not None:
        return "adaptive"
    return "narrow types" if recipe.dtype != "float32" else "dense"


def _kind(found: Tradeoff, recipe: Recipe) -> str:
    kind = kind_of(recipe)
    fewer = recipe.bounces < found.reference.bounces and recipe.frame != "visibility"
    return "fewer bounces" if kind == "dense" and fewer else kind


def _panel(axes: Any, found: Tradeoff, by: Cost, numbered: dict[Recipe, int]) -> None:
    points = found.candidates
    edge = _EDGE * max(point.cost(by) for point in (found.base, *found.front(by)))
    for kind, (colour, mark) in _KINDS.items():
        for onnx in (False, True):
            those = [p for p in points if _kind(found, p.recipe) == kind and (p.recipe.runtime == "onnx") == onnx]
            if not those:
                continue
            filled = {} if mark in "x+" else {"facecolors": colour if onnx else "none", "edgecolors": colour}
            plain = {"c": colour} if mark in "x+" else {}
            x, y = zip(*(_place(point, by, edge) for point in those), strict=True)
            axes.scatter(
                x, y, s=34, marker=mark, linewidths=1.2, alpha=0.75, label=_label(kind, onnx), **filled, **plain
            )
    for point in points:
        if point.cost(by) > edge:
            said = f"{amount(by, point.cost(by))} \u2192"
            place = _place(point, by, edge)
            axes.annotate(said, place, (-6, 0), textcoords="offset points", ha="right", va="center", fontsize=8)
    line = found.front(by)
    x, y = zip(*(_place(point, by) for point in line), strict=True)
    axes.step(x, y, where="post", color="black", linewidth=1.3, zorder=1, label="front: nothing beats these")
    for point in line:
        axes.annotate(
            str(numbered[point.recipe]),
            _place(point, by),
            (-4, -5),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=8.5,
        )
    axes.set(xscale="log", yscale="log", xlabel=_LABELS[by], ylabel="error, % (relative RMS, worst light)")
    axes.grid(alpha=0.25, which="both")
    _plain_ticks(axes)
    _halves(axes, found, by)
    if by == "seconds":
        axes.legend(fontsize=8, loc="best", framealpha=0.85)


def _place(point: Point, by: Cost, edge: float = math.inf) -> tuple[float, float]:
    return _UNITS[by] * min(point.cost(by), edge), 100 * max(point.error, _LEAST)


def _halves(axes: Any, found: Tradeoff, by: Cost) -> None:
    """The base, the best of half its cost, and an arrow from one to the other; in words above the panel."""
    base, half = found.base, found.halved(by)
    from_ = _place(base, by)
    axes.axvline(from_[0], color="black", linewidth=0.8, linestyle=":")
    axes.axvline(from_[0] / 2, color="black", linewidth=0.8, linestyle=":")
    axes.axvspan(axes.get_xlim()[0], from_[0] / 2, color="#2a9d4a", alpha=0.06, zorder=0)
    axes.scatter(*from_, s=190, facecolors="none", edgecolors="black", linewidths=1.4, zorder=5)
    axes.annotate("base", from_, (11, -9), textcoords="offset points", va="top", fontsize=10, fontweight="bold")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high)
    # At the bottom, where points so cheap seldom are.
    axes.annotate(
        f"half of {amount(by, base.cost(by))}",
        (from_[0] / 2, low),
        (3, 4),
        textcoords="offset points",
        fontsize=9,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
    )
    if half.point is not None:
        to = _place(half.point, by)
        axes.scatter(*to, s=190, facecolors="none", edgecolors="#2a9d4a", linewidths=2.2, zorder=5)
        arrow = {"arrowstyle": "->", "color": "#2a9d4a", "linewidth": 2, "shrinkA": 8, "shrinkB": 8}
        axes.annotate("", to, from_, arrowprops=arrow, zorder=4)
    said = str(half).replace("->", "\u2192")
    axes.set_title(
        "\n".join(textwrap.wrap(said[0].upper() + said[1:], 70)), fontsize=10.5, loc="left", fontweight="bold"
    )


def _key(found: Tradeoff, numbered: dict[Recipe, int]) -> list[str]:
    by_recipe = {point.recipe: point for point in found.points}
    lines = []
    for recipe, number in numbered.items():
        point = by_recipe[recipe]
        costs = f"{percent(point.error):>8} {amount('seconds', point.seconds):>9} {amount('bytes', point.bytes):>8}"
        lines.append(f"{number:>2} {costs}  {apart(recipe, found.base.recipe)}")
    return lines


def _label(kind: str, onnx: bool) -> str:
    return f"{kind}, ONNX Runtime" if onnx else kind


def _plain_ticks(axes: Any) -> None:
    """Numbers as they are read, without powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
