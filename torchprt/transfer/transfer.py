"""What a bake leaves: where it was recorded, what is seen there, and what is known of the bake."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.dense import Dense
from torchprt.transfer.layer import Diffuse, Layer
from torchprt.transfer.receivers import Receivers, Vertices, called
from torchprt.words import count

Transport = Literal["unshadowed", "shadowed", "interreflected"]
# What is known of some transfers alone.
SELDOM = ("cut",)
# A shader keeps its layers by name in a module, which has these already.
_TAKEN = frozenset(dir(torch.nn.ModuleDict()))


@dataclass(kw_only=True, repr=False)
class Transfer:
    """Exit radiance of V receivers as a linear function of the light: the sum of `layers`.

    - `receivers`: where: `Vertices`, or the `Texels` of a patch.
    - `layers`: what is seen, by name, as `Diffuse` or `Exit`; each says of which receivers, and its `signal` how the
      numbers are stored: `Dense`, `Clustered` or `Zonal`. Any layer may have any signal that it accepts.
    - `transport`: "unshadowed", "shadowed" or "interreflected"; `bounces`: how many were added.
    - `rays`: hemisphere directions a receiver (0 if none was traced); `seed`: of the direction set.
    - `error`: estimated RMS error of a coefficient of the last layer from the finite number of rays, over all
      receivers, and `signal`: RMS of a coefficient, so that `error / signal` is relative; both None if nothing was
      sampled. `version`: of the torchprt that baked it.
    - `cut`: the share of the light that could arrive that was still between mirrors after all reflections that were
      followed, and is left out; None without mirrors.

    Raises InputError if there is no layer, or layers are of other receivers or orders; `check()` also looks at values.
    """

    receivers: Receivers
    layers: Mapping[str, Layer]
    transport: Transport = "shadowed"
    bounces: int = 0
    rays: int = 0
    seed: int = 0
    error: float | None = None
    signal: float | None = None
    version: str = ""
    cut: float | None = None

    def __post_init__(self) -> None:
        if not self.layers:
            raise InputError("the transfer has no layer: give one or more")
        for name, layer in self.layers.items():
            if not name.isidentifier():
                raise InputError(f"layer '{name}' of the transfer: give it a name of letters, digits and underscores")
            if name in _TAKEN:
                raise InputError(f"layer '{name}' of the transfer: modules of torch use that name, give it another")
            layer.check_among(self.vertices)
        orders = {layer.order for layer in self.layers.values()}
        if len(orders) > 1:
            raise InputError(f"layers of the transfer are of orders {sorted(orders)}: all must be of that of the light")

    def __repr__(self) -> str:
        """What it is in a line, not all its numbers."""
        told = [self.kind, f"order {self.order}", self.transport]
        told += [count(self.bounces, "bounce")] if self.bounces else []
        told += [count(self.channels, "channel"), count(self.vertices, "receiver"), f"{self.bytes / 2**20:.1f} MB"]
        if self.error is not None and self.signal:
            told.append(f"error {self.error / self.signal:.2%}")
        return f"Transfer({', '.join(told)})"

    @property
    def kind(self) -> str:
        """What its layers are and how they are stored: "diffuse", "diffuse + clustered exit"."""
        stored = [(layer.signal.kind, layer.kind) for layer in self.layers.values()]
        return " + ".join(kind if signal == Dense.kind else f"{signal} {kind}" for signal, kind in stored)

    @property
    def needs(self) -> frozenset[str]:
        """What a picture of it takes beside the light: "eye", "pose" (if all its signals follow one) and "reflectance"
        (if that is chosen when a shader is made)."""
        needs = frozenset[str]().union(*(layer.needs for layer in self.layers.values()))
        posed = all(layer.signal.follows_pose for layer in self.layers.values())
        return needs | {"pose"} if posed else needs

    @property
    def approximates(self) -> bool:
        """Whether it is compressed: what a bake recorded is stored as something near to it."""
        return any(layer.signal.approximates for layer in self.layers.values())

    @property
    def order(self) -> int:
        """Number of SH bands of the light."""
        return next(iter(self.layers.values())).order

    @property
    def channels(self) -> int:
        """3 if light bounced off coloured surfaces, else 1."""
        return max(layer.signal.shape[1] for layer in self.layers.values())

    @property
    def vertices(self) -> int:
        """Number of receivers V."""
        return self.receivers.count

    @property
    def positions(self) -> Float[Tensor, "V 3"]:
        """Where the receivers are."""
        return self.receivers.positions

    @property
    def normals(self) -> Float[Tensor, "V 3"]:
        """Their unit normals, zero where there is none."""
        return self.receivers.normals

    @property
    def faces(self) -> Int[Tensor, "F 3"]:
        """Triangles between them."""
        return self.receivers.faces

    @property
    def albedo(self) -> Float[Tensor, "#V #3"]:
        """That of the diffuse layer, zero if there is none."""
        found = [layer for layer in self.layers.values() if isinstance(layer, Diffuse) and layer.receivers is None]
        return found[0].albedo if found else torch.zeros(1, 1, device=self.positions.device)

    @property
    def eye_layers(self) -> dict[str, Layer]:
        """The layers that depend on the eye."""
        return {name: layer for name, layer in self.layers.items() if "eye" in layer.needs}

    @property
    def bytes(self) -> int:
        """Bytes of the transfer of all layers, which is what compression lowers."""
        return sum(layer.bytes for layer in self.layers.values())

    @property
    def provenance(self) -> dict[str, Any]:
        """What is known of the bake, by name: all but receivers and layers, and `cut` only with mirrors."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        left = {"receivers", "layers"} | {name for name in SELDOM if fields[name] is None}
        return {name: value for name, value in fields.items() if name not in left}

    def with_layers(self, **layers: Layer) -> Transfer:
        """The same with these layers in place of those of their names, or after the others."""
        return dataclasses.replace(self, layers={**self.layers, **layers})

    def to_order(self, order: int) -> Transfer:
        """For lights of the first `order` bands. Raises InputError unless 1 <= order <= self.order."""
        return self.with_layers(**{name: layer.to_order(order) for name, layer in self.layers.items()})

    def to(self, dtype: torch.dtype) -> Transfer:
        """The same with all signals stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        return self.with_layers(**{name: layer.to(dtype) for name, layer in self.layers.items()})

    def white(self) -> Transfer:
        """The same as if its receivers were white: what they send is irradiance / pi. Light between surfaces keeps the
        colours of these; layers that depend on the eye are left out.

        Raises InputError if there are no others.
        """
        kept = {name: layer for name, layer in self.layers.items() if "eye" not in layer.needs}
        if not kept:
            raise InputError(
                f"transfer of kind '{self.kind}' depends on the eye, and has no irradiance: bake the scene with "
                "diffuse materials for that"
            )
        made = {name: layer.replace(**{layer.weight_name: layer.weight.new_ones(1, 1)}) for name, layer in kept.items()}
        return dataclasses.replace(self, layers=made)

    def with_ground(self) -> Transfer:
        """The same with its ground as one model among others: to be framed, shown whole and written."""
        parts = self.receivers.parts()
        if not any(each["role"] == "ground" for each in parts):
            return self
        objects = [{**each, "role": "receiver"} for each in parts]
        return dataclasses.replace(self, receivers=self.receivers.replace(objects=objects))

    def without_ground(self) -> Transfer:
        """The same without what was recorded on a ground, and without layers that are of nothing else."""
        keep = ~self.receivers.ground()
        return self._of(keep) if bool(keep.any()) else self

    def only(self, *names: str) -> Transfer:
        """The same of some of its objects alone, by the names of their meshes (or of their files without folders), with
        all that the others do to them.

        Raises InputError if one is of no object, or nothing is known of objects.
        """
        known = list(dict.fromkeys(each["name"] for each in self.receivers.parts()))
        for name in names:
            if not any(called(each, name) for each in known):
                found = ", ".join(Path(each).name for each in known) or "no names of any"
                raise InputError(f"the transfer has no object '{name}': it has {found}")
        return self._of(self.receivers.of_objects(names))

    def _of(self, keep: Bool[Tensor, "V"]) -> Transfer:
        """Of the receivers to `keep`, and layers that are of any of them."""
        if bool(keep.all()):
            return self
        index = keep.nonzero()[:, 0]
        place = keep.cumsum(0) - 1
        layers: dict[str, Layer] = {}
        for name, layer in self.layers.items():
            if layer.receivers is None:
                layers[name] = layer.take(index, None)
                continue
            rows = layer.receivers.long()
            among = keep[rows].nonzero()[:, 0]
            if len(among):
                layers[name] = layer.take(among, place[rows[among]].to(layer.receivers.dtype))
        return dataclasses.replace(self, receivers=self.receivers.take(index), layers=layers)

    def check(self, *, numbers: bool = True) -> None:
        """Raises InputError if a tensor holds NaN or infinity, a weight leaves [0, 1], or an index names nothing.

        Without `numbers` layers whose signals are stored number by number, which are large, are passed over.
        """
        self.receivers.check()
        for name, layer in self.layers.items():
            if numbers or layer.signal.approximates:
                layer.check(f"{name}.")


def diffuse_transfer(
    vectors: Float[Tensor, "C N V"],
    albedo: Float[Tensor, "#V #3"],
    positions: Float[Tensor, "V 3"],
    normals: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    **provenance: Any,
) -> Transfer:
    """Transfer of one diffuse layer of these vectors at the vertices of a mesh; see `Diffuse` and `Transfer`."""
    receivers = Vertices(positions=positions, normals=normals, faces=faces)
    layer = Diffuse(albedo=albedo, signal=Dense(values=vectors))
    return Transfer(receivers=receivers, layers={"diffuse": layer}, **provenance)
