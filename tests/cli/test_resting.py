"""Does the garbage collector rest while torch is loaded, and no longer, and does nothing else notice?"""

import subprocess
import sys

import pytest

from torchprt.cli.resting import resting


def process(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120).stdout


def test_it_rests_while_large_packages_are_loaded_and_not_before_and_after():
    told = process(
        "import gc, inspect, sys\n"
        "from torchprt.cli.resting import resting\n"
        "before = list(sys.meta_path)\n"
        "began = []\n"
        "with resting():\n"
        "    assert gc.isenabled() and 'torch' not in sys.modules\n"
        "    gc.collect()\n"
        "    gc.callbacks.append(lambda phase, about: began.append(phase))\n"
        "    import torch\n"
        "    import trimesh\n"
        "    gc.callbacks.clear()\n"
        "    import torch, trimesh.exchange.ply\n"
        "    assert gc.isenabled() and gc.get_freeze_count() > 100_000\n"
        "assert sys.meta_path == before\n"
        "assert type(torch.__loader__) is type(torch.__spec__.loader) is type(inspect.__loader__)\n"
        "assert 'def compile' in inspect.getsource(torch)\n"
        "print(len(began))\n"
    )
    assert told == "0\n"


def test_a_collector_that_was_off_stays_off():
    told = process(
        "import gc\n"
        "from torchprt.cli.resting import resting\n"
        "gc.disable()\n"
        "with resting():\n    import torch\n"
        "print(gc.isenabled())\n"
    )
    assert told == "False\n"


def test_without_torch_nothing_is_changed():
    told = process(
        "import gc, sys\n"
        "from torchprt.cli.resting import resting\n"
        "before = list(sys.meta_path)\n"
        "with resting():\n    import json\n"
        "print(sys.meta_path == before, gc.get_freeze_count())\n"
    )
    assert told == "True 0\n"


def test_torch_that_is_loaded_already_is_left_alone():
    import torch

    before = list(sys.meta_path)
    with resting():
        import torch as again
    assert sys.meta_path == before
    assert again is torch


def test_a_torch_that_cannot_be_loaded_says_so_itself(tmp_path):
    (tmp_path / "torch.py").write_text("raise ImportError('no such library')\n")
    told = process(
        "import gc, sys\n"
        f"sys.path.insert(0, {str(tmp_path)!r})\n"
        "from torchprt.cli.resting import resting\n"
        "try:\n"
        "    with resting():\n        import torch\n"
        "except ImportError as fault:\n    print(fault, gc.isenabled(), 'torch' in sys.modules)\n"
    )
    assert told == "no such library True False\n"


@pytest.mark.parametrize("arguments", [["--help"], ["bake"]])
def test_help_and_usage_leave_no_finder_behind(arguments):
    told = process(
        "import sys\n"
        f"sys.argv = ['torchprt', *{arguments!r}]\n"
        "from torchprt.cli import main\n"
        "before = list(sys.meta_path)\n"
        "try:\n    main()\n"
        "except SystemExit:\n    print('SAME', sys.meta_path == before)\n"
    )
    assert told.splitlines()[-1] == "SAME True"
