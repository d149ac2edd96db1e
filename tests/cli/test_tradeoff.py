"""Does `torchprt tradeoff` say what accuracy costs, refuse before long work, and go on where it was stopped?"""

import importlib
import shutil

import pytest

from torchprt.measure.recipe import read_recipe


@pytest.fixture(autouse=True)
def small(monkeypatch, tmp_path, untyped):
    """Few recipes, small pictures, one round, and a cache of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("torchprt.measure.views.SIZE", (96, 72))
    monkeypatch.setattr("torchprt.measure.side_by_side.ROUNDS", 1)
    monkeypatch.setattr(
        "torchprt.measure.sweeping.sweep",
        lambda choice, quick: [choice.base, *(choice.base.replace(order=order) for order in (1, 2))],
    )


@pytest.mark.parametrize(
    ("words", "given"),
    [
        (("--eye", "3 numbers"), ["ball.ply", "--eye", "1,2"]),
        (("light 'nowhere'",), ["ball.ply", "--light", "nowhere"]),
        (("--albedo is given", "baked already"), ["ball.safetensors", "--albedo", "0.5"]),
        (("--order is given", "baked already"), ["ball.safetensors", "--order", "3"]),
        (("give one bake, or meshes alone",), ["ball.safetensors", "ball.ply"]),
        (("sees nothing of the model",), ["ball.safetensors", "--eye", "0,0,0"]),
        (("does not exist",), ["none.ply"]),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else None,
)
def test_misuse(words, given, refused, folder, tmp_path):
    arguments = [folder / each if (folder / each).exists() or each == "none.ply" else each for each in given]
    refused(*words, arguments=["tradeoff", *arguments, "-o", tmp_path / "out"])


def test_a_folder_of_something_else_is_refused_before_any_ray(refused, folder, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    refused("holds something that is no sweep", arguments=["tradeoff", folder / "ball.ply", "-o", tmp_path / "out"])


def test_a_mesh_is_baked_and_half_the_time_is_told(done, folder, tmp_path):
    given = ["tradeoff", folder / "ball.ply", "--order", 4, "--rays", 64, "-o", tmp_path / "out"]
    said = done(*given)
    assert "base: order 4, 16 rays" in said
    assert "half the bytes: error" in said
    assert "without a window, under studio, sky" in said
    assert {"table.csv", "table.md", "pareto.png", "front.png", "recipe-01.toml"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }
    recipe, measured = read_recipe(tmp_path / "out" / "recipe-01.toml")
    assert recipe.rays == 16
    assert measured.keys() == {"error", "milliseconds", "bytes", "seconds"}
    # All is known.
    assert done(*given) == said


def test_a_bake_and_files_of_lights(done, folder, tmp_path):
    shutil.copy(folder / "lamp.exr", tmp_path)
    said = done(
        "tradeoff", folder / "ball.safetensors", "--light", tmp_path / "lamp.exr", "--light", "white",
        "--eye", "0,0,4", "--cache", tmp_path / "kept", "-o", tmp_path / "out",
    )  # fmt: skip
    assert "under lamp, white" in said
    assert (tmp_path / "kept").is_dir()
    assert not (tmp_path / "cache").exists()
    assert "error, lamp" in (tmp_path / "out" / "table.csv").read_text().splitlines()[0]


def test_stopped_it_keeps_what_is_measured_and_goes_on(run, folder, tmp_path, monkeypatch):
    from torchprt.measure.sweeping import Sweeping

    given = ["tradeoff", folder / "ball.safetensors", "-o", tmp_path / "out"]
    measure, times = Sweeping._measure, []

    def stopped(self, recipe, report):
        times.append(recipe)
        if len(times) == 3:
            raise KeyboardInterrupt
        measure(self, recipe, report)

    monkeypatch.setattr(Sweeping, "_measure", stopped)
    ended = run(*given)
    assert ended.code == 130
    assert "keeps what is done, the same command goes on from there" in ended.err
    assert "Traceback" not in ended.err
    assert not (tmp_path / "out").exists()
    assert run(*given).code == 0
    # The third a second time, the first two not.
    assert len(times) == 4


def test_built_in_lights_have_no_window_but_those_that_are_tried(run, folder, tmp_path, monkeypatch):
    from torchprt import light

    seen = {}

    def looked_at(source, lights, *rest, **options):
        seen.update(lights)
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("torchprt.measure.tradeoff"), "tradeoff", looked_at)
    run("tradeoff", folder / "ball.safetensors", "--light", "sky", "-o", tmp_path / "out")
    wanted = light.project(light.built_in("sky", 256), 4)
    assert (seen["sky"] - wanted).abs().max() < 1e-6 * wanted.abs().max()
