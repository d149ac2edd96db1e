"""Does the command start fast, and as each of its names?"""

import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ("torch", "numpy", "trimesh", "embreex", "kornia", "onnx", "PIL", "open3d", "matplotlib")


def process(*command):
    return subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("arguments", [["--help"], ["bake", "--help"], ["preview", "--help"], ["bake"], ["nothing"]])
def test_help_and_usage_load_nothing_heavy(arguments):
    code = (
        "import sys\n"
        f"sys.argv = ['torchprt', *{arguments!r}]\n"
        "from torchprt.cli import main\n"
        "try:\n    main()\n"
        f"finally:\n    print('LOADED', *[name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    ended = process(sys.executable, "-c", code)
    assert ended.returncode == (0 if "--help" in arguments else 2)
    assert ended.stdout.splitlines()[-1].split() == ["LOADED"]
    assert arguments[0].strip("-") in ended.stdout + ended.stderr


@pytest.mark.parametrize("name", ["module", "script"])
def test_every_name_of_the_command_refuses_in_one_sentence(name, tmp_path):
    command = [sys.executable, "-m", "torchprt"] if name == "module" else [Path(sys.executable).with_name("torchprt")]
    if name == "script" and not command[0].exists():
        pytest.skip("torchprt is not installed beside this Python")
    ended = process(*command, "bake", tmp_path / "none.ply", "-o", tmp_path / "a.safetensors")
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr == f"torchprt: {tmp_path / 'none.ply'} does not exist: check the name\n"
    assert not list(tmp_path.iterdir())
