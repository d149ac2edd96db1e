"""Plots of `published_clusters.py`: the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import torch
from torch import Tensor

from torchprt import preview

COLOURS = ("#30638e", "#d1495b", "#edae49", "#00798c", "#6a4c93", "#555555", "#8ab17d")
MARKS = "osD^v<>"
GREEN, YELLOW, RED = (0.25, 0.7, 0.3), (0.95, 0.85, 0.2), (0.85, 0.15, 0.15)


def written(figure: plt.Figure, path: Path) -> None:
    figure.savefig(path, dpi=100, metadata={"Software": None})
    plt.close(figure)


def figure2(curves: Mapping[str, Mapping[int, Sequence[tuple[float, float]]]], path: Path) -> None:
    figure, axes = plt.subplots(1, len(curves), figsize=(6 * len(curves), 4.6), layout="constrained", squeeze=False)
    for plot, (model, curve) in zip(axes[0], curves.items(), strict=True):
        for colour, (count, points) in zip(COLOURS, curve.items(), strict=False):
            plot.loglog(*zip(*points, strict=True), "o-", color=colour, markersize=4, label=f"n' = {count}")
        plot.set(title=f"{model}: static PCA, 1, 2, 4 ... clusters", xlabel="stored numbers: m_p n' + m_c (n' + 1) n")
        plot.set_ylabel("squared error")
        plot.legend(fontsize=9)
        plot.grid(alpha=0.3)
    written(figure, path)


def figure3(
    counts: Sequence[int],
    curves: Mapping[str, Mapping[str, Sequence[float]]],
    published: Mapping[str, float],
    path: Path,
) -> None:
    figure, axes = plt.subplots(1, len(curves), figsize=(6 * len(curves), 4.6), layout="constrained", sharey=True)
    for plot, (model, curve) in zip(axes, curves.items(), strict=True):
        for colour, (method, values) in zip(COLOURS, curve.items(), strict=False):
            plot.semilogy(counts, values, "o-", color=colour, markersize=4, label=f"{method}, torchprt")
            label = f"{method}, the paper's bird"
            plot.semilogy([3], [published[method]], "*", color=colour, markersize=14, mec="black", label=label)
        plot.set(title=f"{model}: 256 clusters", xlabel="PCA vectors a cluster, n'")
        plot.grid(alpha=0.3, which="both")
        plot.legend(fontsize=8)
    axes[0].set_ylabel("squared error / that of static at n' = 3")
    written(figure, path)


def figure5(
    positions: Tensor, faces: Tensor, labels: Mapping[str, Tensor], toward: tuple[float, float, float], path: Path
) -> None:
    """Triangles by the clusters among their corners: 1 green, 2 yellow, 3 red."""
    size = (360, 340)
    corners = positions[faces.long()].flatten(0, 1)
    camera = preview.frame(positions, toward, aspect=size[0] / size[1])
    still = preview.Still(corners, torch.arange(len(corners)).view(-1, 3), size=size, camera=camera, samples=9)
    pictures = []
    for label in labels.values():
        a, b, c = label[faces.long()].unbind(1)
        drawn = (b != a).long() + ((c != a) & (c != b)).long()
        colours = torch.tensor([GREEN, YELLOW, RED])[drawn].repeat_interleave(3, 0)
        pictures.append(still.radiance(colours, background=1.0))
    preview.save_png(preview.sheet(pictures, list(labels), 3), path)


def figure10(errors: Mapping[str, Mapping[str, float]], path: Path) -> None:
    figure, plot = plt.subplots(figsize=(7.5, 4.4), layout="constrained")
    width = 0.8 / len(errors)
    for number, (model, values) in enumerate(errors.items()):
        places = [place + (number - (len(errors) - 1) / 2) * width for place in range(len(values))]
        heights = [value / values["CPCA"] for value in values.values()]
        bars = plot.bar(places, heights, width, color=COLOURS[number], label=model)
        plot.bar_label(bars, [f"{height:.3g}" for height in heights], fontsize=8)
    plot.set_yscale("log")
    plot.set_ylim(0.5, None)
    plot.set_xticks(range(3), ["PCA\n1 cluster, n' = 20", "VQ\n1792 clusters, n' = 0", "CPCA\n256 clusters, n' = 8"])
    plot.set(title="equal run-time cost, 25 x 25 matrices", ylabel="squared error / that of CPCA")
    plot.legend()
    written(figure, path)


def figure11(counts: Sequence[int], curves: Mapping[str, Sequence[float]], path: Path) -> None:
    figure, plot = plt.subplots(figsize=(7.5, 4.4), layout="constrained")
    for number, (name, values) in enumerate(curves.items()):
        theirs = name.startswith("paper")
        style = {"linestyle": "--" if theirs else "-", "marker": "*" if theirs else "o", "color": COLOURS[number // 2]}
        plot.semilogy(counts, values, label=name, **style)
    plot.set(title="256 clusters, 25 x 25 matrices", xlabel="PCA vectors a cluster, n'")
    plot.set_ylabel("squared error / that at n' = 2")
    plot.grid(alpha=0.3, which="both")
    plot.legend()
    written(figure, path)


def error_over_bytes(curves: Mapping[str, Mapping[str, Sequence[tuple[float, float]]]], path: Path) -> None:
    figure, axes = plt.subplots(1, len(curves), figsize=(6.5 * len(curves), 5), layout="constrained", squeeze=False)
    for plot, (title, curve) in zip(axes[0], curves.items(), strict=True):
        for number, (method, points) in enumerate(curve.items()):
            x, y = zip(*sorted(points), strict=True)
            size = [bytes / 2**20 for bytes in x]
            plot.loglog(size, y, f"{MARKS[number]}-", color=COLOURS[number], markersize=5, label=method)
        plot.set(title=title, xlabel="stored MiB", ylabel="relative RMS error of the transfer")
        plot.grid(alpha=0.3, which="both")
        plot.legend(fontsize=8)
    written(figure, path)
