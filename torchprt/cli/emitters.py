"""`--emitter`: lamps nearby, in words, and what they make of a shader."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchprt.cli import options
from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.words import count

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.light import Emitter
    from torchprt.shade import LocalLightShader, Shader
    from torchprt.transfer import Transfer

# Of transfer that was baked without sample points.
POINTS = 16
# Places and sizes of a lamp of each kind, in numbers; three of radiance follow.
KINDS = {"sphere": 4, "rectangle": 9}
Emitters = Annotated[
    list[str] | None,
    typer.Option(
        "--emitter",
        help="A lamp nearby, in the unit of the scene: sphere:X,Y,Z,RADIUS,R,G,B, or rectangle: its center, and from "
        "there the middles of its right and upper side, X,Y,Z each, and R,G,B (repeatable).",
    ),
]


def emitters(words: Sequence[str] | None) -> list[Emitter]:
    """The lamps that the words say. Raises InputError for one that says none."""
    return [_emitter(word) for word in words or ()]


def _emitter(word: str) -> Emitter:
    kind, _, rest = word.partition(":")
    if kind not in KINDS:
        raise InputError(f"--emitter is '{word}': give sphere:X,Y,Z,RADIUS,R,G,B or rectangle: and twelve numbers")
    numbers = options.numbers(rest, KINDS[kind] + 3, f"--emitter {kind}")
    from torchprt.light import RectangleEmitter, SphereEmitter

    try:
        if kind == "sphere":
            return SphereEmitter(numbers[:3], numbers[3], numbers[4:])
        return RectangleEmitter(numbers[:3], numbers[3:6], numbers[6:9], numbers[9:])
    except InputError as fault:
        raise InputError(f"--emitter is '{word}': {fault}") from fault


def with_points(transfer: Transfer, lamps: Sequence[Emitter]) -> Transfer:
    """The transfer with sample points, made on the way, which is told, if there are lamps and it has none."""
    from torchprt.light import with_sample_points

    if not lamps or getattr(transfer.receivers, "blend", None) is not None:
        return transfer
    if transfer.receivers.surface_uv is not None:
        raise InputError(
            "--emitter is given, and lamps nearby light vertices, but this was recorded at texels: leave it out"
        )
    say(f"{POINTS} sample points with gradients made on the way: bake with --sample-points to choose")
    return with_sample_points(transfer, POINTS, gradients=True)


class LampShader:
    """`shader` under lamps nearby that stand still, in place of the shader in pictures: `(light [N, 3], eye, pose)`.

    `light` is that of an environment, which may turn.
    """

    def __init__(self, shader: Shader, transfer: Transfer, lamps: Sequence[Emitter]) -> None:
        from torchprt.light import local_light
        from torchprt.shade import local_light_shader

        self.local: LocalLightShader = local_light_shader(shader, transfer)
        self.lights = local_light(transfer, lamps).to(shader.turn.project.dtype)
        self.rows = len(self.lights) // len(transfer.receivers.sampled()[0])
        self.needs = shader.needs

    def under(self, light: Tensor) -> Tensor:
        """The K lights of the lamps and of an environment."""
        import torch

        first = torch.arange(len(self.lights)) % self.rows == 0
        return self.lights + torch.where(first[:, None, None], light.to(self.lights), 0)

    def brightest(self, light: Tensor) -> Tensor:
        """Of those of the sample points the light under which a white surface is the brightest."""
        from torchprt.preview import automatic_exposure

        return min(self.under(light)[:: self.rows].unbind(0), key=automatic_exposure)

    def __call__(self, light: Tensor, eye: Tensor | None = None, pose: Tensor | None = None) -> Tensor:
        import torch

        given: dict[str, Any] = {}
        if "eye" in self.needs:
            given["eye"] = eye
        if "pose" in self.needs and pose is not None:
            given["positions"] = pose
        with torch.no_grad():
            return self.local(self.under(light), **given)


def told(lamps: Sequence[Emitter], environment: str | None) -> str:
    """Under what a picture is, in words."""
    words = count(len(lamps), "lamp")
    return words if environment is None else f"{words} and {environment}"
