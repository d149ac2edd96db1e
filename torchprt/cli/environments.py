"""What stands behind `--light`, in every command: an image, coefficients, or a light that is always there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from torchprt.cli import options
from torchprt.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.preview import Environment

# As `torchprt.light.BUILT_IN`, which this must not import: --help would wait for torch.
BUILT_IN = ("studio", "three-point", "sky", "sunset", "overcast", "white")
STUDIO = BUILT_IN[0]
WORDS = f"{', '.join(BUILT_IN[:-1])} or {BUILT_IN[-1]}"
LIGHT_HELP = f"An environment image, an .npy of light coefficients, or {WORDS}."


def environment_of(word: str, order: int, repair: bool, window: str | None = None) -> Environment:
    """The environment of a file, or one that is always there, whose light is of `order`.

    `window` against ringing; if None a file has none and a built-in light the least that leaves nothing negative.
    """
    import dataclasses

    from torchprt import light
    from torchprt.preview import Environment, built_in_environment

    if word in BUILT_IN:
        if window is None:
            return built_in_environment(word, order)
        found = built_in_environment(word, order, "none")
    else:
        path = Path(word)
        if not path.suffix and not path.exists():
            raise InputError(f"light '{word}' is neither a file nor a light that is always there: give {WORDS}")
        if path.suffix.lower() == ".npy":
            found = Environment(path.stem, light.read_coefficients(path, order))
        else:
            image = options.environment(path, repair)
            found = Environment(path.stem, light.project(image, order), image)
    if window is None or window == "none":
        return found
    return dataclasses.replace(found, light=options.windowed(found.light, window))


def light_of(word: str, order: int, repair: bool = False) -> Tensor:
    """The coefficients of `environment_of`."""
    return environment_of(word, order, repair).light
