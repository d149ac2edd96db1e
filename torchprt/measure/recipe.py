"""A recipe: which model of a scene's transfer is baked, how it is stored, and how it runs."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from torchprt.errors import InputError
from torchprt.files import write
from torchprt.light import WINDOWS
from torchprt.scene.toml_file import read_toml

Runtime = Literal["eager", "compiled", "onnx"]
StoredType = Literal["float32", "float16", "bfloat16"]

FRAMES = ("exit", "visibility")
TYPES = ("float32", "float16", "bfloat16")
RUNTIMES = ("eager", "compiled", "onnx")


@dataclass(frozen=True)
class Recipe:
    """One point of the trade between speed and accuracy. None: not in it.

    What is baked: `order`, `rays`, `bounces`, `shadows` (False: the closed form, without rays), and for glossy scenes
    `frame` with `output_order` (exit) or `visibility_order` (visibility), or `factors`, as the arguments of `bake`.
    What of the light is used: its first `order` bands under a `window`, one of `light.WINDOWS`.
    How it is stored: `clusters` with `components`, `bits` and perhaps `shared` axes of clustered PCA, or `lobes`, or
    dense; in `dtype`.
    How it runs: `runtime`; `adaptive`, the threshold of adaptive shading, twice as much under gloss; `dtype` "bfloat16"
    is also what products are made in, the others are shaded in float32.
    Raises InputError for a number out of range, an unknown word, and what does not go together.
    """

    order: int = 5
    rays: int = 1024
    bounces: int = 0
    shadows: bool = True
    frame: str | None = None
    output_order: int | None = None
    visibility_order: int | None = None
    factors: int | None = None
    window: str = "none"
    clusters: int | None = None
    components: int | None = None
    shared: int | None = None
    bits: int | None = None
    lobes: int | None = None
    dtype: StoredType = "float32"
    adaptive: float | None = None
    runtime: Runtime = "eager"

    # The tables of a file, and of what a measurement of one step depends on.
    TABLES: ClassVar[dict[str, tuple[str, ...]]] = {
        "bake": ("order", "rays", "bounces", "shadows", "frame", "output_order", "visibility_order", "factors"),
        "light": ("window",),
        "store": ("clusters", "components", "shared", "bits", "lobes", "dtype"),
        "run": ("adaptive", "runtime"),
    }

    def __post_init__(self) -> None:
        least = {"order": 1, "rays": 1, "bounces": 0, "output_order": 1, "visibility_order": 1, "factors": 1}
        least |= {"clusters": 1, "components": 0, "shared": 1, "lobes": 1}
        for name, low in least.items():
            value = getattr(self, name)
            if value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int) or value < low:
                raise InputError(f"{name} of the recipe is {value!r}: give a whole number from {low}")
        if not isinstance(self.shadows, bool):
            raise InputError(f"shadows of the recipe is {self.shadows!r}: give true or false")
        words: dict[str, tuple[Any, ...]] = {"window": WINDOWS, "dtype": TYPES, "runtime": RUNTIMES}
        words |= {"frame": (None, *FRAMES), "bits": (None, 8, 16, 32)}
        for name, known in words.items():
            value = getattr(self, name)
            if value not in known:
                listed = ", ".join(str(word) for word in known if word is not None)
                raise InputError(f"{name} of the recipe is {value!r}: give one of {listed}")
        if self.adaptive is not None and not 0 <= self.adaptive < math.inf:
            raise InputError(f"adaptive of the recipe is {self.adaptive!r}: give a threshold of 0 or more, as 0.01")
        self._check_together()

    def _check_together(self) -> None:
        apart = {
            "clusters and lobes": self.clusters is not None and self.lobes is not None,
            "clusters without components": (self.clusters is None) != (self.components is None),
            "bits without clusters": self.bits is not None and self.clusters is None,
            "shared axes without clusters": self.shared is not None and self.clusters is None,
            "bounces without shadows": self.bounces > 0 and not self.shadows,
            "bounces of frame visibility": self.bounces > 0 and self.frame == "visibility",
            "output_order without frame exit": self.output_order is not None and self.frame != "exit",
            "visibility_order without frame visibility": self.visibility_order is not None
            and self.frame != "visibility",
            "factors without frame exit": self.factors is not None and self.frame != "exit",
            "factors and output_order": self.factors is not None and self.output_order is not None,
            "lobes of frame visibility": self.lobes is not None and self.frame == "visibility",
            "adaptive shading of a graph": self.adaptive is not None and self.runtime == "onnx",
            "adaptive shading that is compiled": self.adaptive is not None and self.runtime == "compiled",
            "bfloat16 in a graph, which computes in float32": self.dtype == "bfloat16" and self.runtime == "onnx",
        }
        for pair, given in apart.items():
            if given:
                raise InputError(f"the recipe has {pair}: they do not go together, leave one out")

    def part(self, *tables: str) -> dict[str, Any]:
        """What stands in these tables, by name; what is not in the recipe left out."""
        names = [name for table in tables for name in self.TABLES[table]]
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def replace(self, **changes: Any) -> Recipe:
        """The same with other fields. Raises InputError as the recipe itself."""
        return dataclasses.replace(self, **changes)

    @property
    def name(self) -> str:
        """In one line, without what is the plainest: "order 5, 256 rays, 2 bounces, 64 x 8 x 8 bit, onnx"."""
        said = [f"order {self.order}"]
        said.append(f"{self.rays} rays" if self.shadows else "unshadowed")
        if self.bounces:
            said.append("1 bounce" if self.bounces == 1 else f"{self.bounces} bounces")
        if self.factors is not None:
            said.append(f"{self.factors} factors")
        elif self.frame is not None:
            bands = self.output_order if self.frame == "exit" else self.visibility_order
            said.append(self.frame if bands is None else f"{self.frame} {bands}")
        if self.window != "none":
            said.append(self.window)
        if self.clusters is not None:
            axes = "" if self.shared is None else f" in {self.shared} axes"
            said.append(f"{self.clusters} x {self.components} x {self.bits or 32} bit{axes}")
        if self.lobes is not None:
            said.append("1 lobe" if self.lobes == 1 else f"{self.lobes} lobes")
        if self.dtype != "float32":
            said.append(self.dtype)
        if self.adaptive is not None:
            said.append(f"adaptive {self.adaptive:g}")
        if self.runtime != "eager":
            said.append(self.runtime)
        return ", ".join(said)


def write_recipe(
    recipe: Recipe,
    path: str | os.PathLike[str],
    *,
    predicted: dict[str, float] | None = None,
    notes: tuple[str, ...] = (),
) -> None:
    """A .toml of tables `bake`, `light`, `store`, `run`, and `predicted` if given; `notes` stand above as comments.

    Law: `read_recipe` of it gives the recipe back. Raises InputError if it cannot be written.
    """
    lines = [f"# {line}" for note in notes for line in note.splitlines()]
    tables: dict[str, dict[str, Any]] = {table: recipe.part(table) for table in Recipe.TABLES}
    for table, content in {**tables, "predicted": predicted or {}}.items():
        if content:
            # Strings, numbers and booleans are in JSON as in TOML.
            lines += ["", f"[{table}]", *(f"{name} = {json.dumps(value)}" for name, value in content.items())]
    write(path, ("\n".join(lines).lstrip() + "\n").encode())


def read_recipe(path: str | os.PathLike[str]) -> tuple[Recipe, dict[str, float]]:
    """The recipe of a .toml, and what was predicted of it, {} if nothing is said.

    Raises InputError, naming the file, if it is missing or no .toml, for an unknown table or key, and as `Recipe`.
    """
    source = Path(path)
    content = read_toml(source)
    predicted = content.pop("predicted", {})
    fields: dict[str, Any] = {}
    for table, given in content.items():
        if table not in Recipe.TABLES or not isinstance(given, dict):
            raise InputError(f"{source} has an unknown table [{table}]: a recipe has {', '.join(Recipe.TABLES)}")
        for name, value in given.items():
            if name not in Recipe.TABLES[table]:
                known = ", ".join(Recipe.TABLES[table])
                raise InputError(f"{source} has an unknown key '{name}' in [{table}]: use {known}")
            fields[name] = value
    if not isinstance(predicted, dict) or not all(
        isinstance(value, int | float) and not isinstance(value, bool) for value in predicted.values()
    ):
        raise InputError(
            f"{source} predicts what is no number: give error, milliseconds, bytes and seconds, or nothing"
        )
    try:
        return Recipe(**fields), {name: float(value) for name, value in predicted.items()}
    except InputError as fault:
        raise InputError(f"{source}: {fault}") from fault
