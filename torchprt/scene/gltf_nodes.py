"""Where the nodes of a glTF file stand: world matrices, what its scene shows, instances, joints."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from torchprt.errors import InputError

from .gltf_document import Document

Matrix = Float64[np.ndarray, "4 4"]
INSTANCING = "EXT_mesh_gpu_instancing"


class Nodes:
    """The nodes of a document: `world [4, 4]` of each, and the numbers of those that its scene `shown`, in their order.

    Without a default scene it is the first; without any scene, all nodes are shown.
    Raises InputError if a node is its own ancestor or names something that does not exist.
    """

    def __init__(self, document: Document) -> None:
        self.document = document
        entries = document.all("nodes")
        self._parent: dict[int, int] = {}
        for number, entry in enumerate(entries):
            for child in entry.get("children", ()):
                document.entry("nodes", child)
                self._parent.setdefault(child, number)
        self._world: dict[int, Matrix] = {}
        self.shown = self._shown()

    def world(self, number: int) -> Matrix:
        """The matrix from a node's frame to the world, for columns."""
        path: list[int] = []
        at: int | None = number
        while at is not None and at not in self._world:
            if len(path) > len(self._parent) + 1:
                raise InputError(f"{self.document.source} has node {number} inside itself: export the mesh again")
            path.append(at)
            at = self._parent.get(at)
        matrix = np.eye(4) if at is None else self._world[at]
        for each in reversed(path):
            matrix = matrix @ local(self.document.entry("nodes", each))
            self._world[each] = matrix
        return self._world[number]

    def instances(self, number: int) -> list[Matrix]:
        """World matrices of what a node draws: its own, or several of EXT_mesh_gpu_instancing."""
        return [self.world(number) @ offset for offset in self.offsets(number)]

    def offsets(self, number: int) -> list[Matrix]:
        """The same in the frame of the node."""
        packed = self.document.entry("nodes", number).get("extensions", {}).get(INSTANCING)
        if packed is None:
            return [np.eye(4)]
        parts = {
            name: np.asarray(self.document.accessor(packed["attributes"][key]), np.float64)
            for name, key in (("translation", "TRANSLATION"), ("rotation", "ROTATION"), ("scale", "SCALE"))
            if key in packed["attributes"]
        }
        lengths = {len(values) for values in parts.values()}
        if len(lengths) != 1:
            raise InputError(f"{self.document.source} has uneven instances of node {number}: export the mesh again")
        return [local({name: values[row] for name, values in parts.items()}) for row in range(lengths.pop())]

    def joints(self, skin: int) -> Float64[np.ndarray, "J 4 4"]:
        """Matrices of the joints of a skin, from the bound vertices to the world."""
        entry = self.document.entry("skins", skin)
        worlds = np.stack([self.world(joint) for joint in entry["joints"]])
        if "inverseBindMatrices" not in entry:
            return worlds
        # Stored column by column.
        bind = np.asarray(self.document.accessor(entry["inverseBindMatrices"]), np.float64)
        if len(bind) < len(worlds):
            raise InputError(f"{self.document.source} has a skin without all its matrices: export the mesh again")
        return worlds @ bind[: len(worlds)].reshape(-1, 4, 4).transpose(0, 2, 1)

    def _shown(self) -> list[int]:
        tree = self.document.tree
        count = len(self.document.all("nodes"))
        if not self.document.all("scenes"):
            return list(range(count))
        waiting = list(self.document.entry("scenes", tree.get("scene", 0)).get("nodes", ()))
        found: set[int] = set()
        while waiting:
            number = waiting.pop()
            entry = self.document.entry("nodes", number)
            if number not in found:
                found.add(number)
                waiting += entry.get("children", ())
        return sorted(found)


def local(node: dict[str, Any]) -> Matrix:
    """The matrix of a node in the frame of its parent, from `matrix` or from translation, rotation and scale."""
    if "matrix" in node:
        return np.asarray(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = np.asarray(node.get("rotation", (0, 0, 0, 1)), np.float64)
    # Exporters round; the standard says unit.
    s = x * x + y * y + z * z + w * w
    if s > 0:
        x, y, z, w = np.array([x, y, z, w]) / np.sqrt(s)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    matrix[:3, :3] *= np.asarray(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix
