"""What a verb looks at: a bake in a file, or meshes that it bakes itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchprt.cli import bake_options, options
from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.files import check_writable

if TYPE_CHECKING:
    from torchprt.scene import Scene
    from torchprt.transfer import Transfer

# Options of the scene; all others are arguments of the bake.
OF_SCENE = ("albedo", "material", "specular", "two_sided", "blocker", "ground", "ground_albedo")


class Source:
    """A bake that was made, or the scene that one is to be made of; all words are checked before rays are traced."""

    def __init__(self, files: Sequence[Path], keep: Path | None, given: Mapping[str, Any]):
        self.made: Transfer | None = None
        self.scene: Scene | None = None
        self._keep = keep
        if files[0].suffix.lower() == ".safetensors":
            self._load(files, given)
            return
        if keep is not None:
            check_writable(keep, (".safetensors",))
        rest = {name: value for name, value in given.items() if name not in OF_SCENE and value is not None}
        rest["bounces"] = options.bounces(rest.get("bounces", bake_options.BOUNCES))
        self._arguments = {"order": bake_options.ORDER, "rays": bake_options.RAYS, **rest}
        self.scene = bake_options.scene_of(files, **{name: given[name] for name in OF_SCENE})

    def _load(self, files: Sequence[Path], given: Mapping[str, Any]) -> None:
        from torchprt.transfer import load

        if len(files) > 1:
            raise InputError(f"{files[0]} is a bake, and {files[1]} is given beside it: give one bake, or meshes alone")
        given = {**given, "material": None, "bake": self._keep}
        for name, value in given.items():
            if value is not None and value != []:
                option = "--" + name.replace("_", "-")
                raise InputError(f"{option} is given, but {files[0]} is baked already: leave it out, or give the mesh")
        self.made = load(files[0])

    @property
    def order(self) -> int:
        """Bands of the light that it answers to."""
        return self._arguments["order"] if self.made is None else self.made.order

    def transfer(self) -> Transfer:
        """The bake, made if it was not."""
        if self.made is None:
            assert self.scene is not None
            say(self.scene)
            self.made = bake_options.baked(self.scene, self._keep, **self._arguments)
        return self.made
