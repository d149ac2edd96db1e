"""An object that moves over the model of a page, and casts its shadow on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import onnx
from torchprt.errors import InputError
from torchprt.preview.modes import reflectance
from torchprt.transfer import Transfer

SHADOW, OBJECT, MESH = "shadow.onnx", "object.onnx", "object.glb"


@dataclass(frozen=True, eq=False)
class Flight:
    """`neighbourhood` of an object (see `bake_neighbourhood`), a bake of the object itself, `model`, which is drawn,
    and the `poses [T, 4, 4]` that it goes through in `seconds`, and then again from the first.

    The model of the page keeps its own transfer: its radiance is multiplied by what the object leaves of the plain
    light that a white diffuse surface would reflect there (`shade.by_ratio`).
    """

    neighbourhood: Transfer
    model: Transfer
    poses: Float[Tensor, "T 4 4"]
    seconds: float = 12.0

    def check(self, order: int) -> None:
        """InputError unless all are for lights of `order`, the model can be drawn, and there is a pose."""
        for name, each in (("neighbourhood", self.neighbourhood), ("model", self.model)):
            if each.order != order:
                raise InputError(
                    f"the {name} of the flight is of order {each.order}, the page of {order}: bake all with one order"
                )
        self.neighbourhood.receivers.as_grid()
        if self.model.needs or not len(self.model.faces):
            raise InputError(
                "the model of the flight must be a diffuse bake of a mesh: a page draws no other beside it"
            )
        if self.poses.ndim != 3 or not len(self.poses) or not bool(self.poses.isfinite().all()) or not self.seconds > 0:
            raise InputError(f"poses of the flight have shape {list(self.poses.shape)}: give finite ones, [T, 4, 4]")

    def write(
        self, folder: Path, save: Callable[..., Any], check: bool
    ) -> tuple[dict[str, Any], tuple[Path, ...], tuple[str, ...]]:
        """What `scene.json` says of it, the graphs, which are to be zipped, and other files."""
        onnx.export_neighbourhood(self.neighbourhood, folder / SHADOW, check=check)
        onnx.export(self.model, folder / OBJECT, check=check)
        save(self.model.positions, self.model.normals, self.model.faces, folder / MESH, colour=reflectance(self.model))
        poses = torch.as_tensor(self.poses, dtype=torch.float64)
        about = {"poses": [[round(x, 6) for x in pose.flatten().tolist()] for pose in poses], "seconds": self.seconds}
        return about, (folder / SHADOW, folder / OBJECT), (MESH,)
