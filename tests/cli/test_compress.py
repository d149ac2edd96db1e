"""Does the command compress a bake, and refuse what it cannot?"""

import numpy as np
import pytest
import torch
from transfers import random_glossy, stored

from torchprt.transfer import Clustered, load, save


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--clusters", "100000"], "clusters"),
        (["--components", "10000"], "components"),
        (["--method", "best"], "--method"),
        (["--method", "vq", "--components", "8"], "components"),
        (["--method", "pca", "--clusters", "2"], "clusters"),
    ],
)
def test_refuses_what_the_transfer_cannot_give_and_writes_nothing(run, folder, tmp_path, options, word):
    output = tmp_path / "a.safetensors"
    ended = run("compress", folder / "ball.safetensors", "-o", output, *options)
    assert ended.code == 2
    assert word in ended.err
    assert not output.exists()


def test_compresses_tells_what_it_cost_and_shades_the_same(done, folder, tmp_path):
    whole, packed = folder / "ball.safetensors", tmp_path / "a.safetensors"
    said = done("compress", whole, "-o", packed, "--clusters", "12", "--components", "4")
    transfer = load(packed)
    signal = transfer.layers["diffuse"].signal
    assert isinstance(signal, Clustered)
    assert f"compression error {signal.compression_error:.2%}" in said
    assert "times smaller" in said
    assert "12 clusters (iterative), 4 PCA vectors each" in done("info", packed)
    for name, source in (("whole", whole), ("packed", packed)):
        done("shade", source, "--light", folder / "lamp.exr", "-o", tmp_path / f"{name}.npy")
    one, other = np.load(tmp_path / "whole.npy"), np.load(tmp_path / "packed.npy")
    difference = np.sqrt(((one - other) ** 2).mean() / (one**2).mean())
    assert 0 < difference < 0.1


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--error", "a lot"], "--error"),
        (["--error", "1%", "--bytes", "4M"], "both"),
        (["--error", "1%", "--clusters", "4"], "clusters"),
        (["--bytes", "4 bananas"], "--bytes"),
        (["--bytes", "10"], "one cluster"),
        (["--bits", "12"], "bits"),
        (["--coherence=-5%"], "--coherence"),
        (["--importance", "nothing.npy"], "nothing.npy"),
        (["--superclusters", "2", "--clusters", "100000"], "clusters"),
        (["--sample", "9", "--clusters", "10"], "give a larger sample"),
        (["--sample", "50", "--clusters", "5", "--coherence", "5%"], "leave it out"),
    ],
)
def test_refuses_a_size_that_cannot_be_and_writes_nothing(run, folder, tmp_path, options, word):
    output = tmp_path / "a.safetensors"
    ended = run("compress", folder / "ball.safetensors", "-o", output, *options)
    assert ended.code == 2
    assert word in ended.err
    assert not output.exists()


@pytest.mark.parametrize(
    "options",
    [
        ["--error", "5%", "--bits", "8"],
        ["--bytes", "6K"],
        ["--clusters", "6", "--shared", "9", "--bits", "16"],
        ["--clusters", "6", "--coherence", "5%", "--superclusters", "3"],
        ["--clusters", "6", "--importance", "natural", "--sample", "60"],
    ],
    ids=" ".join,
)
def test_whatever_the_size_it_shades_in_the_order_of_the_mesh(done, folder, tmp_path, options):
    whole, packed = folder / "ball.safetensors", tmp_path / "a.safetensors"
    done("compress", whole, "-o", packed, *options)
    transfer = load(packed)
    if "--error" in options:
        assert transfer.layers["diffuse"].signal.compression_error <= 0.05
    if "--bytes" in options:
        assert transfer.bytes <= 6 * 1024
    said = done("info", packed)
    assert "overdraw" in said
    assert "representatives" in said
    for name, source in (("whole", whole), ("packed", packed)):
        done("shade", source, "--light", folder / "lamp.exr", "-o", tmp_path / f"{name}.npy")
    one, other = np.load(tmp_path / "whole.npy"), np.load(tmp_path / "packed.npy")
    assert np.sqrt(((one - other) ** 2).mean() / (one**2).mean()) < 0.2


def test_clusters_are_exported_as_they_are(done, folder, tmp_path, untyped):
    done("compress", folder / "ball.safetensors", "-o", tmp_path / "a.safetensors", "--clusters", "4")
    assert "same" in done("export", tmp_path / "a.safetensors", "-o", tmp_path / "a.onnx")
    assert "clustered" in done("info", tmp_path / "a.onnx")


@pytest.fixture
def layered(tmp_path):
    """Random transfer of a diffuse layer of all 90 vertices and exit matrices of 60."""
    path = tmp_path / "layered.safetensors"
    save(random_glossy("exit", vertices=90, glossy=60, order=3, output_order=2), path)
    return path


@pytest.mark.parametrize(
    ("chosen", "other", "options"),
    [
        ("diffuse", "exit", ["--layer", "diffuse"]),
        ("diffuse", "exit", ["--layer", "diffuse", "--importance", "natural"]),
        ("exit", "diffuse", ["--layer", "exit"]),
        ("exit", "diffuse", []),
    ],
)
def test_the_layer_that_is_named_is_compressed_and_the_other_stays(done, layered, tmp_path, chosen, other, options):
    packed = tmp_path / "a.safetensors"
    said = done("compress", layered, "-o", packed, "--clusters", 5, "--components", 2, *options)
    assert f"{chosen}: 5 clusters (iterative), 2 PCA vectors each" in said
    assert f"{other}: 5 clusters" not in said
    transfer, whole = load(packed), load(layered)
    assert list(transfer.layers) == ["diffuse", "exit"]
    assert isinstance(transfer.layers[chosen].signal, Clustered)
    assert torch.equal(stored(transfer, other), stored(whole, other))
    # Then the other one: the first stays as it was compressed.
    both = tmp_path / "b.safetensors"
    done("compress", packed, "-o", both, "--layer", other, "--clusters", 5, "--components", 2)
    twice = load(both)
    assert twice.kind == "clustered diffuse + clustered exit"
    assert torch.equal(twice.layers[chosen].signal.weights, transfer.layers[chosen].signal.weights)


@pytest.mark.parametrize(
    ("layer", "words"),
    [
        ("gloss", ["layer is 'gloss'", "diffuse, exit"]),
        ("", ["layer is ''"]),
    ],
)
def test_refuses_a_layer_that_there_is_not(refused, layered, tmp_path, layer, words):
    refused(*words, arguments=["compress", layered, "-o", tmp_path / "a.safetensors", "--layer", layer])


def test_refuses_a_layer_that_is_compressed_already(done, refused, layered, tmp_path):
    packed = tmp_path / "a.safetensors"
    done("compress", layered, "-o", packed, "--layer", "diffuse", "--clusters", 5)
    refused(
        "compressed already", arguments=["compress", packed, "-o", tmp_path / "b.safetensors", "--layer", "diffuse"]
    )
