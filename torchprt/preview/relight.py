"""Shading in a loop in which light or eye mostly stay."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.shade import DiffuseShader, FixedEyeShader, FixedLightShader, ViewShader


class Relight:
    """Calls `shader` for one light and one eye, and folds in whichever of the two stays from call to call.

    The result is that of the shader to rounding. A shader that does not depend on the eye is called as it is.
    """

    def __init__(self, shader: nn.Module):
        self.shader = shader
        self._light: Tensor | None = None
        self._eye: Tensor | None = None
        self._fixed_light: FixedLightShader | None = None
        self._fixed_eye: FixedEyeShader | None = None

    @property
    def follows_eye(self) -> bool:
        return isinstance(self.shader, ViewShader)

    @torch.no_grad()
    def __call__(self, light: Float[Tensor, "N 3"], eye: Float[Tensor, "3"]) -> Float[Tensor, "V 3"]:
        """Linear exit radiance toward `eye`. Raises InputError as the shader."""
        if not isinstance(self.shader, ViewShader):
            return self.shader(light)
        same_light = self._light is not None and torch.equal(light, self._light)
        same_eye = self._eye is not None and torch.equal(eye, self._eye)
        if not same_light:
            self._fixed_light = None
        if not same_eye:
            self._fixed_eye = None
        self._light, self._eye = light, eye
        if same_light and self._fixed_light is None and not same_eye:
            self._fixed_light = self.shader.fix_light(light)
        if same_eye and self._fixed_eye is None and not same_light:
            self._fixed_eye = self.shader.fix_eye(eye=eye)
        if self._fixed_light is not None:
            return self._fixed_light(eye=eye)
        if self._fixed_eye is not None:
            return self._fixed_eye(light)
        return self.shader(light, eye=eye)

    @torch.no_grad()
    def transfer_of(self, vertex: int, eye: Float[Tensor, "3"]) -> Float[Tensor, "N 3"]:
        """What a vertex sends toward `eye` for each direction that light comes from, as SH coefficients.

        The transfer vector of diffuse receivers times albedo, of glossy ones the row that the eye selects.
        """
        if isinstance(self.shader, ViewShader):
            fixed = self._fixed_eye
            if fixed is None or self._eye is None or not torch.equal(eye, self._eye):
                fixed = self.shader.fix_eye(eye=eye)
            return fixed.transfer[..., vertex].T.expand(-1, 3)
        shader = self.shader
        if isinstance(shader, DiffuseShader) and hasattr(shader, "transfer"):
            albedo = shader.albedo[vertex if len(shader.albedo) > 1 else 0]
            return shader.transfer[..., vertex].T * albedo
        # Linear in the light: one of each coefficient at a time.
        count = int(shader.order) ** 2  # type: ignore[arg-type]
        lights = torch.eye(count)[..., None].expand(count, count, 3)
        return shader(lights)[:, vertex]
