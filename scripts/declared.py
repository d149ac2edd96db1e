"""What pyproject.toml asks for, as pip is to install it in its oldest or its newest versions.

python scripts/declared.py oldest|newest EXTRA...     prints one requirement a line, for the Python that runs it
"""

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]


def project() -> dict[str, Any]:
    """The table `project` of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def declared(extras: Iterable[str], table: dict[str, Any]) -> Iterator[Requirement]:
    """The requirements of the base and of `extras`, and of the extras these name, that hold for this Python."""
    for line in [*table["dependencies"], *_extra(extras, table)]:
        requirement = Requirement(line)
        if requirement.marker is not None and not requirement.marker.evaluate():
            continue
        yield requirement


def _extra(extras: Iterable[str], table: dict[str, Any]) -> Iterator[str]:
    for extra in extras:
        for line in table["optional-dependencies"][extra]:
            inner = Requirement(line)
            if inner.name == table["name"]:
                yield from _extra(sorted(inner.extras), table)
            else:
                yield line


def oldest(requirement: Requirement) -> str:
    """`name>=X` as `name==X`.

    Raises ValueError if the requirement has no lower bound: then nobody knows what it was tested with.
    """
    bounds = [part.version for part in requirement.specifier if part.operator == ">="]
    if len(bounds) != 1:
        raise ValueError(f"{requirement} has no lower bound: say name>=VERSION in pyproject.toml")
    return f"{_named(requirement)}=={bounds[0]}"


def newest(requirement: Requirement) -> str:
    """The requirement without its lower bound, which pip meets with the newest there is."""
    upper = ",".join(str(part) for part in requirement.specifier if part.operator != ">=")
    return _named(requirement) + upper


def _named(requirement: Requirement) -> str:
    extras = ",".join(sorted(requirement.extras))
    return f"{requirement.name}[{extras}]" if extras else requirement.name


if __name__ == "__main__":
    choose = {"oldest": oldest, "newest": newest}[sys.argv[1]]
    for found in declared(sys.argv[2:], project()):
        print(choose(found))
