"""Does the reference hold every public name, as it is?"""

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "torchprt"
ROOMS = sorted(path.parent.relative_to(PACKAGE).as_posix().replace("/", ".") for path in PACKAGE.rglob("*/__init__.py"))
# What the command has to say is in its --help.
ROOMS.remove("cli")


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_has_a_docstring_and_stands_in_the_reference(room):
    module = importlib.import_module(f"torchprt.{room}")
    page = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    headed = set(re.findall(rf"^### `torchprt\.{re.escape(room)}\.(\w+)`$", page, re.MULTILINE))
    assert headed == set(module.__all__)
    things = {name: getattr(module, name) for name in module.__all__}
    assert not [
        name for name, it in things.items() if (inspect.isroutine(it) or inspect.isclass(it)) and not it.__doc__
    ]


def test_the_reference_says_what_the_docstrings_say():
    done = subprocess.run(
        [sys.executable, "docs/make/reference.py", "--check"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
