"""Does `preview` say why where it cannot open a window?"""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize("display", [None, ":54321", "nowhere.invalid:0"])
def test_without_a_display_preview_names_the_way_without(folder, display):
    pytest.importorskip(
        "open3d", exc_type=ImportError, reason="Open3D is not installed: pip install 'torchprt[preview]'"
    )
    kept = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    if display is not None:
        kept["DISPLAY"] = display
    command = [sys.executable, "-m", "torchprt", "preview", folder / "ball.safetensors"]
    ended = subprocess.run(list(map(str, command)), capture_output=True, text=True, env=kept, check=False, timeout=300)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith("torchprt: there is no display")
    assert "`torchprt render`" in ended.stderr
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "fault", [ModuleNotFoundError("No module named 'open3d'"), OSError("libusb-1.0.so.0: not found")]
)
def test_without_open3d_preview_says_what_to_install(refused, folder, monkeypatch, fault):
    class Refuses:
        def find_spec(self, name, path=None, target=None):
            if name == "open3d":
                raise fault
            return None

    for name in [name for name in sys.modules if name.split(".")[0] == "open3d"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Refuses(), *sys.meta_path])
    words = ["pip install 'torchprt[preview]'", "libusb-1.0-0 libgl1 libegl1", "`torchprt render`"]
    if isinstance(fault, OSError):
        words.append("libusb-1.0.so.0: not found")
    refused(*words, arguments=["preview", folder / "ball.safetensors"])


def test_preview_refuses_a_size_before_anything_else(refused, folder):
    refused("--size is 'x'", arguments=["preview", folder / "ball.safetensors", "--size", "x"])
