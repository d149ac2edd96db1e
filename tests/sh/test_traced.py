"""Every run-time operation is one graph, compiled or exported, and computes what it computes eagerly."""

import numpy as np
import pytest
import torch

from torchprt import sh


def lights(*shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(9))


def turns(count):
    return sh.yaw_pitch_roll(360 * torch.rand(count, 3, generator=torch.Generator().manual_seed(10)))


OPERATIONS = {
    "basis": (lambda d: sh.basis(d, 5), lambda: (sh.fibonacci(20, torch.float32)[0],)),
    "evaluate": (sh.evaluate, lambda: (lights(2, 16, 3), sh.fibonacci(20, torch.float32)[0])),
    "rotate": (sh.rotate, lambda: (lights(2, 16, 3), turns(2))),
    "rotation_matrix": (lambda r: sh.rotation_matrix(r, 4), lambda: (turns(2),)),
    "project_cube": (lambda c: sh.project_cube(c, 4), lambda: (lights(2, 6, 4, 4, 3),)),
    "project_latlong": (lambda i: sh.project_latlong(i, 4), lambda: (lights(2, 4, 8, 3),)),
    "convolve": (lambda l: sh.convolve(l, sh.clamped_cosine(4)), lambda: (lights(2, 16, 3),)),
    "phong": (lambda k: sh.phong(k, 4), lambda: (torch.rand(3),)),
    "zonal": (sh.zonal, lambda: (torch.rand(4), sh.fibonacci(3, torch.float32)[0])),
    "product": (sh.product, lambda: (lights(2, 16, 3), lights(9, 3))),
    "product_matrix": (lambda a: sh.product_matrix(a, 3, 3), lambda: (lights(2, 9),)),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_compiles_into_one_graph(name, untyped):
    operation, arguments = OPERATIONS[name]
    arguments = arguments()
    torch.compiler.reset()
    compiled = torch.compile(operation, fullgraph=True, backend="aot_eager")
    # The same operations, possibly in another order: a few eps of values of order one.
    torch.testing.assert_close(compiled(*arguments), operation(*arguments), atol=1e-5, rtol=0)


def test_eager_results_are_right_after_a_graph_was_traced(untyped):
    torch.compiler.reset()
    directions, _ = sh.fibonacci(6, torch.float32)
    torch.compile(lambda d: sh.basis(d, 9), fullgraph=True, backend="aot_eager")(directions)
    torch.export.export(sh.Rotation(9), (lights(2, 81, 3), turns(2)))
    torch.testing.assert_close(sh.basis(directions, 9).double(), sh.basis(directions.double(), 9), atol=1e-5, rtol=0)


def test_a_rotation_exports_to_plain_onnx_operations(untyped, tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    module, light, rotation = sh.Rotation(6).eval(), lights(2, 36, 3), turns(2)
    batch = torch.export.Dim("batch")
    program = torch.onnx.export(
        module,
        (light, rotation),
        dynamo=True,
        opset_version=18,
        verbose=False,
        input_names=["light", "rotation"],
        dynamic_shapes=({0: batch}, {0: batch}),
    )
    path = tmp_path / "rotation.onnx"
    program.save(path)
    nodes = list(program.model.graph)
    assert not {node.op_type for node in nodes} & {"Einsum", "Loop", "ScatterElements", "ScatterND", "IsNaN", "If"}
    assert len(nodes) <= 130
    session = runtime.InferenceSession(path, providers=["CPUExecutionProvider"])
    for count in (1, 2, 5):
        light, rotation = lights(count, 36, 3), turns(count)
        (ours,) = session.run(None, {"light": light.numpy(), "rotation": rotation.numpy()})
        # 36 products of values of order one in float32.
        np.testing.assert_allclose(ours, sh.rotate(light, rotation).numpy(), atol=36 * 2**-22)


def test_a_constant_is_marked_as_the_compiler_marks_it():
    from torchprt.sh.constant import constant

    def table():
        return 1

    def other():
        return 1

    torch.compiler.assume_constant_result(other)
    assert constant(table) is table
    assert vars(table) == vars(other) != {}
