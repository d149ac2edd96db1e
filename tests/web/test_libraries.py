"""Does the JavaScript of others come from npm alone, as it was tested, once, and whole?"""

import base64
import errno
import hashlib
import importlib
import io
import os
import shutil
import stat
import tarfile
from pathlib import Path

import pytest

from torchprt.errors import InputError

room = importlib.import_module("torchprt.web.libraries")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "torchprt"


@pytest.fixture
def npm(tmp_path, monkeypatch):
    """`npm(script)`: the npm that is found is this shell script, in the folder for the package; gives its calls."""
    folder = tmp_path / "bin"
    folder.mkdir()

    def npm(script):
        program = folder / "npm"
        program.write_text(
            f"""#!/bin/sh
echo "$@" >> {folder}/calls
[ "$1" = pack ] || exit 9
shift; wanted=$1
while [ "$1" != --pack-destination ]; do shift; done
cd "$2" || exit 9
{script}
"""
        )
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
        return lambda: (folder / "calls").read_text().splitlines()

    return npm


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """Packages as `LIBRARIES`, with a word in each file, and the integrity that belongs to them."""
    made = []
    for library in room.LIBRARIES:
        path = tmp_path / f"{library.name}-{library.version}.tgz"
        with tarfile.open(path, "w:gz") as archive:
            for source in [*library.files, "unwanted.js"]:
                content = f"of {source}".encode()
                entry = tarfile.TarInfo(f"package/{source}")
                entry.size = len(content)
                archive.addfile(entry, io.BytesIO(content))
        digest = base64.b64encode(hashlib.sha512(path.read_bytes()).digest()).decode()
        made.append(room.Library(library.name, library.version, f"sha512-{digest}", library.files))
    monkeypatch.setattr(room, "LIBRARIES", tuple(made))
    return tmp_path


def test_without_npm_it_says_what_to_install(cache, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(InputError, match=r"npm is not installed.*three@0\.\d+\.\d+.*install Node\.js"):
        room.libraries()
    assert not list(cache.iterdir())


def test_what_npm_complains_of_is_told_and_nothing_is_kept(cache, npm):
    npm("echo 'npm error code ENOTFOUND' >&2; exit 1")
    with pytest.raises(InputError, match=r"npm could not bring three@.*npm error code ENOTFOUND"):
        room.libraries()
    assert not list(cache.iterdir())


def test_npm_that_brings_nothing_is_a_fault_too(cache, npm):
    npm("exit 0")
    with pytest.raises(InputError, match=r"npm could not bring three@.*exit code 0"):
        room.libraries()


def test_a_cache_without_room_says_which_variable_names_another(cache, npm, packages, tmp_path, monkeypatch):
    npm(f"cp {tmp_path}/*.tgz .")

    def full(path, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", full)
        with pytest.raises(InputError, match=r"cannot be written .*free some space.*set XDG_CACHE_HOME"):
            room.libraries()
    assert not list(cache.iterdir())
    room.libraries()


def test_a_cache_where_a_file_stands(cache):
    cache.parent.write_text("mine")
    with pytest.raises(InputError, match="cannot be made"):
        room.libraries()


def test_another_package_of_that_name_and_version_is_refused(cache, npm, packages):
    changed = packages / f"three-{room.LIBRARIES[0].version}.tgz"
    changed.write_bytes(changed.read_bytes() + b"x")
    npm(f"cp {packages}/*.tgz .")
    with pytest.raises(InputError, match="npm brought another three@"):
        room.libraries()
    assert not list(cache.iterdir())


def test_they_are_fetched_once_and_only_what_a_page_needs_is_kept(cache, npm, packages):
    calls = npm(f"cp {packages}/*.tgz .")
    folder = room.libraries()
    assert folder.parent == cache
    assert len(calls()) == len(room.LIBRARIES)
    assert all("--ignore-scripts" in call for call in calls())
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    wanted = {name for library in room.LIBRARIES for name in library.files.values()}
    assert found == wanted | set(room.NOTICES.values())
    assert (folder / "three.module.min.js").read_text() == "of build/three.module.min.js"
    packed = (folder / "ort.wasm.wasm.gz").read_bytes()
    assert room.gzip.decompress(packed) == b"of dist/ort-wasm-simd-threaded.wasm"
    assert "Microsoft" in (folder / "onnxruntime-LICENSE.txt").read_text()
    assert [entry.name for entry in cache.iterdir()] == [folder.name]
    assert room.libraries() == folder
    assert len(calls()) == len(room.LIBRARIES)


def test_every_library_has_its_licence_and_every_import_of_the_page_its_file():
    page = room.Path(room.__file__).parent / "page"
    kept = {name for library in room.LIBRARIES for name in library.files.values()}
    for script in page.glob("*.js"):
        for line in script.read_text().splitlines():
            if " from " in line and line.startswith(("import ", "}")):
                target = line.split('"')[1]
                assert target == "three" or (page / target).is_file() or target.removeprefix("./libraries/") in kept
    notice = (page / "NOTICE.txt").read_text()
    for name in ("three-LICENSE.txt", "onnxruntime-LICENSE.txt", "onnxruntime-ThirdPartyNotices.txt"):
        assert name in notice
    assert (room.Path(room.__file__).parents[2] / "LICENSE").read_text() in notice


def test_the_policy_of_the_page_names_the_hash_of_its_import_map():
    index = (room.Path(room.__file__).parent / "page" / "index.html").read_text()
    inside = index.split('<script type="importmap">')[1].split("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(inside.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in index


@pytest.mark.skipif(shutil.which("npm") is None, reason="PACKAGES OF NPM ARE NOT TESTED: npm is not installed")
def test_the_pinned_packages_hold_every_file(libraries):
    for name in ("three.module.min.js", "loaders/GLTFLoader.js", "ort.wasm.bundle.min.mjs", "ort.jspi.wasm.gz"):
        assert (libraries / name).stat().st_size > 10_000
