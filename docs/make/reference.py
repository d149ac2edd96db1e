"""Writes docs/reference.md: every public name of every room, from its signature and docstring.

python docs/make/reference.py            writes the file
python docs/make/reference.py --check    fails if the file is not what it would write
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import importlib
import inspect
import itertools
import re
import sys
import textwrap
import types
from pathlib import Path

from torch import nn

ROOMS = (
    "sh",
    "transfer",
    "light",
    "brdf",
    "compression",
    "trace",
    "scene",
    "scene.samples",
    "pose",
    "shade",
    "transport",
    "onnx",
    "preview",
    "measure",
    "web",
)
PATH = Path(__file__).parents[1] / "reference.md"
HEADER = """# Reference

Every public name, room by room. Written by `scripts/docs reference` from signatures and docstrings: do not edit.
Shape letters and the axes are those of [conventions.md](conventions.md). `import torchprt as prt` also offers
{shortcuts} directly.
"""


@functools.cache
def source_text(module: str) -> str:
    return Path(inspect.getsourcefile(sys.modules[module]) or "").read_text(encoding="utf-8")


def signature(thing: object, name: str) -> str:
    """As it stands in the source, on one line: the annotations there are shorter than what Python makes of them."""
    owner = thing.__init__ if inspect.isclass(thing) else thing  # type: ignore[misc]
    try:
        lines = inspect.getsource(inspect.unwrap(owner))  # type: ignore[arg-type]
    except (OSError, TypeError):
        return name
    found = re.search(r"def \w+(\(.*?\)(?: -> .*?)?):\s*(?:#.*|\.\.\.)?\n", lines, re.DOTALL)
    if not found:
        return name
    text = inspect.cleandoc("\n" + indented(found[0])).removeprefix("def ").removesuffix(":")
    text = re.sub(r"^\w+", name, text.removesuffix(" -> None"), count=1)
    # What a method is called on may be written with its type, as what it gives is then.
    typed = re.search(r"\((?:\n    )?self: (\w+)", text)
    if typed:
        text = re.sub(rf"-> {typed[1]}\b", "-> Self", text)
    text = re.sub(r"(?<=\n    )self(?:: \w+)?, (?=\S)|\n    self(?:: \w+)?,(?=\n)", "", text)
    return re.sub(r"\((?:self|cls)(?:: \w+)?(?:, )?", "(", text, count=1)


def indented(definition: str) -> str:
    """The lines of a definition up to its colon; a method stands further right than its first line shows."""
    lines = re.sub(r":\s*(?:#.*|\.\.\.)?$", ":", definition.rstrip()).split("\n")
    margin = len(lines[-1]) - len(lines[-1].lstrip()) if len(lines) > 1 else 0
    return "\n".join([" " * margin + lines[0].lstrip(), *lines[1:]])


def fields(kind: type) -> list[tuple[str, str]]:
    """The fields of a dataclass as they are written, each with the string below it."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(definition, ast.ClassDef)
    found = []
    for line, after in itertools.pairwise([*definition.body, ast.Pass()]):
        if isinstance(line, ast.AnnAssign) and "ClassVar" not in ast.unparse(line.annotation):
            below = after.value if isinstance(after, ast.Expr) else None
            comment = below.value if isinstance(below, ast.Constant) and isinstance(below.value, str) else ""
            text = ast.unparse(line).replace("'", '"')
            text = re.sub(r"(?:dataclasses\.)?field\(default_factory=(\w+)\)", r"\1()", text)
            found.append((text, inspect.cleandoc(comment)))
    return found


def constructor(kind: type) -> str:
    inherited = [base for base in kind.__mro__ if dataclasses.is_dataclass(base)]
    found: dict[str, str] = {}
    for base in inherited:
        for text, _ in fields(base):
            # As the nearest class has it.
            found.setdefault(text.split(":")[0], text)
    arguments = list(found.values())
    # Those without a default come first, as they are asked for.
    arguments.sort(key=lambda text: "=" in text)
    line = f"{kind.__name__}({', '.join(arguments)})"
    return line if len(line) <= 110 else f"{kind.__name__}(\n    " + ",\n    ".join(arguments) + ",\n)"


def docstring(thing: object) -> str:
    return inspect.cleandoc(thing.__doc__) if isinstance(thing.__doc__, str) else ""


def constant_comment(module: types.ModuleType, name: str) -> str:
    """What stands beside a constant: the comment above it or the string below it."""
    for candidate in sys.modules.values():
        if not getattr(candidate, "__name__", "").startswith(module.__name__ + "."):
            continue
        text = source_text(candidate.__name__)
        below = re.search(rf'^{name}\b.*\n"""(.*?)"""', text, re.MULTILINE | re.DOTALL)
        above = re.search(rf"((?:^#.*\n)+)^{name}\b[^\n]*=", text, re.MULTILINE)
        if below:
            return below[1]
        if above:
            return " ".join(line.lstrip("# ") for line in above[1].splitlines())
    return ""


@functools.cache
def public_classes() -> dict[type, str]:
    """Every class of the reference, and its full name."""
    found = {}
    for room in ROOMS:
        module = importlib.import_module(f"torchprt.{room}")
        things = {name: getattr(module, name) for name in public(room)}
        found |= {thing: f"torchprt.{room}.{name}" for name, thing in things.items() if inspect.isclass(thing)}
    return found


def described_elsewhere(kind: type) -> list[type]:
    """The nearest base that has an entry of its own, and all that it is made of."""
    nearest = [base for base in kind.__mro__[1:] if base in public_classes()][:1]
    return [part for base in nearest for part in base.__mro__]


def methods(kind: type) -> list[str]:
    entries = []
    elsewhere = described_elsewhere(kind)
    # What a class inherits is described at its base, unless the base is not public; modules inherit too much.
    bases = [kind]
    if dataclasses.is_dataclass(kind):
        bases += [base for base in kind.__mro__[1:] if dataclasses.is_dataclass(base) and base not in elsewhere]
    members = {name: member for base in reversed(bases) for name, member in vars(base).items()}
    known = {name for base in elsewhere for name in vars(base)}
    for name, member in members.items():
        if name.startswith("_") or name in ("extra_repr",):
            continue
        if name in known and not docstring(member):
            # Another way to do what the base says.
            continue
        if isinstance(member, property):
            entries.append(f"- `.{name}`: {docstring(member)}".removesuffix(": "))
        elif inspect.isfunction(member) or isinstance(member, classmethod):
            function = member.__func__ if isinstance(member, classmethod) else member
            call = " ".join(signature(function, "." + name).split())
            call = call.replace("( ", "(").replace(", )", ")").replace(" )", ")")
            entries.append(f"- `{call}`: {docstring(member)}".rstrip(": "))
    told = [base for base in elsewhere[:1] if base is not nn.Module]
    link = {base: public_classes()[base].lower().replace(".", "") for base in told}
    entries += [f"- and what [`{base.__name__}`](#{link[base]}) has." for base in told]
    return [entry.replace("\n\n", "\n").replace("\n", "\n  ") for entry in entries]


def registered(thing: object) -> str:
    """For which classes a generic function has an answer, and what it makes of them."""
    registry = {kind: made for kind, made in getattr(thing, "registry", {}).items() if kind is not object}
    pairs = [
        f"`{kind.__name__}`" + ("" if made.__name__.startswith("_") else f" as `{made.__name__}`")
        for kind, made in registry.items()
    ]
    return f"Registered: {', '.join(sorted(pairs))}." if pairs else ""


def entry(module: types.ModuleType, name: str) -> str:
    thing = getattr(module, name)
    parts = [f"### `{module.__name__}.{name}`"]
    if inspect.isclass(thing):
        if dataclasses.is_dataclass(thing) and "__init__" in thing.__dict__ and not _own_init(thing):
            parts.append(f"```python\n{constructor(thing)}\n```")
        elif "__init__" in thing.__dict__:
            parts.append(f"```python\n{signature(thing, name)}\n```")
        parts.append(docstring(thing))
        if dataclasses.is_dataclass(thing):
            told = [f"- `{text.split(':')[0]}`: {comment}" for text, comment in fields(thing) if comment]
            parts += ["\n".join(told).replace("\n", "\n  ").replace("\n  - ", "\n- ")] if told else []
        parts += ["\n".join(methods(thing))] if methods(thing) else []
    elif inspect.isfunction(thing) or hasattr(thing, "__wrapped__"):
        parts += [f"```python\n{signature(thing, name)}\n```", docstring(thing), registered(thing)]
    elif isinstance(thing, types.ModuleType):
        parts.append(docstring(thing))
    elif isinstance(thing, (int, float)):
        parts += [f"`{name} = {thing!r}`", constant_comment(module, name)]
    return "\n\n".join(part for part in parts if part)


def _own_init(kind: type) -> bool:
    return "__init__" in re.findall(r"def (\w+)", inspect.getsource(kind))


def public(room: str) -> list[str]:
    return sorted(importlib.import_module(f"torchprt.{room}").__all__, key=str.lower)


def document() -> str:
    import torchprt

    rooms = [room for room in torchprt.__all__ if isinstance(getattr(torchprt, room), types.ModuleType)]
    others = ", ".join(f"`{name}`" for name in torchprt.__all__ if name not in rooms)
    pages = [HEADER.format(shortcuts=others)]
    contents = []
    for room in ROOMS:
        module = importlib.import_module(f"torchprt.{room}")
        contents.append(
            f"- [{module.__name__}](#{module.__name__.replace('.', '')}): {docstring(module).splitlines()[0]}"
        )
    pages.append("\n".join(contents))
    for room in ROOMS:
        module = importlib.import_module(f"torchprt.{room}")
        pages.append(f"## {module.__name__}\n\n{docstring(module)}")
        pages += [entry(module, name) for name in public(room)]
    return "\n\n".join(page.strip() for page in pages) + "\n"


def main(arguments: list[str]) -> None:
    text = document()
    if "--check" in arguments:
        if not PATH.is_file() or PATH.read_text(encoding="utf-8") != text:
            sys.exit(f"{PATH} is not what the docstrings say: run python docs/make/reference.py")
        return
    PATH.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
