"""Does the graph of a neighbourhood compute what the shader does, for any object's pose and any receivers?"""

import numpy as np
import onnxruntime
import pytest
import torch
from neighbourhoods import lights, posed, random_neighbourhood, receivers

from torchprt import InputError
from torchprt.compression import compress
from torchprt.onnx import compare_neighbourhood, describe, export_neighbourhood
from torchprt.onnx.operators import ALLOWED
from torchprt.shade import NeighbourhoodShader
from torchprt.transfer import Dense


@pytest.mark.parametrize("wrong", [{"albedo": 1.5}, {"albedo": (0.1, 0.2)}])
def test_refuses_an_albedo_that_is_none(wrong, tmp_path):
    with pytest.raises(InputError, match="from 0 to 1"):
        export_neighbourhood(random_neighbourhood(), tmp_path / "a.onnx", **wrong)
    with pytest.raises(InputError, match=r"must end in \.onnx"):
        export_neighbourhood(random_neighbourhood(), tmp_path / "a.bin")
    assert not list(tmp_path.iterdir())


MADE = {}


@pytest.fixture(params=["dense 3", "clustered 1"])
def made(request, tmp_path_factory, untyped):
    """Each traced once for all tests."""
    if request.param not in MADE:
        MADE[request.param] = exported(request, tmp_path_factory)
    return MADE[request.param]


def exported(request, tmp_path_factory):
    transfer = random_neighbourhood(int(request.param[-1]), shape=(3, 4, 3))
    if "clustered" in request.param:
        transfer = compress(transfer, clusters=3, components=2)
    path = tmp_path_factory.mktemp("graph") / "a.onnx"
    return transfer, path, export_neighbourhood(transfer, path, albedo=(0.5, 0.25, 1.0))


def test_it_is_the_shader_and_says_what_it_takes(made):
    transfer, path, report = made
    assert report.parity.passed
    assert set(report.operators) <= ALLOWED
    assert report.inputs["positions"] == report.inputs["normals"] == ("R", 3)
    assert report.inputs["pose"] == ("B", 4, 4)
    assert report.outputs == {"radiance": ("B", "R", 3)}
    told = describe(path)
    assert told["kind"] == transfer.kind
    assert told["albedo"] == "applied, [0.5, 0.25, 1.0]"
    assert told["inputs"] == report.inputs


def test_any_batch_and_any_receivers_and_none_at_all(made):
    transfer, path, _ = made
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    shade = NeighbourhoodShader(transfer)
    for batch, count in ((0, 3), (1, 1), (2, 17)):
        given = receivers(count)
        pose = torch.stack([posed(at=(0.1 * b, 0.0, 0.2), turn=(30.0 * b, 10.0, 0.0)) for b in range(2)])[:batch]
        turn = posed(turn=(20.0, 40.0, 60.0))[:3, :3].repeat(batch, 1, 1)
        feed = {"light": lights(batch), "rotation": turn, **given, "pose": pose}
        (found,) = session.run(None, {name: value.numpy() for name, value in feed.items()})
        assert found.shape == (batch, count, 3)
        wanted = shade(lights(batch), turn, **given, pose=pose, albedo=torch.tensor([0.5, 0.25, 1.0]))
        np.testing.assert_allclose(found, wanted.numpy(), rtol=0, atol=2e-5)


def test_a_graph_of_another_object_is_not_the_same(made):
    transfer, path, _ = made
    layer = transfer.layers["neighbourhood"]
    values = layer.signal.dense().values
    values[:, 5] += 0.01
    other = transfer.with_layers(neighbourhood=layer.replace(signal=Dense(values=values)))
    assert not compare_neighbourhood(path, other, albedo=(0.5, 0.25, 1.0), batches=(7,)).passed
