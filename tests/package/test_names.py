"""Is `import torchprt` light, and does every name of it lead somewhere?"""

import importlib
import subprocess
import sys

import pytest

import torchprt

HEAVY = ("torch", "numpy", "scipy", "trimesh", "embreex", "kornia", "onnx", "onnxruntime", "OpenEXR", "PIL", "rich")


def says(code):
    """What `code` prints in a Python of its own."""
    ended = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.split()


def test_importing_it_loads_nothing_heavy():
    assert says(f"import sys, torchprt; print(*[name for name in {HEAVY!r} if name in sys.modules])") == []


def test_rooms_do_not_load_what_they_may_never_use():
    rooms = "brdf, compression, light, pose, preview, scene, sh, shade, trace, transfer, transport"
    unused = ("torch._dynamo", "kornia", "open3d", "matplotlib", "onnx", "sympy")
    assert says(f"import sys; from torchprt import {rooms}; print(*[n for n in {unused!r} if n in sys.modules])") == []


@pytest.mark.parametrize("name", torchprt.__all__)
def test_every_name_is_there(name):
    assert getattr(torchprt, name) is not None


def test_names_are_those_of_their_rooms():
    from torchprt import compression, scene, shade, transfer, transport

    assert torchprt.load is scene.load
    assert torchprt.Scene is scene.Scene
    assert torchprt.samples is scene.samples
    assert torchprt.shader is shade.shader
    assert torchprt.bake is transport.bake
    assert torchprt.compress is compression.compress
    assert torchprt.load_transfer is transfer.load
    assert torchprt.save_transfer is transfer.save
    assert torchprt.Transfer is transfer.Transfer
    assert torchprt.sh is importlib.import_module("torchprt.sh")


def test_dir_shows_them_all_and_no_name_twice():
    assert dir(torchprt) == sorted(set(torchprt.__all__))
    assert len(torchprt.__all__) == len(set(torchprt.__all__))


@pytest.mark.parametrize("name", ["bakes", "_bake", "DiffuseTransfer", ""])
def test_another_name_is_an_attribute_error(name):
    with pytest.raises(AttributeError, match=f"module 'torchprt' has no attribute '{name}'"):
        getattr(torchprt, name)
    assert not hasattr(torchprt, name)


BAKES = """
import numpy
import torchprt as prt
corners, face = numpy.array([[0.0, 0, 0], [1, 0, 0], [0, 0, -1]]), numpy.array([[0, 1, 2]])
scene = prt.Scene([prt.Object(prt.scene.make_mesh(corners, face))])
options = {"rays": 4, "order": 2, "progress": False}
before = prt.bake(scene, **options).layers["diffuse"].signal.values
import torchprt.transport
after = prt.bake(scene, **options).layers["diffuse"].signal.values
from torchprt.transport import bake
named = bake(scene, **options).layers["diffuse"].signal.values
print(bool((before == after).all()), bool((before == named).all()))
"""


def test_baking_works_before_and_after_its_room_is_imported():
    assert says(BAKES) == ["True", "True"]


def test_its_version_is_that_of_the_distribution():
    from importlib.metadata import PackageNotFoundError, version

    try:
        installed = version("torchprt")
    except PackageNotFoundError:
        pytest.skip("torchprt is not installed")
    assert torchprt.__version__ == installed
