"""Does diffuse transfer refuse what does not fit together, and say it in one sentence?"""

import dataclasses

import pytest
import torch

from torchprt.errors import InputError


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("transfer", torch.zeros(16, 25), r"'transfer' of the transfer has shape \[16, 25\]: it must be \[C, N, V\]"),
        ("transfer", torch.zeros(2, 16, 25), "2 channels: it must have 1 or 3"),
        ("transfer", torch.zeros(1, 15, 25), "15 coefficients a vertex: it must be the square"),
        ("transfer", torch.zeros(1, 0, 25), "0 coefficients a vertex"),
        ("transfer", torch.zeros(1, 16, 25, dtype=torch.int32), "'transfer' of the transfer is int32"),
        ("albedo", torch.zeros(24, 3), r"'albedo' .* must be \[V\|1, 3\|1\] with .*V = 25"),
        ("albedo", torch.zeros(25, 2), r"'albedo' .* shape \[25, 2\]"),
        ("positions", torch.zeros(24, 3), "'positions'"),
        ("positions", torch.zeros(25, 3, dtype=torch.float16), "'positions' of the transfer is float16"),
        ("normals", torch.zeros(25, 2), "'normals'"),
        ("faces", torch.zeros(2, 4, dtype=torch.int64), "'faces'"),
        ("faces", torch.zeros(2, 3), "'faces' of the transfer is float32: it must be int32 or int64"),
    ],
)
def test_refuses_tensors_that_do_not_fit(make_transfer, field, value, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(make_transfer(), **{field: value})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("transfer", torch.full((1, 16, 25), torch.nan), "'transfer' of the transfer holds 400 NaN"),
        ("normals", torch.full((25, 3), torch.inf), "'normals' .* infinite"),
        ("albedo", torch.full((25, 3), 1.5), r"albedo of the transfer is outside \[0, 1\]"),
        ("albedo", torch.full((25, 3), -0.1), "albedo"),
        ("faces", torch.tensor([[0, 1, 25]]), "faces of the transfer name vertices"),
        ("faces", torch.tensor([[0, 1, -1]]), "faces of the transfer name vertices"),
    ],
)
def test_check_names_the_values_at_fault(make_transfer, field, value, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(make_transfer(), **{field: value}).check()


def test_no_vertices_is_a_transfer(make_transfer):
    empty = make_transfer(side=0)
    empty.check()
    assert (empty.vertices, empty.bytes) == (0, 0)


def test_a_lower_order_keeps_the_first_bands(make_transfer):
    transfer = make_transfer(order=5)
    lower = transfer.to_order(3)
    assert lower.order == 3
    assert torch.equal(lower.transfer, transfer.transfer[:, :9])
    assert lower.transfer.is_contiguous()


@pytest.mark.parametrize("order", [0, 5, -1])
def test_refuses_an_order_that_it_does_not_have(make_transfer, order):
    with pytest.raises(InputError, match=f"order {order} is not between 1 and the 4"):
        make_transfer(order=4).to_order(order)


@pytest.mark.parametrize(("dtype", "size"), [(torch.float16, 2), (torch.float32, 4), (torch.float64, 8)])
def test_bytes_count_the_vectors_alone(make_transfer, dtype, size):
    assert make_transfer(channels=3).to(dtype).bytes == 3 * 16 * 25 * size
