"""Clustered PCA beside the figures of Sloan, Hall, Hart and Snyder 2003.

    python scripts/published_clusters.py OUT [FIGURE ...]

Writes figure2.png, figure3.png ... into OUT, where it also keeps what it bakes and compresses (delete
it to have it made anew), and prints the numbers. Published values
are those that the paper states in its text and captions: none is read off a plot. The paper's models are not available,
so that ratios and order are compared: its bird is smooth, as the teapot of the samples; its Buddha is bumpy, as the
scanned bunny (TORCHPRT_DATA names a folder with mesh/bunny.ply; without it the sculpture of the samples stands in).
Exit matrices are 25 x 25, of orthonormal exit functions; the paper leaves out one that is nearly redundant.
"""

from __future__ import annotations

import functools
import os
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import published_cluster_plots as plots
import torch
from rich.console import Console
from torch import Tensor

from torchprt import light, preview, sh
from torchprt.compression import (
    clustered_pca,
    compress,
    overdraw,
    superclusters,
)
from torchprt.measure import Table
from torchprt.scene import Material, Mesh, Object, Scene, TangentWarning, read_mesh, samples
from torchprt.shade import shader
from torchprt.transfer import Transfer, load, save
from torchprt.transport import bake

OUT = Path("reproduced")
MATERIAL, CLUSTERS = "ward:0.2,0.4", 256
ORDERS = {"bumpy": 6, "smooth": 5}
STATIC, MOST = (0, 1, 2, 4, 8, 16), 4096
METHODS = ("static", "iterative", "adaptive")
# Squared errors: figure 4 (n' = 3), figure 10, figure 11 (n' = 2, 4, 8, 12), figure 6, and figure 5's overdraw.
FIGURE4 = {"static": 17.7, "iterative": 4.28, "adaptive": 2.54}
FIGURE10 = {"PCA": 101304.0, "VQ": 14799.0, "CPCA": 294.4}
FIGURE11 = {"smooth": (9510.75, 2353.09, 294.421, 66.7495), "bumpy": (40353.5, 21077.5, 8524.1, 4413.01)}
COMPONENTS11 = (2, 4, 8, 12)
FIGURE6 = {"static, n' = 1": 15.293, "iterative, n' = 1": 8.83, "iterative, n' = 2": 2.23, "iterative, n' = 4": 0.432}
FIGURE5 = (2.03, 1.79, 1.60)
EQUAL_COST: dict[str, dict[str, Any]] = {
    "PCA": {"clusters": 1, "components": 20, "method": "pca"},
    "VQ": {"clusters": 1792, "components": 0, "method": "vq"},
    "CPCA": {"components": 8},
}
PICTURE = {"bunny": (340, 330), "teapot": (400, 270), "sculpture": (340, 300)}
VIEWS = {"bunny": (0.25, 0.3, 1.0), "teapot": (0.5, 0.45, 1.0), "sculpture": (0.35, 0.45, 1.0)}


@functools.cache
def mesh(model: str) -> tuple[str, Mesh]:
    """Name and mesh of the "bumpy" or the "smooth" model."""
    if model == "smooth":
        return "teapot", samples.teapot(48_000).objects[0].mesh
    named = os.environ.get("TORCHPRT_DATA")
    path = (Path(named) if named else Path(__file__).parents[2] / "shared" / "data") / "mesh" / "bunny.ply"
    if path.is_file():
        return "bunny", read_mesh(path)
    return "sculpture", samples.organic(35_000).objects[0].mesh


def kept(name: str, scene: Scene, **options: Any) -> Any:
    """The bake of OUT/name, made if it is not there."""
    path = OUT / f"{name}.safetensors"
    if not path.is_file():
        save(bake(scene, rays=1024, progress=False, **options), path)
    return load(path)


@functools.cache
def diffuse(model: str) -> Transfer:
    name, shape = mesh(model)
    order = ORDERS[model]
    return kept(f"{name}_diffuse_{order}", Scene([Object(shape, Material(0.6))]), order=order)


@functools.cache
def glossy(model: str) -> Transfer:
    name, shape = mesh(model)
    scene = Scene([Object(shape, Material(0.0, gloss=MATERIAL))])
    return kept(f"{name}_{MATERIAL.replace(':', '_')}_5", scene, order=5)


def stored(transfer: Transfer) -> Any:
    """The signal of the only layer that there is."""
    (layer,) = transfer.layers.values()
    return layer.signal


def signal(transfer: Transfer) -> Tensor:
    values = stored(transfer).values
    return values.movedim(2 if values.ndim == 3 else 1, 0).flatten(1).float()


def compressed(transfer: Transfer, name: str, **options: Any) -> Transfer:
    """`compress` of a bake, from OUT if it is there."""
    options = {"clusters": CLUSTERS, **options}
    stem = "_".join([name, transfer.kind, str(transfer.order), *(str(value) for value in options.values())])
    path = OUT / f"{stem}.safetensors"
    if not path.is_file():
        save(compress(transfer, **options), path)
    return load(path)


def squared(transfer: Transfer) -> float:
    return float(stored(transfer).squared_error.double().sum())


def static_errors(data: Tensor, clusters: int, components: tuple[int, ...]) -> dict[int, float]:
    """Squared error by n', from one run: static clusters do not depend on n', and PCA vectors are orthonormal."""
    found = clustered_pca(data, clusters, max(components), method="static")
    power = found.weights.double().square().sum(0)
    return {count: float(found.error.sum() + power[count:].sum()) for count in components}


def figure2() -> Table:
    """Static PCA: error over cost by number of clusters."""
    table = Table("figure 2: squared error of static PCA by clusters and n' (20 passes of vector quantisation)")
    curves: dict[str, dict[int, list[tuple[float, float]]]] = {}
    for model in ("smooth", "bumpy"):
        data = signal(diffuse(model))
        points, width = data.shape
        curves[mesh(model)[0]] = {count: [] for count in STATIC}
        clusters = 1
        while clusters <= min(MOST, points):
            errors = static_errors(data, clusters, STATIC)
            for count, error in errors.items():
                cost = points * count + clusters * (count + 1) * width
                curves[mesh(model)[0]][count].append((cost, error))
            shown = {f"n' = {count}": error for count, error in errors.items()}
            table.add(f"{mesh(model)[0]}, {clusters}", extra=shown)
            clusters *= 2
    plots.figure2(curves, OUT / "figure2.png")
    return table


def figure3() -> Table:
    """Static, iterative, adaptive: error by n', 256 clusters."""
    table = Table("figure 3: squared error, relative to static at n' = 3; published: the paper's bird, from figure 4")
    counts = (1, 2, 3, 4, 6)
    curves: dict[str, dict[str, list[float]]] = {}
    for model in ("smooth", "bumpy"):
        name = mesh(model)[0]
        errors = {
            method: [squared(compressed(diffuse(model), name, components=count, method=method)) for count in counts]
            for method in METHODS
        }
        unit = errors["static"][counts.index(3)]
        curves[name] = {method: [error / unit for error in values] for method, values in errors.items()}
        for method, values in curves[name].items():
            extra: dict[str, Any] = {f"n' = {count}": value for count, value in zip(counts, values, strict=True)}
            extra["published, n' = 3"] = FIGURE4[method] / FIGURE4["static"] if model == "smooth" else ""
            table.add(f"{name}, {method}", extra=extra)
    published = {method: error / FIGURE4["static"] for method, error in FIGURE4.items()}
    plots.figure3(counts, curves, published, OUT / "figure3.png")
    return table


def lamps(order: int) -> Tensor:
    turn = sh.yaw_pitch_roll(torch.tensor([-60.0, 0.0, 0.0]))
    return sh.least_window(sh.rotate(light.project(light.studio(256), order), turn))[0]


def still(model: str) -> tuple[preview.Still, Tensor]:
    """The model in a picture, and its eye."""
    name, shape = mesh(model)
    size = PICTURE[name]
    camera = preview.frame(shape.positions, VIEWS[name], aspect=size[0] / size[1])
    transfer = diffuse(model)
    return preview.Still(transfer.positions, transfer.faces, size=size, camera=camera, samples=9), torch.tensor(
        camera.eye
    )


def radiance(transfer: Transfer, eye: Tensor | None = None) -> Tensor:
    options = {} if eye is None else {"eye": eye}
    with torch.no_grad():
        return shader(transfer)(lamps(transfer.order), **options)


def figure4() -> Table:
    """Where the error is, and what it looks like, n' = 3."""
    table = Table("figure 4: squared error at n' = 3, and relative to static")
    for model in ("smooth", "bumpy"):
        name = mesh(model)[0]
        view, _ = still(model)
        found = {method: compressed(diffuse(model), name, components=3, method=method) for method in METHODS}
        errors = {method: squared(each) for method, each in found.items()}
        for method, error in errors.items():
            published = f"{FIGURE4[method]} ({FIGURE4[method] / FIGURE4['static']:.2f})" if model == "smooth" else ""
            ours = f"{error:.3g} ({error / errors['static']:.2f})"
            table.add(f"{name}, {method}", extra={"published (bird)": published, "torchprt": ours})
        # One scale for the three, whose end a hundredth of the vertices of the first exceeds.
        most = float(stored(found["static"]).squared_error.quantile(0.99))
        maps = [
            view.radiance(preview.error_colours(stored(each).squared_error, most), background=1.0)
            for each in found.values()
        ]
        shown = [view.picture(radiance(each), exposure=-2.0) for each in found.values()]
        labels = [f"{method} [{errors[method]:.3g}; paper {FIGURE4[method]}]" for method in METHODS]
        if model == "bumpy":
            labels = [f"{method} [{errors[method]:.3g}]" for method in METHODS]
        page = preview.sheet(maps, labels, 3), preview.sheet(shown, [f"{method}, rendered" for method in METHODS], 3)
        preview.save_png(torch.cat(page), OUT / f"figure4_{name}.png")
    return table


def figure5() -> Table:
    """Overdraw as it is, after reclassification, and in superclusters."""
    budget, components, registers = 0.1, 8, 256
    # As many clusters as fit in the registers of the paper's hardware, four numbers each: section 6.2.
    most = registers // ((components + 1) * 6)
    table = Table(f"figure 5: overdraw; budget {budget:.0%}, at most {most} clusters in a supercluster")
    published = dict(zip(("clusters", "reclassified", "reclassified, superclusters"), FIGURE5, strict=True))
    panels: dict[str, dict[str, tuple[Tensor, float]]] = {}
    for model in ("smooth", "bumpy"):
        name, faces = mesh(model)[0], glossy(model).faces
        plain, moved = (
            stored(compressed(glossy(model), name, components=components, **options)).label.long()
            for options in ({}, {"coherence": budget})
        )
        labels = {
            "clusters": plain,
            "reclassified": moved,
            "reclassified, superclusters": superclusters(faces, moved, most)[moved],
        }
        panels[name] = {each: (label, overdraw(faces, label)) for each, label in labels.items()}
        for each, (_, drawn) in panels[name].items():
            table.add(f"{name}, {each}", extra={"published (625D)": published[each], "torchprt": drawn})
        alone = overdraw(faces, superclusters(faces, plain, most)[plain])
        table.add(f"{name}, superclusters alone", extra={"published (625D)": "", "torchprt": alone})
    for model in ("smooth", "bumpy"):
        name, transfer = mesh(model)[0], glossy(model)
        found = {f"{each}: {drawn:.2f}": label for each, (label, drawn) in panels[name].items()}
        plots.figure5(transfer.positions, transfer.faces, found, VIEWS[name], OUT / f"figure5_{name}.png")
    return table


def figure6() -> Table:
    """Order 10 in the time of its weights: a square over the ground, 64 clusters."""
    table = Table("figure 6: squared error of order-10 light over a square and the ground, 64 clusters")
    scene = samples.plane_and_blocker(96)
    transfer = kept("square_diffuse_10", scene, order=10)
    camera = preview.frame(transfer.positions, (0.0, 1.0, 0.35), aspect=1.0)
    view = preview.Still(transfer.positions, transfer.faces, size=(260, 260), camera=camera)

    def shown(each: Transfer) -> Tensor:
        lamp = light.disc((0.35, 1.0, 0.2), 0.15, 1.0, each.order, normalise=True).float()
        with torch.no_grad():
            found = shader(each)(sh.window(lamp, sh.lanczos(each.order, dtype=torch.float32)))
        return view.picture(found, tone="none")

    pictures, labels, unit = [], [], 0.0
    for name, published in FIGURE6.items():
        method, count = name.split(", n' = ")
        found = compressed(transfer, "square", clusters=64, components=int(count), method=method)
        error = squared(found)
        unit = unit or error
        theirs = f"{published} ({published / next(iter(FIGURE6.values())):.3f})"
        table.add(name, extra={"published": theirs, "torchprt": f"{error:.3g} ({error / unit:.3f})"})
        pictures.append(shown(found))
        labels.append(f"order 10, {name}")
    pictures += [shown(transfer.to_order(5)), shown(transfer)]
    preview.save_png(preview.sheet(pictures, [*labels, "order 5", "order 10"], 6), OUT / "figure6.png")
    return table


def figure10() -> Table:
    """Plain PCA, plain VQ and CPCA at the same cost of a frame."""
    table = Table("figure 10: squared error at equal run-time cost, 25 x 25 matrices; and relative to CPCA")
    errors: dict[str, dict[str, float]] = {}
    for model in ("smooth", "bumpy"):
        name = mesh(model)[0]
        view, eye = still(model)
        found = {each: compressed(glossy(model), name, **options) for each, options in EQUAL_COST.items()}
        errors[name] = {each: squared(packed) for each, packed in found.items()}
        exact = radiance(glossy(model), eye)
        # The light end of what is seen is white in all of them.
        exposure = -float(view.radiance(exact, 0.0).quantile(0.995).log2()) - 0.2
        pictures = [view.picture(radiance(each, eye), exposure=exposure) for each in found.values()]
        counts = {each: (size.get("clusters", CLUSTERS), size["components"]) for each, size in EQUAL_COST.items()}
        labels = [f"{each}, {k} clusters, n' = {n}: {errors[name][each]:.4g}" for each, (k, n) in counts.items()]
        pictures.append(view.picture(exact, exposure=exposure))
        preview.save_png(preview.sheet(pictures, [*labels, "uncompressed"], 4), OUT / f"figure10_{name}.png")
        for each, error in errors[name].items():
            ours = f"{error:.4g} ({error / errors[name]['CPCA']:.3g})"
            theirs = f"{FIGURE10[each]:.6g} ({FIGURE10[each] / FIGURE10['CPCA']:.3g})" if model == "smooth" else ""
            table.add(f"{name}, {each}", extra={"published (bird)": theirs, "torchprt": ours})
    plots.figure10({"paper's bird": FIGURE10, **errors}, OUT / "figure10.png")
    return table


def figure11() -> Table:
    """More PCA vectors, glossy."""
    table = Table("figure 11: squared error by n', 25 x 25 matrices, 256 clusters; relative to n' = 2")
    curves: dict[str, tuple[float, ...]] = {}
    for model, published in FIGURE11.items():
        name = mesh(model)[0]
        ours = [squared(compressed(glossy(model), name, components=count)) for count in COMPONENTS11]
        theirs = "bird" if model == "smooth" else "Buddha"
        curves[f"paper's {theirs}"] = tuple(error / published[0] for error in published)
        curves[name] = tuple(error / ours[0] for error in ours)
        for source, values in ((f"published ({theirs})", published), (name, ours)):
            extra = {
                f"n' = {count}": f"{error:.4g} ({error / values[0]:.3g})"
                for count, error in zip(COMPONENTS11, values, strict=True)
            }
            table.add(source, extra=extra)
    plots.figure11(COMPONENTS11, curves, OUT / "figure11.png")
    return table


def error_over_bytes() -> Table:
    """Not in the paper: relative RMS error by the bytes of the compressed tensor, for methods and precisions."""
    table = Table("error over bytes: relative RMS of the transfer, and how many times smaller than float32")
    curves: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for kind, transfer in (("diffuse", diffuse("bumpy")), ("glossy", glossy("bumpy"))):
        width, points = signal(transfer).shape[1], len(signal(transfer))
        whole = 4 * width * points
        families = FAMILIES["all"] | FAMILIES[kind]
        curve: dict[str, list[tuple[float, float]]] = {family: [] for family in families}
        for family, sizes in families.items():
            for size in sizes:
                found = compressed(transfer, mesh("bumpy")[0], **size)
                bytes, error = found.bytes, stored(found).compression_error
                assert error is not None
                curve[family].append((bytes, error))
                options = ", ".join(f"{name} {value}" for name, value in size.items())
                table.add(f"{kind}: {options}", error=error, bytes=bytes, extra={"smaller": whole / bytes})
        curves[f"{mesh('bumpy')[0]}, {kind}, {width} numbers a vertex"] = curve
    plots.error_over_bytes(curves, OUT / "error_over_bytes.png")
    return table


def sizes(counts: tuple[int, ...], **options: Any) -> list[dict[str, Any]]:
    return [{"components": count, **options} for count in counts]


FAMILIES: dict[str, dict[str, list[dict[str, Any]]]] = {
    "all": {
        "vector quantisation": [{"clusters": count, "components": 0, "method": "vq"} for count in (64, 256, 1792)],
        "plain PCA": sizes((4, 8, 20), clusters=1, method="pca"),
        "static, 256 clusters": sizes((2, 4, 8, 12), method="static"),
        "iterative, 256 clusters": sizes((2, 4, 8, 12)),
        "the same, 8-bit weights": sizes((8, 12), bits=8),
    },
    "diffuse": {
        "adaptive, 256 clusters": sizes((2, 4, 8), method="adaptive"),
    },
    "glossy": {"two levels, 8-bit weights": sizes((8, 12, 16), clusters=256, shared=320, bits=8)},
}

FIGURES: dict[str, Callable[[], Table]] = {
    "figure2": figure2,
    "figure3": figure3,
    "figure4": figure4,
    "figure5": figure5,
    "figure6": figure6,
    "figure10": figure10,
    "figure11": figure11,
    "bytes": error_over_bytes,
}


def run(names: list[str]) -> None:
    """Prints every table and writes every picture, or those that are named."""
    torch.set_num_threads(1)
    # The smooth field of tangents is what is asked for.
    warnings.simplefilter("ignore", TangentWarning)
    OUT.mkdir(parents=True, exist_ok=True)
    console = Console(width=None if sys.stdout.isatty() else 140)
    started = time.perf_counter()
    for name in names or FIGURES:
        console.print(FIGURES[name]())
        console.print(f"{name}: {time.perf_counter() - started:.0f} s since the start")
    console.print(f"pictures in {OUT}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        OUT = Path(sys.argv[1])
    if unknown := sorted(set(sys.argv[2:]) - set(FIGURES)):
        sys.exit(f"there is no figure {unknown[0]}: choose from {' '.join(FIGURES)}")
    run(sys.argv[2:])
