"""Does ONNX Runtime compute what torch computes, at every extreme, layer by layer?"""

import numpy as np
import onnxruntime
import pytest
import torch
from numerics.conftest import EACH, together
from numerics.extremes import extremes, plain
from numerics.kernels import CHOICES, TRANSFERS

from torchprt.onnx.parity import tolerance
from torchprt.shade import shader

pytestmark = pytest.mark.usefixtures("untyped")

SIGNALS = ("dense", "clustered", "zonal")
KINDS = {"light": "light", "rotation": "rotation", "view": "view", "frames": "rotation"}


def test_every_layer_with_every_signal_is_in_one_of_the_graphs():
    there = {(name, signal) for signal in SIGNALS for name in together(signal).layers}
    wanted = {(layer, name.split()[1]) for name, transfer in TRANSFERS.items() for layer in transfer.layers}
    # Those two are there in three channels only, and lobes of visibility are refused.
    assert there >= wanted - {("diffuse", "clustered"), ("phase", "clustered")} - {("visibility", "zonal")}


@pytest.mark.parametrize("signal", SIGNALS)
def test_onnx_runtime_gives_what_torch_gives_at_every_extreme(graph, signal):
    transfer, path = graph(signal)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    module = shader(transfer, dtype=torch.float64, **CHOICES["reflectance"])
    taken = [value.name for value in session.get_inputs()]
    usual = {name: plain(KINDS[name], transfer.order, torch.float32) for name in taken}
    wrong = {}
    for name in taken:
        for extreme, value in extremes(KINDS[name], transfer.order, torch.float32).items():
            if extreme == "not quite orthogonal":
                continue
            case = usual | {name: value}
            if "frames" in case:
                case["frames"] = case["frames"].expand(transfer.vertices, 3, 3)
            feed = {key: np.ascontiguousarray(each[None]) for key, each in case.items()}
            if "frames" in feed:
                feed["frames"] = feed["frames"][0] if len(session.get_inputs()[-1].shape) == 3 else feed["frames"]
            found = torch.from_numpy(session.run(None, feed)[0][0]).double()
            wide = {key: each.double() for key, each in case.items()}
            exact = module(wide.pop("light"), wide.pop("rotation"), **wide)
            for place, layer in enumerate(transfer.layers):
                rows = slice(EACH * place, EACH * (place + 1))
                size = max(float(exact[rows].abs().max()), 1e-30)
                off = float((found[rows] - exact[rows]).abs().max()) / size
                # A table of factors changes as functions of as high an order as it has texels.
                if not off <= tolerance(32 if layer == "factored" else transfer.order):
                    wrong[f"{layer}: {name} {extreme}"] = off
    assert not wrong
