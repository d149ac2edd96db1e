"""What a picture is asked to be: the options of `shade` and `render`, and what makes a picture of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from torchprt.cli import options
from torchprt.cli.environments import LIGHT_HELP, STUDIO, environment_of
from torchprt.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.brdf import Brdf
    from torchprt.cli.emitters import LampShader
    from torchprt.preview import Background, Camera, Environment, Orbit, Studio
    from torchprt.shade import Shader
    from torchprt.shade.display import ToneMap
    from torchprt.transfer import Transfer

# As `torchprt.shade.display.TONES`, of which the first is the one of every picture that asks for no other.
TONES = ("neutral", "agx", "filmic", "none")
MOST_SAMPLES = 256
COLOURS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}

Light = Annotated[str, typer.Option(help=LIGHT_HELP)]
Lights = Annotated[
    list[str] | None, typer.Option(help=f"{LIGHT_HELP} Repeatable.", show_default=f"{STUDIO}; none with --emitter")
]
LightOrLamps = Annotated[str | None, typer.Option(help=LIGHT_HELP, show_default=f"{STUDIO}; none with --emitter")]
Size = Annotated[str, typer.Option(help="Of each picture, in pixels.")]
View = Annotated[str, typer.Option(help="From the model toward the camera: X,Y,Z.")]
Target = Annotated[
    str | None, typer.Option(help="The point X,Y,Z that the camera looks at.", show_default="middle of the model")
]
Distance = Annotated[
    float | None, typer.Option(help="Of the camera from there, in units of the mesh.", show_default="all is seen")
]
Fov = Annotated[float, typer.Option(help="Angle of view from top to bottom, in degrees.")]
Samples = Annotated[int, typer.Option(min=1, max=MOST_SAMPLES, help="Rays a pixel, for smooth edges.")]
Rotate = Annotated[str, typer.Option(help="Turns the environment: YAW, or YAW,PITCH,ROLL, in degrees.")]
Window = Annotated[
    str | None,
    typer.Option(
        help="Against ringing: none, hann, lanczos, gauss, least or auto.",
        show_default="none; least for built-in lights",
    ),
]
ShowEnvironment = Annotated[bool, typer.Option("--background", help="Show the environment behind the model.")]
Backdrop = Annotated[
    str | None,
    typer.Option(help="Or behind it: transparent, white, black, #RRGGBB.", show_default="grey, lighter in the middle"),
]
Exposure = Annotated[float | None, typer.Option(help="In stops.", show_default="white in this light is white")]
Tone = Annotated[str, typer.Option(help="neutral (true colours), agx (bright suns), filmic or none.")]
Repair = Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")]

# The values where nothing is given.
LIGHT, SIZE, VIEW, FOV, SAMPLES, ROTATE, TONE = STUDIO, "800x600", "0.45,0.35,1", 35.0, 4, "0", TONES[0]


@dataclass(frozen=True)
class PictureOptions:
    """What these options say, checked. `rotation` turns the environment."""

    light: str
    size: tuple[int, int]
    view: tuple[float, float, float]
    target: tuple[float, float, float] | None
    distance: float | None
    fov: float
    samples: int
    rotation: Tensor
    window: str | None
    background: Background
    exposure: float | None
    tone: ToneMap
    repair: bool

    def environment(self, order: int, dark: bool = False) -> Environment:
        """The light, and what is seen behind the model; `dark`: that there is none."""
        if dark:
            import torch

            from torchprt.preview import Environment

            if self.background == "environment":
                raise InputError(
                    "--background is given, but there are lamps alone: give an environment image as --light"
                )
            return Environment("lamps", torch.zeros(order**2, 3))
        found = environment_of(self.light, order, self.repair, self.window)
        if self.background == "environment" and found.image is None:
            raise InputError(f"--background is given, but {self.light} is no image: give one as --light")
        return found

    def camera(self, *shown: Transfer) -> Camera:
        """The camera that holds all that is `shown`."""
        from torchprt import preview

        return preview.frame(_subjects(shown), self.view, **self._held())

    def orbit(self, *shown: Transfer, sides: int) -> Orbit:
        """The camera's way around, seen whole from all of so many sides."""
        from torchprt import preview

        return preview.Orbit.around(_subjects(shown), self.view, sides=sides, **self._held())

    def studio(
        self,
        transfer: Transfer,
        shader: Shader,
        environment: Environment,
        colours: Tensor | None = None,
        near: LampShader | None = None,
        volume: Transfer | None = None,
    ) -> Studio:
        """What makes the pictures; of `colours` if they are given, under lamps `near` the model if there are any, in a
        `volume` if there is one."""
        from torchprt.preview import automatic_exposure, studio_of

        shown = self._shown()
        if self.exposure is None and near is not None:
            shown["exposure"] = automatic_exposure(near.brightest(environment.light))
        return studio_of(transfer, shader, environment, volume=volume, colours=colours, relight=near, **shown)

    def patch_studio(
        self, patch: Transfer, mesh: Path, repeat: Sequence[float], brdf: Brdf | None, environment: Environment
    ) -> Studio:
        """What makes pictures of a patch on a mesh, read at every pixel."""
        from torchprt.preview import PatchStudio
        from torchprt.scene import read_mesh

        surface = read_mesh(mesh)
        if surface.uv is None:
            raise InputError(f"{mesh} has no texture coordinates: unwrap it (a patch is laid on through them)")
        return PatchStudio(
            patch,
            surface.positions,
            surface.faces.int(),
            surface.uv,
            environment,
            normals=surface.normals,
            repeat=(repeat[0], repeat[1]),
            brdf=brdf,
            **self._shown(),
        )

    def _shown(self) -> dict[str, Any]:
        names = ("size", "exposure", "tone", "background", "samples")
        return {name: getattr(self, name) for name in names}

    def _held(self) -> dict[str, Any]:
        width, height = self.size
        return {"aspect": width / height, "field": self.fov, "target": self.target, "distance": self.distance}


def _subjects(shown: Sequence[Transfer]) -> Tensor:
    """The places that pictures of all of them are about."""
    import torch

    from torchprt import preview

    return torch.cat([preview.subject(each.receivers).double() for each in shown])


def picture_options(
    *,
    light: str,
    size: str,
    view: str,
    target: str | None,
    distance: float | None,
    fov: float,
    samples: int,
    rotate: str,
    window: str | None,
    background: bool,
    backdrop: str | None,
    exposure: float | None,
    tone: str,
    repair: bool,
) -> PictureOptions:
    """The words of these options checked, before any file is read. Raises InputError for those that say nothing."""
    import torch

    from torchprt import sh

    if window is not None:
        options.choice(window, "--window", options.WINDOWS)
    options.choice(tone, "--tone", TONES)
    if exposure is not None and not abs(exposure) <= 100:
        raise InputError(f"--exposure is {exposure}: give stops from -100 to 100")
    if distance is not None and not 0 < distance < float("inf"):
        raise InputError(f"--distance is {distance}: give a number above 0")
    if not 1 <= fov <= 170:
        raise InputError(f"--fov is {fov}: give degrees from 1 to 170")
    if background and backdrop is not None:
        raise InputError("--background and --backdrop are both given: give one, there is one thing behind the model")
    turn = torch.tensor(options.turn(rotate, "--rotate"), dtype=torch.float64)
    return PictureOptions(
        light=light,
        size=options.size(size),
        view=options.direction(view, "--view"),
        target=None if target is None else cast("Any", tuple(options.numbers(target, 3, "--target"))),
        distance=distance,
        fov=fov,
        samples=samples,
        rotation=sh.yaw_pitch_roll(turn).float(),
        window=window,
        background="environment" if background else _backdrop(backdrop),
        exposure=exposure,
        tone=cast("ToneMap", tone),
        repair=repair,
    )


def _backdrop(word: str | None) -> Background:
    if word is None:
        return "plain"
    if word == "transparent":
        return "transparent"
    if word in COLOURS:
        return COLOURS[word]
    if re.fullmatch("#[0-9a-fA-F]{6}", word):
        red, green, blue = (int(word[start : start + 2], 16) / 255 for start in (1, 3, 5))
        return red, green, blue
    raise InputError(f"--backdrop is '{word}': give transparent, {', '.join(COLOURS)} or #RRGGBB")
