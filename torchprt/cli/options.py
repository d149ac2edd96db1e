"""What the words of a command line mean: every option that is more than a number or the name of a file."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.suffixes import check_readable

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.brdf import Brdf
    from torchprt.scene import Material
    from torchprt.transfer import Transfer

# Edge of a picture in pixels: its rays take 200 bytes each.
LARGEST = 4096
# As `torchprt.light.WINDOWS`, which this must not import: --help would wait for torch.
WINDOWS = ("none", "hann", "lanczos", "gauss", "least", "auto")
FRAMES = ("exit", "incident", "visibility")
METHODS = ("iterative", "adaptive", "static", "pca", "vq")
PROJECTIONS = ("optimal", "reduced", "zero", "odd", "even")

Output = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]
OpenGloss = Annotated[
    str | None, typer.Option("--material", help="The gloss, for a bake of frame incident: phong:40, ggx:0.3, ...")
]


def numbers(text: str, count: int | None, option: str) -> list[float]:
    """Finite numbers with commas between them, `count` of them unless that is None."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{option} is '{text}': give numbers with commas between them") from None
    if count is not None and len(found) != count:
        raise InputError(f"{option} is '{text}': give {count} numbers with commas between them")
    if not all(math.isfinite(number) for number in found):
        raise InputError(f"{option} is '{text}': the numbers must be finite")
    return found


def choice(text: str, option: str, choices: Sequence[str]) -> Any:
    """`text` if it is one of `choices`."""
    if text not in choices:
        raise InputError(f"{option} is '{text}': give {', '.join(choices[:-1])} or {choices[-1]}")
    return text


def bounces(text: str) -> int | float | Literal["auto"]:
    if text == "auto":
        return "auto"
    if text == "inf":
        return math.inf
    try:
        return int(text)
    except ValueError:
        raise InputError(f"--bounces is '{text}': give a whole number, inf or auto") from None


def albedo(text: str | None) -> Any:
    if text is None or text in ("file", "vertex"):
        return text
    return colour(text, "--albedo", ", file or vertex")


def surface(text: str | None, specular: str | None) -> Material | Literal["file"] | None:
    """As `material`, or "file" for that of the file."""
    if text != "file":
        return material(text, specular)
    if specular is not None:
        raise InputError(f"--specular is '{specular}', but --material file weighs its gloss itself: leave it out")
    return "file"


def material(text: str | None, specular: str | None) -> Material | None:
    """The material of --material and --specular; None for the plain diffuse one."""
    from torchprt.scene import read_material

    if text is None:
        if specular is not None:
            raise InputError(f"--specular is '{specular}', but there is no gloss that it weighs: give --material too")
        return None
    with warnings.catch_warnings():
        # It is looked at again, and warned of, when albedo and specular have their values.
        warnings.simplefilter("ignore")
        read = read_material(text)
        return read if specular is None else replace(read, specular=colour(specular, "--specular"))


def gloss(text: str) -> Brdf:
    """The reflectance of a material that is chosen when a bake is shaded."""
    read = material(text, None)
    if read is None or read.brdf is None:
        raise InputError(f"--material is '{text}', which has no gloss: give one, as phong:40 or ggx:0.3")
    return read.brdf


def surface_of(transfer: Transfer, option: str, file: Path, instead: str = "leave it out") -> None:
    """InputError if `transfer` is of a volume, for which an option, or a command, has no meaning."""
    if not transfer.receivers.on_surface:
        raise InputError(f"{option} is for surfaces, and {file} is a volume, which has none: {instead}")


def gloss_of(transfer: Transfer, material: str | None) -> Any:
    """The reflectance that `transfer` leaves open, and how well it is held is told; None if it leaves none."""
    open_ = [layer for layer in transfer.layers.values() if "reflectance" in layer.needs]
    if not open_:
        if material is not None:
            raise InputError(f"--material is given, but the reflectance of {transfer.kind} transfer is baked in")
        return None
    if material is None:
        raise InputError("incident transfer leaves the reflectance open: give --material, as phong:40 or ggx:0.3")
    from torchprt.brdf import exit_error

    brdf, order = gloss(material), math.isqrt(open_[0].signal.shape[2])
    say(f"exit functions of order {order} hold {brdf.spec} to {exit_error(brdf, order, order):.2%}")
    return brdf


def factors(text: str | None) -> int | float | None:
    """A whole number is a count of rows, a number below 1 the error that may be left."""
    if text is None:
        return None
    if text.isdecimal() and text.isascii() and int(text) > 0:
        return int(text)
    try:
        error = float(text)
    except ValueError:
        error = math.nan
    if not 0 < error < 1:
        raise InputError(f"--factors is '{text}': give how many, as 4, or the error they may leave, as 0.05")
    return error


def whole(text: str, option: str) -> int:
    if not (text.isdecimal() and text.isascii()):
        raise InputError(f"{option} is '{text}': give a whole number")
    return int(text)


def size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 1 <= int(width) <= LARGEST and 1 <= int(height) <= LARGEST):
        raise InputError(f"--size is '{text}': give WIDTHxHEIGHT in pixels, up to {LARGEST}x{LARGEST}")
    return int(width), int(height)


def turn(text: str, option: str) -> list[float]:
    """Yaw, pitch and roll in degrees; what is left out is 0."""
    found = numbers(text, None, option)
    if len(found) > 3:
        raise InputError(f"{option} is '{text}': give a yaw, or yaw, pitch and roll, with commas between them")
    return found + [0.0] * (3 - len(found))


def direction(text: str, option: str) -> tuple[float, float, float]:
    x, y, z = numbers(text, 3, option)
    if not (x or y or z):
        raise InputError(f"{option} is '{text}': give a direction, at least one number other than 0")
    return x, y, z


def eye(point: str | None, toward: str | None) -> dict[str, Tensor]:
    """The keyword by which a shader takes the eye: "eye" for a point, "view" for a direction; empty without both."""
    import torch

    if point is not None and toward is not None:
        raise InputError("--eye and --toward are both given: give one, a point or a direction toward a distant eye")
    if point is not None:
        return {"eye": torch.tensor(numbers(point, 3, "--eye"), dtype=torch.float64)}
    if toward is not None:
        return {"view": torch.tensor(direction(toward, "--toward"), dtype=torch.float64)}
    return {}


def environment(path: Path, repair: bool) -> Tensor:
    """The latitude-longitude map of an image, whose damage is told."""
    from torchprt import light

    image, report = light.read_with_report(path, repair=repair)
    if report.damaged:
        say(f"{path}: {report}")
    if image.shape[1] != 2 * image.shape[0]:
        raise InputError(
            f"{path} is {image.shape[1]} x {image.shape[0]} pixels: an environment is a latitude-longitude map, "
            "twice as wide as high"
        )
    return image


def positions(path: Path) -> Tensor:
    """Poses of a mesh, `[T, V, 3]`, from an .npy."""
    import numpy as np
    import torch

    check_readable(path)
    try:
        values = np.load(path)
    except Exception:  # Damaged headers end in exceptions of any kind.
        raise InputError(f"{path} is no .npy of numbers: write one with numpy.save") from None
    if not isinstance(values, np.ndarray) or values.ndim != 3 or values.shape[2] != 3 or values.dtype.kind not in "fiu":
        raise InputError(f"{path} does not hold poses: it must be numbers of shape T x V x 3, a pose after the other")
    return torch.from_numpy(values.astype(np.float64))


def windowed(coefficients: Tensor, name: str) -> Tensor:
    """The light under one of `WINDOWS`; what those leave that depend on the light is told."""
    from torchprt import light, sh

    factors = light.window_factors(coefficients, name)
    left = f"{float(factors[-1]):.0%} of the highest band"
    if name == "least":
        say(f"the least window that keeps the light positive leaves {left}")
    if name == "auto":
        weak = f"the least window that keeps what it lights positive leaves {left}"
        say("no window: nothing that this light shines on turns negative" if bool((factors == 1).all()) else weak)
    return sh.window(coefficients, factors)


def colour(text: str, option: str, other: str = "") -> float | tuple[float, ...]:
    """One number, or three with commas between them."""
    found = numbers(text, None, option)
    if len(found) not in (1, 3):
        raise InputError(f"{option} is '{text}': give one number, three (r,g,b){other}")
    return found[0] if len(found) == 1 else tuple(found)
