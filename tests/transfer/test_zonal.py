"""Does zonal transfer come back from its file as it went, and refuse what does not fit together?"""

import dataclasses
import math

import pytest
import torch
from zonal_transfers import random_zonal, random_zonal_factored

from torchprt.errors import InputError
from torchprt.transfer import ZonalFactoredTransfer, load, save
from torchprt.transfer.kinds import DIFFUSE
from torchprt.transfer.layout import tensors


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("axis", torch.zeros(4, 9), r"'axis' of the transfer has shape \[4, 9\]: it must be \[L, 3, V\]"),
        ("axis", torch.zeros(4, 3, 8), "'axis'"),
        ("coefficients", torch.zeros(1, 3, 2, 9), r"'coefficients' .* with .*L = 4"),
        ("coefficients", torch.zeros(2, 4, 2, 9), "2 channels: it must have 1 or 3|'exact'"),
        ("exact", torch.zeros(1, 3, 9), "exact of the transfer holds 3 coefficients: it must be 0, or 4"),
        ("exact", torch.zeros(3, 4, 9), "'exact'"),
        ("squared_error", torch.zeros(8), "'squared_error'"),
        ("faces", torch.zeros(2, 4, dtype=torch.int64), "'faces'"),
    ],
)
def test_refuses_tensors_that_do_not_fit(field, value, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(random_zonal(), **{field: value})


def test_refuses_a_transfer_without_a_band():
    with pytest.raises(InputError, match="have no band"):
        dataclasses.replace(random_zonal(exact=False), coefficients=torch.zeros(1, 4, 0, 9))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("axis", torch.full((4, 3, 9), 0.5), "axis of the transfer holds 36 vectors that are not of unit length"),
        ("axis", torch.zeros(4, 3, 9), "36 vectors that are not of unit length"),
        ("coefficients", torch.full((1, 4, 2, 9), math.nan), "'coefficients' of the transfer holds 72 NaN"),
        ("albedo", torch.full((9, 3), 1.5), r"albedo of the transfer is outside \[0, 1\]"),
        ("faces", torch.tensor([[0, 1, 9]]), "faces of the transfer name vertices"),
    ],
)
def test_the_check_refuses_values_that_mean_nothing(tmp_path, field, value, message):
    transfer = dataclasses.replace(random_zonal(), **{field: value})
    with pytest.raises(InputError, match=message):
        transfer.check()
    with pytest.raises(InputError, match=message):
        save(transfer, tmp_path / "a.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("side", [0, 1, 3])
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_a_file_gives_back_what_was_saved(tmp_path, side, exact, channels, dtype):
    transfer = random_zonal(side, exact=exact, channels=channels, dtype=dtype, smooth=True, fit_error=0.01, rays=64)
    save(transfer, tmp_path / "a.safetensors")
    back = load(tmp_path / "a.safetensors")
    assert type(back) is type(transfer)
    for field in dataclasses.fields(transfer):
        if field.name not in transfer.layouts:
            assert getattr(back, field.name) == getattr(transfer, field.name)
    for name, value in tensors(transfer).items():
        assert getattr(back, name).dtype == value.dtype
        assert torch.equal(getattr(back, name), value)


@pytest.mark.parametrize(("exact", "bands"), [(False, 4), (True, 2)])
def test_the_order_counts_the_bands_that_are_stored_apart(exact, bands):
    transfer = random_zonal(exact=exact, order=4)
    assert transfer.coefficients.shape[2] == bands
    assert (transfer.order, transfer.lobes, transfer.channels, transfer.vertices) == (4, 4, 1, 9)
    assert transfer.bytes == 4 * 9 * (4 * 3 + 4 * bands + (4 if exact else 0))


@pytest.mark.parametrize("exact", [False, True])
def test_fewer_bands_are_the_first_ones(exact):
    transfer = random_zonal(exact=exact, order=5)
    fewer = transfer.to_order(3)
    assert fewer.order == 3
    assert torch.equal(fewer.coefficients, transfer.coefficients[:, :, : 1 if exact else 3])
    assert torch.equal(fewer.exact, transfer.exact)


@pytest.mark.parametrize(("exact", "order"), [(False, 0), (False, 6), (True, 1), (True, 6)])
def test_refuses_an_order_that_it_does_not_have(exact, order):
    with pytest.raises(InputError, match=f"order {order} is not between {2 if exact else 1} and the 5"):
        random_zonal(exact=exact, order=5).to_order(order)


def test_half_precision_halves_the_bytes_and_keeps_axes_that_pass():
    transfer = random_zonal()
    for dtype in (torch.float16, torch.bfloat16):
        half = transfer.to(dtype)
        half.check()
        assert half.bytes == transfer.bytes // 2


def test_looks_the_same_from_everywhere():
    assert isinstance(random_zonal(), DIFFUSE)


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("diffuse", [False, True])
def test_glossy_lobes_come_back_from_their_file(tmp_path, exact, channels, diffuse):
    transfer = random_zonal_factored(exact=exact, channels=channels, diffuse=diffuse)
    save(transfer, tmp_path / "a.safetensors")
    back = load(tmp_path / "a.safetensors")
    assert type(back) is ZonalFactoredTransfer
    assert all(torch.equal(getattr(back, name), value) for name, value in tensors(transfer).items())
    assert (back.order, back.lobes, back.channels, back.vertices) == (4, 3, channels, 9)
    assert back.to_order(3).order == 3
    assert back.to(torch.float16).bytes < back.bytes


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("coefficients", torch.zeros(1, 2, 3, 3, 4), r"orders 5 \(glossy\) and 4 \(diffuse\): .* order 4 of the light"),
        ("diffuse_exact", torch.zeros(1, 0, 9), r"orders 4 \(glossy\) and 2 \(diffuse\)"),
        ("diffuse", torch.zeros(1, 16, 9), "'diffuse'"),
        ("factors", torch.zeros(3, 32, 32), "'factors'"),
        ("diffuse_axis", torch.zeros(2, 3, 0), "diffuse layer are for"),
    ],
)
def test_refuses_glossy_lobes_that_do_not_fit(field, value, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(random_zonal_factored(), **{field: value})


def test_the_check_looks_at_all_axes():
    for name in ("axis", "diffuse_axis"):
        transfer = random_zonal_factored()
        getattr(transfer, name).mul_(1.01)
        with pytest.raises(InputError, match=f"{name} of the transfer holds"):
            transfer.check()
