"""Transfer of low order as attributes of vertices, for vertex shaders of any engine."""

from __future__ import annotations

import os

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.preview.asset import keep_attributes
from torchprt.preview.asset_source import Asset
from torchprt.preview.glb import save_glb
from torchprt.shade.shader import shader
from torchprt.transfer import Transfer
from torchprt.transfer.file import CONVENTIONS

# WebGL promises 16 attributes of four numbers; position, normal and colour take three.
MOST = 13


def save_transfer_glb(
    transfer: Transfer, path: str | os.PathLike[str], order: int = 3, *, asset: Asset | None = None
) -> None:
    """Writes the mesh with the first `order` bands of its transfer as `.glb`: albedo in `COLOR_0`, vectors in `_PRT_n`.

    Coefficient i of channel c is number `k = c order^2 + i` of a vertex: component `k % 4` of the VEC4 `_PRT_{k // 4}`,
    the last filled with zeros. Exit radiance in channel c is `COLOR_0[c] * sum_i light[i, c] PRT[c, i]`, with the one
    channel for all three if there is only one. `extras` of the mesh say order, channels and conventions.

    With the `asset` that was baked, as `find_asset` gives it, the file is that asset, with all that it had: `COLOR_0`
    is its own, albedo is in `_PRT_ALBEDO`, and what reverse sides recorded is in `_PRT_BACK_n`, `_PRT_BACK_ALBEDO`.

    Raises InputError if the transfer depends on the eye or is of a volume, `order` is above its own, the vectors need
    more than 13 attributes, or `path` cannot be written.
    """
    if not transfer.receivers.on_surface:
        raise InputError("a volume has no vertices that attributes could belong to: export .onnx or a page")
    if list(transfer.layers) != ["diffuse"]:
        raise InputError(
            f"transfer of kind '{transfer.kind}' does not fit attributes of vertices: they hold diffuse transfer alone"
        )
    low = transfer.to_order(order)
    layer = shader(low).layers["diffuse"]
    numbers = layer.toward(None).reshape(-1, low.vertices).float()
    count = -(-len(numbers) // 4)
    if count > MOST:
        raise InputError(
            f"order {order} with {low.channels} channels takes {count} attributes of four numbers, and WebGL leaves "
            f"{MOST}: give a lower order"
        )
    padded = torch.zeros(4 * count, low.vertices)
    padded[: len(numbers)] = numbers
    attributes: dict[str, Tensor] = {f"_PRT_{k}": padded[4 * k : 4 * k + 4].T for k in range(count)}
    albedo = low.albedo.float().expand(low.vertices, 3)
    extras = {"torchprt": {"order": order, "channels": low.channels, "conventions": CONVENTIONS}}
    if asset is not None:
        keep_attributes(asset, low, {"_PRT_ALBEDO": albedo, **attributes}, extras).save(path)
        return
    save_glb(low.positions, low.normals, low.faces, path, colour=albedo, attributes=attributes, extras=extras)
