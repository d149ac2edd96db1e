"""Does compressed transfer stand for the transfer that it was made of?"""

import dataclasses

import pytest
import torch
from transfers import KINDS, random_glossy

from torchprt.compression import compress, decompress, overdraw, reorder
from torchprt.compression.search import stored_bytes
from torchprt.compression.transfer import receiver_faces
from torchprt.errors import InputError
from torchprt.shade import shader
from torchprt.transfer import ClusteredTransfer, load, save

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


def test_refuses_what_is_compressed_already(diffuse):
    with pytest.raises(InputError, match="clustered"):
        compress(compress(diffuse, clusters=2, components=1))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"error": 0.1, "bytes": 1000}, "both"),
        ({"error": 0.0}, "above 0"),
        ({"error": float("nan")}, "above 0"),
        ({"error": 1e-9, "bits": 8}, "the best is"),
        ({"bytes": 10}, "give [0-9]+ or more"),
        ({"error": 0.1, "clusters": 3}, "clusters"),
        ({"bits": 4}, "bits"),
        ({"coherence": -1.0}, "coherence"),
        ({"shared": 1000, "clusters": 2}, "shared"),
    ],
)
def test_refuses_sizes_that_cannot_be(diffuse, options, said):
    with pytest.raises(InputError, match=said):
        compress(diffuse, **options)


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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stored", [{}, {"bits": 16}, {"bits": 8}, {"shared": 5}], ids=str)
def test_glossy_kinds_come_back_with_all_that_is_beside_them(kind, stored):
    whole = random_glossy(kind, vertices=40, glossy=30)
    packed = compress(whole, clusters=3, components=2, **stored)
    assert packed.kind == f"clustered {kind}".removesuffix(" glossy") + " glossy" * (kind == "glossy")
    assert packed.output_order == whole.output_order if kind != "factored" else True
    back = decompress(packed)
    name = "visibility" if kind == "visibility" else "matrix"
    change = (getattr(back, name) - getattr(whole, name)).double().square()
    squared = change.sum(0) if kind == "visibility" else change.sum((0, 2, 3))
    torch.testing.assert_close(packed.squared_error.double(), squared, rtol=1e-3, atol=1e-6)
    for field in dataclasses.fields(whole):
        if field.name != name:
            value, found = getattr(whole, field.name), getattr(back, field.name)
            assert torch.equal(value, found) if isinstance(value, torch.Tensor) else value == found, field.name


def test_as_many_shared_axes_as_numbers_lose_nothing(glossy):
    numbers = glossy.matrix[:, 0].numel()
    plain = compress(glossy, clusters=3, components=2)
    two_level = compress(glossy, clusters=3, components=2, shared=numbers)
    # Another basis in which clusters are sought, the same distances.
    assert two_level.compression_error == pytest.approx(plain.compression_error, rel=0.05)
    assert compress(glossy, clusters=3, components=2, shared=4).compression_error > plain.compression_error


def test_shared_axes_are_those_of_least_error(glossy):
    packed = compress(glossy, clusters=1, components=4, shared=7)
    signal = glossy.matrix.transpose(0, 1).flatten(1).double()
    axes = packed.shared.flatten(1).double()
    torch.testing.assert_close(axes @ axes.mT, torch.eye(7).double(), atol=1e-5, rtol=0)
    left = float((signal - signal @ axes.mT @ axes).square().sum())
    assert left == pytest.approx(float(torch.linalg.svdvals(signal)[7:].square().sum()), rel=1e-5)


@pytest.mark.parametrize("bits", [32, 8])
def test_an_error_that_is_asked_for_is_met_in_fewer_bytes_than_a_smaller_one(make_transfer, bits):
    whole = make_transfer(side=36, order=4)
    coarse, fine = (compress(whole, error=error, bits=bits) for error in (0.3, 0.15))
    assert coarse.compression_error <= 0.3
    assert fine.compression_error <= 0.15
    assert coarse.bytes < fine.bytes < whole.bytes


@pytest.mark.parametrize("method", ["vq", "pca", "iterative", "adaptive"])
def test_bytes_that_are_asked_for_are_kept_to_and_used(make_transfer, method):
    whole = make_transfer(side=36, order=4)
    few, many = (compress(whole, bytes=size, method=method) for size in (8_000, 30_000))
    assert 4_000 < few.bytes <= 8_000
    assert 12_000 < many.bytes <= 30_000
    assert many.compression_error < few.compression_error


@pytest.mark.parametrize("bits", [32, 16, 8])
@pytest.mark.parametrize("shared", [0, 6])
def test_bytes_are_foretold(make_transfer, bits, shared):
    packed = compress(make_transfer(side=30, order=4), clusters=7, components=3, bits=bits, shared=shared)
    assert packed.bytes == stored_bytes(900, 16, 7, 3, shared, bits)


def test_coherence_lowers_overdraw_for_no_more_error_than_is_allowed(make_transfer):
    whole = make_transfer(side=40, order=3)
    plain, coherent = (compress(whole, clusters=9, components=2, coherence=part) for part in (0, 0.1))
    assert overdraw(whole.faces, coherent.label) < overdraw(whole.faces, plain.label)
    allowed = 1.1 * float(plain.squared_error.double().sum())
    assert float(coherent.squared_error.double().sum()) <= allowed * (1 + 1e-5)


def test_clusters_of_glossy_receivers_are_made_coherent_over_their_own_triangles(make_transfer):
    whole = random_glossy("glossy", vertices=36, glossy=30)
    faces = make_transfer(side=6).faces
    whole = dataclasses.replace(whole, faces=faces)
    among = receiver_faces(whole)
    kept = torch.isin(faces, whole.glossy).all(1)
    assert torch.equal(whole.glossy[among], faces[kept].long())
    assert 0 < len(among) < len(faces)
    compress(whole, clusters=4, components=1, coherence=0.2).check()


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


@pytest.mark.parametrize("kind", ["diffuse", *KINDS])
@pytest.mark.parametrize("stored", [{}, {"bits": 8, "shared": 5}], ids=str)
def test_files_hold_it_whole(kind, diffuse, stored, tmp_path):
    whole = diffuse if kind == "diffuse" else random_glossy(kind, vertices=40)
    packed = compress(whole, clusters=3, components=2, method="adaptive", **stored)
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
    with pytest.raises(InputError, match="weights"):
        dataclasses.replace(packed, weights=packed.weights[1:]).check()
    with pytest.raises(InputError, match="offsets"):
        dataclasses.replace(packed, offsets=packed.offsets[1:])
    with pytest.raises(InputError, match="low and step"):
        dataclasses.replace(packed, low=packed.low.new_zeros(len(packed.basis)))
    with pytest.raises(InputError, match="shared axes"):
        dataclasses.replace(packed, mean=packed.mean[:, 1:], basis=packed.basis[:, 1:])


@pytest.mark.parametrize("kind", ["diffuse", "glossy"])
def test_reordered_transfer_shades_the_same_and_leads_back(make_transfer, kind):
    mesh = make_transfer(side=9, order=4)
    whole = mesh
    if kind == "glossy":
        whole = dataclasses.replace(random_glossy("glossy", vertices=81, glossy=70), faces=mesh.faces)
    packed = compress(whole, clusters=7, components=3, method="adaptive", bits=8)
    moved = reorder(packed, most=2)
    moved.check()
    light = torch.randn(16, 3, generator=torch.Generator().manual_seed(5))
    eye = {} if kind == "diffuse" else {"eye": torch.tensor([0.3, 2.0, 1.0])}
    wanted = shader(packed)(light, **eye)
    torch.testing.assert_close(moved.mesh_order(shader(moved)(light, **eye)), wanted, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(moved.positions, packed.positions[moved.original])
    # The same triangles, with their corners in the same sense.
    one, other = (set(map(tuple, faces.tolist())) for faces in (moved.original[moved.faces.long()], packed.faces))
    assert one == other
    assert bool((moved.label.long().diff() != 0).sum() < 7)
    with pytest.raises(InputError, match="already"):
        reorder(moved)
