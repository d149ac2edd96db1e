"""Do the scripts that write pages of the documentation run, and say what they are asked about alone?"""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def script(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def test_a_kernel_that_is_none_is_named():
    command = [sys.executable, ROOT / "scripts/published_numerics.py", "--only", "sh.nonesuch"]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    assert done.returncode == 2
    assert "there is no kernel sh.nonesuch" in done.stderr


def test_the_page_of_numbers_has_a_row_for_each_type_and_what_is_refused():
    page = script("published_numerics").page(["sh.convolve, sh.window", "brdf a table"])
    rows = [line for line in page.splitlines() if line.startswith("| `sh.convolve")]
    assert [row.split(" | ")[2] for row in rows[:-1]] == ["float16", "bfloat16", "float32"]
    assert "kernel has 4 bands" in rows[-1]
    assert "| `brdf a table` |" in page
    assert "sh.rotate" not in page


def test_the_page_of_numbers_has_every_kernel():
    """Written by hand it would not."""
    text = (ROOT / "docs" / "numerics.md").read_text(encoding="utf-8")
    for kernel in script("published_numerics").kernels.KERNELS:
        assert f"| `{kernel.name}` |" in text


@pytest.mark.usefixtures("untyped")
def test_the_page_of_ringing_weighs_every_window(monkeypatch):
    module = script("published_ringing")
    for name, value in (("RECEIVERS", 20), ("RAYS", 64), ("GLOSSY", 2), ("VIEWS", 2), ("HIGH", 4), ("TEXELS", 8)):
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(module, "GLOSSY_ORDERS", (2,))
    monkeypatch.setattr(module, "photographs", dict)
    one = module.scenes()["head"]
    monkeypatch.setattr(module, "scenes", lambda: {"head": one})
    page = module.page(["sky", "overcast"], (2, 3))
    for name in ("sky", "overcast"):
        for order in (2, 3):
            row = next(line for line in page.splitlines() if line.startswith(f"| {name} | {order} |"))
            assert row.count("|") == 3 + len(module.light.WINDOWS)
