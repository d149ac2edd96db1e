"""Is a volume baked from the command line as its options say, and do meshes stand in its shadow?"""

import numpy as np
import pytest

from torchprt.transfer import load

BAKE = ["--rays", "32", "--order", "3", "--threads", "1", "--bounces", "1"]


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    """Cells of density, some of them empty, and a margin of nothing."""
    path = tmp_path_factory.mktemp("cloud") / "cloud.npy"
    values = np.zeros((6, 5, 6), np.float32)
    values[1:5, 1:4, 1:5] = np.random.default_rng(0).uniform(0.2, 1, (4, 3, 4))
    np.save(path, values)
    return path


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (["--scale", "0"], "scale"),
        (["--albedo", "1,2"], "--albedo"),
        (["--albedo", "1.5"], "albedo"),
        (["--phase", "1"], "phase"),
        (["--phase", "x"], "--phase"),
        (["--spacing", "0"], "no extent"),
        (["--spacing", "1,2"], "one number, or three"),
        (["--origin", "1,2"], "3 numbers"),
        (["--grid", "density"], "no names of grids"),
        (["--bounces", "many"], "--bounces"),
        (["--output-order", "9"], "output_order is 9"),
    ],
)
def test_refuses_what_makes_no_sense(wrong, words, cloud, tmp_path, refused):
    refused(words, arguments=["volume", cloud, "-o", tmp_path / "a.safetensors", *wrong])


def test_refuses_what_is_no_volume(folder, cloud, tmp_path, refused):
    refused("a mesh, not a volume", arguments=["volume", folder / "ball.ply", "-o", tmp_path / "a.safetensors"])
    for other, words in ((folder / "ball.safetensors", "no volume"), (cloud, "cloud.npy")):
        refused(words, arguments=["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--volume", other])


def test_bakes_tells_and_casts_its_shadow(folder, cloud, tmp_path, run):
    baked = tmp_path / "cloud.safetensors"
    options = ["--scale", "2", "--spacing", "0.5,0.25,0.5", "--origin=-1.5,1.2,-1.5", "--albedo", "0.9,0.5,0.2"]
    ended = run("volume", cloud, "-o", baked, *BAKE, *options, "--phase", "0.3", "--blocker", folder / "ball.ply")
    assert ended.code == 0, ended.err
    assert "4x3x4 cells, (-1, 1.45, -1) to (1, 2.2, 1), 48 hold anything (100%)" in ended.out
    assert not list(tmp_path.glob("*.partial"))
    np.savez(tmp_path / "cloud.npz", density=np.load(cloud))
    told = run("info", tmp_path / "cloud.npz", baked)
    assert "volume of 4x3x4 cells, (1, 1, 1) to (5, 4, 5)" in told.out
    found = load(baked)
    assert found.channels == 3
    assert found.layers["phase"].moments == pytest.approx([1.0, 0.3, 0.09])
    assert float(found.receivers.extinction.max()) == pytest.approx(2 * float(np.load(cloud).max()))
    shaded = {}
    for name, more in (("open", []), ("below", ["--volume", baked])):
        ended = run("bake", folder / "ball.ply", "-o", tmp_path / f"{name}.safetensors", *BAKE, *more)
        assert ended.code == 0, ended.err
        shaded[name] = load(tmp_path / f"{name}.safetensors")
    assert shaded["below"].channels == 3
    up = shaded["open"].normals[:, 1] > 0.9
    values = [shaded[name].layers["diffuse"].signal.values[0, 0, up].mean() for name in ("open", "below")]
    assert values[1] < 0.9 * values[0]
