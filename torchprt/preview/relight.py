"""Shading in a loop in which light, eye and pose mostly stay."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.shade import FixedLightShader, Shader


class Relight:
    """Calls `shader` for one light, one eye and one pose, and folds in what stays from call to call.

    The result is that of the shader to rounding. What a shader does not depend on is not passed to it.
    """

    def __init__(self, shader: Shader):
        self.shader = shader
        self.follows_pose = "pose" in shader.needs
        self.follows_eye = "eye" in shader.needs
        self._light: Tensor | None = None
        self._eye: Tensor | None = None
        self._pose: Tensor | None = None
        self._posed: Shader | None = None
        self._fixed_light: FixedLightShader | None = None
        self._fixed_eye: Shader | None = None

    @torch.no_grad()
    def __call__(
        self, light: Float[Tensor, "N 3"], eye: Float[Tensor, "3"], pose: Float[Tensor, "V 3"] | None = None
    ) -> Float[Tensor, "V 3"]:
        """Linear exit radiance toward `eye`; `pose`: where the vertices are, as at rest if omitted.

        Raises InputError as the shader.
        """
        shader = self.shader
        if self.follows_pose:
            if not _same(pose, self._pose):
                self._pose, self._posed = pose, None
                moved = {} if pose is None else {"positions": pose}
                return shader(light, **moved, **({"eye": eye} if self.follows_eye else {}))
            shader = self._still(pose)
        if not self.follows_eye:
            return shader(light)
        same_light, same_eye = _same(light, self._light), _same(eye, self._eye)
        self._fixed_light = self._fixed_light if same_light else None
        self._fixed_eye = self._fixed_eye if same_eye else None
        self._light, self._eye = light, eye
        if same_light and not same_eye and self._fixed_light is None:
            self._fixed_light = shader.fix_light(light)
        if same_eye and not same_light and self._fixed_eye is None:
            self._fixed_eye = shader.fix_eye(eye=eye)
        if self._fixed_light is not None:
            return self._fixed_light(eye=eye)
        if self._fixed_eye is not None:
            return self._fixed_eye(light)
        return shader(light, eye=eye)

    @torch.no_grad()
    def transfer_of(
        self, vertex: int, eye: Float[Tensor, "3"], pose: Float[Tensor, "V 3"] | None = None
    ) -> Float[Tensor, "N 3"]:
        """What a vertex sends toward `eye` for each direction that light comes from, as SH coefficients.

        Transfer vectors of diffuse receivers times albedo; of glossy ones what the eye selects, times specular.
        """
        shader = self._still(pose) if self.follows_pose else self.shader
        vectors = shader.vectors(**({"eye": eye} if self.follows_eye else {}))
        return vectors[..., vertex].T.expand(-1, 3)

    def _still(self, pose: Tensor | None) -> Shader:
        """The shader of one pose, made when it is asked for again."""
        if self._posed is None or not _same(pose, self._pose):
            self._pose, self._posed = pose, self.shader.fix_pose(positions=pose)
            self._fixed_light = self._fixed_eye = None
        return self._posed


def _same(one: Tensor | None, other: Tensor | None) -> bool:
    if one is None or other is None:
        return one is other
    return one is other or torch.equal(one, other)
