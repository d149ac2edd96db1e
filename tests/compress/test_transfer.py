"""Does compressed transfer stand for the transfer that it was made of?"""

import dataclasses

import pytest
import torch
from transfers import random_glossy

from torchprt.compress import compress, decompress
from torchprt.errors import InputError
from torchprt.transfer import ClusteredGlossyTransfer, ClusteredTransfer, load, save

EPS = torch.finfo(torch.float32).eps


@pytest.fixture
def diffuse(make_transfer):
    return make_transfer(side=20, order=3, channels=3)


@pytest.fixture
def glossy():
    return random_glossy("glossy", vertices=40)


@pytest.mark.parametrize("options", [{"clusters": 0}, {"clusters": 10_000}, {"components": -1}, {"components": 10_000}])
def test_refuses_what_the_signal_cannot_give(diffuse, options):
    with pytest.raises(InputError):
        compress(diffuse, **options)


@pytest.mark.parametrize("kind", ["incident", "visibility", "factored"])
def test_refuses_kinds_without_a_compressed_form(kind):
    with pytest.raises(InputError, match=kind):
        compress(random_glossy(kind), clusters=2, components=1)


def test_refuses_transfer_without_receivers(diffuse):
    empty = dataclasses.replace(
        diffuse,
        transfer=diffuse.transfer[..., :0],
        albedo=diffuse.albedo[:1],
        positions=diffuse.positions[:0],
        normals=diffuse.normals[:0],
        faces=diffuse.faces[:0],
    )
    with pytest.raises(InputError, match="no receivers"):
        compress(empty)


@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
def test_the_stated_errors_are_those_of_what_comes_back(diffuse, method):
    packed = compress(diffuse, clusters=6, components=3, method=method)
    back = decompress(packed)
    squared = (back.transfer - diffuse.transfer).double().square().sum((0, 1))
    # Reconstructed in float32, the stated error from the same numbers in float64.
    torch.testing.assert_close(packed.squared_error.double(), squared, rtol=1e-3, atol=1e-6)
    relative = float(squared.sum().sqrt() / diffuse.transfer.double().norm())
    assert packed.compression_error == pytest.approx(relative, rel=1e-4)
    assert packed.method == method
    assert 0.01 < relative < 1


def test_matrices_come_back_with_all_that_is_beside_them(glossy):
    packed = compress(glossy, clusters=3, components=2)
    assert isinstance(packed, ClusteredGlossyTransfer)
    back = decompress(packed)
    squared = (back.matrix - glossy.matrix).double().square().sum((0, 2, 3))
    torch.testing.assert_close(packed.squared_error.double(), squared, rtol=1e-3, atol=1e-6)
    for field in dataclasses.fields(glossy):
        if field.name != "matrix":
            value, found = getattr(glossy, field.name), getattr(back, field.name)
            assert torch.equal(value, found) if isinstance(value, torch.Tensor) else value == found, field.name


def test_what_is_so_many_subspaces_comes_back_to_rounding(diffuse):
    generator = torch.Generator().manual_seed(3)
    label = torch.arange(400) % 4
    centres = 10 * torch.randn(4, 27, generator=generator)
    axes = torch.randn(4, 2, 27, generator=generator)
    points = centres[label] + (torch.randn(400, 1, 2, generator=generator) @ axes[label])[:, 0]
    exact = dataclasses.replace(diffuse, transfer=points.view(400, 3, 9).permute(1, 2, 0).contiguous())
    packed = compress(exact, clusters=4, components=2)
    # Sums of 27 products of numbers up to 30.
    torch.testing.assert_close(decompress(packed).transfer, exact.transfer, atol=27 * 30 * EPS, rtol=0)
    assert packed.compression_error < 1e-5


def test_importance_changes_what_is_kept_and_the_error_stays_that_of_the_transfer(diffuse):
    importance = torch.cat([torch.full((9,), 100.0), torch.ones(18)])
    plain, weighed = (
        compress(diffuse, clusters=4, components=3),
        compress(diffuse, clusters=4, components=3, importance=importance),
    )

    def first_channel(packed):
        return float((decompress(packed).transfer - diffuse.transfer)[0].norm())

    assert first_channel(weighed) < 0.9 * first_channel(plain)
    squared = (decompress(weighed).transfer - diffuse.transfer).double().square().sum()
    assert float(weighed.squared_error.double().sum()) == pytest.approx(float(squared), rel=1e-3)


def test_bytes_are_those_of_the_stored_tensors_and_fewer(make_transfer):
    whole = make_transfer(side=70, order=5)
    packed = compress(whole, clusters=16, components=4, iterations=1)
    # A label of one byte, four weights; 16 means and 64 vectors of 25; 17 offsets.
    assert packed.bytes == 4900 * (1 + 16) + 80 * 25 * 4 + 17 * 4
    assert packed.bytes < whole.bytes / 4


@pytest.mark.parametrize("kind", ["diffuse", "glossy"])
def test_files_hold_it_whole(kind, diffuse, glossy, tmp_path):
    packed = compress({"diffuse": diffuse, "glossy": glossy}[kind], clusters=3, components=2, method="adaptive")
    save(packed, tmp_path / "a.safetensors")
    again = load(tmp_path / "a.safetensors")
    assert type(again) is type(packed)
    for field in dataclasses.fields(packed):
        value, found = getattr(packed, field.name), getattr(again, field.name)
        assert torch.equal(value, found) if isinstance(value, torch.Tensor) else value == found, field.name


def test_a_label_without_its_cluster_is_named(diffuse):
    packed = compress(diffuse, clusters=3, components=1)
    assert isinstance(packed, ClusteredTransfer)
    with pytest.raises(InputError, match="label"):
        dataclasses.replace(packed, label=packed.label + 1).check()
    with pytest.raises(InputError, match="offsets"):
        dataclasses.replace(packed, offsets=packed.offsets + 1).check()
    with pytest.raises(InputError, match="offsets"):
        dataclasses.replace(packed, offsets=packed.offsets[1:])
