"""What the command says: lines on standard output, complaints on standard error, what a bake holds."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.transfer import CompressedTransfer, Transfer, ZonalFactoredTransfer, ZonalMap, ZonalTransfer


def say(what: Any) -> None:
    print(what, flush=True)


def complain(what: Any) -> None:
    print(f"torchprt: {what}", file=sys.stderr, flush=True)


def triple(values: Tensor) -> str:
    return "({:.4g}, {:.4g}, {:.4g})".format(*values.tolist())


def describe(transfer: Transfer) -> str:
    """Kind, size and Monte Carlo error of a transfer in a line."""
    from torchprt.transfer.kinds import DIFFUSE

    parts = [transfer.kind, transfer.transport]
    if transfer.bounces:
        parts.append(f"{transfer.bounces} {'bounce' if transfer.bounces == 1 else 'bounces'}")
    parts.append(f"order {transfer.order}")
    if not isinstance(transfer, DIFFUSE):
        parts.append(_rows(transfer))
    parts += ["3 channels" if transfer.channels == 3 else "1 channel", f"{transfer.vertices} vertices"]
    if not isinstance(transfer, DIFFUSE):
        parts[-1] += f" ({len(transfer.glossy)} glossy)"
    parts.append(f"{transfer.bytes / 2**20:.1f} MB of {str(_stored(transfer).dtype).removeprefix('torch.')}")
    if transfer.error is not None and transfer.signal:
        parts.append(f"error {transfer.error / transfer.signal:.2%} (RMS, Monte Carlo estimate)")
    return ", ".join(parts)


def describe_map(baked: ZonalMap) -> str:
    """Size, lobes and error of the map of a patch in a line."""
    rows, columns = baked.size
    fitted = "" if baked.fit_error is None else f", fit {baked.fit_error:.2%}"
    smooth = ", smooth" if baked.smooth else ""
    tiles = "tiles" if baked.tiles_u and baked.tiles_v else "a single patch"
    return (
        f"map of {rows} x {columns} texels, {baked.transport}, order {baked.order}, {baked.lobes} lobes{smooth}, "
        f"{tiles}, {baked.bytes / 1024:.0f} kB{fitted}"
    )


def _stored(transfer: Any) -> Tensor:
    """What most of the bytes are."""
    names = ("transfer", "matrix", "weights", "visibility", "coefficients")
    return next(getattr(transfer, name) for name in names if hasattr(transfer, name))


def details(transfer: Transfer) -> list[str]:
    """Lines about the surfaces of a transfer: albedo, materials, and how well its functions of the eye hold them."""
    from torchprt.transfer import (
        ClusteredFactoredTransfer,
        ClusteredVisibilityTransfer,
        FactoredTransfer,
        VisibilityTransfer,
        ZonalFactoredTransfer,
        ZonalTransfer,
    )
    from torchprt.transfer.clustered import Clusters
    from torchprt.transfer.kinds import DIFFUSE, INCIDENT

    lines = [f"{transfer.vertices} receivers, {len(transfer.faces)} faces, albedo {_weight(transfer.albedo)}"]
    if isinstance(transfer, Clusters):
        lines += _clusters(transfer)
    if isinstance(transfer, ZonalTransfer | ZonalFactoredTransfer):
        lines.append(_lobes(transfer))
    if isinstance(transfer, DIFFUSE):
        return lines
    names = ", ".join(transfer.materials) or "none"
    lines.append(f"materials {names}, specular {_weight(transfer.specular)}")
    if isinstance(transfer, INCIDENT):
        lines.append("the reflectance is chosen when it is shaded" + ", bounces excepted" * bool(transfer.bounces))
    elif isinstance(transfer, FactoredTransfer | ClusteredFactoredTransfer | ZonalFactoredTransfer):
        if transfer.factor_error is not None:
            lines.append(f"{len(transfer.factors)} factors hold the material to {transfer.factor_error:.2%}")
    elif transfer.exit_error is not None:
        worst = names if len(transfer.materials) == 1 else "the worst material"
        lines.append(f"exit functions of order {transfer.output_order} hold {worst} to {transfer.exit_error:.2%}")
    if isinstance(transfer, VisibilityTransfer | ClusteredVisibilityTransfer) and transfer.product_error is not None:
        lines.append(f"visibility of order {transfer.visibility_order} costs {transfer.product_error:.2%} of radiance")
    return lines


def _clusters(transfer: CompressedTransfer) -> list[str]:
    """What compression cost and how often triangles are drawn."""
    from torchprt.compression import overdraw
    from torchprt.compression.transfer import receiver_faces

    about = f"{len(transfer.mean)} clusters ({transfer.method}), {len(transfer.basis) / len(transfer.mean):.3g} PCA"
    about += f" vectors each, compression error {transfer.compression_error or 0:.2%} (relative RMS)"
    if len(transfer.shared):
        about += f", in {len(transfer.shared)} shared axes"
    per_receiver = transfer.squared_error.double()
    worst = float(per_receiver.max() / per_receiver.mean()) ** 0.5 if float(per_receiver.sum()) else 1.0
    parts = {
        "labels": transfer.label,
        "weights": transfer.weights,
        "representatives": transfer.mean,
    }
    sizes = {name: part.numel() * part.element_size() for name, part in parts.items()}
    for part in (transfer.basis, transfer.shared, transfer.low, transfer.step, transfer.offsets):
        sizes["representatives"] += part.numel() * part.element_size()
    told = ", ".join(f"{name} {size / 2**20:.2f} MB" for name, size in sizes.items())
    faces = receiver_faces(transfer)
    drawn = f", overdraw {overdraw(faces, transfer.label):.3f}" if len(faces) else ""
    order = ", vertices in the order of clusters" if len(transfer.original) else ""
    return [about, f"{told}, worst vertex {worst:.1f} times the RMS{drawn}{order}"]


def _lobes(transfer: ZonalTransfer | ZonalFactoredTransfer) -> str:
    """How transfer is held in lobes that turn with the surface."""
    each = "row" if hasattr(transfer, "factors") else "vertex"
    about = f"{transfer.lobes} {'lobe' if transfer.lobes == 1 else 'lobes'} a {each}"
    if transfer.exact.shape[-2]:
        about += ", bands 0 and 1 exact"
    if transfer.smooth:
        about += ", lobes of neighbours correspond"
    return about if transfer.fit_error is None else f"{about}, fit error {transfer.fit_error:.2%} (relative RMS)"


def _rows(transfer: Any) -> str:
    """What stands between the light and the eye at a glossy receiver."""
    from torchprt.transfer.kinds import INCIDENT

    if hasattr(transfer, "factors"):
        return f"{len(transfer.factors)} factors"
    if isinstance(transfer, INCIDENT):
        return f"incident radiance of order {transfer.output_order}"
    shown = f"output order {transfer.output_order} ({transfer.projection})"
    return f"visibility order {transfer.visibility_order}, {shown}" if hasattr(transfer, "visibility_order") else shown


def _weight(weight: Tensor) -> str:
    if len(weight) == 1:
        return ", ".join(f"{value:.3g}" for value in weight[0].tolist())
    return f"of every vertex, mean {triple(weight.expand(-1, 3).mean(0))}"
