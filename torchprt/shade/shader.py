"""The shader: layers put under a light, toward an eye, in a pose, and added up."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.pose import DeformedFrames
from torchprt.sh import Rotation, check_rotation, rotate
from torchprt.sh.basis import values_are_at_hand
from torchprt.sh.precision import at_least_single, whole_rotation
from torchprt.shade.fixed_light import FixedLightShader
from torchprt.shade.layer import DiffuseLayer, LayerModule, layer_module
from torchprt.shade.signal import Making, signal_module
from torchprt.transfer import Transfer
from torchprt.words import count

_MAKE_AGAIN = "make it with shader(transfer) of transfer that is loaded on a device that is there"


class Shader(nn.Module):
    """Exit radiance of transfer: the sum of its layers, each its weight times its transfer under the light.

    Made by `torchprt.shader(transfer)`, on the device of the transfer. `needs` says what a call takes beside the light:
    "eye", "pose" (which may be omitted: the rest pose). `layers`: a `LayerModule` each by name, whose buffers, or
    parameters if they are to be learned, hold the transfer.

    Laws: linear in `light`; turning the light and asking for `rotation` are the same; light, eye and pose turned
    together change nothing; channels do not mix.
    Source: Sloan, Kautz and Snyder 2002, section 6; Sloan, Hall, Hart and Snyder 2003, sections 3 and 6; Sloan, Luna
    and Snyder 2005, sections 4 and 5.
    """

    def __init__(
        self, layers: Mapping[str, LayerModule], turn: Rotation, vertices: int, estimate: DeformedFrames | None = None
    ):
        """`estimate`: the frames of poses, if all layers follow one."""
        super().__init__()
        self.layers: Mapping[str, LayerModule] = nn.ModuleDict(layers)  # type: ignore[assignment]
        self.turn = turn
        self.order = turn.order
        self.vertices = vertices
        self.estimate = estimate
        self.register_load_state_dict_post_hook(_refuse_half_loaded)
        needs = frozenset[str]().union(*(layer.needs for layer in layers.values()))
        self.needs = needs | {"pose"} if estimate is not None else needs

    def extra_repr(self) -> str:
        return f"order={self.order}, vertices={self.vertices}, needs={sorted(self.needs)}"

    @property
    def dtype(self) -> torch.dtype:
        """The dtype of what is stored and multiplied; places, directions and tables are float32 at least."""
        return next(layer.weight.dtype for layer in self.layers.values())

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
        frames: Float[Tensor, "*#B V 3 3"] | None = None,
        positions: Float[Tensor, "*#B V 3"] | None = None,
        out: Tensor | None = None,
    ) -> Float[Tensor, "... V 3"]:
        """Linear exit radiance of every receiver under every light, toward every eye, in every pose.

        `light [..., N, 3]`; `rotation [..., 3, 3]` turns the environment, not the surface (identity if omitted).
        If it needs an eye: exactly one of `eye [..., 3]`, a point in the unit of the scene, and `view [..., 3]`, the
        direction toward a distant eye, of any length above zero. If it follows a pose: `frames [..., V, 3, 3]`, the
        rotation of every receiver from the rest pose, or `positions [..., V, 3]` of the deformed mesh, from which they
        are estimated (`pose.DeformedFrames`); frames count if both are given, the rest pose if neither is. A point is
        seen from `positions`, so an eye with frames needs both.

        `light` may be narrower or wider than the shader, as long as both are float64 or neither is: the products are
        made in the dtype of the shader, and the result has that of `light`. Rotations, eyes, views and poses are used
        in float32 at least. Autocast changes the products alone.

        All batches broadcast. Fastest where the dimensions of many lights have size 1 in those of eye and pose: they
        are then applied once, and a further light costs what a diffuse one does; any other eye or pose takes C N V
        numbers of memory. The result is a view with vertices contiguous, not a permuted copy. `out`: a former result
        to write over, for loops that must not allocate; of one layer that is stored whole, and without gradients.

        Raises InputError if the light is of another order, what it needs is not given or what it does not need is,
        shapes do not fit or, outside a traced graph, if a direction is zero or not finite, `rotation` or frames are not
        proper rotations within 1e-4 (a collapsed or mirrored frame is none), or positions are not finite.
        """
        self.check_given(eye, view, frames, positions)
        wanted, light = light.dtype, turned_light(light, rotation, self.turn).to(self.dtype)
        if out is not None and wanted != self.dtype:
            raise InputError(f"out cannot be used with a light in {wanted}: the shader is {self.dtype}, convert one")
        turned = None if frames is None and positions is None else self.pose(frames, positions)
        if out is not None and len(self.layers) != 1:
            raise InputError(f"out cannot be used with {len(self.layers)} layers: leave it out")
        radiance: Tensor | None = None
        for layer in self.layers.values():
            posed = None if turned is None else layer.among(turned, -3)
            values = layer.values(eye, view, posed, positions)
            radiance = layer.spread(layer(light, values, posed, out), radiance, self.vertices)
        assert radiance is not None
        return radiance.mT.to(wanted)

    def vectors(
        self,
        *,
        eye: Float[Tensor, "3"] | None = None,
        view: Float[Tensor, "3"] | None = None,
        frames: Float[Tensor, "V 3 3"] | None = None,
        positions: Float[Tensor, "V 3"] | None = None,
    ) -> Float[Tensor, "C N V"]:
        """What a light is multiplied with for one eye and one pose: the transfer vectors of all layers, weights inside.

        C = 3 if a weight or transfer has three channels. Raises InputError as `forward`, and for more than one.
        """
        self.check_given(eye, view, frames, positions)
        turned = self._one_pose(frames, positions)
        total: Tensor | None = None
        for layer in self.layers.values():
            posed = None if turned is None else layer.among(turned, -3)
            values = layer.values(eye, view, posed, positions)
            if values is not None and values.ndim != 2:
                raise InputError("eye or view has a batch: fix one at a time, of shape [3]")
            vectors = (layer.toward(values, posed) * layer.weight.T.unsqueeze(1)).to(self.dtype)
            # Of a layer that answers to fewer bands.
            missing = self.order**2 - vectors.shape[1]
            vectors = vectors if missing == 0 else nn.functional.pad(vectors, (0, 0, 0, missing))
            total = layer.spread(vectors, total, self.vertices)
        assert total is not None
        return total

    def fix_eye(self, *, eye: Float[Tensor, "3"] | None = None, view: Float[Tensor, "3"] | None = None) -> Shader:
        """A shader for lights alone, with one `eye` or `view`: one diffuse layer of `vectors`, at rest.

        Equal to the general call to rounding. Gradients flow through it to the eye and the parameters of this shader.
        Raises InputError as `forward`, and if more than one eye is given.
        """
        vectors = self.vectors(eye=eye, view=view).contiguous()
        layer = DiffuseLayer.holding(vectors, vectors.new_ones(1, 1).detach())
        return Shader({"diffuse": layer}, self.turn, self.vertices)

    def fix_light(
        self, light: Float[Tensor, "*#B N 3"], rotation: Float[Tensor, "*#B 3 3"] | None = None
    ) -> FixedLightShader:
        """A shader for eyes alone, under one light or a batch, at rest: what rows send and other radiance are stored.

        Equal to the general call to rounding. Stores 3 (M G + V) numbers a light. Gradients flow through it to the
        light and the parameters of this shader. Raises InputError as `forward`, and if it needs no eye.
        """
        if "eye" not in self.needs:
            raise InputError("fix_light is for shaders that need an eye: this one gives its radiance when it is called")
        light = turned_light(light, rotation, self.turn).to(self.dtype)
        radiance: Tensor | None = None
        seen: dict[str, LayerModule] = {}
        coefficients: dict[str, Tensor] = {}
        for name, layer in self.layers.items():
            if "eye" in layer.needs:
                seen[name] = layer
                coefficients[name] = (layer.under(layer.lit(light)) * layer.weight.T.unsqueeze(-2)).to(self.dtype)
            else:
                radiance = layer.spread(layer(light), radiance, self.vertices)
        return FixedLightShader(seen, coefficients, radiance, self.vertices, self.order)

    def fix_pose(
        self, frames: Float[Tensor, "V 3 3"] | None = None, *, positions: Float[Tensor, "V 3"] | None = None
    ) -> Shader:
        """The shader of one pose: its transfer is stored, and it costs what a static one does.

        Equal to the general call to rounding. Gradients flow through it to the pose and the parameters of this shader.
        With `frames` alone the receivers stay where they are at rest: then give `view`, not `eye`.
        Raises InputError as `forward`, if it follows no pose, and if there is more than one.
        """
        if "pose" not in self.needs:
            raise InputError("fix_pose is for shaders that follow a pose: this one has one, as it was baked")
        self.check_given(None, None, frames, positions)
        turned = self._one_pose(frames, positions)
        layers = {
            name: layer.posed(None if turned is None else layer.among(turned, -3), positions)
            for name, layer in self.layers.items()
        }
        return Shader(layers, self.turn, self.vertices)

    def pose(self, frames: Tensor | None, positions: Tensor | None) -> Float[Tensor, "*P V 3 3"] | None:
        """The frames of a pose, checked, in float32 at least; None for the rest pose."""
        dtype = self.turn.project.dtype
        if frames is not None:
            if frames.shape[-3:] != (self.vertices, 3, 3):
                raise InputError(
                    f"frames have shape {list(frames.shape)}: the transfer has {self.vertices} receivers, give "
                    f"[..., {self.vertices}, 3, 3]"
                )
            check_rotation(frames, "frames")
            return whole_rotation(frames).to(dtype)
        if positions is None:
            return None
        if values_are_at_hand(positions) and not bool(positions.isfinite().all()):
            raise InputError("positions hold NaN or infinity: give finite numbers")
        assert self.estimate is not None
        return self.estimate(positions).to(dtype)

    def _one_pose(self, frames: Tensor | None, positions: Tensor | None) -> Float[Tensor, "V 3 3"] | None:
        turned = self.pose(frames, positions)
        if turned is not None and turned.ndim != 3:
            raise InputError("frames or positions have a batch: fix one pose at a time")
        return turned

    def check_given(
        self, eye: Tensor | None, view: Tensor | None, frames: Tensor | None, positions: Tensor | None
    ) -> None:
        """InputError if an eye or a pose is given that this shader has no use for, or one that does not suffice."""
        if "eye" not in self.needs and not (eye is None and view is None):
            raise InputError("eye or view is given, but what this shader gives does not depend on it: omit it")
        if "pose" not in self.needs and not (frames is None and positions is None):
            raise InputError("frames or positions are given, but this shader has one pose: omit them")
        if eye is not None and frames is not None and positions is None:
            raise InputError("eye is a point and frames are given without positions: give positions too, or a view")


def shader(
    transfer: Transfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = (), **choices: Any
) -> Shader:
    """The `nn.Module` that shades `transfer`.

    `dtype`: of what it stores and multiplies (float32, or wider if the transfer is); places, directions and tables are
    float32 at least, also after `.half()`; `learn`: names of buffers that become parameters, as
    "albedo", "specular" or "values", of every layer that has them, or "exit.values" for that of one. With bounces
    albedo and specular were also baked into what other surfaces receive, so learning them is refused.

    `choices`: what layers and signals leave open. For incident transfer the reflectance, `exponent` of a Phong lobe (40
    if neither is given) or `brdf`; for zonal lobes the `method`, "direct" or "table". None counts as not given.
    Raises InputError for a name that cannot be learned, or for a choice that no layer leaves open.
    """
    given = {name: value for name, value in choices.items() if value is not None}
    classes = {
        name: (layer_module.dispatch(type(layer)), signal_module.dispatch(type(layer.signal)))
        for name, layer in transfer.layers.items()
    }
    open_ = {choice for pair in classes.values() for each in pair for choice in getattr(each, "choices", ())}
    for name in sorted(given.keys() - open_):
        raise InputError(f"{name} is given, but transfer of kind '{transfer.kind}' does not leave it open")
    learnable = {
        name: [each for part in pair for each in getattr(part, "learnable", ())] for name, pair in classes.items()
    }
    learned = _learned(transfer, learnable, (learn,) if isinstance(learn, str) else tuple(learn))
    if dtype is None:
        dtype = torch.float32
        for layer in transfer.layers.values():
            dtype = torch.promote_types(dtype, layer.signal.dtype)
    device = transfer.positions.device
    if device.type == "meta":
        raise InputError(f"the transfer is on the meta device, where it has no values: {_MAKE_AGAIN}")
    estimate = None
    # It is where the transfer is, whatever the default device.
    with torch.device("cpu"):
        layers = {
            name: layer_module(layer, Making(transfer.receivers, dtype, learned[name], given))
            for name, layer in transfer.layers.items()
        }
        if "pose" in transfer.needs:
            estimate = DeformedFrames(transfer.positions, transfer.faces, normals=transfer.normals).to(
                at_least_single(dtype)
            )
    return Shader(layers, Rotation(transfer.order, dtype).to(device), transfer.vertices, estimate)


def _refuse_half_loaded(module: nn.Module, _: Any) -> None:
    """InputError if a state dict was assigned to a shader on the meta device, whose constants are then still there."""
    assert isinstance(module, Shader)
    if module.turn.project.is_meta and not next(iter(module.layers.values())).weight.is_meta:
        raise InputError(f"the shader is on the meta device, and no state dict holds all of it: {_MAKE_AGAIN}")


def _learned(transfer: Transfer, learnable: Mapping[str, list[str]], learn: tuple[str, ...]) -> dict[str, set[str]]:
    """The names to learn of every layer. InputError for one that there is not, or that was baked in."""
    learned: dict[str, set[str]] = {name: set() for name in transfer.layers}
    for wanted in learn:
        of, _, name = wanted.rpartition(".")
        found = [each for each in learned if name in learnable[each] and of in ("", each)]
        if not found:
            known = ", ".join(f"'{each}'" for each in sorted({each for names in learnable.values() for each in names}))
            raise InputError(
                f"learn names '{wanted}': a shader of transfer of kind '{transfer.kind}' can learn {known}"
            )
        for each in found:
            if name == transfer.layers[each].weight_name and transfer.bounces > 0:
                raise InputError(
                    f"{name} cannot be learned: {count(transfer.bounces, 'bounce')} of the bake took it into what "
                    "other surfaces receive; bake without bounces"
                )
            learned[each].add(name)
    return learned


def turned_light(light: Tensor, rotation: Tensor | None, turn: Rotation) -> Tensor:
    """`light [*B, N, 3]` as a shader uses it: turned if asked to, InputError if it is not of the order of `turn`, or
    if one is float64 and the other is not."""
    if light.shape[-2] != turn.order**2:
        raise InputError(
            f"light has {light.shape[-2]} coefficients but the transfer is of order {turn.order}: "
            f"project the light with order={turn.order}"
        )
    wide = turn.project.dtype
    if not light.is_floating_point() or torch.promote_types(light.dtype, torch.float32) != wide:
        raise InputError(f"light is {light.dtype} but the shader works in {wide}: convert the light with .to({wide})")
    if rotation is None:
        return light
    # A graph takes its constants from the module; elsewhere the rotation is checked and the fast way taken.
    return turn(light, rotation) if torch.compiler.is_compiling() else rotate(light, rotation)
