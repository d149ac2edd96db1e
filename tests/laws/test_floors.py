"""Does data flow one way? Rooms import rooms on lower floors, never above, and never a neighbour."""

import ast
import sys
from pathlib import Path

import pytest

import torchprt

PACKAGE = Path(torchprt.__file__).parent
FLOORS = {
    "errors": -2, "version": -2, "lazily": -2, "suffixes": -1, "words": -1,
    "files": 0, "memory": 0, "progress": 0, "checkpoint": 0,
    "sh": 1, "transfer": 1,
    "light": 2, "pose": 2, "brdf": 2, "compression": 2, "trace": 2,
    "scene": 3, "shade": 3,
    "transport": 4, "onnx": 4, "preview": 4,
    "measure": 5, "web": 5, "demo": 5, "notebook": 5,
    "cli": 6, "__main__": 7,
}  # fmt: skip
LEAN = {
    "pose": {"torch", "jaxtyping"},
    "sh": {"torch", "jaxtyping", "numpy", "scipy"},
    "shade": {"torch", "jaxtyping"},
}
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def room_of(path: Path) -> str:
    first = path.relative_to(PACKAGE).parts[0]
    return first.removesuffix(".py")


def modules(source: str, package: str) -> set[str]:
    """Full names of all modules that `source`, a file of `package`, imports, wherever in it the import stands."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            origin = ".".join([*base, *([node.module] if node.module else [])])
            # `from torchprt import shade` imports a room as well.
            found |= {f"{origin}.{name.name}" for name in node.names}
    return found


def rooms(source: str, package: str) -> set[str]:
    parts = [name.split(".") for name in modules(source, package)]
    return {name[1] for name in parts if name[0] == "torchprt" and len(name) > 1}


@pytest.mark.parametrize(
    ("line", "room"),
    [
        ("import torchprt.transport", "transport"),
        ("from torchprt import transport", "transport"),
        ("from torchprt.transport.bake import bake", "transport"),
        ("from ..transport import bake", "transport"),
        ("from .. import transport", "transport"),
        ("from . import basis", "sh"),
        ("from .basis import basis", "sh"),
        ("def late():\n    from torchprt.transport import bake", "transport"),
    ],
)
def test_finds_every_way_to_import_a_room(line, room):
    assert rooms(line, "torchprt.sh") == {room}


def test_every_room_has_a_floor():
    assert {room_of(path) for path in FILES} <= set(FLOORS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_a_file_imports_only_its_room_and_lower_floors(path):
    room = room_of(path)
    package = ".".join(["torchprt", *path.relative_to(PACKAGE).parts[:-1]])
    imported = rooms(path.read_text(encoding="utf-8"), package)
    upward = {other for other in imported if other != room and FLOORS[other] >= FLOORS[room]}
    assert not upward


@pytest.mark.parametrize("room", sorted(LEAN))
def test_the_rooms_that_a_run_time_needs_import_torch_and_little_else(room):
    for path in (PACKAGE / room).rglob("*.py"):
        tops = {name.split(".")[0] for name in modules(path.read_text(encoding="utf-8"), f"torchprt.{room}")}
        assert tops - set(sys.stdlib_module_names) - {"torchprt"} <= LEAN[room]
