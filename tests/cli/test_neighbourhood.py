"""Is an object baked and cast from the command line as its options say?"""

import pytest
from PIL import Image

from torchprt.transfer import load

BAKE = ["--grid", "5x4x5", "--rays", "64", "--order", "3", "--threads", "1"]


@pytest.fixture(scope="module")
def around(folder, tmp_path_factory):
    """A ball baked with this command, once for all."""
    return tmp_path_factory.mktemp("around") / "around.safetensors"


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (["--grid", "4x4"], "three counts"),
        (["--grid", "many"], "number of nodes"),
        (["--box", "0,0,0"], "6 numbers"),
        (["--share", "much"], "--share"),
        (["--output-order", "9"], "output_order is 9"),
    ],
)
def test_refuses_what_makes_no_sense(wrong, words, folder, tmp_path, refused):
    refused(words, arguments=["neighbourhood", folder / "ball.ply", "-o", tmp_path / "a.safetensors", *wrong])


@pytest.mark.filterwarnings("ignore:a grid of")
def test_bakes_tells_and_casts(folder, tmp_path, run, refused, around):
    ended = run("neighbourhood", folder / "ball.ply", "-o", around, *BAKE, "--share", "10%", "--bounces", "1")
    assert ended.code == 0, ended.err
    assert "its box encloses the shadow" in ended.out
    assert "grid of 5x4x5 nodes" in ended.out
    baked = load(around)
    assert baked.receivers.shape == [5, 4, 5]
    assert not list(around.parent.glob("*.partial"))
    told = run("info", around)
    assert "what arrives around it of order 3" in told.out
    options = ["--size", "40x30", "--samples", "1", "--light", folder / "lamp.exr"]
    path = ["--path", "0,3,0; 1,3,0,90", "--path", "-2,3,0"]
    still = run("cast", around, folder / "ball.ply", "-o", tmp_path / "a.png", *options, *path)
    assert still.code == 0, still.err
    assert "2 pictures of 40 x 30" in still.out
    assert "2 objects" in still.out
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (80, 30)
    onto = run("cast", around, folder / "ball.safetensors", "-o", tmp_path / "b.gif", *options, "--frames", "2")
    # Its light has four bands, the neighbourhood three.
    assert onto.code == 2
    assert "different orders" in onto.err
    (tmp_path / "a.png").unlink()
    (tmp_path / "b.gif").unlink(missing_ok=True)
    refused("--path is", arguments=["cast", around, folder / "ball.ply", "-o", tmp_path / "c.png", "--path", "1,2"])
    refused(
        "has its own",
        arguments=["cast", around, folder / "ball.safetensors", "-o", tmp_path / "c.png", "--albedo", "1"],
    )
    refused(
        "not around an object",
        arguments=["cast", folder / "ball.safetensors", folder / "ball.ply", "-o", tmp_path / "c.png"],
    )
    page = ["export", folder / "ball.safetensors", "-o", tmp_path / "page", "--web"]
    refused("without --model or --path", arguments=[*page, "--cast", around])
    refused("without --cast", arguments=[*page, "--path", "0,3,0"])
    refused(
        "of order 3", arguments=[*page, "--cast", around, "--model", folder / "ball.safetensors", "--path", "0,3,0"]
    )
    refused("receivers read it", arguments=["shade", around, "-o", tmp_path / "a.npy"])
    refused("no use for it", arguments=["export", around, "-o", tmp_path / "a.onnx", "--from", "environment"])
