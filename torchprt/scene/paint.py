"""A material as a file says it, in the terms of glTF whichever format it came in."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from .texture import Map

Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Paint:
    """What a material of a file says of light, and in words what it says that is not taken.

    Colours are linear. Where there is a map, factors multiply what it holds.
    """

    name: str
    colour: Colour | None = None
    """Factor of the base colour; None if the file says none, which is white."""
    colour_map: Map | None = None
    alpha: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"
    """What the alpha of the map does: nothing, cut holes, or let light through. No hole is made: what would not be seen
    has no part in the average."""
    cutoff: float = 0.5
    metallic: float = 0.0
    roughness: float = 1.0
    """As glTF has it: its square is the width of GGX."""
    gloss_map: Map | None = None
    """Roughness in green, metallic in blue."""
    reflectance: Colour = (0.04, 0.04, 0.04)
    """Of what is not metallic, seen along the normal; zero for none."""
    two_sided: bool = False
    normal_map: Map | None = None
    """The normal in the tangent frame of its texture coordinates, as glTF has it: x along u, y up the picture, z out,
    from -1 to 1 over red, green and blue."""
    normal_scale: float = 1.0
    """What its x and y are multiplied by."""
    left: tuple[str, ...] = ()
    """What it has besides, and no bake takes."""
    notes: tuple[str, ...] = ()
    """What had to be decided, in words that its name can follow behind a colon."""

    @property
    def coloured(self) -> bool:
        """Whether the file says a colour at all."""
        return self.colour is not None or self.colour_map is not None

    @property
    def glossy(self) -> bool:
        """Whether it reflects otherwise than diffusely."""
        return self.metallic > 0 or any(self.reflectance)


NONE = Paint("no material", reflectance=(0.0, 0.0, 0.0))
"""Of faces that name none."""


def listed(names: Sequence[str], most: int = 4) -> str:
    """Names in quotes with commas between them, the last of many counted."""
    quoted = [f"'{name}'" for name in dict.fromkeys(names)]
    if len(quoted) > most:
        return f"{', '.join(quoted[: most - 1])} and {len(quoted) - most + 1} others"
    return " and ".join([", ".join(quoted[:-1]), quoted[-1]] if len(quoted) > 1 else quoted)
