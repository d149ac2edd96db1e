"""Small text files that people write: .toml, read whole or refused in a sentence."""

import sys
from pathlib import Path
from typing import Any

from torchprt.errors import InputError
from torchprt.suffixes import check_readable


def read_toml(source: Path) -> dict[str, Any]:
    """What stands in a .toml file. Raises InputError, naming it, if it is missing, cannot be read, or is no TOML."""
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    check_readable(source)
    try:
        return tomllib.loads(source.read_text(encoding="utf-8"))
    except OSError as fault:
        raise InputError(f"{source} cannot be read ({fault.strerror}): check the name and its permissions") from fault
    except ValueError as fault:  # Both of bad UTF-8 and of bad TOML.
        raise InputError(f"{source} is not a .toml file ({fault}): mend it") from fault


def number(source: Path, key: str, value: Any) -> float:
    """A number. Raises InputError, naming file and key, for anything else."""
    # TOML keeps true apart from 1; Python does not.
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{source} has {key} = {value!r}: give a number")
    return float(value)


def colour(source: Path, content: dict[str, Any], key: str) -> float | list[float]:
    """One number, or three."""
    value = content[key]
    if not isinstance(value, list):
        return number(source, key, value)
    if len(value) != 3:
        raise InputError(f"{source} has {key} of {len(value)} numbers: give one, or three (linear RGB)")
    return [number(source, key, each) for each in value]


def only(source: Path, content: dict[str, Any], keys: tuple[str, ...], where: str = "") -> None:
    """Raises InputError, naming the first of them, if there are keys other than these."""
    unknown = [key for key in content if key not in keys]
    if unknown:
        raise InputError(f"{source} has an unknown key {unknown[0]!r}{where}: use {', '.join(keys)}")
