"""Does the command do what any command does: complete words, say its version, be quiet when it is told to?"""

import os
import subprocess
import sys

import pytest

import torchprt

COMPLETED = "from torchprt.cli import main; import sys; sys.argv = ['torchprt']; main()"


def completions(*words, folder):
    """What Tab offers in bash at the end of these words, which stand behind `torchprt`."""
    typed = ["torchprt", *map(str, words)]
    asked = {"COMP_WORDS": " ".join(typed), "COMP_CWORD": str(len(typed) - 1), "_TORCHPRT_COMPLETE": "complete_bash"}
    path = os.pathsep.join(filter(None, [os.path.dirname(os.path.dirname(torchprt.__file__)), os.getenv("PYTHONPATH")]))
    ended = subprocess.run(
        [sys.executable, "-c", COMPLETED],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        cwd=folder,
        env={**os.environ, **asked, "PYTHONPATH": path},
    )
    return ended.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["ba"], ["bake"]),
        (["bake", "--proj"], ["--projection"]),
        (["bake", "a.ply", "--projection", "o"], ["optimal", "odd"]),
        (["export", "a.safetensors", "--eye", ""], ["point", "direction"]),
        (["compress", "a.safetensors", "--method", "a"], ["adaptive"]),
        # Nothing is offered where a file is wanted: bash then offers files.
        (["bake", ""], []),
        (["bake", "a.ply", "-o", ""], []),
        (["render", "a.safetensors", "--light", "s"], ["studio", "sky", "sunset", "sea.exr", "small/"]),
    ],
)
def test_tab_offers_verbs_options_words_and_files(words, offered, tmp_path):
    (tmp_path / "sea.exr").touch()
    (tmp_path / "small").mkdir()
    (tmp_path / "park.exr").touch()
    assert completions(*words, folder=tmp_path) == offered


def test_words_that_are_completed_are_those_of_options_that_are_there():
    import inspect

    from torchprt.cli.command import VERBS
    from torchprt.cli.completion import WORDS, WORDS_AND_FILES

    taken = {
        name
        for verb in VERBS
        for each in inspect.signature(verb).parameters
        for name in (each, f"{verb.__name__} {each}")
    }
    assert taken >= {*WORDS, *WORDS_AND_FILES}


def test_its_version(run):
    ended = run("--version")
    assert (ended.code, ended.out, ended.err) == (0, f"torchprt {torchprt.__version__}\n", "")


def test_a_verb_that_is_not_there_is_near_one_that_is(misused):
    misused("Did you mean 'bake'?", arguments=["baek"])


@pytest.mark.parametrize("how", ["-q", "--quiet", "before", "variable"])
def test_told_to_be_quiet_it_tells_nothing_but_faults(how, run, folder, tmp_path, monkeypatch):
    options = [how]
    if how == "variable":
        monkeypatch.setenv("TORCHPRT_QUIET", "1")
        options = []
    # As an option of the command, in front of the verb.
    first, options = (["-q"], []) if how == "before" else ([], options)
    before = os.environ.get("TORCHPRT_QUIET")
    # A light that rings, one bar and what was written: each is told otherwise.
    bake = ["bake", folder / "ball.ply", "-o", tmp_path / "a.safetensors", "--rays", "8", "--threads", "1"]
    shade = ["shade", tmp_path / "a.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "a.npy"]
    for command in (bake, shade):
        ended = run(*first, *command, *options)
        assert (ended.code, ended.out, ended.err) == (0, "", "")
    assert (tmp_path / "a.npy").exists()
    ended = run(*first, "shade", tmp_path / "none.safetensors", "--light", "white", "-o", tmp_path / "b.npy", *options)
    assert (ended.code, ended.out) == (2, "")
    assert "none.safetensors does not exist" in ended.err
    # It is for this command only, and what is asked for is told.
    assert os.environ.get("TORCHPRT_QUIET") == before
    assert "a.safetensors: diffuse" in run(*first, "info", tmp_path / "a.safetensors", *options).out


def test_not_told_to_be_quiet_it_tells(run, folder, tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHPRT_QUIET", "0")
    ended = run("shade", folder / "ball.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "a.npy")
    assert "--window auto takes nearly all of that away" in ended.out
    assert "mean radiance" in ended.out
