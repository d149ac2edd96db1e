"""Does a packed graph compute what the graph computed, at the bytes that were promised?"""

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from torchprt.onnx.operators import check_operators
from torchprt.web.packing import COLOUR_LOSS, LEAST, pack


@pytest.fixture
def packed(tmp_path):
    """`packed(values)`: what a graph that gives its one weight gives after packing, and the bytes of its file."""

    def packed(values):
        path = tmp_path / "model.onnx"
        shape = helper.make_tensor_value_info("y", TensorProto.FLOAT, values.shape)
        zero = helper.make_tensor_value_info("x", TensorProto.FLOAT, [])
        graph = helper.make_graph(
            [helper.make_node("Add", ["weights", "x"], ["y"])],
            "graph",
            [zero],
            [shape],
            [numpy_helper.from_array(values, "weights")],
        )
        onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), path)
        pack(path)
        onnx.checker.check_model(path, full_check=True)
        check_operators(onnx.load(path))
        (found,) = onnxruntime.InferenceSession(path).run(None, {"x": np.zeros((), np.float32)})
        return found, path.stat().st_size

    return packed


def rng():
    return np.random.default_rng(3)


def test_small_weights_and_rows_of_one_value_come_back_to_the_bit(packed):
    small = rng().normal(size=(3, LEAST // 3 - 1)).astype(np.float32)
    np.testing.assert_array_equal(packed(small)[0], small)
    flat = np.repeat(np.float32([[0.1], [-3], [0], [1e-30]]), LEAST, 1)
    np.testing.assert_array_equal(packed(flat)[0], flat)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_a_row_is_off_by_half_a_step_of_16_bits(packed, scale):
    values = (rng().normal(size=(25, 1000)) * scale * 10.0 ** -np.arange(25)[:, None]).astype(np.float32)
    found, size = packed(values)
    # And the rounding of three operations of float32.
    allowed = np.ptp(values, axis=1, keepdims=True) * (0.5 / 65535 + 3 * np.finfo(np.float32).eps)
    assert (np.abs(found - values) <= allowed).all()
    assert size < 2 * values.size + 2000


def test_rows_too_short_for_a_step_of_their_own_share_one(packed):
    values = rng().uniform(-1, 1, (5000, 3)).astype(np.float32)
    found, size = packed(values)
    assert np.abs(found - values).max() <= 1.1 / 65535
    assert size < 2 * values.size + 2000


def test_three_channels_that_are_nearly_one_take_4_bytes_a_coefficient(packed):
    generator = rng()
    colour = generator.uniform(0.1, 0.9, (3, 1, 4000))
    grey = generator.normal(size=(1, 25, 4000))
    values = (colour * grey + 0.02 * generator.uniform(-1, 1, (3, 25, 4000))).astype(np.float32)
    values[:, :, 7] = 0
    found, size = packed(values)
    # A ratio for each column and channel is beside them.
    assert size < (4 * 25 + 3) * 4000 + 4000
    assert np.sqrt(np.square(found - values).mean() / np.square(values).mean()) < COLOUR_LOSS


def test_three_channels_that_have_nothing_in_common_keep_16_bits_each(packed):
    values = rng().normal(size=(3, 25, 1000)).astype(np.float32)
    found, size = packed(values)
    assert np.abs(found - values).max() < np.ptp(values) / 65535
    assert size > 2 * values.size
