"""Does compressed transfer stand for the transfer that it was made of?"""

import pytest
import torch
from contents import differing
from transfers import KINDS, gloss, random_glossy, replaced, stored

from torchprt.compression import compress, decompress, overdraw, reorder
from torchprt.compression.search import stored_bytes
from torchprt.compression.transfer import faces_between
from torchprt.errors import InputError
from torchprt.shade import shader
from torchprt.transfer import load, save

EPS = torch.finfo(torch.float32).eps


@pytest.fixture
def diffuse(make_transfer):
    return make_transfer(side=20, order=3, channels=3)


@pytest.fixture
def glossy():
    return random_glossy("exit", vertices=40)


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
    empty = replaced(
        diffuse,
        values=stored(diffuse)[..., :0],
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
    squared = (stored(back) - stored(diffuse)).double().square().sum((0, 1))
    # Reconstructed in float32, the stated error from the same numbers in float64.
    signal = gloss(packed).signal
    torch.testing.assert_close(signal.squared_error.double(), squared, rtol=1e-3, atol=1e-6)
    relative = float(squared.sum().sqrt() / stored(diffuse).double().norm())
    assert signal.compression_error == pytest.approx(relative, rel=1e-4)
    assert signal.method == method
    assert 0.01 < relative < 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sizes", [{}, {"bits": 16}, {"bits": 8}, {"shared": 5}], ids=str)
def test_glossy_kinds_come_back_with_all_that_is_beside_them(kind, sizes):
    whole = random_glossy(kind, vertices=40, glossy=30)
    packed = compress(whole, clusters=3, components=2, **sizes)
    assert packed.kind == f"diffuse + clustered {kind}"
    back = decompress(packed)
    change = (stored(back) - stored(whole)).double().square()
    squared = change.sum((0, 1)) if kind == "visibility" else change.sum((0, 2, 3))
    torch.testing.assert_close(gloss(packed).signal.squared_error.double(), squared, rtol=1e-3, atol=1e-6)
    assert differing(back, whole) == {f"{kind}.signal.values"}


def error_of(packed):
    return gloss(packed).signal.compression_error


def test_as_many_shared_axes_as_numbers_lose_nothing(glossy):
    numbers = stored(glossy)[:, 0].numel()
    plain = error_of(compress(glossy, clusters=3, components=2))
    two_level = error_of(compress(glossy, clusters=3, components=2, shared=numbers))
    # Another basis in which clusters are sought, the same distances.
    assert two_level == pytest.approx(plain, rel=0.05)
    assert error_of(compress(glossy, clusters=3, components=2, shared=4)) > plain


def test_shared_axes_are_those_of_least_error(glossy):
    packed = compress(glossy, clusters=1, components=4, shared=7)
    signal = stored(glossy).transpose(0, 1).flatten(1).double()
    axes = gloss(packed).signal.shared.flatten(1).double()
    torch.testing.assert_close(axes @ axes.mT, torch.eye(7).double(), atol=1e-5, rtol=0)
    left = float((signal - signal @ axes.mT @ axes).square().sum())
    assert left == pytest.approx(float(torch.linalg.svdvals(signal)[7:].square().sum()), rel=1e-5)


@pytest.mark.parametrize("bits", [32, 8])
def test_an_error_that_is_asked_for_is_met_in_fewer_bytes_than_a_smaller_one(make_transfer, bits):
    whole = make_transfer(side=36, order=4)
    coarse, fine = (compress(whole, error=error, bits=bits) for error in (0.3, 0.15))
    assert error_of(coarse) <= 0.3
    assert error_of(fine) <= 0.15
    assert coarse.bytes < fine.bytes < whole.bytes


@pytest.mark.parametrize("method", ["vq", "pca", "iterative", "adaptive"])
def test_bytes_that_are_asked_for_are_kept_to_and_used(make_transfer, method):
    whole = make_transfer(side=36, order=4)
    few, many = (compress(whole, bytes=size, method=method) for size in (8_000, 30_000))
    assert 4_000 < few.bytes <= 8_000
    assert 12_000 < many.bytes <= 30_000
    assert error_of(many) < error_of(few)


@pytest.mark.parametrize("bits", [32, 16, 8])
@pytest.mark.parametrize("shared", [0, 6])
def test_bytes_are_foretold(make_transfer, bits, shared):
    packed = compress(make_transfer(side=30, order=4), clusters=7, components=3, bits=bits, shared=shared)
    assert packed.bytes == stored_bytes(900, 16, 7, 3, shared, bits)


def test_coherence_lowers_overdraw_for_no_more_error_than_is_allowed(make_transfer):
    whole = make_transfer(side=40, order=3)
    plain, coherent = (gloss(compress(whole, clusters=9, components=2, coherence=part)).signal for part in (0, 0.1))
    assert overdraw(whole.faces, coherent.label) < overdraw(whole.faces, plain.label)
    allowed = 1.1 * float(plain.squared_error.double().sum())
    assert float(coherent.squared_error.double().sum()) <= allowed * (1 + 1e-5)


def test_clusters_of_glossy_receivers_are_made_coherent_over_their_own_triangles(make_transfer):
    whole = random_glossy("exit", vertices=36, glossy=30)
    faces = make_transfer(side=6).faces
    whole = replaced(whole, faces=faces)
    receivers = gloss(whole).receivers
    among = faces_between(whole, gloss(whole))
    kept = torch.isin(faces, receivers).all(1)
    assert torch.equal(receivers[among], faces[kept].long())
    assert 0 < len(among) < len(faces)
    compress(whole, clusters=4, components=1, coherence=0.2).check()


def test_what_is_so_many_subspaces_comes_back_to_rounding(diffuse):
    generator = torch.Generator().manual_seed(3)
    label = torch.arange(400) % 4
    centres = 10 * torch.randn(4, 27, generator=generator)
    axes = torch.randn(4, 2, 27, generator=generator)
    points = centres[label] + (torch.randn(400, 1, 2, generator=generator) @ axes[label])[:, 0]
    exact = replaced(diffuse, values=points.view(400, 3, 9).permute(1, 2, 0).contiguous())
    packed = compress(exact, clusters=4, components=2)
    # Sums of 27 products of numbers up to 30.
    torch.testing.assert_close(stored(decompress(packed)), stored(exact), atol=27 * 30 * EPS, rtol=0)
    assert error_of(packed) < 1e-5


def test_importance_changes_what_is_kept_and_the_error_stays_that_of_the_transfer(diffuse):
    importance = torch.cat([torch.full((9,), 100.0), torch.ones(18)])
    plain, weighed = (
        compress(diffuse, clusters=4, components=3),
        compress(diffuse, clusters=4, components=3, importance=importance),
    )

    def first_channel(packed):
        return float((stored(decompress(packed)) - stored(diffuse))[0].norm())

    assert first_channel(weighed) < 0.9 * first_channel(plain)
    squared = (stored(decompress(weighed)) - stored(diffuse)).double().square().sum()
    assert float(gloss(weighed).signal.squared_error.double().sum()) == pytest.approx(float(squared), rel=1e-3)


def test_bytes_are_those_of_the_stored_tensors_and_fewer(make_transfer):
    whole = make_transfer(side=70, order=5)
    packed = compress(whole, clusters=16, components=4, iterations=1)
    # A label of one byte, four weights; 16 means and 64 vectors of 25; 17 offsets.
    assert packed.bytes == 4900 * (1 + 16) + 80 * 25 * 4 + 17 * 4
    assert packed.bytes < whole.bytes / 4


@pytest.mark.parametrize("kind", ["diffuse", *KINDS])
@pytest.mark.parametrize("sizes", [{}, {"bits": 8, "shared": 5}], ids=str)
def test_files_hold_it_whole(kind, diffuse, sizes, tmp_path):
    whole = diffuse if kind == "diffuse" else random_glossy(kind, vertices=40)
    packed = compress(whole, clusters=3, components=2, method="adaptive", **sizes)
    save(packed, tmp_path / "a.safetensors")
    again = load(tmp_path / "a.safetensors")
    assert again.kind == packed.kind
    assert not differing(again, packed)


def test_a_label_without_its_cluster_is_named(diffuse):
    packed = compress(diffuse, clusters=3, components=1)
    signal = gloss(packed).signal
    assert signal.kind == "clustered"
    with pytest.raises(InputError, match="label"):
        replaced(packed, label=signal.label + 1).check()
    with pytest.raises(InputError, match="offsets"):
        replaced(packed, offsets=signal.offsets + 1).check()
    with pytest.raises(InputError, match="weights"):
        replaced(packed, weights=signal.weights[1:]).check()
    with pytest.raises(InputError, match="offsets"):
        replaced(packed, offsets=signal.offsets[1:])
    with pytest.raises(InputError, match="low and step"):
        replaced(packed, low=signal.low.new_zeros(len(signal.basis)))
    with pytest.raises(InputError, match="shared axes"):
        replaced(packed, mean=signal.mean[:, 1:], basis=signal.basis[:, 1:])


@pytest.mark.parametrize("kind", ["diffuse", "exit"])
def test_reordered_transfer_shades_the_same_and_leads_back(make_transfer, kind):
    mesh = make_transfer(side=9, order=4)
    whole = mesh
    if kind == "exit":
        whole = replaced(random_glossy("exit", vertices=81, glossy=70), faces=mesh.faces)
    packed = compress(whole, clusters=7, components=3, method="adaptive", bits=8)
    moved = reorder(packed, most=2)
    moved.check()
    light = torch.randn(16, 3, generator=torch.Generator().manual_seed(5))
    eye = {} if kind == "diffuse" else {"eye": torch.tensor([0.3, 2.0, 1.0])}
    wanted = shader(packed)(light, **eye)
    there = moved.receivers.in_mesh_order(shader(moved)(light, **eye))
    torch.testing.assert_close(there, wanted, atol=1e-5, rtol=1e-5)
    original = moved.receivers.original
    torch.testing.assert_close(moved.positions, packed.positions[original])
    # The same triangles, with their corners in the same sense.
    one, other = (set(map(tuple, faces.tolist())) for faces in (original[moved.faces.long()], packed.faces))
    assert one == other
    assert bool((gloss(moved).signal.label.long().diff() != 0).sum() < 7)
    with pytest.raises(InputError, match="already"):
        reorder(moved)


# A layer among others


def test_refuses_a_layer_that_there_is_not(glossy):
    with pytest.raises(InputError, match="layer is 'incident': the transfer has diffuse, exit"):
        compress(glossy, layer="incident")


@pytest.mark.parametrize("kind", KINDS)
def test_the_layer_that_is_named_is_compressed_and_the_other_keeps_its_bits(kind):
    whole = random_glossy(kind, vertices=40, glossy=30)
    first = compress(whole, layer="diffuse", clusters=3, components=2)
    assert first.kind == f"clustered diffuse + {kind}"
    changed = differing(first, whole)
    assert {name.rsplit(".", 1)[0] for name in changed} == {"diffuse.signal"}
    # And so does that which is compressed already.
    both = compress(first, layer=kind, clusters=2, components=1)
    assert both.kind == f"clustered diffuse + clustered {kind}"
    assert {name.rsplit(".", 1)[0] for name in differing(both, first)} == {f"{kind}.signal"}
    # In either order, and as each by itself.
    assert not differing(
        both, compress(compress(whole, clusters=2, components=1), layer="diffuse", clusters=3, components=2)
    )
    assert decompress(both).kind == whole.kind


def test_bytes_that_are_asked_for_are_those_of_all_layers():
    whole = random_glossy("exit", vertices=900, order=3)
    kept = whole.layers["exit"].bytes
    packed = compress(whole, layer="diffuse", bytes=kept + 9_000, bits=8)
    assert kept + 4_500 < packed.bytes <= kept + 9_000
    with pytest.raises(InputError, match=r"give [0-9]+ or more"):
        compress(whole, layer="diffuse", bytes=kept)
