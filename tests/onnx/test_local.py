"""Does a graph blend the lights of sample points as the shader does, for every layer and signal?"""

import onnxruntime
import pytest
import torch
from transfers import KINDS, random_glossy, replaced
from zonal_transfers import bumpy, random_zonal_factored

from torchprt.compression import compress
from torchprt.errors import InputError
from torchprt.light import with_sample_points
from torchprt.onnx import compare, describe, export
from torchprt.shade import EnvironmentShader, LocalLightShader, local_light_shader, shader
from torchprt.transfer import Exit, Incident

pytestmark = pytest.mark.usefixtures("untyped")

SIDE, GLOSSY, ORDER = 3, 5, 2


def every_layer(signal, channels):
    """Transfer with a layer of every kind, about some of the receivers each, over a diffuse one."""
    if signal == "lobes":
        made = random_zonal_factored(SIDE**2, GLOSSY, rows=4, lobes=1, order=ORDER, channels=channels, exact=False)
        factored = made.layers["factored"]
        common = {name: getattr(factored, name) for name in ("signal", "receivers", "tangents", "specular")}
        return made.with_layers(exit=Exit(**common, output_order=2), incident=Incident(**common))
    layers = {}
    for kind in KINDS:
        one = random_glossy(kind, SIDE**2, GLOSSY, ORDER, 2, channels)
        layers |= (one if signal == "dense" else compress(one, clusters=2, components=1)).layers
    positions, faces = bumpy(SIDE)
    return replaced(one.with_layers(**layers), positions=positions.float(), faces=faces)


def test_refuses_transfer_without_a_blend(make_transfer, tmp_path):
    with pytest.raises(InputError, match="has no sample points"):
        export(make_transfer(), tmp_path / "a.onnx", local=True)


def test_refuses_a_light_that_is_inside(tmp_path):
    transfer = with_sample_points(random_glossy("exit", vertices=9, glossy=5, order=2), 2)
    with pytest.raises(InputError, match="fix_light is given, so the graph takes no light: leave local out"):
        export(transfer, tmp_path / "a.onnx", local=True, fix_light=torch.zeros(4, 3))


@pytest.mark.parametrize(("signal", "channels"), [("dense", 1), ("clustered", 3), ("lobes", 1)])
def test_every_layer_and_signal_is_lit_locally(signal, channels, tmp_path):
    transfer = with_sample_points(every_layer(signal, channels), 3)
    choices = {"exponent": 5.0} if "reflectance" in transfer.needs else {}
    report = export(transfer, tmp_path / "a.onnx", local=True, eye="direction", check=False, **choices)
    assert report.inputs["light"] == ("B", 3, ORDER**2, 3)
    module = local_light_shader(shader(transfer, dtype=torch.float64, **choices), transfer)
    assert compare(tmp_path / "a.onnx", module, batches=(3,)).passed


def test_one_light_a_file_as_before_unless_it_is_asked_for(make_transfer, tmp_path):
    transfer = with_sample_points(make_transfer(), 4)
    report = export(transfer, tmp_path / "a.onnx", check=False)
    assert report.inputs["light"] == ("B", 16, 3)
    assert "sample_points" not in describe(tmp_path / "a.onnx")


@pytest.mark.parametrize(
    ("count", "gradients", "arguments"),
    [(2, True, {"fix_eye": [1.0, 2.0, 3.0]}), (1, False, {"source": "environment", "size": 3})],
)
def test_points_and_gradients_are_told(count, gradients, arguments, tmp_path):
    made = random_glossy("exit", vertices=9, glossy=5, order=2)
    transfer = with_sample_points(made, count, gradients=gradients)
    path = tmp_path / "a.onnx"
    report = export(transfer, path, local=True, **arguments)
    assert report.parity.passed
    about = describe(path)
    torch.testing.assert_close(torch.tensor(about["sample_points"]), transfer.receivers.sample_points.float())
    assert about["gradients"] == gradients
    assert about["inputs"][next(iter(about["inputs"]))][:2] == ("B", (4 if gradients else 1) * count)


def test_a_batch_of_none_and_one_that_was_not_traced(make_transfer, tmp_path):
    transfer = with_sample_points(make_transfer(), 3)
    export(transfer, tmp_path / "a.onnx", local=True, check=False)
    session = onnxruntime.InferenceSession(tmp_path / "a.onnx", providers=["CPUExecutionProvider"])
    local = local_light_shader(shader(transfer), transfer)
    for batch in (0, 1, 5):
        light = torch.randn(batch, 3, 16, 3, generator=torch.Generator().manual_seed(0))
        feed = {"light": light.numpy(), "rotation": torch.eye(3).expand(batch, 3, 3).numpy()}
        torch.testing.assert_close(torch.from_numpy(session.run(None, feed)[0]), local(light), rtol=1e-5, atol=1e-5)


def test_a_shader_of_another_blend_is_not_the_same(make_transfer, tmp_path):
    transfer = with_sample_points(make_transfer(), 3)
    export(transfer, tmp_path / "a.onnx", local=True, check=False)
    other = LocalLightShader(shader(transfer), transfer.receivers.blend.flip(1))
    assert not compare(tmp_path / "a.onnx", other, batches=(3,)).passed
    with pytest.raises(InputError, match="takes light, rotation but the module takes environment"):
        compare(tmp_path / "a.onnx", EnvironmentShader(other, 4))
