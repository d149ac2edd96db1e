"""The tables of docs/scale.md: what was measured, and what the simulation makes of it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from simulate import CORES, FURTHER, REMEDIES, TOGETHER, Bake, Cluster, Costs, Outcome, simulate

HERE = Path(__file__).parent
RECEIVERS = (10**5, 10**6, 10**7, 10**8, 10**9)
WORKERS = (1, 8, 32, 128, 1024)
NAMES = {
    "workers": "tracing and gathering",
    "scheduler": "scheduler",
    "client": "client",
    "links": "links: scene, exit radiance, results",
    "tree": "the scene and its tree made anew",
    "store": "store of the hits",
}
POWERS = dict(zip(RECEIVERS, ("100 000", "1 000 000", "10 million", "100 million", "1000 million"), strict=True))


def tables(file: Path = HERE / "measured.json") -> dict[str, str]:
    """All tables by name, in Markdown."""
    measured, costs = json.loads(file.read_text()), Costs.read(file)
    return {
        "of": _of(measured),
        "measured": _measured(measured),
        "tasks": _tasks(measured["tasks"]),
        "walls": _walls(costs),
        "times": _times(costs),
        "remedies": _remedies(costs),
    }


def _of(found: dict[str, Any]) -> str:
    scene, machine = found["scene"], found["machine"]
    return (
        f"{scene['name']}, {scene['receivers']} receivers in {scene['chunks']} chunks, {found['workers']} workers of a "
        f"thread each, scheduler and client on {machine['cores']} cores ({machine['processor']}, engine "
        f"{machine['engine']}, distributed {machine['distributed']}, {machine['day']}), of which others had "
        f"{found['share of others']:.0%} meanwhile. Median of {found['repeats']} repeats (lowest to highest), bounces "
        f"after the first alike. The client's own work: {_spread(found['client seconds a receiver'], 1e6)} µs a "
        f"receiver. A worker holds {_spread(found['memory']['bytes a receiver'], 1.0)} bytes a receiver of the scene "
        "and its tree."
    )


def _tasks(found: dict[str, Any]) -> str:
    scheduler = found["scheduler seconds a task by workers"]
    rows = [["scheduler, ms a task", *(_spread(each, 1e3) for each in scheduler.values())]]
    rows.append(
        ["client, ms a task", *(_spread(each, 1e3) for each in found["client seconds a task by workers"].values())]
    )
    bytes_too = ", ".join(
        f"{name} {_spread(each, 1e9)} ns" for name, each in found["seconds a byte of results"].items()
    )
    return f"{_table(['workers', *scheduler], rows)}\n\nA byte of a result: {bytes_too}."


def _measured(found: dict[str, Any]) -> str:
    stages, count = found["stages"], found["scene"]["receivers"]

    def row(name: str, of: str, unit: str, scale: float) -> list[str]:
        return [name, unit, *(_spread(stages[stage][of], scale) for stage in stages)]

    rows = [
        row("rays or gathers", "task seconds a receiver", "µs a receiver", 1e6),
        row("worker beside them", "worker seconds a chunk", "ms a chunk", 1e3),
        row("scheduler", "scheduler seconds a chunk", "ms a chunk", 1e3),
        row("client", "client seconds a chunk", "ms a chunk", 1e3),
        row("sent to each worker", "bytes sent", "bytes a receiver", 1 / count),
        row("a worker, until it can use that", "worker seconds of arrival", "µs a receiver", 1e6 / count),
        row("results", "bytes back a receiver", "bytes a receiver", 1.0),
    ]
    kept = _spread(found["store"]["bytes a receiver"], 1.0)
    rows.append(["hits in the store", "bytes a receiver", "", f"{kept} written", f"{kept} read"])
    return _table(["CPU time, bytes", "unit", "rays", "rays, hits kept", "one bounce"], rows)


def first(resource: str, bake: Bake, costs: Costs, changes: dict[str, Any]) -> int | None:
    """From how many workers on a resource is busy for longer than they are, up to a million."""
    for workers in (round(2 ** (each / 8)) for each in range(8 * 10 + 1)):
        found = simulate(bake, replace(Cluster(workers), **changes), costs)
        if found.busy.get(resource, 0.0) >= found.busy["workers"]:
            return workers
    return None


def _walls(costs: Costs) -> str:
    bake, rows = Bake(10**6), []
    found = [simulate(bake, replace(Cluster(32), **changes), costs) for changes in ({}, TOGETHER)]
    for name, said in NAMES.items():
        row = [said]
        for each, changes in zip(found, ({}, TOGETHER), strict=True):
            whole = name == "workers"
            row.append(_number(each.busy[name] * (32 if whole else 1)) + (" of a core" if whole else ""))
            count = None if whole else first(name, bake, costs, changes)
            row.append("" if whole else "beyond 1024" if count is None else str(count))
        rows.append(row)
    rows[1:] = sorted(rows[1:], key=lambda row: int(row[2]) if row[2].isdigit() else 10**9)
    return _table(["", "as built: s", "from cores", "all remedies: s", "from cores"], rows)


def _times(costs: Costs) -> str:
    rows = []
    for receivers in RECEIVERS:
        found = [simulate(Bake(receivers), Cluster(workers), costs) for workers in WORKERS]
        best = [simulate(Bake(receivers), replace(Cluster(workers), **TOGETHER), costs) for workers in WORKERS]
        held = _memory(found[0].held)
        rows.append([POWERS[receivers], held, *(f"{_time(a)} ({_time(b)})" for a, b in zip(found, best, strict=True))])
    return _table(["receivers", "held by a process", *(f"{_cores(workers)}" for workers in WORKERS)], rows)


def _remedies(costs: Costs) -> str:
    rows, changes = [], dict[str, Any]()

    def row(name: str, changes: dict[str, Any]) -> list[str]:
        cells = []
        for workers in (32, 128):
            found = simulate(Bake(10**7), replace(Cluster(workers), **changes), costs)
            cells += [_time(found), f"{found.efficiency:.0%}", found.wall]
        return [name, *cells]

    rows.append(row("as built", {}))
    for name, more in REMEDIES.items():
        changes = changes | more
        rows.append(row(f"and {name}" if len(rows) > 1 else name, changes))
    rows += [row(f"all of these, and {name}", changes | more) for name, more in FURTHER.items()]
    return _table(["", "32 cores", "share", "wall", "128 cores", "share", "wall"], rows)


def _spread(found: dict[str, float], scale: float) -> str:
    middle, low, high = (_number(found[name] * scale) for name in ("median", "low", "high"))
    return middle if low == high else f"{middle} ({low} to {high})"


def _number(value: float) -> str:
    """Two digits, three where the first is a one; none is cut off before the point."""
    if value == 0:
        return "0"
    digits = 3 if f"{value:e}"[0] == "1" else 2
    text = f"{float(f'{value:.{digits}g}'):.10f}".rstrip("0").rstrip(".")
    return text.removeprefix("0") if text.startswith("0.") else text


def _time(found: Outcome) -> str:
    seconds = found.seconds
    for limit, unit, name in ((120, 1, "s"), (7200, 60, "min"), (48 * 3600, 3600, "h")):
        if seconds < limit:
            return f"{_number(seconds / unit)} {name}"
    return f"{_number(seconds / 86400)} d"


def _memory(size: float) -> str:
    for limit, unit, name in ((1e9, 1e6, "MB"), (1e12, 1e9, "GB")):
        if size < limit:
            return f"{_number(size / unit)} {name}"
    return f"{_number(size / 1e12)} TB"


def _cores(workers: int) -> str:
    return "1 core" if workers == 1 else f"{workers} cores"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    print(f"{CORES} cores a machine")
    for name, text in tables().items():
        print(f"{name}\n{text}\n")
