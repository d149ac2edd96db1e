"""Graphs of every layer with every signal, each written once."""

import pytest
import torch
from numerics.kernels import CHOICES, TRANSFERS

from torchprt.transfer import Transfer, Vertices

EACH = 4


def together(signal):
    """Every layer with one signal in one transfer, about receivers of its own, so that none hides behind another."""
    layers, normals = {}, []
    for name, transfer in TRANSFERS.items():
        _, stored, channels = name.split()
        for own, layer in transfer.layers.items() if (stored, channels) == (signal, "1") else ():
            if own not in layers:
                receivers = torch.arange(EACH * len(layers), EACH * (len(layers) + 1))
                layers[own] = layer.take(torch.arange(EACH), receivers)
                # Tangents belong to them.
                normals.append(transfer.normals[layer.index(transfer.vertices)[:EACH]])
    count = EACH * len(layers)
    places = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    return Transfer(
        receivers=Vertices(positions=places, normals=torch.cat(normals), faces=torch.zeros(0, 3, dtype=torch.int64)),
        layers=layers,
    )


@pytest.fixture(scope="session")
def graph(tmp_path_factory):
    """A transfer and the file of it, by the name of its signals."""
    from torchprt.onnx import export

    made = {}

    def written(signal):
        if signal not in made:
            transfer = together(signal)
            path = tmp_path_factory.mktemp("extremes") / f"{signal}.onnx"
            more = {"pose": "frames"} if "pose" in transfer.needs else {}
            export(transfer, path, check=False, eye="direction", **more, **CHOICES["reflectance"])
            made[signal] = transfer, path
        return made[signal]

    return written
