"""Is a file refused whose names, dtypes or shapes are not those that docs/onnx.md promises?"""

import sys

import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from transfers import random_glossy

from torchprt.onnx import ParityError, compare, export
from torchprt.shade import shader

EXPORT = sys.modules["torchprt.onnx.export"]

pytestmark = pytest.mark.usefixtures("untyped")


@pytest.fixture(scope="module")
def written(make_transfer, tmp_path_factory):
    from jaxtyping import config

    config.update("jaxtyping_disable", True)
    transfer = make_transfer(side=2, order=2)
    path = tmp_path_factory.mktemp("contract") / "a.onnx"
    export(transfer, path, check=False)
    config.update("jaxtyping_disable", False)
    return path, transfer


def renamed(model):
    for node in model.graph.node:
        node.output[:] = ["colour" if name == "radiance" else name for name in node.output]
    model.graph.output[0].name = "colour"


def in_double(model):
    model.graph.node.append(helper.make_node("Cast", ["radiance"], ["wide"], to=TensorProto.DOUBLE))
    for node in model.graph.node:
        node.output[:] = [{"radiance": "narrow", "wide": "radiance"}.get(name, name) for name in node.output]
        node.input[:] = ["narrow" if name == "radiance" else name for name in node.input]
    model.graph.output[0].type.tensor_type.elem_type = TensorProto.DOUBLE


def sized(which, axis, size):
    def change(model):
        dimension = getattr(model.graph, which)[0].type.tensor_type.shape.dim[axis]
        dimension.Clear()
        setattr(dimension, "dim_param" if isinstance(size, str) else "dim_value", size)

    return change


def wide_weights(model):
    for tensor in model.graph.initializer:
        if len(tensor.dims) > 1:
            tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor).astype("f8"), tensor.name))
            return


def wide_inside(model):
    model.graph.node.append(helper.make_node("Cast", ["light"], ["light_wide"], to=TensorProto.DOUBLE))


SIGNATURES = [
    (renamed, "outputs colour: 'radiance' alone was promised"),
    (in_double, r"'radiance' as tensor\(double\): tensor\(float\) was promised"),
    (sized("output", 0, 2), r"'radiance' of shape \[2, 4, 3\]: \[B, 4, 3\] was promised"),
    (sized("input", 0, "N"), r"'light' of shape \[N, 4, 3\]: \[B, 4, 3\] was promised"),
    (sized("input", 0, 1), r"'light' of shape \[1, 4, 3\]"),
]


@pytest.fixture
def doctored(written, tmp_path):
    def change(how):
        model = onnx.load(written[0])
        how(model)
        onnx.save(model, tmp_path / "doctored.onnx")
        return tmp_path / "doctored.onnx", shader(written[1])

    return change


@pytest.mark.parametrize(("change", "message"), SIGNATURES)
def test_parity_refuses_another_signature(doctored, change, message):
    with pytest.raises(ParityError, match=message):
        compare(*doctored(change))


def test_parity_takes_what_was_not_changed(doctored):
    assert compare(*doctored(lambda model: None), batches=(1,)).passed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *SIGNATURES,
        (sized("output", 1, "V"), r"shape \[B, V, 3\]"),
        (wide_weights, "has DOUBLE in"),
        (wide_inside, "has DOUBLE in 'light_wide'"),
    ],
)
def test_export_refuses_it_and_leaves_no_file(written, tmp_path, monkeypatch, change, message):
    # Only the contract is of interest: a checker of ONNX would refuse some of these as well.
    monkeypatch.setattr(onnx.checker, "check_model", lambda *_, **__: None)

    def traced(planned):
        model = onnx.load(written[0])
        change(model)
        return model

    monkeypatch.setattr(EXPORT, "_trace", traced)
    with pytest.raises(ParityError, match=message):
        export(written[1], tmp_path / "b.onnx", check=False)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["incident", "exit"])
def test_a_fixed_light_is_float32_throughout(kind, tmp_path):
    transfer = random_glossy(kind, order=2, output_order=2)
    lobe = {"exponent": 20.0} if kind == "incident" else {}
    export(transfer, tmp_path / "a.onnx", fix_light=torch.ones(4, 3), check=False, **lobe)
    model = onnx.load(tmp_path / "a.onnx")
    assert model.graph.output[0].type.tensor_type.elem_type == TensorProto.FLOAT
    assert {tensor.data_type for tensor in model.graph.initializer} <= {TensorProto.FLOAT, TensorProto.INT64}
