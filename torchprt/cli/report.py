"""What the command says: lines on standard output, complaints on standard error, what a bake holds."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchprt.files import CannotWrite
from torchprt.progress import quiet
from torchprt.words import count

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from torchprt.transfer import Atlas, Cells, Layer, Transfer


def say(what: Any) -> None:
    """Tells what was done and what is worth knowing, unless all shall be quiet."""
    if not quiet():
        answer(what)


def answer(what: Any) -> None:
    """Tells what was asked for."""
    try:
        print(what, flush=True)
    except BrokenPipeError:
        # Who listened has heard enough, as `head` does; the work goes on. Python itself would complain at its end.
        _to_nobody(sys.stdout)
    except OSError as fault:
        raise unheard(fault) from fault


def unheard(fault: OSError) -> CannotWrite:
    """That standard output goes where there is no room. Nothing more is sent there."""
    _to_nobody(sys.stdout)
    return CannotWrite("standard output", str(fault.strerror), "send it elsewhere")


def complain(what: Any) -> None:
    try:
        print(f"torchprt: {what}", file=sys.stderr, flush=True)
    except OSError:
        # There is no place left to complain at; the exit code tells.
        _to_nobody(sys.stderr)


def _to_nobody(stream: Any) -> None:
    """From here on a stream of this process goes nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, stream.fileno())
    finally:
        os.close(nowhere)


def triple(values: Tensor | np.ndarray) -> str:
    return "({:.4g}, {:.4g}, {:.4g})".format(*values.tolist())


def describe(transfer: Transfer) -> str:
    """Kind, size and Monte Carlo error of a transfer in a line."""
    parts = [transfer.kind, transfer.transport]
    if transfer.bounces:
        parts.append(count(transfer.bounces, "bounce"))
    parts.append(f"order {transfer.order}")
    parts += [_functions(each) for each in transfer.layers.values() if each.needs]
    parts += [count(transfer.channels, "channel")]
    parts.append(count(transfer.vertices, _place(transfer)))
    counts = [layer.signal.shape[0] for layer in transfer.eye_layers.values()]
    if counts and transfer.receivers.on_surface:
        parts[-1] += f" ({max(counts)} glossy)"
    signal = max(transfer.layers.values(), key=lambda layer: layer.bytes).signal
    stored = signal.tensors()["weights"].dtype if "weights" in signal.tensors() else signal.dtype
    parts.append(f"{transfer.bytes / 2**20:.1f} MB of {str(stored).removeprefix('torch.')}")
    if transfer.error is not None and transfer.signal:
        parts.append(f"error {transfer.error / transfer.signal:.2%} (RMS, Monte Carlo estimate)")
    return ", ".join(parts)


def _place(transfer: Transfer) -> str:
    """What its receivers are called."""
    if not transfer.receivers.on_surface:
        return "cell"
    if "texel" in transfer.receivers.tensors():
        return "texel"
    return "node" if "receivers" in transfer.needs else "vertex"


def details(transfer: Transfer) -> list[str]:
    """Lines about where a transfer was recorded, and of each layer what it is and what it loses."""
    place = transfer.receivers.metadata()
    lines = [f"{count(transfer.vertices, 'receiver')}, {count(len(transfer.faces), 'face')}"]
    if "tiles_u" in place:
        tiles = "tiles" if place["tiles_u"] and place["tiles_v"] else "a single patch"
        lines = [f"map of {place['rows']} x {place['columns']} texels, {tiles}"]
    if "gutter" in transfer.receivers.tensors():
        lines += _atlas(transfer.receivers.as_atlas())
    if not transfer.receivers.on_surface:
        lines = _volume(transfer.receivers.as_cells())
    elif "spacing" in place:
        lines = _grid(place)
    objects = [each for each in place.get("objects", ()) if each.get("side") == "front"]
    if len(objects) > 1:
        told = [f"{Path(each['name']).name} ({each['rows'][1] - each['rows'][0]})" for each in objects]
        lines.append(f"{count(len(objects), 'object')}: {', '.join(told)}")
    ground = int(transfer.receivers.ground().sum())
    if ground:
        lines[0] += f"; {ground} of the receivers are ground"
    if transfer.receivers.mirrors is not None:
        lines.append(f"{count(len(transfer.receivers.mirrors[3]), 'face')} of mirrors, which record nothing")
    if "sample_points" in transfer.receivers.tensors():
        points, blend = transfer.receivers.sampled()
        more = " with gradients" if blend.shape[1] > len(points) else ""
        lines.append(f"{count(len(points), 'sample point')}{more} for lamps nearby")
    if transfer.cut:
        lines.append(f"{transfer.cut:.2g} of the light is cut off between mirrors")
    lines += _sight(transfer)
    for name, layer in transfer.layers.items():
        told = _clusters(transfer, layer) + _lobes(layer) + _surface(layer)
        lines += [f"{name}: {line}" for line in told]
    return lines


def _atlas(atlas: Atlas) -> list[str]:
    """How much of a map is covered, and how it was laid out."""
    charts = int(atlas.chart.max()) + 1 if atlas.count else 0
    share = atlas.count / (atlas.rows * atlas.columns)
    lines = [
        f"map of {atlas.columns} x {atlas.rows} texels, {share:.1%} of them on {count(charts, 'chart')}, "
        f"{count(len(atlas.gutter), 'texel')} of gutters"
    ]
    return lines + list(atlas.notes)


def _volume(cells: Cells) -> list[str]:
    """Where cells stand, how many hold anything, and how thick it is."""
    corners = " to ".join("({:.3g}, {:.3g}, {:.3g})".format(*corner) for corner in cells.box)
    whole = math.prod(cells.shape)
    side = max(step * count for step, count in zip(cells.spacing, cells.shape, strict=True))
    extinction = cells.extinction.double()
    most, mean = (float(each) if cells.count else 0.0 for each in (extinction.amax(), extinction.mean()))
    return [
        f"volume of {'x'.join(map(str, cells.shape))} cells, {corners}: {cells.count} hold anything, "
        f"{1 - cells.count / whole:.1%} are empty",
        f"extinction {mean:.3g} in the mean of those, {most:.3g} at most: {mean * side:.3g} and {most * side:.3g} over "
        "the longest side",
    ]


def _grid(place: dict[str, Any]) -> list[str]:
    """Where a grid stands around its object, and by what rule."""
    last = [o + s * (n - 1) for o, s, n in zip(place["origin"], place["spacing"], place["shape"], strict=True)]
    corners = " to ".join("({:.3g}, {:.3g}, {:.3g})".format(*corner) for corner in (place["origin"], last))
    lines = [f"grid of {'x'.join(map(str, place['shape']))} nodes, {corners}"]
    if place["share"] is not None:
        lines.append(
            f"its box encloses the shadow: on its border the object takes {place['border']:.1%} of the light of what "
            f"faces up at most, {place['share']:.1%} were allowed"
        )
    return lines


def _sight(transfer: Transfer) -> list[str]:
    """How many receivers could not see by themselves, and what was done about them."""
    from torchprt.transfer import Sight

    sight = transfer.receivers.tensors().get("sight")
    if sight is None:
        return []
    told = {
        Sight.TURNED: "turned (their faces cancel or oppose each other)",
        Sight.MOVED: "moved off their own surface",
        Sight.FILLED: "filled from their neighbours (under their own surface or in a solid)",
        Sight.BLIND: "left dark (as those that are filled, but no neighbour sees)",
    }
    counts = {kind: int((sight == kind).sum()) for kind in told}
    parts = [f"{counts[kind]} {what}" for kind, what in told.items() if counts[kind]]
    return [f"receivers that could not see: {', '.join(parts)}"] if parts else []


def _functions(layer: Layer) -> str:
    """What stands between the light and the eye."""
    about, (_, _, rows, _) = layer.metadata(), layer.signal.shape
    if "reflectance" in layer.needs:
        return f"incident radiance of order {math.isqrt(rows)}"
    if "receivers" in layer.needs:
        return f"what arrives around it of order {math.isqrt(rows)}"
    if "output_order" not in about:
        if "factor_error" in about:
            return count(rows, "factor")
        return count(rows, "function of the eye", "functions of the eye")
    shown = f"output order {about['output_order']} ({about['projection']})"
    seen = getattr(layer, "visibility_order", None)
    return shown if seen is None else f"visibility order {seen}, {shown}"


def _surface(layer: Layer) -> list[str]:
    """Albedo, materials, and how well its functions of the eye hold them."""
    about = layer.metadata()
    if "receivers" in layer.needs:
        error = about["interpolation_error"]
        lines = [] if error is None else [f"diffuse receivers between nodes err by {error:.2%} (RMS), rays included"]
        if about["inside"]:
            lines.append(f"{count(about['inside'], 'node')} in the object, filled from those around")
        return lines
    if "materials" not in about:
        lines = [f"{layer.weight_name} {_weight(layer.weight)}"]
        if "moments" in about:
            # Of a single moment there is no direction.
            cosine = [*about["moments"], 0.0][1]
            lines.append(f"phase function of order {len(about['moments'])}, mean cosine {cosine:.3g}")
        return lines
    names = ", ".join(about["materials"]) or "none"
    lines = [f"materials {names}, {layer.weight_name} {_weight(layer.weight)}"]
    if "reflectance" in layer.needs:
        lines.append("the reflectance is chosen when it is shaded, that of bounces excepted")
    if about.get("factor_error") is not None:
        lines.append(f"{_functions(layer)} hold the material to {about['factor_error']:.2%}")
    if about.get("exit_error") is not None:
        worst = names if len(about["materials"]) == 1 else "the worst material"
        lines.append(f"exit functions of order {about['output_order']} hold {worst} to {about['exit_error']:.2%}")
    if about.get("product_error") is not None:
        order = getattr(layer, "visibility_order", None)
        lines.append(f"visibility of order {order} costs {about['product_error']:.2%} of radiance")
    return lines


def _clusters(transfer: Transfer, layer: Layer) -> list[str]:
    """What compression cost and how often triangles are drawn by engines that draw a cluster at a time."""
    parts, about = layer.signal.tensors(), layer.signal.metadata()
    if "label" not in parts:
        return []
    from torchprt.compression import overdraw
    from torchprt.compression.transfer import faces_between

    clusters, vectors = len(parts["mean"]), len(parts["basis"])
    lost = f"compression error {about['compression_error'] or 0:.2%} (relative RMS)"
    if about["method"] == "D3DX":
        lost = "compression error not known"
    first = f"{count(clusters, 'cluster')} ({about['method']}), {vectors / clusters:.3g} PCA vectors each, {lost}"
    if len(parts["shared"]):
        first += f", in {count(len(parts['shared']), 'shared axis')}"
    squared = parts["squared_error"].double()
    worst = float(squared.max() / squared.mean()) ** 0.5 if float(squared.sum()) else 1.0
    sizes = {name: parts[name].numel() * parts[name].element_size() for name in ("label", "weights")}
    sizes["representatives"] = layer.signal.bytes - sum(sizes.values())
    told = ", ".join(f"{name} {size / 2**20:.2f} MB" for name, size in sizes.items())
    faces = faces_between(transfer, layer)
    drawn = f", overdraw {overdraw(faces, parts['label']):.3f}" if len(faces) else ""
    order = ", vertices in the order of clusters" if "original" in transfer.receivers.tensors() else ""
    return [first, f"{told}, worst vertex {worst:.1f} times the RMS{drawn}{order}"]


def _lobes(layer: Layer) -> list[str]:
    """How transfer is held in lobes that turn with the surface."""
    parts, about = layer.signal.tensors(), layer.signal.metadata()
    if "axis" not in parts:
        return []
    rows, lobes = parts["axis"].shape[:2]
    said = f"{count(lobes, 'lobe')} a {'vertex' if rows == 1 else 'row'}"
    if parts["exact"].shape[2]:
        said += ", bands 0 and 1 exact"
    if about["smooth"]:
        said += ", lobes of neighbours correspond"
    return [said if about["fit_error"] is None else f"{said}, fit error {about['fit_error']:.2%} (relative RMS)"]


def _weight(weight: Tensor) -> str:
    if len(weight) == 1:
        return ", ".join(f"{value:.3g}" for value in weight[0].tolist())
    return f"of every vertex, mean {triple(weight.expand(-1, 3).float().mean(0))}"
