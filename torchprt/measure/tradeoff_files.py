"""What a sweep writes: a table, a plot, pictures of where each point of the front errs, and recipes to bake it by."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from torchprt.errors import InputError
from torchprt.files import atomic_folder
from torchprt.measure.front import Point, amount, apart, percent
from torchprt.measure.plot import check_matplotlib, save_plot
from torchprt.measure.recipe import write_recipe
from torchprt.measure.table import Table
from torchprt.preview import error_colours, save_png, sheet

if TYPE_CHECKING:
    from torchprt.measure.tradeoff import Tradeoff

CSV, MARKDOWN, PLOT, SHEET = "table.csv", "table.md", "pareto.png", "front.png"
# Ends of the scale of an error map, relative to the RMS of the reference.
_ENDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_COLUMNS = 2


def save_tradeoff(found: Tradeoff, folder: str | os.PathLike[str]) -> None:
    """Writes `table.csv`, `table.md`, `pareto.png`, `front.png` and `recipe-NN.toml` of the points on the fronts.

    They are numbered as in the plot, the least error first. A folder of an earlier sweep is replaced as a whole.
    Raises InputError if nothing but the reference was tried, matplotlib is not installed, or the folder holds something
    else or cannot be written.
    """
    check_folder(folder)
    check_matplotlib()
    if not found.candidates:
        raise InputError("only the reference was tried: there is nothing to compare, give other recipes")
    with atomic_folder(folder) as made:
        written = table(found)
        written.to_csv(made / CSV)
        written.to_markdown(made / MARKDOWN)
        save_plot(found, made / PLOT)
        save_png(thumbnails(found), made / SHEET)
        for number, point in enumerate(found.fronts(), 1):
            _write(found, point, made / f"recipe-{number:02}.toml")


def check_folder(folder: str | os.PathLike[str]) -> Path:
    """`folder`, if a sweep may be written there: it is not there, empty, or of an earlier sweep. Else InputError."""
    target = Path(folder)
    if target.exists() and not target.is_dir():
        raise InputError(f"{target} is a file: give the name of a folder for the sweep")
    if target.is_dir() and any(target.iterdir()) and not ((target / CSV).is_file() and (target / PLOT).is_file()):
        raise InputError(f"{target} holds something that is no sweep of torchprt: give another folder")
    # Before long work, not after it.
    above = next((each for each in target.parents if each.exists()), target.parent)
    if not above.is_dir():
        raise InputError(f"{target} cannot be made: {above} is a file, choose another folder")
    if not os.access(above, os.W_OK):
        raise InputError(f"{target} cannot be made: no permission in {above}, choose another folder")
    return target


def table(found: Tradeoff) -> Table:
    """All points, in the order in which they were tried."""
    numbered = {point.recipe: number for number, point in enumerate(found.fronts(), 1)}
    made = Table(f"Speed for accuracy: {found.name}, against {found.reference.name}")
    for point in found.points:
        extra: dict[str, float | int | str] = {"psnr": round(point.psnr, 2), "flip": point.flip}
        if point.bake_seconds is not None:
            extra |= {"bake seconds": point.bake_seconds}
        extra |= {"baked": point.baked, "store seconds": point.store_seconds}
        extra |= {f"error, {name}": error for name, error in point.errors.items()}
        if point.recipe in numbered:
            extra["front"] = numbered[point.recipe]
        same = sum(row.name.split(" #")[0] == point.recipe.name for row in made.rows)
        made.add(
            point.recipe.name + (f" #{same + 1}" if same else ""),
            error=point.error,
            seconds=point.timing,
            bytes=point.bytes,
            extra=extra,
        )
    return made


def thumbnails(found: Tradeoff, most: int | None = None) -> torch.Tensor:
    """The reference and the points of the fronts under the first light, each beside a map of its error, `[I, J, 3]`.

    The scale of the maps is one for all; its end stands with the reference. `most`: so many points at most, spread
    over the fronts.
    """
    scale = found.wanted.double().square().mean().sqrt()
    points = list(enumerate(found.fronts(), 1))
    if most is not None and len(points) > most:
        points = [points[round(place * (len(points) - 1) / max(1, most - 1))] for place in range(most)]
    shown = [(number, point, found.radiance(point)) for number, point in points]
    errors = [(radiance - found.wanted).double().square().mean(-1).sqrt() / scale for _, _, radiance in shown]
    tops = sorted(float(error.quantile(0.99)) if len(error) < 1 << 24 else float(error.max()) for error in errors)
    end = next((each for each in _ENDS if each >= tops[len(tops) // 2]), _ENDS[-1])
    blank = torch.ones_like(found.views.picture(found.wanted))
    pictures = [torch.cat([found.views.picture(found.wanted), blank], 1)]
    light = next(iter(found.lights))
    labels = [f"reference, under {light}; red is an error of {100 * end:g} % and more"]
    for (number, point, radiance), error in zip(shown, errors, strict=True):
        painted = found.views.painted(error_colours(error.float(), end))
        pictures.append(torch.cat([found.views.picture(radiance), painted], 1))
        costs = f"{percent(point.error)}, {amount('seconds', point.seconds)}, {amount('bytes', point.bytes)}"
        labels.append(f"{number}  {apart(point.recipe, found.base.recipe)}: {costs}")
    return sheet([_smaller(each) for each in pictures], labels, _COLUMNS)


def _smaller(picture: torch.Tensor) -> torch.Tensor:
    return (
        picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
        .unflatten(0, (-1, 2))
        .unflatten(2, (-1, 2))
        .mean((1, 3))
    )


def _write(found: Tradeoff, point: Point, path: Path) -> None:
    measured = {
        "error": point.error,
        "milliseconds": round(1e3 * point.seconds, 4),
        "bytes": point.bytes,
    }
    if point.bake_seconds is not None:
        measured["seconds"] = round(point.bake_seconds + point.store_seconds, 2)
    notes = (f"{point.recipe.name}, measured by torchprt tradeoff on {found.name}", f"under {', '.join(found.lights)}")
    write_recipe(point.recipe, path, predicted=measured, notes=notes)
