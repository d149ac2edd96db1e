"""What does clustered PCA cost, and what does it lose? Against scikit-learn, plain PCA and plain vector quantisation.

    python scripts/benchmarks/compress.py [PART ...]      # encode cost precision coherence importance million

The bunny (TORCHPRT_DATA names the folder with mesh/bunny.ply and hdri/*.exr) or, without it, the project's own
sculpture and its studio: order-6 diffuse vectors, and 25 x 25 exit matrices of an anisotropic material. 256 clusters;
one thread, CPU time of the process; the rounds of what is compared are interleaved.
"""

from __future__ import annotations

import functools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from memory import MILLION, resident, rolling_ground
from rich.console import Console
from torch import Tensor

from torchprt import light, sh
from torchprt.compression import (
    clustered_pca,
    compress,
    decompress,
    light_importance,
    make_coherent,
    natural_light_importance,
    overdraw,
    superclusters,
)
from torchprt.compression.expected_light import Turned
from torchprt.light import DamagedImageWarning
from torchprt.measure import Table, relative_rms, time_it
from torchprt.scene import Material, Mesh, Object, Scene, TangentWarning, load, read_mesh, samples
from torchprt.shade import shader
from torchprt.transfer import Signal, Transfer
from torchprt.transport import bake

TURNED: tuple[Turned, ...] = ("any", "yaw")
MATERIAL, CLUSTERS, COMPONENTS, TURNS = "ward:0.2,0.4", 256, 8, 8
EQUAL_COST: dict[str, dict[str, Any]] = {
    "PCA, n' = 20": {"clusters": 1, "components": 20, "method": "pca"},
    "VQ, 1792 clusters": {"clusters": 1792, "components": 0, "method": "vq"},
    "CPCA, 256 clusters, n' = 8": {"clusters": CLUSTERS, "components": COMPONENTS},
}


def folder() -> Path:
    return Path(os.environ.get("TORCHPRT_DATA") or Path(__file__).parents[3] / "shared" / "data")


@functools.cache
def mesh() -> Mesh:
    path = folder() / "mesh" / "bunny.ply"
    return read_mesh(path) if path.is_file() else samples.organic(35_000).objects[0].mesh


@functools.cache
def diffuse() -> Transfer:
    return bake(Scene([Object(mesh(), Material(0.6))]), order=6, progress=False)


@functools.cache
def glossy() -> Transfer:
    with warnings.catch_warnings():
        # The smooth field of tangents is what is asked for.
        warnings.simplefilter("ignore", TangentWarning)
        return bake(Scene([Object(mesh(), Material(0.0, gloss=MATERIAL))]), order=5, progress=False)


def stored(transfer: Transfer) -> Signal:
    """Of the only layer that there is."""
    (layer,) = transfer.layers.values()
    return layer.signal


def signal(transfer: Transfer) -> Tensor:
    values = stored(transfer).dense().values
    return values.movedim(2 if values.ndim == 3 else 1, 0).flatten(1).float()


@functools.cache
def environments(order: int) -> dict[str, Tensor]:
    """Photographs, or the studio and two skies of the project."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DamagedImageWarning)
        found = {path.stem: light.read(path) for path in sorted((folder() / "hdri").glob("*.exr"))}
    if found:
        return {name: light.project(image, order).double() for name, image in found.items()}
    return {
        "studio": light.project(light.studio(256), order).double(),
        "overcast": light.overcast_sky(1.0, (0.0, 1.0, 0.0), order).double(),
        "disc": light.disc((0.3, 0.8, 0.5), 0.4, 1.0, order).double(),
    }


def turned(lamp: Tensor) -> Tensor:
    """`[TURNS, N, 3]`: one light, about the vertical."""
    yaw = 360 * torch.arange(TURNS, dtype=torch.float64) / TURNS
    return sh.rotate(lamp[None], sh.yaw_pitch_roll(torch.stack([yaw, 0 * yaw, 0 * yaw], 1)))


def interleaved(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    """CPU seconds of calls that take seconds: no call beforehand, as `time_it` has it."""
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.process_time()
            call()
            found[name].append(time.process_time() - start)
    return found


def spread(values: list[float]) -> str:
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def pca_in_clusters(data: np.ndarray, label: np.ndarray) -> float:
    """Squared error of scikit-learn's PCA in every cluster of scikit-learn."""
    from sklearn.decomposition import PCA

    error = 0.0
    for cluster in range(CLUSTERS):
        some = data[label == cluster].astype(np.float64)
        count = min(COMPONENTS, *some.shape)
        model = PCA(count, svd_solver="full").fit(some)
        error += float(np.square(some - model.inverse_transform(model.transform(some))).sum())
    return error


def encode() -> Iterator[Table]:
    """Times of encoding, and errors, against k-means of scikit-learn alone and followed by its PCA."""
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits

    for name, transfer, rounds in (("diffuse", diffuse(), 3), ("glossy", glossy(), 2)):
        data = signal(transfer)
        rows = data.numpy()
        found: dict[str, Any] = {}

        def kmeans() -> None:
            # What scikit-learn does unless told otherwise, but for the number of clusters.
            found["k-means"] = KMeans(CLUSTERS, n_init=1, random_state=0).fit(rows)  # noqa: B023

        def ours(method: str) -> None:
            found[method] = clustered_pca(data, CLUSTERS, COMPONENTS, method=method)  # type: ignore[arg-type]  # noqa: B023

        methods = ("static", "iterative", "adaptive")
        calls: dict[str, Callable[[], object]] = {method: functools.partial(ours, method) for method in methods}
        with threadpool_limits(1):
            times = interleaved({"k-means": kmeans} | calls, rounds)
            both = pca_in_clusters(rows, found["k-means"].labels_)
        table = Table(f"encoding {data.shape[0]} x {data.shape[1]}, {CLUSTERS} clusters, n' = {COMPONENTS} ({name})")
        kept = {"k-means": both} | {method: float(found[method].error.sum()) for method in methods}
        for each, timing in times.items():
            label = "scikit-learn: k-means alone (error: then PCA in each)" if each == "k-means" else each
            ratios = [one / other for one, other in zip(timing, times["k-means"], strict=True)]
            extra = {
                "CPU s": spread(timing),
                "/ k-means": spread(ratios),
                "squared error": kept[each],
                "error / k-means + PCA": kept[each] / both,
            }
            table.add(label, extra=extra)
        yield table


def equal_cost() -> Iterator[Table]:
    """Plain PCA, VQ and CPCA of as many seconds a frame: error of matrices and of radiance, and time of a frame."""
    transfer, positions = glossy(), mesh().positions
    eye = (positions.mean(0) + torch.tensor([2.0, 3.0, 4.0]) * (positions.amax(0) - positions.amin(0)).max()).float()
    lights = torch.cat([turned(each) for each in environments(5).values()]).float()
    packed = {name: compress(transfer, **options) for name, options in EQUAL_COST.items()}
    modules = {"uncompressed": shader(transfer)} | {name: shader(each) for name, each in packed.items()}
    with torch.no_grad():
        frames = {name: functools.partial(module, lights[:1], eye=eye) for name, module in modules.items()}
        frames["uncompressed, light first"] = functools.partial(_light_first, modules["uncompressed"], lights[0], eye)
        times = time_it(frames, rounds=9)
        seen = {name: module(lights, eye=eye) for name, module in modules.items()}
    table = Table("equal run-time cost, 25 x 25 matrices; a frame: one light, one eye, both new")
    best = float(stored(packed["CPCA, 256 clusters, n' = 8"]).squared_error.double().sum())
    for name, module_time in times.items():
        extra: dict[str, Any] = {"frame": str(module_time)}
        if name in packed:
            squared = float(stored(packed[name]).squared_error.double().sum())
            extra |= {"squared error": squared, "/ CPCA": squared / best}
            extra["radiance, RMS"] = f"{relative_rms(seen[name], seen['uncompressed']):.2%}"
            table.add(name, error=stored(packed[name]).compression_error, bytes=packed[name].bytes, extra=extra)
        else:
            table.add(name, bytes=transfer.bytes, extra=extra)
    yield table


def _light_first(module: Any, light: Tensor, eye: Tensor) -> Tensor:
    """What the shader would do if it applied the light before the eye: two products, no diffuse layer."""
    gloss = module.layers["exit"]
    values = gloss.values(eye, None).contiguous().unsqueeze(1)
    matrix = gloss.signal.values
    _, receivers, rows, columns = matrix.shape
    return torch.bmm(values, (matrix.view(-1, columns) @ light).view(receivers, rows, 3))


def precision() -> Iterator[Table]:
    """Bits of a weight, PCA vectors, two levels: bytes of the compressed tensor and error of shading."""
    sizes = {
        "diffuse": [(256, 8, 32, 0), (256, 8, 16, 0), (256, 8, 8, 0), (256, 16, 8, 0)],
        "glossy": [
            *((256, 8, 32, 0), (256, 8, 16, 0), (256, 8, 8, 0), (256, 12, 8, 0)),
            *((256, 12, 8, 320), (256, 16, 8, 320), (256, 20, 8, 384), (512, 12, 8, 160)),
        ],
    }
    for kind, transfer in (("diffuse", diffuse()), ("glossy", glossy())):
        data = signal(transfer)
        table = Table(f"bytes and bits, {kind}: {data.shape[0]} x {data.shape[1]}")
        for clusters, components, bits, shared in sizes[kind]:
            packed = compress(transfer, clusters=clusters, components=components, bits=bits, shared=shared)
            restored = signal(decompress(packed))
            made = stored(packed)
            parts = (made.label, made.weights)
            points = sum(part.numel() * part.element_size() for part in parts) / len(data)
            rest = made.bytes - points * len(data)
            name = f"{clusters} clusters, n' = {components}, {bits} bits" + (f", {shared} shared" if shared else "")
            extra = {
                "smaller": 4 * data.numel() / made.bytes,
                "smaller at 1M vertices": 4 * data.shape[1] * MILLION / (points * MILLION + rest),
                "radiance, RMS": f"{shading_error(transfer, restored - data):.2%}",
            }
            table.add(name, error=made.compression_error, bytes=made.bytes, extra=extra)
        yield table


def shading_error(transfer: Transfer, difference: Tensor, only: str | None = None) -> float:
    """RMS of what `difference` adds to exit radiance, relative, over the hemisphere; the mean of all environments.

    Exit functions of the projection "optimal" are orthonormal there.
    """
    data = signal(transfer)
    errors = []
    for name, lamp in environments(transfer.order).items():
        if only in (None, name):
            lights = turned(lamp).float().movedim(1, 0).flatten(1)
            power = [_radiant(each, lights) for each in (difference, data)]
            errors.append((power[0] / power[1]) ** 0.5)
    return sum(errors) / len(errors)


def _radiant(rows: Tensor, lights: Tensor) -> float:
    total = 0.0
    for some in rows.split(1 << 13):
        total += float((some.view(len(some), -1, len(lights)) @ lights).square().sum(dtype=torch.float64))
    return total


def coherence() -> Iterator[Table]:
    """Overdraw as it is, after reclassification for 5 % more error, in superclusters."""
    transfer, registers = glossy(), 256
    most = registers // ((COMPONENTS + 1) * 6)
    data, faces = signal(transfer), transfer.faces
    packed = clustered_pca(data, CLUSTERS, COMPONENTS)
    table = Table(
        f"overdraw, 25 x 25 matrices; superclusters of at most {most} clusters, as the paper's registers hold"
    )
    published = {"clusters": 2.03, "reclassified": 1.79, "reclassified, superclusters": 1.60}
    for budget in (0.05, 0.1):
        coherent = make_coherent(data, packed, faces, budget=budget)
        labels = {
            "clusters": packed.label,
            "reclassified": coherent.label,
            "reclassified, superclusters": superclusters(faces, coherent.label, most)[coherent.label],
        }
        for name, label in labels.items():
            if budget == 0.05 or name != "clusters":
                added = float(coherent.error.sum() / packed.error.sum()) - 1 if name != "clusters" else 0.0
                extra = {
                    "overdraw": overdraw(faces, label),
                    "published (another model, budget 10 %)": published[name],
                    "squared error added": f"{added:.1%}",
                }
                table.add(name + ("" if name == "clusters" else f", budget {budget:.0%}"), extra=extra)
    yield table


def importance() -> Iterator[Table]:
    """What it buys to weigh coefficients by the light, for the same size: error of radiance, light by light."""
    for kind, transfer in (("diffuse", diffuse()), ("glossy", glossy())):
        data, order = signal(transfer), transfer.order
        lamps, rows = environments(order), data.shape[1] // transfer.order**2
        table = Table(
            f"importance, {kind}, {CLUSTERS} clusters, n' = {COMPONENTS}: RMS error of radiance, light by light"
        )
        plain: dict[str, float] = {}

        def weigh(importance: Tensor | None, names: list[str]) -> dict[str, float]:
            packed = clustered_pca(data, CLUSTERS, COMPONENTS, importance=importance)  # noqa: B023
            difference = packed.reconstruct() - data  # noqa: B023
            found = {name: shading_error(transfer, difference, name) for name in names}  # noqa: B023
            return found | {"transfer": float(difference.norm() / data.norm())}  # noqa: B023

        def note(name: str, errors: dict[str, float]) -> None:
            if not plain:  # noqa: B023
                plain.update(errors)  # noqa: B023
            of_transfer = {"transfer": f"{errors['transfer']:.2%}"} if "transfer" in errors else {}
            ratios = torch.tensor([errors[each] / plain[each] for each in lamps], dtype=torch.float64)  # noqa: B023
            shown = {each: f"{errors[each]:.2%}" for each in lamps}  # noqa: B023
            table.add(name, extra=of_transfer | shown | {"/ none": float(ratios.log().mean().exp())})  # noqa: B023

        names = list(lamps)
        note("none", weigh(None, names))
        note("natural light", weigh(natural_light_importance(order, rows=rows), names))
        everything = torch.stack(list(lamps.values()))
        for turns in TURNED:
            options: dict[str, Any] = {"turned": turns, "rows": rows}
            note(f"all of them, turned '{turns}'", weigh(light_importance(everything, **options), names))
            held_out = {}
            for number, name in enumerate(names):
                others = torch.cat([everything[:number], everything[number + 1 :]])
                held_out[name] = weigh(light_importance(others, **options), [name])[name]
            note(f"all others, turned '{turns}'", held_out)
        own = {name: weigh(light_importance(lamps[name][None], rows=rows), [name])[name] for name in names}
        note("itself, turned 'yaw'", own)
        yield table


def million() -> Iterator[Table]:
    """Order-5 diffuse transfer of a million vertices, in a process of its own."""
    with tempfile.TemporaryFile("w+") as output:
        subprocess.run([sys.executable, __file__, "--million"], stdout=output, check=True)
        output.seek(0)
        found = json.load(output)
    table = Table(f"{found['vertices']} vertices, order 5, diffuse, {CLUSTERS} clusters, n' = {COMPONENTS}")
    signal_bytes, grown = found["signal"], found["peak"] - found["before"]
    extra = {
        "CPU time": f"{found['seconds']:.0f} s",
        "smaller": found["signal"] / found["bytes"],
        "signal, MiB": round(signal_bytes / 2**20),
        "before, MiB": round(found["before"] / 2**20),
        "peak, MiB": round(found["peak"] / 2**20),
        "grown / signal": grown / signal_bytes,
    }
    table.add("iterative", error=found["error"], bytes=found["bytes"], extra=extra)
    yield table


def compress_a_million() -> dict[str, Any]:
    transfer = bake(load(rolling_ground(MILLION)), order=5, rays=64, progress=False)
    before = resident()
    # What the bake took is not counted.
    Path("/proc/self/clear_refs").write_text("5")
    start = time.process_time()
    packed = compress(transfer, clusters=CLUSTERS, components=COMPONENTS)
    return {
        "seconds": time.process_time() - start,
        "vertices": transfer.vertices,
        "before": before,
        "peak": resident(peak=True),
        "signal": transfer.bytes,
        "bytes": packed.bytes,
        "error": stored(packed).compression_error,
    }


PARTS: dict[str, Callable[[], Iterator[Table]]] = {
    "encode": encode,
    "cost": equal_cost,
    "precision": precision,
    "coherence": coherence,
    "importance": importance,
    "million": million,
}


def run(names: list[str] | None = None) -> None:
    """Prints the tables of all parts, or of some."""
    torch.set_num_threads(1)
    console = Console(width=None if sys.stdout.isatty() else 150)
    console.print(f"scene: {mesh().name}, {len(mesh().positions)} vertices; lights: {', '.join(environments(5))}")
    for name in names or PARTS:
        for table in PARTS[name]():
            console.print(table)


if __name__ == "__main__":
    if sys.argv[1:] == ["--million"]:
        torch.set_num_threads(1)
        print(json.dumps(compress_a_million()))
    elif unknown := sorted(set(sys.argv[1:]) - set(PARTS)):
        sys.exit(f"there is no part {unknown[0]}: choose from {' '.join(PARTS)}")
    else:
        run(sys.argv[1:])
