"""Does a file compute the pictures of a volume that torch does?"""

import onnxruntime
import pytest
import torch
from volumes import random_volume

from torchprt.compression import compress
from torchprt.errors import InputError
from torchprt.onnx import compare_volume, describe, export, export_volume
from torchprt.shade import VolumeShader

pytestmark = pytest.mark.usefixtures("untyped")


def run(path, **feeds):
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (image,) = session.run(None, {name: value.numpy() for name, value in feeds.items()})
    return torch.from_numpy(image)


def test_refuses_what_is_no_volume_and_sizes_without_pixels(make_transfer, tmp_path):
    with pytest.raises(InputError, match="not recorded in a volume"):
        export_volume(make_transfer(3), tmp_path / "a.onnx")
    with pytest.raises(InputError, match="no pixels"):
        export_volume(random_volume(), tmp_path / "a.onnx", size=(0, 4))
    with pytest.raises(InputError, match=r"end in \.onnx"):
        export_volume(random_volume(), tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_computes_what_the_shader_does_for_any_batch(tmp_path):
    transfer, path = compress(random_volume("phase"), clusters=2, components=3), tmp_path / "cloud.onnx"
    options = {"size": (10, 6), "field": 60.0, "samples": 9}
    report = export_volume(transfer, path, **options)
    assert report.parity.passed
    assert report.parity.relative_rms > 0
    assert report.outputs == {"image": ("B", 6, 10, 4)}
    light, eye = torch.randn(2, 16, 3), torch.tensor([[4.0, 2.0, 1.0], [-1.0, -3.0, 2.0]])
    rotation = torch.eye(3).repeat(2, 1, 1)
    wanted = VolumeShader(transfer, reading="trilinear", **options)(light, eye=eye)
    torch.testing.assert_close(run(path, light=light, rotation=rotation, eye=eye), wanted, rtol=1e-3, atol=1e-4)
    none = run(path, light=light[:0], rotation=rotation[:0], eye=eye[:0])
    assert none.shape == (0, 6, 10, 4)
    told = describe(path)
    assert told["kind"] == "clustered phase"
    assert (told["width"], told["height"], told["field"], told["samples"]) == (10, 6, 60.0, 9)
    assert (len(told["target"]), told["reading"]) == (3, "trilinear")
    # Of another transfer, whose numbers differ a little.
    layer = transfer.layers["phase"]
    assert not compare_volume(
        path, transfer.with_layers(phase=layer.replace(albedo=0.99 * layer.albedo)), **options
    ).passed


@pytest.mark.parametrize("options", [{"eye": "direction"}, {"fix_light": torch.ones(16, 3)}])
def test_the_graph_of_the_cells_is_that_of_any_transfer(options, tmp_path):
    """What the page draws: radiance of every cell."""
    transfer = random_volume("phase")
    report = export(transfer, tmp_path / "cells.onnx", **options)
    assert report.parity.passed
    assert report.outputs == {"radiance": ("B", transfer.vertices, 3)}
