"""Does a graph with receivers at fixed orders of the light give what the shader gives?"""

import functools

import pytest
import torch
from every_shader import ORDER, every_transfer

from torchprt.errors import InputError
from torchprt.onnx import describe, export
from torchprt.shade import shader

pytestmark = pytest.mark.usefixtures("untyped")
made = functools.cache(every_transfer)
NAMES = ("exit dense 3", "visibility dense 1", "factored zonal 1")


def mixed(module):
    """Orders 2, 3 and 4 by turns for the last layer."""
    name, layer = list(module.layers.items())[-1]
    return {name: 2 + torch.arange(layer.signal.shape[0]) % 3}


def test_a_graph_refuses_orders_that_do_not_fit(make_transfer, tmp_path):
    with pytest.raises(InputError, match="orders name a layer 'gloss'"):
        export(make_transfer(), tmp_path / "a.onnx", orders={"gloss": torch.ones(25, dtype=torch.int64)})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["diffuse", *NAMES])
def test_a_graph_gives_the_same(name, make_transfer, tmp_path):
    transfer = make_transfer(order=ORDER) if name == "diffuse" else made()[name]
    exponent = 10.0 if "reflectance" in transfer.needs else None
    module = shader(transfer, exponent=exponent)
    path = tmp_path / "fixed.onnx"
    pose = "frames" if "pose" in transfer.needs else None
    eye = "direction" if "eye" in transfer.needs else "point"
    report = export(transfer, path, orders=mixed(module), eye=eye, pose=pose, exponent=exponent)
    assert report.parity.passed
    (counts,) = describe(path)["orders"].values()
    assert set(counts) == {"2", "3", "4"}


def test_a_graph_under_a_fixed_light_gives_the_same(tmp_path):
    transfer = made()["exit dense 1"]
    orders = mixed(shader(transfer))
    light = torch.randn(ORDER**2, 3, generator=torch.Generator().manual_seed(1))
    assert export(transfer, tmp_path / "a.onnx", orders=orders, fix_light=light).parity.passed
    assert export(transfer, tmp_path / "b.onnx", orders=orders, fix_eye=[1.0, 2.0, 3.0]).parity.passed
