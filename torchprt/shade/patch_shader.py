"""A patch read at points of a surface, one for every pixel, instead of at its vertices."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from torchprt.errors import InputError
from torchprt.sh.basis import values_are_at_hand
from torchprt.shade.eye_layer import EyeLayerModule
from torchprt.shade.layer import LayerModule
from torchprt.shade.patch import bilinear, mix, sampled_lobes, texels_of
from torchprt.shade.shader import Shader, shader, turned_light
from torchprt.shade.zonal import ZonalSignal
from torchprt.transfer import Texels, Transfer, Zonal


class PatchShader(nn.Module):
    """Radiance of a patch at any points: read there through texture coordinates, turned by tangent frames, put under
    the light, all points and lights at once.

    What `lay` does at vertices, for the pixels of a picture: detail between the vertices is not lost, and nothing is
    stored for the surface. `shader`: the shader of the patch itself, on its texels; what `learn` names there are the
    parameters. `choices` and `learn` as in `torchprt.shader`.

    Laws: linear in the light; at points that are vertices it gives what the shader of `lay` gives, and also where
    texture coordinates are mirrored and glossy layers cannot be laid; turning frames, light and eye together changes
    nothing.
    Raises InputError if `patch` is none, or if a layer of it is not in lobes.
    Source: Sloan, Luna and Snyder 2005, sections 5 and 6 (a pixel shader that looks zonal lobes up in textures).
    """

    def __init__(self, patch: Transfer, *, learn: Iterable[str] = (), dtype: torch.dtype | None = None, **choices: Any):
        super().__init__()
        self._texels: Texels = texels_of(patch)
        self._smooth = {name: cast(Zonal, layer.signal).smooth for name, layer in patch.layers.items()}
        self.shader: Shader = shader(patch, learn=learn, dtype=dtype, **choices)
        self.needs = self.shader.needs - {"pose"}
        self.order = self.shader.order

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        uv: Float[Tensor, "V 2"],
        frames: Float[Tensor, "frames 3 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
        positions: Float[Tensor, "V 3"] | None = None,
    ) -> Float[Tensor, "... V 3"]:
        """Linear exit radiance `[*B, V, 3]` of V points of a surface.

        `uv` texture coordinates, in patches; `frames` as `pose.surface_frames` makes them, columns tangent, bitangent
        and normal, left-handed where coordinates are mirrored; a point whose frame is zero gets no light. If it needs
        an eye: exactly one of `eye`, a point, which needs the `positions` of the points too, and `view`, a direction.
        Memory: C N V numbers for each eye and 4 M L V of axes: many points want to come in pieces.
        Raises InputError if shapes do not fit, what it needs is not given, or texture coordinates are not finite.
        """
        # Not `len`, which would make a constant of the number of points in a traced graph.
        if uv.shape != (frames.shape[0], 2) or frames.shape[1:] != (3, 3):
            raise InputError(
                f"uv have shape {list(uv.shape)} and frames {list(frames.shape)}: give [V, 2] and [V, 3, 3]"
            )
        if values_are_at_hand(uv) and not bool(uv.isfinite().all()):
            raise InputError("uv of the points are not finite: give every point a pair of texture coordinates")
        if eye is not None and positions is None and "eye" in self.needs:
            raise InputError("eye is a point: give the positions of the points too, or a view")
        if "eye" not in self.needs and not (eye is None and view is None):
            raise InputError("eye or view is given, but the patch looks alike from everywhere: omit it")
        wanted = light.dtype
        light = turned_light(light, rotation, self.shader.turn).to(self.shader.dtype)
        taps, shares = bilinear(self._texels, uv)
        frames = frames.to(self.shader.turn.project.dtype)
        shown = (frames[..., 2].detach().abs().amax(-1) > 0).to(light.dtype)
        total: Tensor | None = None
        for name, layer in self.shader.layers.items():
            here = self._at_points(layer, self._smooth[name], taps, shares, positions)
            radiance = here(light, here.values(eye, view, frames), frames)
            total = radiance if total is None else total + radiance
        assert total is not None
        return (total * shown).mT.to(wanted)

    def _at_points(
        self, layer: LayerModule, smooth: bool, taps: Tensor, shares: Tensor, positions: Tensor | None
    ) -> LayerModule:
        """A layer of the patch whose receivers are points between its texels."""
        stored = cast(ZonalSignal, layer.signal)
        lobes = sampled_lobes(stored.axis, stored.coefficients, stored.exact, taps, shares, smooth)
        signal = _changed(stored, axis=lobes[0], coefficients=lobes[1], exact=lobes[2])
        signal.shape = (taps.shape[1], *stored.shape[1:])
        weight = layer.weight if len(layer.weight) == 1 else mix(layer.weight.mT, taps, shares).mT
        changes: dict[str, Tensor] = {layer.weight_name: weight}
        if isinstance(layer, EyeLayerModule):
            # Rows tangent, bitangent, normal: the mean is made a frame again, about the normal.
            tangent, _, up = mix(layer.frames, taps, shares).unbind(0)
            up = normalize(up, dim=0)
            tangent = normalize(tangent - (tangent * up).sum(0) * up, dim=0)
            changes["frames"] = torch.stack([tangent, torch.linalg.cross(up, tangent, dim=0), up])
            changes["points"] = torch.zeros_like(up) if positions is None else positions.mT
        return layer.changed(signal=signal, **changes)


def _changed(signal: ZonalSignal, **lobes: Tensor) -> ZonalSignal:
    made = copy.copy(signal)
    made._buffers, made._parameters = {**signal._buffers, **lobes}, {}
    return made
