"""Does an exported file stand alone, say what it is, and compute what the shader computes?"""

import sys
import warnings

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from transfers import replaced, stored

from torchprt.errors import InputError
from torchprt.onnx import ParityError, compare, describe, export
from torchprt.onnx.operators import ALLOWED, check_operators
from torchprt.onnx.parity import ParityReport, tolerance
from torchprt.sh import project_cube, yaw_pitch_roll
from torchprt.shade import EnvironmentShader, Shader, shader

# `torchprt.onnx.export` names the function.
EXPORT = sys.modules["torchprt.onnx.export"]

pytestmark = pytest.mark.usefixtures("untyped")


@pytest.fixture(scope="module")
def written(make_transfer, tmp_path_factory):
    """One file for the tests that only read it, with its transfer and report."""
    from jaxtyping import config

    config.update("jaxtyping_disable", True)
    transfer = make_transfer(order=3, transport="interreflected", bounces=2, rays=64, seed=5, error=0.01, signal=0.5)
    path = tmp_path_factory.mktemp("onnx") / "scene.onnx"
    report = export(transfer, path)
    config.update("jaxtyping_disable", False)
    return path, transfer, report


# Misuse


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"source": "sun"}, "source 'sun' is unknown: use 'light' or 'environment'"),
        ({"source": "environment", "size": 1}, "size 1 of the cube map is too small"),
    ],
)
def test_refuses_arguments_it_cannot_use(make_transfer, tmp_path, arguments, message):
    with pytest.raises(InputError, match=message):
        export(make_transfer(), tmp_path / "a.onnx", **arguments)
    assert list(tmp_path.iterdir()) == []


def test_refuses_another_suffix(make_transfer, tmp_path):
    with pytest.raises(InputError, match=r"a\.pt must end in \.onnx"):
        export(make_transfer(), tmp_path / "a.pt")


def test_refuses_a_folder_that_does_not_exist(make_transfer, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        export(make_transfer(), tmp_path / "none" / "a.onnx")


def test_refuses_a_transfer_without_vertices(make_transfer, tmp_path):
    with pytest.raises(InputError, match="no vertices"):
        export(make_transfer(side=0), tmp_path / "a.onnx")


def test_refuses_values_that_are_not_finite_and_leaves_no_file(make_transfer, tmp_path):
    transfer = make_transfer()
    stored(transfer)[0, 3, 4] = torch.nan
    with pytest.raises(InputError, match=r"'diffuse\.signal\.values' of the transfer holds 1 NaN"):
        export(transfer, tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []


def test_refuses_more_than_two_gigabytes_before_it_writes(make_transfer, tmp_path):
    transfer = make_transfer(side=1, order=5)
    count = 25_000_000
    # 2.5 GB of weights that take no memory here.
    large = replaced(
        transfer,
        values=stored(transfer).expand(1, 25, count),
        albedo=torch.ones(1, 1),
        positions=transfer.positions.expand(count, 3),
        normals=transfer.normals.expand(count, 3),
    )
    with pytest.raises(InputError, match=r"weights are 2\.3 GB, more than the 2 GB"):
        export(large, tmp_path / "a.onnx")
    assert list(tmp_path.iterdir()) == []


# What is in the file


def test_is_one_file_with_the_weights_inside(written):
    path, transfer, report = written
    assert [each.name for each in path.parent.iterdir()] == [path.name]
    assert report.bytes == path.stat().st_size > transfer.bytes
    assert all(not tensor.external_data for tensor in onnx.load(path, load_external_data=False).graph.initializer)


def test_shapes_are_read_back_with_a_dynamic_batch(written):
    _, _, report = written
    assert report.inputs == {"light": ("B", 9, 3), "rotation": ("B", 3, 3)}
    assert report.outputs == {"radiance": ("B", 25, 3)}
    assert report.opset == 18


def test_uses_plain_operators_alone(written):
    path, _, report = written
    assert set(report.operators) <= ALLOWED
    check_operators(onnx.load(path))
    assert report.operators["MatMul"] == 4


@pytest.mark.parametrize("name", ["Einsum", "Loop", "If", "ScatterElements", "ScatterND", "GridSample", "IsNaN"])
def test_an_operator_that_web_runtimes_lack_is_found(written, name):
    model = onnx.load(written[0])
    assert name not in ALLOWED
    model.graph.node[0].op_type = name
    with pytest.raises(RuntimeError, match=f"operators that web runtimes lack: {name}"):
        check_operators(model)


def test_another_opset_is_found(written):
    model = onnx.load(written[0])
    model.opset_import[0].version = 20
    with pytest.raises(RuntimeError, match="operator sets"):
        check_operators(model)


def test_holds_nothing_of_the_machine_that_wrote_it(written):
    assert b".py" not in written[0].read_bytes()


def test_inputs_are_explained_in_the_file(written):
    graph = onnx.load(written[0]).graph
    assert all(value.doc_string for value in (*graph.input, *graph.output))
    assert "Condon-Shortley" in graph.input[0].doc_string


def test_export_is_silent(make_transfer, tmp_path, capfd):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        export(make_transfer(order=2), tmp_path / "a.onnx")
    assert capfd.readouterr() == ("", "")


# What it computes


@pytest.mark.parametrize(
    ("channels", "albedo"), [(1, ("V", 3)), (1, ("V", 1)), (1, (1, 3)), (3, ("V", 3)), (3, (1, 1))]
)
def test_every_layout_of_the_albedo_passes_parity(make_transfer, tmp_path, channels, albedo):
    report = export(make_transfer(order=2, channels=channels, albedo=albedo), tmp_path / "a.onnx")
    assert report.parity.passed
    assert report.parity.batches == (1, 3, 7, 16)


@pytest.mark.parametrize(("order", "side"), [(1, 1), (6, 5)])
def test_orders_and_a_single_vertex_pass_parity(make_transfer, tmp_path, order, side):
    assert export(make_transfer(side=side, order=order), tmp_path / "a.onnx").parity.passed


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_every_storage_dtype_becomes_float32(make_transfer, tmp_path, dtype):
    assert export(make_transfer(order=2, dtype=dtype), tmp_path / "a.onnx").parity.passed
    sizes = {tensor.data_type for tensor in onnx.load(tmp_path / "a.onnx").graph.initializer if len(tensor.dims) > 1}
    assert sizes == {onnx.TensorProto.FLOAT}


def test_shades_straight_from_cube_maps(make_transfer, tmp_path):
    size, transfer = 8, make_transfer(order=3)
    report = export(transfer, tmp_path / "a.onnx", source="environment", size=size)
    assert report.inputs == {"environment": ("B", 6, size, size, 3), "rotation": ("B", 3, 3)}
    assert report.parity.passed
    # And not only against our own module: projection, then shading, by separate functions.
    environment = torch.rand(5, 6, size, size, 3, generator=torch.Generator().manual_seed(0))
    rotation = yaw_pitch_roll(torch.tensor([25.0, 60.0, -130.0])).expand(5, 3, 3)
    session = onnxruntime.InferenceSession(tmp_path / "a.onnx", providers=["CPUExecutionProvider"])
    found = session.run(None, {"environment": environment.numpy(), "rotation": rotation.numpy()})[0]
    wanted = shader(transfer)(project_cube(environment, 3), rotation).numpy()
    assert np.abs(found - wanted).max() <= tolerance(3) * np.abs(wanted).max()


def test_the_file_is_the_sum_of_equation_8(written):
    path, transfer, _ = written
    light = np.random.default_rng(0).standard_normal((5, 9, 3)).astype("f4")
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    found = session.run(None, {"light": light, "rotation": np.broadcast_to(np.eye(3, dtype="f4"), (5, 3, 3))})[0]
    wanted = transfer.albedo.numpy() * np.einsum("nv,bnc->bvc", stored(transfer)[0].numpy(), light)
    assert np.abs(found - wanted).max() <= tolerance(3) * np.abs(wanted).max()


# Parity


def test_parity_sees_one_wrong_coefficient(written):
    path, transfer, _ = written
    vectors = stored(transfer).clone()
    # A hundredth of one coefficient of one vertex of 25.
    vectors[0, 4, 7] += 0.01 * vectors.abs().max()
    report = compare(path, shader(replaced(transfer, values=vectors)))
    assert not report.passed
    assert "NOT the same" in str(report)


class Back(Shader):
    """Turns the light the wrong way round."""

    def forward(self, light, rotation=None, **others):
        return super().forward(light, rotation.mT, **others)


def test_parity_sees_a_rotation_the_wrong_way(written):
    path, transfer, _ = written
    right = shader(transfer)
    wrong = Back(dict(right.layers.items()), right.turn, right.vertices)
    assert compare(path, right).passed
    assert not compare(path, wrong).passed


def test_nan_is_not_parity():
    assert not ParityReport(float("nan"), 0.0, 1e-5, 1, (1,)).passed
    assert not ParityReport(0.0, float("nan"), 1e-5, 1, (1,)).passed
    assert ParityReport(0.0, 0.0, 1e-5, 1, (1,)).passed


def test_a_black_scene_is_the_same(make_transfer, tmp_path):
    transfer = make_transfer(order=2)
    report = export(replaced(transfer, values=stored(transfer) * 0), tmp_path / "a.onnx")
    assert report.parity.max_error == 0


def test_parity_refuses_a_module_with_other_inputs(written):
    path, transfer, _ = written
    with pytest.raises(InputError, match="takes light, rotation but the module takes environment, rotation"):
        compare(path, EnvironmentShader(shader(transfer), 4))


def test_parity_refuses_a_file_that_is_not_onnx(written, tmp_path):
    (tmp_path / "a.onnx").write_bytes(b"ply")
    with pytest.raises(InputError, match=r"a\.onnx cannot be opened by ONNX Runtime"):
        compare(tmp_path / "a.onnx", shader(written[1]))


def test_without_parity_no_file_is_left_and_an_old_one_stays(make_transfer, tmp_path, monkeypatch):
    failed = ParityReport(0.5, 0.5, 1e-5, 1, (1,))
    monkeypatch.setattr(EXPORT, "compare", lambda path, module: failed)
    (tmp_path / "old.onnx").write_bytes(b"old")
    for name in ("new.onnx", "old.onnx"):
        with pytest.raises(ParityError, match=f"{name} was not written"):
            export(make_transfer(order=2), tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["old.onnx"]
    assert (tmp_path / "old.onnx").read_bytes() == b"old"


def test_the_check_can_be_left_out(make_transfer, tmp_path, monkeypatch):
    monkeypatch.setattr(EXPORT, "compare", lambda path, module: pytest.fail("was compared"))
    assert export(make_transfer(order=2), tmp_path / "a.onnx", check=False).parity is None


# What a file says about itself


def test_describe_reads_back_what_was_exported(written):
    path, transfer, report = written
    about = describe(path)
    assert (about["kind"], about["order"], about["vertices"], about["channels"]) == ("diffuse", 3, 25, 1)
    assert (about["source"], about["size"], about["albedo"]) == ("light", None, "applied, one a vertex")
    for name in ("transport", "bounces", "rays", "seed", "error", "signal"):
        assert about[name] == getattr(transfer, name)
    assert (about["inputs"], about["outputs"], about["opset"]) == (report.inputs, report.outputs, 18)
    assert (about["bytes"], about["operators"]) == (report.bytes, report.operators)


def test_describe_refuses_a_missing_file_and_a_folder(tmp_path):
    for path, fault in ((tmp_path / "none.onnx", "does not exist"), (tmp_path, "it is a folder")):
        with pytest.raises(InputError, match=fault):
            describe(path)


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\n", b"\0" * 100, b"\xff" * 100])
def test_describe_refuses_an_empty_or_foreign_file(tmp_path, content):
    path = tmp_path / "foreign.onnx"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"foreign\.onnx"):
        describe(path)


def test_describe_refuses_onnx_of_someone_else(tmp_path):
    node = onnx.helper.make_node("Identity", ["a"], ["b"])
    values = [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1]) for name in "ab"]
    onnx.save(onnx.helper.make_model(onnx.helper.make_graph([node], "g", values[:1], values[1:])), tmp_path / "a.onnx")
    with pytest.raises(InputError, match="is not an ONNX file of torchprt"):
        describe(tmp_path / "a.onnx")


def test_describe_refuses_a_file_cut_short_anywhere(written, tmp_path):
    whole, cut = written[0].read_bytes(), tmp_path / "cut.onnx"
    # The metadata stand at the end: many lengths there, and a spread of lengths before.
    for length in [*range(0, len(whole) - 1500, 997), *range(len(whole) - 1500, len(whole), 7), len(whole) - 1]:
        cut.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"cut\.onnx"):
            describe(cut)


@pytest.mark.parametrize(
    ("key", "text", "message"),
    [("order", None, "lacks the metadata 'order'"), ("order", "{", "damaged metadata"), ("format", "3", "newer")],
)
def test_describe_names_what_is_wrong_with_the_metadata(written, tmp_path, key, text, message):
    model = onnx.load(written[0])
    entries = {entry.key: entry.value for entry in model.metadata_props} | {key: text}
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, {name: value for name, value in entries.items() if value is not None})
    onnx.save(model, tmp_path / "a.onnx")
    with pytest.raises(InputError, match=message):
        describe(tmp_path / "a.onnx")
