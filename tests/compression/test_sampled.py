"""Are clusters of a sample those of all receivers, near enough, and does every receiver get the best of them?"""

import pytest
import torch
from transfers import KINDS, gloss, random_glossy, replaced, stored

from torchprt.compression import SampledWarning, compress, decompress, sampled
from torchprt.compression.sampled import sample_of
from torchprt.errors import InputError
from torchprt.transfer import Dense, load, save


@pytest.fixture
def diffuse(make_transfer):
    return make_transfer(side=20, order=3, channels=3)


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(sampled, "_BLOCK", 64)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"sample": 0}, "sample is 0"),
        ({"sample": 5, "clusters": 6}, "clusters is 6, but the sample is of 5 receivers: give a larger sample"),
        ({"sample": 100, "clusters": 3, "coherence": 0.1}, "coherence"),
        ({"sample": 100, "clusters": 3, "shared": 1000}, "shared"),
    ],
)
def test_refuses_what_a_sample_cannot_give(diffuse, options, said):
    with pytest.raises(InputError, match=said):
        compress(diffuse, **options)


def test_names_the_receiver_that_is_not_finite(diffuse):
    values = stored(diffuse).clone()
    values[0, 0, 399] = torch.nan
    with pytest.raises(InputError, match="not finite, first in row"):
        compress(replaced(diffuse, values=values), clusters=3, components=2, sample=100)


@pytest.mark.parametrize("size", [1, 7, 399, 400])
def test_one_receiver_of_every_run_is_drawn(size):
    dense = Dense(values=torch.arange(400.0)[None, None])
    rows = sample_of(dense, size, 3)[:, 0].long()
    bounds = torch.arange(size + 1) * 400 // size
    assert bool(((bounds[:-1] <= rows) & (rows < bounds[1:])).all())


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        *zip(KINDS, ({}, {"bits": 8}, {"bits": 16, "shared": 5}, {"method": "adaptive"}), strict=True),
        ("exit", {"bits": 8, "shared": 5, "method": "adaptive"}),
        ("incident", {"method": "vq", "components": 0}),
    ],
    ids=str,
)
def test_the_stated_errors_are_those_of_all_receivers(kind, options, small_blocks):
    whole = random_glossy(kind, vertices=200, glossy=150)
    packed = compress(whole, **({"clusters": 3, "components": 2, "sample": 60} | options))
    change = (stored(decompress(packed)) - stored(whole)).double().square()
    squared = change.sum((0, 1)) if kind == "visibility" else change.sum((0, 2, 3))
    signal = gloss(packed).signal
    signal.check()
    torch.testing.assert_close(signal.squared_error.double(), squared, rtol=1e-3, atol=1e-6)
    relative = float(squared.sum().sqrt() / stored(whole).double().norm())
    assert signal.compression_error == pytest.approx(relative, rel=1e-4)


def test_every_receiver_is_in_the_nearest_subspace_with_its_best_weights(diffuse, small_blocks):
    """Against all clusters for every receiver, in float64; equal distances up to rounding are equal."""
    signal = gloss(compress(diffuse, clusters=5, components=2, sample=80)).signal
    data = stored(diffuse).movedim(2, 0).flatten(1).double()
    basis = signal.basis.double().unflatten(0, (5, 2))
    centred = data - signal.mean.double()[:, None]
    along = torch.einsum("kvs,kps->kvp", centred, basis)
    left = centred.square().sum(2) - along.square().sum(2)
    found = left.gather(0, signal.label.long()[None])[0]
    assert bool((found <= left.amin(0) + 1e-5 * data.square().sum(1).mean()).all())
    best = along[signal.label.long(), torch.arange(len(data))]
    torch.testing.assert_close(signal.weights.view(-1, 2).double(), best, rtol=0, atol=1e-5 * float(best.abs().max()))


@pytest.mark.parametrize("importance", [False, True])
def test_a_sample_of_nearly_all_loses_nearly_as_little_as_all(diffuse, importance):
    weighed = torch.linspace(0.5, 2, 27) if importance else None
    options = {"clusters": 8, "components": 3, "bits": 16, "importance": weighed}
    errors = [gloss(compress(diffuse, sample=sample, **options)).signal.compression_error for sample in (None, 390)]
    assert errors[1] == pytest.approx(errors[0], rel=0.1)


@pytest.mark.parametrize("bits", [32, 8])
def test_same_bits_however_many_threads_and_wherever_the_transfer_stands(diffuse, tmp_path, bits, small_blocks):
    path = tmp_path / "a.safetensors"
    save(diffuse, path)
    options = {"clusters": 6, "components": 2, "bits": bits, "sample": 90, "seed": 4}
    threads, found = torch.get_num_threads(), []
    try:
        for count, transfer in ((1, diffuse), (3, diffuse), (2, load(path, mapped=True))):
            torch.set_num_threads(count)
            found.append(gloss(compress(transfer, **options)).signal.tensors())
    finally:
        torch.set_num_threads(threads)
    for other in found[1:]:
        assert all(torch.equal(other[name], value) for name, value in found[0].items())


def test_a_block_is_the_same_whatever_comes_after_it(diffuse, small_blocks, monkeypatch):
    """In the same clusters, of the first two blocks of 64: of 256 receivers, and of 400."""
    values = stored(diffuse).clone()
    errors = []
    for count in (256, 400):
        part = replaced(
            diffuse,
            values=values[..., :count].contiguous(),
            albedo=diffuse.albedo[:1],
            positions=diffuse.positions[:count],
            normals=diffuse.normals[:count],
            faces=diffuse.faces[:0],
        )
        signal = gloss(part).signal
        if not errors:
            data = sample_of(signal, 128, 0)
            space = sampled._Space.of(data, 0, None)
            packed = sampled.pack(data, 4, 2, "iterative", 1, 0, None, sampled.Passes())
            clusters = sampled._Found.of(packed, data, space, 32, signal)
        monkeypatch.setattr(sampled, "_MOMENTS", 0)
        made = sampled._Streamed(signal, clusters, sampled.Passes()).signal("iterative")
        errors.append((made.label[:128], made.weights[:256], made.squared_error[:128]))
    assert all(torch.equal(one, other) for one, other in zip(*errors, strict=True))


def test_error_and_bytes_are_sought_with_a_sample(diffuse):
    within = compress(diffuse, bytes=12_000, sample=150)
    assert within.bytes <= 12_000
    assert gloss(compress(diffuse, error=0.4, sample=150)).signal.compression_error <= 0.4


def test_what_does_not_fit_into_memory_is_sampled_and_said(diffuse, monkeypatch):
    monkeypatch.setattr(sampled, "_LEAST", 64)
    monkeypatch.setattr(sampled, "_PER_CLUSTER", 20)
    monkeypatch.setattr(sampled, "available", lambda: 100_000)
    with pytest.warns(SampledWarning, match="all 400 receivers needs about .* clusters are of a sample"):
        packed = compress(diffuse, clusters=4, components=2)
    monkeypatch.undo()
    chosen = compress(diffuse, clusters=4, components=2, sample=80)
    assert torch.equal(gloss(packed).signal.weights, gloss(chosen).signal.weights)
    assert not torch.equal(
        gloss(packed).signal.weights, gloss(compress(diffuse, clusters=4, components=2)).signal.weights
    )
