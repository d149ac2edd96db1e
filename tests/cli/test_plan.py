"""Does the command plan, write the recipe, and bake by it?"""

import importlib

import pytest

from torchprt.measure import Recipe, read_recipe, write_recipe
from torchprt.measure.recipe import RUNTIMES
from torchprt.transfer import load


def test_its_words_are_those_of_the_library():
    # `torchprt.measure.plan` is the function, too.
    library, command = (importlib.import_module(f"torchprt.{room}.plan") for room in ("measure", "cli"))
    assert command.LEAST == library.LEAST
    assert command.RUNTIMES == RUNTIMES


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--error", "a lot"], "--error"),
        (["--error", "0"], "error is 0"),
        (["--ms", "0"], "--ms"),
        (["--bytes", "many"], "--bytes"),
        (["--least", "watts"], "--least"),
        (["--runtime", "gpu"], "--runtime"),
        (["--window", "square"], "--window"),
        (["--eye", "1,2"], "--eye"),
        (["--light", "nothing"], "nothing"),
        (["--error", "1e-9"], "nearest"),
    ],
)
def test_refuses_what_cannot_be_and_writes_nothing(run, folder, tmp_path, options, word):
    output = tmp_path / "r.toml"
    ended = run("plan", folder / "ball.ply", "-o", output, "--order", "3", *options)
    assert ended.code == 2
    assert word in ended.err
    assert not output.exists()


def test_plans_tells_why_and_bakes_what_was_planned(done, folder, tmp_path):
    recipe, baked = tmp_path / "r.toml", tmp_path / "a.safetensors"
    said = done(
        "plan", folder / "ball.ply", "--light", folder / "lamp.exr", "--order", "4", "--error", "5%", "-o", recipe
    )
    found, predicted = read_recipe(recipe)
    assert found.name in said
    assert "bands" in said
    assert predicted["bound"] <= 0.05
    told = done("bake", folder / "ball.ply", "--plan", recipe, "-o", baked)
    assert f"predicted: error {predicted['error']:.2%}" in told
    assert "achieved: " in told
    transfer = load(baked)
    assert (transfer.order, transfer.bytes) == (found.order, predicted["bytes"])


def test_a_recipe_of_ones_own_is_baked_and_stored(done, folder, tmp_path):
    path, baked = tmp_path / "r.toml", tmp_path / "a.safetensors"
    write_recipe(Recipe(order=3, rays=32, clusters=4, components=2, bits=8), path)
    told = done("bake", folder / "ball.ply", "--plan", path, "-o", baked)
    assert "predicted" not in told
    assert load(baked).approximates


@pytest.mark.parametrize(
    "options",
    [["--order", "3"], ["--rays", "16"], ["--bounces", "0"], ["--unshadowed"], ["--half"], ["--factors", "2"]],
)
def test_a_plan_and_a_word_against_it_are_refused(refused, folder, tmp_path, options):
    path = tmp_path / "r.toml"
    write_recipe(Recipe(order=3, rays=32), path)
    refused(
        options[0],
        "says how to bake",
        arguments=["bake", folder / "ball.ply", "--plan", path, "-o", tmp_path / "a.safetensors", *options],
    )


def test_a_plan_that_is_none_is_named(refused, folder, tmp_path):
    path = tmp_path / "r.toml"
    path.write_text("[bake]\nbands = 3\n")
    refused(
        "r.toml", "bands", arguments=["bake", folder / "ball.ply", "--plan", path, "-o", tmp_path / "a.safetensors"]
    )
