"""Does whatever writes a file do it by `torchprt.files`, where faults of a disk become sentences?"""

import ast
from pathlib import Path

import pytest

import torchprt

PACKAGE = Path(torchprt.__file__).parent
GUARDS = {"atomic", "atomic_folder", "sentences"}
WRITERS = {
    "write_bytes", "write_text", "mkdir", "makedirs", "copyfile", "copytree", "tofile", "savefig", "save_file",
    "mkdtemp", "mkstemp", "TemporaryDirectory", "NamedTemporaryFile", "TemporaryFile",
}  # fmt: skip
# Functions that are called where a guard is held, by who calls them.
INSIDE = {
    "web/export.py": {"_zipped": "export", "_picture": "export"},
    "web/libraries.py": {"_unpack": "libraries"},
    "web/mesh.py": {"save_small_glb": "web.export.export"},
    "web/packing.py": {"pack": "web.export.export"},
    # Has sentences of its own.
    "transport/checkpoint.py": {"__init__": ""},
    "transport/object_store.py": {"__init__": ""},
    "transport/workers.py": {"_write": ""},
}
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "files.py")


def writers(source):
    """Lines of calls that write a file and stand in no guard, with the function that they are in."""
    found = []

    def look(node, function, guarded):
        if isinstance(node, ast.FunctionDef):
            function = node.name
        if isinstance(node, ast.With):
            named = [_name(item.context_expr.func) for item in node.items if isinstance(item.context_expr, ast.Call)]
            guarded = guarded or bool(GUARDS & set(named))
        if isinstance(node, ast.Call) and not guarded and (_name(node.func) in WRITERS or _opens(node)):
            found.append((node.lineno, function))
        for child in ast.iter_child_nodes(node):
            look(child, function, guarded)

    look(ast.parse(source), "", False)
    return found


def _name(node):
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _opens(call):
    texts = [each.value for each in call.args if isinstance(each, ast.Constant) and isinstance(each.value, str)]
    return _name(call.func) == "open" and any(set(text) & set("wxa") and len(text) < 4 for text in texts)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("path.write_bytes(b'')", True),
        ("open(path, 'w')", True),
        ("path.open('xb')", True),
        ("path.open('rb')", False),
        ("save_file({}, path)", True),
        ("with atomic(path) as new:\n    new.write_bytes(b'')", False),
        ("with a, files.atomic(path) as new, new.open('wb') as file:\n    pass", False),
        ("with other(path) as new:\n    new.write_bytes(b'')", True),
    ],
)
def test_finds_what_writes_without_a_guard(line, found):
    assert bool(writers(line)) == found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_whatever_writes_a_file_does_it_where_faults_become_sentences(path):
    inside = INSIDE.get(path.relative_to(PACKAGE).as_posix(), {})
    assert not [each for each in writers(path.read_text(encoding="utf-8")) if each[1] not in inside]
