"""Does what torchprt did leave a process that can be forked, and do workers of data loaders shade?

Each runs in a process of its own: what is asked is whether something hangs, and a test that did would take the others
with it.
"""

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import pytest

AFTER_A_BAKE = """
import multiprocessing
import torch
import torchprt as prt
from torchprt.scene.samples import vase

def child(queue):
    some = torch.ones(600, 600)
    queue.put(float((some @ some).exp().log().sum()))

torch.set_num_threads(2)  # On a machine of one core too.
prt.bake(vase(32), order=3, rays=64, progress=False)
assert torch.get_num_threads() == 2
fork = multiprocessing.get_context("fork")
queue = fork.Queue()
process = fork.Process(target=child, args=(queue,), daemon=True)
process.start()
process.join(60)
print("hangs" if process.is_alive() else "ends")
process.kill()
"""

LOADERS = """
import sys
import torch
import torchprt as prt
from torch.utils.data import DataLoader, Dataset
from torchprt.scene.samples import vase

class Relit(Dataset):
    def __init__(self, shader):
        self.shader = shader

    def __len__(self):
        return 4

    def __getitem__(self, index):
        return self.shader(torch.full((64, 9, 3), float(index)))

if __name__ == "__main__":
    torch.set_num_threads(2)
    lights = Relit(prt.shader(prt.bake(vase(16), order=3, rays=64, progress=False)))
    here = torch.stack([lights[index] for index in range(4)])
    for context in sys.argv[1:]:
        loader = DataLoader(lights, batch_size=4, num_workers=2, multiprocessing_context=context, timeout=100)
        (there,) = loader
        torch.testing.assert_close(there, here)
        print(context)
"""


def output(script: str, folder: Path, *words: str) -> list[str]:
    path = folder / "script.py"
    path.write_text(script)
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, path, *words],
        env=environment | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=300,
        check=False,
    )
    assert not done.returncode, done.stderr
    return done.stdout.split()


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system does not fork")
def test_a_process_that_has_baked_can_be_forked(tmp_path):
    # GNU OpenMP waits forever in the child for threads that the parent had.
    assert output(AFTER_A_BAKE, tmp_path) == ["ends"]


def test_workers_of_a_data_loader_shade_what_was_baked_here(tmp_path):
    contexts = multiprocessing.get_all_start_methods()
    assert output(LOADERS, tmp_path, *contexts) == contexts
