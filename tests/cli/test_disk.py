"""Whatever a verb writes: is a disk at fault one sentence, with code 2, what was there before kept, and nothing left?

All verbs stand in `WRITES`; a new one is missed by `test_no_verb_is_forgotten`.
"""

import copy
import errno
import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from atlases import lit_cube
from faults import everything, room_for
from PIL import Image
from safetensors import safe_open

import torchprt
from torchprt import measure
from torchprt.cli.command import VERBS
from torchprt.scene import height_field
from torchprt.scene import load as read_scene
from torchprt.transfer import save
from torchprt.transport import bake_neighbourhood, bake_patch

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of the size of files")

ROOM = 600
BALL, LAMP, SIZE = "ball.safetensors", ["--light", "lamp.exr"], ["--size", "96x72", "--samples", "1"]
# What each verb writes: the name of the file (or, without a suffix, the folder), and the other arguments.
WRITES: dict[str, list[tuple[str, list[str]]]] = {
    "bake": [
        ("a.safetensors", ["ball.ply", "--rays", "16", "--threads", "1"]),
        ("b.safetensors", ["ball.ply", "--rays", "16", "--threads", "2", "--bounces", "1", "--half"]),
        ("c.safetensors", ["ball.ply", "--unshadowed"]),
        ("d.safetensors", ["ball.ply", "--rays", "16", "--threads", "1", "--bounces", "1", "--in-parts"]),
    ],
    "shade": [
        *((f"a{suffix}", [BALL, *LAMP]) for suffix in (".npy", ".ply", ".glb")),
        *((f"a{suffix}", [BALL, *LAMP, *SIZE]) for suffix in (".png", ".jpg", ".webp")),
        *((f"map{suffix}", ["cube.safetensors", *LAMP]) for suffix in (".npy", ".exr", ".glb", ".png")),
    ],
    "light": [("a.npy", ["lamp.exr", "--order", "16"])],
    "export": [
        ("a.onnx", [BALL]),
        ("a.glb", [BALL]),
        ("lit.glb", ["cube.safetensors"]),
        ("page", [BALL, "--web", *LAMP]),
        ("scene", [BALL, "--three", *LAMP]),
    ],
    "compress": [("a.safetensors", [BALL, "--clusters", "4"])],
    "plan": [("a.toml", ["ball.ply", *LAMP, "--order", "3", "--error", "20%"])],
    "fit": [("a.safetensors", [BALL, "--lobes", "2"])],
    "patch": [("a.safetensors", ["relief.png", "--size", "8", "--rays", "16", "--lobes", "1", "--threads", "1"])],
    "lay": [("a.safetensors", ["patch.safetensors", "square.obj"])],
    "render": [
        *((f"a{suffix}", [BALL, *LAMP, *SIZE]) for suffix in (".png", ".jpg", ".webp")),
        *((f"b{suffix}", [BALL, *LAMP, *SIZE, "--turntable", "4"]) for suffix in (".gif", ".webp", ".mp4", ".png")),
    ],
    "neighbourhood": [
        ("a.safetensors", ["ball.ply", "--grid", "8", "--rays", "16", "--threads", "1"]),
    ],
    "cast": [
        *((f"a{suffix}", ["around.safetensors", "ball.ply", *LAMP, *SIZE]) for suffix in (".png", ".gif")),
    ],
    "volume": [
        ("a.safetensors", ["cloud.npy", "--rays", "16", "--threads", "1", "--bounces", "1"]),
    ],
    "tradeoff": [("sweep", [BALL, *LAMP])],
    "demo": [("demo", [])],
    # They answer, and write nothing.
    "serve": [],
    "info": [],
    # Its window does, see tests/preview/test_window.py.
    "preview": [],
}
CASES = [
    pytest.param(verb, *write, id=f"{verb}-{write[0]}")
    for verb, writes in WRITES.items()
    for write in writes
    # See below: it takes long.
    if verb != "demo"
]
# One of each verb and kind of place: it is refused before the work begins.
PLACES = list(
    {(verb, "." in name): (verb, name, given) for verb, all in WRITES.items() for name, given in all}.values()
)


def test_no_verb_is_forgotten():
    assert {*WRITES} == {verb.__name__ for verb in VERBS}


@pytest.fixture(scope="module")
def inputs(folder, tmp_path_factory):
    """What verbs are given: that of all tests of commands, a relief, a patch, and a square to lay it on."""
    made = tmp_path_factory.mktemp("inputs")
    for path in folder.iterdir():
        shutil.copy(path, made)
    heights = np.random.default_rng(0).integers(0, 255, (8, 8), np.uint8)
    Image.fromarray(heights).save(made / "relief.png")
    mesh = height_field(torch.from_numpy(heights / 255.0), 0.1, "relief")
    save(bake_patch(mesh, size=4, lobes=1, order=3, rays=16, threads=1, progress=False), made / "patch.safetensors")
    around = bake_neighbourhood(read_scene(made / "ball.ply"), grid=8, rays=16, threads=1, progress=False)
    save(around, made / "around.safetensors")
    save(lit_cube(), made / "cube.safetensors")
    np.save(made / "cloud.npy", np.full((4, 4, 4), 0.2, np.float32))
    corners = "".join(f"v {x} {y} 0\nvt {x} {y}\n" for y in range(9) for x in range(9))
    first = [9 * y + x + 1 for y in range(8) for x in range(8)]
    faces = "".join("f " + " ".join(f"{a + step}/{a + step}" for step in (0, 1, 10, 9)) + "\n" for a in first)
    (made / "square.obj").write_text(corners + faces)
    return made


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def traced():
    """The graph of the ball, which takes seconds to trace."""
    return {}


@pytest.fixture
def write(inputs, cache, run, tmp_path, monkeypatch, untyped, no_npm, traced):
    """`write(verb, name, given)`: the verb, which writes `name` into the folder it works in."""
    export = importlib.import_module("torchprt.onnx.export")

    def once(plan, trace=export._trace):
        if "ball" not in traced:
            traced["ball"] = trace(plan)
        return copy.deepcopy(traced["ball"])

    def planned_once(*arguments, plan=measure.plan, **options):
        if "plan" not in traced:
            traced["plan"] = plan(*arguments, **options)
        return traced["plan"]

    monkeypatch.setattr(export, "_trace", once)
    # Its times differ from run to run.
    monkeypatch.setattr(measure, "plan", planned_once)
    # What a sweep measures is kept elsewhere; and it is of two recipes.
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.setattr(
        "torchprt.measure.sweeping.sweep", lambda choice, quick: [choice.base, choice.base.replace(order=2)]
    )
    for path in inputs.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return lambda verb, name, given: run(verb, *given, "-o", name)


def refused(ended, *words):
    assert ended.code == 2, ended
    assert "Traceback" not in ended.err
    told = [line for line in ended.err.splitlines() if line.startswith("torchprt: ")]
    assert len(told) == 1, ended.err
    for word in words:
        assert word in told[0]


def largest(name):
    """Bytes of what was written there, of the largest file of several."""
    return max(path.stat().st_size for path in [Path(name), *Path(name).rglob("*")] if path.is_file())


def held(name):
    """What a result is, whatever order it is stored in."""
    path = Path(name)
    if path.suffix == ".safetensors":
        with safe_open(path, "pt") as file:
            tensors = {key: file.get_tensor(key).numpy().tobytes() for key in sorted(file.keys())}
            return tensors, file.metadata()
    # Exporters give names to nodes that differ from one time to the next.
    return everything(path).keys() if path.is_dir() else None if path.suffix == ".onnx" else path.read_bytes()


def without_chunks(files):
    """A stopped bake or compression keeps what it has."""
    return {name: content for name, content in files.items() if ".partial" not in name}


@pytest.mark.parametrize(("verb", "name", "given"), CASES)
def test_a_disk_without_room(verb, name, given, write):
    assert write(verb, name, given).code == 0
    whole, size = held(name), largest(name)
    before = everything(Path())
    # Near the beginning (for less, what is said would find no room either), and for all but the last byte.
    for room in (min(ROOM, size - 1), size - 1):
        with room_for(room):
            refused(write(verb, name, given), name, "cannot be written", "free some space")
        assert without_chunks(everything(Path())) == before
    assert write(verb, name, given).code == 0
    assert held(name) == whole
    assert everything(Path()).keys() == before.keys()


def test_a_demo_without_room(write):
    with room_for(ROOM):
        refused(write("demo", "demo", []), "studio.exr cannot be written", "free some space")
    assert not list(Path("demo").iterdir())


def test_pictures_of_a_turntable_without_room(write):
    Path("frame-01.png").write_text("former")
    given = [BALL, *LAMP, *SIZE, "--turntable", "2"]
    with room_for(ROOM):
        refused(write("render", "frame-##.png", given), "frame-00.png cannot be written")
    assert Path("frame-01.png").read_text() == "former"
    assert not Path("frame-00.png").exists()


def test_a_bake_on_the_way_without_room(write):
    given = ["ball.ply", *LAMP, *SIZE, "--bake", "kept.safetensors", "--rays", "16", "--threads", "1"]
    with room_for(ROOM):
        refused(write("render", "a.png", given), "kept.safetensors", "cannot be written")
    assert not Path("a.png").exists()
    assert write("render", "a.png", given).code == 0


@pytest.mark.parametrize(("verb", "name", "given"), PLACES)
def test_a_place_that_takes_no_file(verb, name, given, write, monkeypatch):
    suffix, is_file = Path(name).suffix, Path(name).suffix != ""
    Path("taken").write_text("former")
    Path(f"folder{suffix}").mkdir()
    wrong = {f"taken/a{suffix}": "cannot be"}
    if is_file:
        wrong |= {
            f"folder{suffix}": "is a folder",
            f"none/a{suffix}": "does not exist, make it first",
            "a" * 260 + suffix: "give a shorter name",
        }
    else:
        wrong["taken"] = "taken"
    before = everything(Path())
    for place, words in wrong.items():
        refused(write(verb, place, given), words)
        assert everything(Path()) == before

    opened, made = os.open, os.mkdir
    for number in (errno.EACCES, errno.EROFS):

        def denied(path, flags, *rest, number=number, **options):
            if flags & (os.O_CREAT | os.O_TMPFILE) and not str(path).startswith(os.devnull):
                raise OSError(number, os.strerror(number), str(path))
            return opened(path, flags, *rest, **options)

        def unmade(path, *rest, number=number, **options):
            raise OSError(number, os.strerror(number), str(path))

        with monkeypatch.context() as patched:
            patched.setattr(os, "open", denied)
            patched.setattr(os, "mkdir", unmade)
            refused(write(verb, name, given), os.strerror(number), "choose another folder")
        assert everything(Path()) == before
    assert (os.open, os.mkdir) == (opened, made)


@pytest.mark.parametrize(("verb", "name", "given"), [case for case in CASES if "." in case.values[1]])
@pytest.mark.parametrize("fault", [KeyboardInterrupt(), OSError(errno.EROFS, "Read-only file system")], ids=repr)
def test_a_fault_when_a_file_takes_its_name(verb, name, given, fault, write, monkeypatch):
    """The last step: until then the former file is there."""
    Path(name).write_text("former")
    before, replace = everything(Path()), os.replace

    def stopped(source, target, **options):
        if Path(target).name == name:
            raise fault
        return replace(source, target, **options)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", stopped)
        ended = write(verb, name, given)
    assert without_chunks(everything(Path())) == before
    if isinstance(fault, OSError):
        refused(ended, f"{name} cannot be written (Read-only file system)", "choose another folder")
    else:
        assert ended.code == 130
        assert "Traceback" not in ended.err
    assert write(verb, name, given).code == 0
    assert everything(Path()).keys() == before.keys()


def test_a_folder_of_the_system_that_takes_no_files(run, folder):
    if not Path("/proc").is_dir():
        pytest.skip("no /proc")
    refused(run("light", folder / "lamp.exr", "-o", "/proc/a.npy"), "/proc/a.npy cannot be written")


BAKES = """
import os, sys
from torchprt.cli import main

def bake():
    sys.argv = "torchprt -q bake ../ball.ply -o a.safetensors --rays 16 --threads 1".split()
    code = 0
    try:
        main()
    except SystemExit as end:
        code = end.code or 0
    print(code, *sorted(os.listdir()), flush=True)

bake()
print(open("a.safetensors").read())
os.system("mount -o remount,size=16m .")
bake()
"""


def test_a_real_disk_without_room(tmp_path):
    import trimesh

    if shutil.which("unshare") is None:
        pytest.skip("no unshare: a small disk cannot be made")
    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "ball.ply")
    (tmp_path / "disk").mkdir()
    small = (
        'mount -t tmpfs -o size=128k tmpfs "$1" && cd "$1" && printf former > a.safetensors || exit 77; "$2" -c "$3"'
    )
    command = ["unshare", "-Urm", "sh", "-c", small, "sh", tmp_path / "disk", sys.executable, BAKES]
    environment = os.environ | {"PYTHONPATH": str(Path(torchprt.__file__).parents[1])}
    ended = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    if ended.returncode == 77 or "unshare" in ended.stderr:
        pytest.skip(f"a small disk cannot be made: {ended.stderr.strip()}")
    assert ended.stdout.splitlines() == [
        "2 a.safetensors a.safetensors.partial", "former", "0 a.safetensors"
    ]  # fmt: skip
    told = [line for line in ended.stderr.splitlines() if line.startswith("torchprt: ")]
    assert len(told) == 1, ended.stderr
    assert "cannot be written (No space left on device): free some space, then do the same again" in told[0]
    assert "Traceback" not in ended.stderr
