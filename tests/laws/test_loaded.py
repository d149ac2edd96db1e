"""Do commands load what they need and no more? What a start takes is what is loaded: scripts/benchmarks/start.py.

All commands run in one process, those that need least first, so that none before loads what another must not.
"""

import json
import subprocess
import sys

import numpy as np
import pytest

import torchprt as prt
from torchprt.scene import make_mesh

NOTHING = ("torch", "numpy")
# Some of these are no more than a decorator or a conversion of colours away.
SLOW = (
    *("torch._dynamo", "torch._inductor", "torch.onnx", "sympy", "mpmath"),
    *("numba", "kornia", "onnx", "onnxruntime", "open3d", "matplotlib", "rich", "dask", "mitsuba"),
    *("torchprt.transport", "torchprt.measure", "torchprt.web", "torchprt.onnx"),
)
# Reading .ply brings them, by way of trimesh.
MESHES = ("scipy", "networkx", "trimesh", "embreex", "PIL")
ROOMS = ("torchprt.scene.reading", "torchprt.compression")

RUNS = {
    "info none.ply": NOTHING,
    "bake none.ply -o b.safetensors": NOTHING,
    "bake mesh.ply -o b.foreign": NOTHING,
    "light none.png -o b.foreign": NOTHING,
    "shade none.safetensors -o b.foreign": NOTHING,
    "info foreign.safetensors": (*SLOW, *MESHES, *ROOMS, "torchprt.shade", "torchprt.preview"),
    "info a.safetensors": (*SLOW, *MESHES, *ROOMS, "torchprt.shade", "torchprt.preview"),
    "light studio --order 3 -o b.npy": (*SLOW, *MESHES, *ROOMS),
    "shade a.safetensors -o c.npy": (*SLOW, *MESHES, *ROOMS),
    "shade a.safetensors --light b.npy -o d.npy": (*SLOW, *MESHES, *ROOMS),
    "info broken.glb": (*SLOW, *MESHES, "torchprt.compression"),
    "shade a.safetensors -o d.ply": (*SLOW, "trimesh", "networkx", "torchprt.compression"),
    "shade a.safetensors -o e.png --size 32x32": (*SLOW[:-4], "torchprt.compression"),
    "info d.ply": (*SLOW, "torchprt.compression"),
}
REFUSED = [each for each in RUNS if "none" in each or "foreign" in each or "broken" in each]

PROGRAM = """
import json, sys
from torchprt.cli import main
told = {}
for command, unwanted in json.loads(sys.argv[1]).items():
    sys.argv = ["torchprt", "-q", *command.split()]
    try:
        main()
        code = 0
    except SystemExit as ended:
        code = ended.code or 0
    told[command] = [code, [name for name in unwanted if name in sys.modules]]
print("\\n" + json.dumps(told))
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """The exit code of each command, and what was loaded when it ended."""
    folder = tmp_path_factory.mktemp("loaded")
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    scene = prt.Scene([prt.Object(make_mesh(corners, faces))])
    prt.save_transfer(prt.bake(scene, order=3, rays=16, progress=False), folder / "a.safetensors")
    (folder / "broken.glb").write_bytes(b"glTF\2\0\0\0" + bytes(100))
    (folder / "foreign.safetensors").write_bytes(bytes(range(200)))
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps(RUNS)],
        cwd=folder, capture_output=True, text=True, check=True, timeout=240,
    )  # fmt: skip
    return json.loads(ended.stdout.splitlines()[-1])


@pytest.mark.parametrize("command", RUNS)
def test_a_command_loads_no_more_than_it_needs(told, command):
    code, unwanted = told[command]
    assert code == (2 if command in REFUSED else 0)
    assert unwanted == []
