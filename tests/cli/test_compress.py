"""Does the command compress a bake, and refuse what it cannot?"""

import numpy as np
import pytest

from torchprt.transfer import ClusteredTransfer, load


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--clusters", "100000"], "clusters"),
        (["--components", "10000"], "components"),
        (["--method", "best"], "--method"),
        (["--method", "vq"], "components"),
        (["--method", "pca"], "clusters"),
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
    assert isinstance(transfer, ClusteredTransfer)
    assert f"compression error {transfer.compression_error:.2%}" in said
    assert "times smaller" in said
    assert "12 clusters (iterative), 4 PCA vectors each" in done("info", packed)
    for name, source in (("whole", whole), ("packed", packed)):
        done("shade", source, "--light", folder / "lamp.exr", "-o", tmp_path / f"{name}.npy")
    one, other = np.load(tmp_path / "whole.npy"), np.load(tmp_path / "packed.npy")
    difference = np.sqrt(((one - other) ** 2).mean() / (one**2).mean())
    assert 0 < difference < 0.1


def test_an_export_of_clusters_is_refused_with_the_way_out(run, done, folder, tmp_path):
    done("compress", folder / "ball.safetensors", "-o", tmp_path / "a.safetensors", "--clusters", "4")
    ended = run("export", tmp_path / "a.safetensors", "-o", tmp_path / "a.onnx")
    assert ended.code == 2
    assert "decompress" in ended.err
    assert not (tmp_path / "a.onnx").exists()
