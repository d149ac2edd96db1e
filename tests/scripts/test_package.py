"""Does what is published hold what it must, and nothing else?"""

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BUILD = """
import sys
from setuptools import build_meta
folder = sys.argv[1]  # Each of the two leaves other arguments.
build_meta.build_sdist(folder)
build_meta.build_wheel(folder)
"""


@pytest.fixture(scope="module")
def tracked():
    """The files of the checkout. In an unpacked sdist there is none, and what to compare with is not known."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("what is published is compared with a checkout, and this is none")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    return {name for name in found if name and (ROOT / name).is_file()}


@pytest.fixture(scope="module")
def published(tracked, tmp_path_factory):
    """The names of the files in the sdist and in the wheel, made from a copy: a build leaves things behind."""
    copy, made = tmp_path_factory.mktemp("checkout"), tmp_path_factory.mktemp("made")
    for name in tracked:
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, copy / name)
    command = [sys.executable, "-c", BUILD, made]
    subprocess.run(command, cwd=copy, capture_output=True, check=True, stdin=subprocess.DEVNULL)
    (sdist,), (wheel,) = made.glob("*.tar.gz"), made.glob("*.whl")
    with tarfile.open(sdist) as file:
        source = {member.name.split("/", 1)[1] for member in file if member.isfile()}
    with zipfile.ZipFile(wheel) as file:
        return source, set(file.namelist())


def test_the_sdist_is_the_checkout_with_all_tests_and_their_helpers(published, tracked):
    source, _ = published
    own = {name for name in source if name in ("PKG-INFO", "setup.cfg") or name.startswith("torchprt.egg-info/")}
    assert source - own == tracked
    assert {"tests/conftest.py", "tests/transfers.py", "docs/reference.md", "constraints.txt"} <= source


def test_the_wheel_is_the_package_with_its_page_and_no_tests(published, tracked):
    _, wheel = published
    package = {name for name in wheel if ".dist-info/" not in name}
    assert package == {name for name in tracked if name.startswith("torchprt/")}
    assert any(name.startswith("torchprt/web/page/") for name in package)
