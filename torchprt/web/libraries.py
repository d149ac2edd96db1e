"""The JavaScript of others that a page runs: fetched once by npm at pinned versions, kept in a cache, checked."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import os
import shutil
import subprocess
import tarfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from torchprt.errors import InputError
from torchprt.files import CannotWrite, atomic_folder


@dataclass(frozen=True)
class Library:
    """A package of npm at one version; `integrity` as in a lock file of npm; `files`: paths inside it, and here."""

    name: str
    version: str
    integrity: str
    files: dict[str, str]


# three.js: the last version whose package has minified modules. ONNX Runtime: WebAssembly alone, and with WebGPU.
LIBRARIES = (
    Library(
        "three",
        "0.184.0",
        "sha512-wtTRjG92pM5eUg/KuUnHsqSAlPM296brTOcLgMRqEeylYTh/CdtvKUvCyyCQTzFuStieWxvZb8mVTMvdPyUpxg==",
        {
            "build/three.module.min.js": "three.module.min.js",
            "build/three.core.min.js": "three.core.min.js",
            "examples/jsm/loaders/GLTFLoader.js": "loaders/GLTFLoader.js",
            "examples/jsm/loaders/EXRLoader.js": "loaders/EXRLoader.js",
            "examples/jsm/libs/fflate.module.js": "libs/fflate.module.js",
            "examples/jsm/libs/meshopt_decoder.module.js": "libs/meshopt_decoder.module.js",
            "examples/jsm/utils/BufferGeometryUtils.js": "utils/BufferGeometryUtils.js",
            "examples/jsm/utils/SkeletonUtils.js": "utils/SkeletonUtils.js",
            "LICENSE": "three-LICENSE.txt",
        },
    ),
    Library(
        "onnxruntime-web",
        "1.30.0",
        "sha512-q0y+JrrtukXSzsBWEMccVfqX25LRmosXHF+CaRJmg8pZClzcV7svNc4rKY3jL02Vb7QmRMDs1SigqR4CXAfKYQ==",
        {
            "dist/ort.wasm.bundle.min.mjs": "ort.wasm.bundle.min.mjs",
            "dist/ort-wasm-simd-threaded.wasm": "ort.wasm.wasm.gz",
            "dist/ort.jspi.bundle.min.mjs": "ort.jspi.bundle.min.mjs",
            "dist/ort-wasm-simd-threaded.jspi.wasm": "ort.jspi.wasm.gz",
        },
    ),
)
# npm's package of ONNX Runtime has no licence file; PyPI's of the same project has, and is there wherever graphs are
# written.
NOTICES = {"LICENSE": "onnxruntime-LICENSE.txt", "ThirdPartyNotices.txt": "onnxruntime-ThirdPartyNotices.txt"}
PATIENCE = 600


def libraries() -> Path:
    """The folder with the JavaScript of others and its licences; made by npm if this user has none yet (50 MB once).

    It is `torchprt/web-VERSIONS-FILES` in XDG_CACHE_HOME, or in `~/.cache`. Packages are compared with the SHA-512 that
    stands here. Only npm uses the network.
    Raises InputError if npm is missing or fails, or a package is not the one that it should be.
    """
    versions = "-".join(f"{library.name}-{library.version}" for library in LIBRARIES)
    # Another list of files of the same packages is another folder.
    files = json.dumps([library.files for library in LIBRARIES])
    folder = _cache() / f"web-{versions}-{hashlib.sha256(files.encode()).hexdigest()[:8]}"
    if folder.is_dir():
        return folder
    try:
        with atomic_folder(folder) as made:
            # The packages lie beside what is made of them, and go with the rest.
            for library in LIBRARIES:
                _unpack(library, _fetch(library, made.parent), made)
            for source, name in NOTICES.items():
                shutil.copyfile(_notice(source), made / name)
    except CannotWrite as fault:
        # Another process may have been faster, and what it made is the same.
        if not folder.is_dir():
            raise CannotWrite(folder, fault.reason, f"{fault.advice}, or set XDG_CACHE_HOME to another one") from fault
    return folder


def _cache() -> Path:
    named = os.environ.get("XDG_CACHE_HOME")
    return (Path(named) if named else Path.home() / ".cache") / "torchprt"


def _fetch(library: Library, scratch: Path) -> Path:
    """The package as npm packs it."""
    npm, wanted = shutil.which("npm"), f"{library.name}@{library.version}"
    if npm is None:
        raise InputError(
            f"npm is not installed, and a page needs {wanted} from it once: install Node.js (Debian: apt-get install "
            "npm) and write the page again"
        )
    command = [npm, "pack", wanted, "--silent", "--ignore-scripts", "--pack-destination", str(scratch)]
    try:
        ended = subprocess.run(command, cwd=scratch, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired as fault:
        raise InputError(f"npm did not bring {wanted} within {PATIENCE} s: look at its registry and network") from fault
    packed = scratch / f"{library.name}-{library.version}.tgz"
    if ended.returncode or not packed.is_file():
        reason = (ended.stderr or ended.stdout).strip().splitlines() or [f"exit code {ended.returncode}"]
        raise InputError(f"npm could not bring {wanted} ({reason[-1]}): look at its registry and network")
    return packed


def _unpack(library: Library, packed: Path, folder: Path) -> None:
    found = "sha512-" + base64.b64encode(hashlib.sha512(packed.read_bytes()).digest()).decode()
    if found != library.integrity:
        raise InputError(
            f"npm brought another {library.name}@{library.version} than torchprt was tested with (its SHA-512 "
            "differs): look at its registry"
        )
    with tarfile.open(packed) as archive:
        for source, name in library.files.items():
            member = archive.extractfile(f"package/{source}")
            assert member is not None
            target = folder / name
            target.parent.mkdir(exist_ok=True)
            content = member.read()
            # 14 MB of WebAssembly are 4 MB: plain static servers do not compress.
            target.write_bytes(gzip.compress(content, mtime=0) if target.suffix == ".gz" else content)


def _notice(name: str) -> Path:
    try:
        files = distribution("onnxruntime").files or []
    except PackageNotFoundError as fault:
        raise InputError("onnxruntime is not installed: install torchprt[export]") from fault
    for file in files:
        if file.name == name:
            return Path(str(file.locate()))
    raise InputError(f"the installed onnxruntime has no {name}, which must go with a page: install it again")
