"""The environments that a bake is looked at under: an image, a light, or one that is always there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from torchprt.cli import options

if TYPE_CHECKING:
    from torchprt.preview import Environment

# Environments for whoever has none at hand.
STUDIO, SKY = "studio", "sky"


def environment_of(word: str, order: int, repair: bool) -> Environment:
    """The environment of a file, or one that is always there."""
    from torchprt import light, sh
    from torchprt.preview import Environment

    path = Path(word)
    if word == SKY:
        # A sun is too small for any order: the weakest window that leaves no negative light.
        sky = light.clear_sky((0.55, 0.6, 0.5), 3.0, order)
        return Environment(word, sh.least_window(sky)[0].float())
    if path.suffix.lower() == ".npy":
        return Environment(path.name, light.read_coefficients(path, order))
    image = light.studio(256) if word == STUDIO else options.environment(path, repair)
    return Environment(path.name, light.project(image, order), image)
