"""The tables and the picture of docs/scale.md, from scripts/scale/measured.json.

    python docs/make/scale.py

`scripts/scale/measure.py` measures anew.
"""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts/scale"))

from simulate import REMEDIES, Bake, Cluster, Costs, simulate  # noqa: E402
from tables import NAMES, POWERS, tables  # noqa: E402

PAGE, PICTURE = ROOT / "docs/scale.md", ROOT / "docs/images/scale.png"
WORKERS = [1, 2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 724, 1000]
# What a bake waits for, and how that is marked.
MARKS = {"workers": "o", "scheduler": "s", "client": "D", "links": "v", "tree": "^", "store": "P"}
COLOURS = ["#30638e", "#d1495b", "#edae49", "#00798c", "#6a4c93", "#8a8a8a", "#7cb518"]


def page() -> None:
    """Puts the tables in their places."""
    text = PAGE.read_text(encoding="utf-8")
    for name, table in tables().items():
        start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        text = re.sub(f"{start}.*?{end}", lambda _, new=f"{start}\n{table}\n{end}": new, text, flags=re.DOTALL)
    PAGE.write_text(text, encoding="utf-8")


def picture() -> None:
    costs = Costs.read()
    figure = Figure(figsize=(13, 5.2), layout="constrained", dpi=100)
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for (receivers, name), colour in zip(POWERS.items(), COLOURS, strict=False):
        found = [simulate(Bake(receivers), Cluster(workers), costs) for workers in WORKERS]
        seconds = [each.seconds for each in found]
        left.plot(WORKERS, seconds, color=colour, linestyle="-" if found[0].fits else ":", label=name)
        _marked(left, seconds, found, colour)
    left.set(yscale="log", ylim=(1, 3e7), ylabel="seconds", title="Time of a bake, as built")
    changes: dict[str, Any] = {}
    steps = [("as built", {}), *((f"+ {name}", more) for name, more in REMEDIES.items())]
    for (name, more), colour in zip(steps, COLOURS, strict=False):
        changes = changes | more
        found = [simulate(Bake(10**7), replace(Cluster(workers), **changes), costs) for workers in WORKERS]
        shares = [100 * each.efficiency for each in found]
        right.plot(WORKERS, shares, color=colour, label=name)
        _marked(right, shares, found, colour)
    long = [simulate(Bake(10**7, rays=16 * 1024), replace(Cluster(workers), **changes), costs) for workers in WORKERS]
    right.plot(WORKERS, [100 * each.efficiency for each in long], color="black", linestyle="--", label="+ 16 384 rays")
    right.set(ylim=(0, 100), ylabel="percent of all cores' time in which rays are traced")
    right.set_title("Share of tracing, 10 million receivers", loc="left")
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_xlim(1, 1000)
        axes.set_xticks([1, 10, 100, 1000], ["1", "10", "100", "1000"])
        axes.set_xlabel("cores")
        axes.grid(alpha=0.3)
    key = left.legend(title="receivers (dotted: no machine of 32 GiB holds it)", ncols=2, fontsize=8, title_fontsize=8)
    left.add_artist(key)
    right.legend(title="one upon the other", loc="lower left", fontsize=8, title_fontsize=8)
    handles = [
        left.plot([], [], MARKS[each], color="black", markersize=5, label=said)[0] for each, said in NAMES.items()
    ]
    figure.legend(
        handles=handles,
        title="what is busy for longest",
        loc="outside lower center",
        ncols=6,
        fontsize=8,
        title_fontsize=8,
    )
    figure.savefig(PICTURE, format="png", metadata={"Software": None})


def _marked(axes: Any, values: list[float], found: list[Any], colour: str) -> None:
    for workers, value, each in zip(WORKERS, values, found, strict=True):
        axes.plot(workers, value, MARKS[each.wall], color=colour, markersize=4.5)


if __name__ == "__main__":
    page()
    picture()
