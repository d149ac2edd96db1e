"""Are maps of lobes refused when they are wrong, and read as they were written?"""

import dataclasses

import pytest
import torch
from lobe_maps import random_map

from torchprt.errors import InputError
from torchprt.transfer import ZonalMap, ZonalTransfer, load, load_map, save, save_map, zonal_map


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"axis": torch.zeros(3, 3, 6)}, "tensor 'axis' of the transfer has shape"),
        ({"exact": torch.zeros(1, 4, 6, 7)}, "tensor 'exact' of the transfer has shape"),
        ({"exact": torch.zeros(1, 3, 6, 8)}, "must be 0, or 4"),
        ({"albedo": torch.zeros(2, 6, 8)}, "tensor 'albedo' of the transfer has shape"),
        ({"albedo": torch.zeros(3, 6, 2)}, "tensor 'albedo' of the transfer has shape"),
        ({"coefficients": torch.zeros(2, 3, 2, 6, 8), "exact": torch.zeros(2, 4, 6, 8)}, "has 2 channels"),
    ],
)
def test_refuses_tensors_that_make_no_map(change, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(random_map(), **change)


def test_refuses_a_map_without_texels():
    with pytest.raises(InputError, match="0 x 8 texels"):
        random_map(rows=0)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [("axis", 2.0, "unit length"), ("exact", torch.nan, "NaN"), ("albedo", 1.5, r"outside \[0, 1\]")],
)
def test_refuses_to_write_values_that_cannot_be(tmp_path, name, value, message):
    patch = random_map()
    getattr(patch, name)[0, 0, 0] = value
    with pytest.raises(InputError, match=message):
        save_map(patch, tmp_path / "map.safetensors")


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_is_read_as_it_was_written(tmp_path, dtype):
    patch = random_map(dtype=dtype, tiles_v=False, smooth=True, fit_error=0.01, rays=77, version="1")
    save_map(patch, tmp_path / "map.safetensors")
    found = load_map(tmp_path / "map.safetensors")
    for field in dataclasses.fields(ZonalMap):
        one, other = getattr(patch, field.name), getattr(found, field.name)
        assert torch.equal(one, other) if isinstance(one, torch.Tensor) else one == other


def test_a_map_is_not_taken_for_transfer_nor_transfer_for_a_map(tmp_path, make_transfer):
    save_map(random_map(), tmp_path / "map.safetensors")
    with pytest.raises(InputError, match="read it with load_map"):
        load(tmp_path / "map.safetensors")
    save(make_transfer(), tmp_path / "vertices.safetensors")
    with pytest.raises(InputError, match="read it with load"):
        load_map(tmp_path / "vertices.safetensors")


def test_texels_become_a_map_row_after_row():
    patch = random_map(rows=2, columns=3)
    texels = ZonalTransfer(
        axis=patch.axis.flatten(-2),
        coefficients=patch.coefficients.flatten(-2),
        exact=patch.exact.flatten(-2),
        squared_error=patch.squared_error.flatten(),
        albedo=patch.albedo.flatten(1).mT.contiguous(),
        positions=torch.zeros(6, 3),
        normals=torch.zeros(6, 3),
        faces=torch.zeros(0, 3, dtype=torch.int32),
        rays=5,
        fit_error=0.1,
    )
    found = zonal_map(texels, 2, 3)
    for name in ZonalMap.layouts:
        assert torch.equal(getattr(found, name), getattr(patch, name))
    assert (found.rays, found.fit_error, found.tiles_u, found.tiles_v) == (5, 0.1, True, True)
    one = dataclasses.replace(texels, albedo=torch.tensor([[0.2, 0.4, 0.6]]))
    assert zonal_map(one, 2, 3).albedo.flatten().tolist() == pytest.approx([0.2, 0.4, 0.6])
    with pytest.raises(InputError, match="6 receivers"):
        zonal_map(texels, 2, 4)


def test_fewer_bands_are_the_first_ones():
    patch = random_map(order=5)
    lower = patch.to_order(3)
    assert lower.order == 3
    assert torch.equal(lower.coefficients, patch.coefficients[:, :, :1])
    for order in (1, 6):
        with pytest.raises(InputError, match="is not between 2 and the 5"):
            patch.to_order(order)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_halves_the_bytes_and_is_accepted(tmp_path, dtype):
    patch = random_map(dtype=torch.float32)
    half = patch.to(dtype)
    assert half.bytes * 2 == patch.bytes
    save_map(half, tmp_path / "map.safetensors")
    assert load_map(tmp_path / "map.safetensors").axis.dtype == dtype
