"""What `shade` writes of one light: an array, a model, a picture, or the map of an atlas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from torchprt.cli import picture_options as asked
from torchprt.cli.report import say, triple
from torchprt.errors import InputError
from torchprt.files import write_array
from torchprt.suffixes import PICTURES
from torchprt.words import count

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.cli.emitters import LampShader
    from torchprt.preview import Camera, Environment
    from torchprt.shade import Shader
    from torchprt.transfer import Transfer

What = Literal["radiance", "irradiance", "white"]
MODELS = (".ply", ".glb")
MAPS = (".exr", ".png", ".npy")
NAME = "{light}"
"""What stands for the name of a light in that of a file."""


def files_of(output: Path, words: Sequence[str]) -> list[Path]:
    """The file of each light. Raises InputError if several lights would be written into one."""
    named = [Path(str(output).replace(NAME, Path(word).stem)) for word in words]
    if len(words) > 1 and NAME not in str(output):
        raise InputError(f"{output} is one file for {len(words)} lights: put {NAME} into its name, for theirs")
    twice = next((each for each in named if named.count(each) > 1), None)
    if twice is not None:
        raise InputError(f"{twice} would be of two lights of one name: rename one of their files, or leave it out")
    return named


def check_output(transfer: Transfer, path: Path, output: Path, camera: Mapping[str, Any]) -> None:
    """InputError if a file of this suffix is not to be had of `transfer`, that of `path`, or with these options of a
    camera."""
    ends, on_map = output.suffix.lower(), transfer.receivers.surface_uv is not None
    if ends == ".exr" and not on_map:
        raise InputError(f"{output} is a map, and {path} has no texels: bake with --texels, or write .npy or a picture")
    if not on_map:
        return
    if ends == ".ply":
        raise InputError(
            f"{output} has colours of vertices, and {path} was recorded at texels: write .glb, which shows the map, or "
            "take it to vertices with transfer.to_vertices"
        )
    if ends in PICTURES and ends not in MAPS:
        raise InputError(f"{output} cannot hold a map: write .exr, .png or .npy, or a picture with `torchprt render`")
    for option, value in camera.items():
        if value:
            raise InputError(f"{option} is given, but a map has no camera: leave it out, or use `torchprt render`")


def camera_options(
    size: str, view: str, target: str | None, distance: float | None, fov: float, samples: int, background: bool
) -> dict[str, bool]:
    """Which options of the camera are given."""
    return {
        "--size": size != asked.SIZE,
        "--view": view != asked.VIEW,
        "--target": target is not None,
        "--distance": distance is not None,
        "--fov": fov != asked.FOV,
        "--samples": samples != asked.SAMPLES,
        "--background or --backdrop": background,
    }


@dataclass(frozen=True, eq=False)
class Lit:
    """What is the same for all lights: the transfer and the file it is of, the picture that is asked for, its camera,
    `what` is computed, the window against ringing, whether an eye is looked from, and the lamps that stand beside."""

    transfer: Transfer
    source: Path
    picture: asked.PictureOptions
    shader: Shader
    near: LampShader | None
    framed: Camera | None
    what: What
    window: str | None
    glossy: bool
    under: str | None

    def write(self, path: Path, environment: Environment, radiance: Tensor) -> None:
        """Writes what is computed under a light, `[V, 3]`, and tells what was."""
        import math

        from torchprt import preview

        loaded, picture, ends = self.transfer, self.picture, path.suffix.lower()
        if self.what == "irradiance":
            radiance = radiance * math.pi
        studio = picture.studio(loaded, self.shader, environment, near=self.near)
        if self.what == "irradiance" and picture.exposure is None:
            studio.exposure = preview.irradiance_exposure(studio.exposure)
        place = self._place()
        # Others were filled from their neighbours.
        dark = int(((loaded.normals == 0).all(-1) & (radiance == 0).all(-1)).sum())
        if dark and loaded.receivers.on_surface:
            say(f"{dark} of {count(len(radiance), place)} without a normal read 0")
        negative = int((radiance < 0).any(-1).sum())
        if negative:
            share = f"{negative} of {count(len(radiance), place)}"
            why = _why_negative(self.window, self.glossy)
            say(f"negative {self.word} at {share}, down to {float(radiance.min()):.3g}: {why}")
        model = loaded.without_ground()
        if ends in MODELS and model is not loaded:
            loaded, radiance = model, radiance[~loaded.receivers.ground()]
        if self.framed is not None:
            preview.save_picture(studio.picture(self.framed, picture.rotation, radiance), path)
        elif ends == ".ply":
            found = preview.colours(radiance, studio.exposure, picture.tone)
            preview.save_ply(loaded.positions, loaded.faces, found, path)
        elif ends == ".glb":
            linear = preview.linear_colours(radiance, studio.exposure, picture.tone)
            say(f"{path}: {preview.save_lit_glb(loaded, linear, path, near=self.source.parent)}")
        elif loaded.receivers.surface_uv is not None:
            preview.save_map(loaded.receivers, radiance, path, exposure=studio.exposure, tone=picture.tone)
        else:
            radiance = loaded.receivers.in_mesh_order(radiance)
            write_array(path, radiance.contiguous().numpy())
        shown = "" if ends in (".npy", ".exr") else f", exposure {studio.exposure:+.2f} stops"
        mean = f"{count(len(radiance), place)}, mean {self.word} {triple(radiance.mean(0))}"
        say(f"{path}: {mean}{shown}, under {self.under or environment.name}")

    @property
    def word(self) -> str:
        """What is computed, as it is told."""
        return {"radiance": "radiance", "irradiance": "irradiance", "white": "irradiance / pi"}[self.what]

    def _place(self) -> str:
        receivers = self.transfer.receivers
        if not receivers.on_surface:
            return "cell"
        return "vertex" if receivers.surface_uv is None else "texel"


def _why_negative(window: str | None, glossy: bool) -> str:
    if glossy:
        mended = "" if window == "least" else ", --window least takes away what the light does"
        return f"the light and the gloss ring at their orders{mended}"
    if window == "least":
        return "the light does not ring under this window, the transfer does"
    mended = "least takes that away" if window == "auto" else "auto takes nearly all of that away"
    return f"the light rings at this order, --window {mended}"
