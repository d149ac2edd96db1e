"""Does a room that loads its parts when they are used look as if it had them all?"""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOMS = ("preview", "scene")


def room_of(name):
    return importlib.import_module(f"torchprt.{name}")


def modules(room):
    return {path.stem for path in Path(room.__file__).parent.iterdir() if path.name != "__init__.py"}


@pytest.mark.parametrize("name", ROOMS)
@pytest.mark.parametrize("missing", ["loads", "_NAMES_", "__wrapped__", ""])
def test_another_name_is_an_attribute_error(name, missing):
    with pytest.raises(AttributeError, match=f"module 'torchprt.{name}' has no attribute '{missing}'"):
        getattr(room_of(name), missing)


@pytest.mark.parametrize("name", ROOMS)
def test_what_it_says_of_its_names_is_what_type_checkers_read(name):
    room = room_of(name)
    source = ast.parse(Path(room.__file__).read_text(encoding="utf-8"))
    checked = [each for each in source.body if isinstance(each, ast.If)]
    places = {alias.asname: each.module or alias.name for node in checked for each in node.body for alias in each.names}
    assert places == room._NAMES


@pytest.mark.parametrize("name", ROOMS)
def test_a_name_is_that_of_a_module_only_if_it_is_the_module(name):
    room = room_of(name)
    taken = modules(room) & set(room._NAMES)
    assert taken == {each for each, place in room._NAMES.items() if each == place}
    for each in sorted(modules(room) & set(room.__all__) - taken):
        # Imported at once, so that the name is what it should be whoever imports the module first.
        assert f"from .{each} import {each} as {each}" in Path(room.__file__).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ROOMS)
def test_every_name_is_there_and_shown(name):
    room = room_of(name)
    assert len(room.__all__) == len(set(room.__all__))
    assert set(room.__all__) <= set(dir(room))
    for each in room.__all__:
        assert getattr(room, each) is getattr(room, each)


def test_a_room_loads_what_is_asked_of_it_and_no_more():
    told = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys\n"
            "from torchprt import preview, scene\n"
            "print('torchprt.scene.reading' in sys.modules, 'torchprt.preview.session' in sys.modules)\n"
            "from torchprt.scene import read_mesh, samples\n"
            "print(read_mesh.__module__, samples.__name__, scene.samples is samples)\n"
            "print('torchprt.scene.volume_reading' in sys.modules)\n",
        ],
        capture_output=True, text=True, check=True, timeout=120,
    ).stdout  # fmt: skip
    assert told.splitlines() == ["False False", "torchprt.scene.reading torchprt.scene.samples True", "False"]
