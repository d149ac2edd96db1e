"""Are the lights that are always there taken wherever a light is asked for, and is a wrong name told?"""

import numpy as np
import pytest
from transfers import random_glossy, replaced

from torchprt.cli.environments import BUILT_IN
from torchprt.cli.options import WINDOWS
from torchprt.cli.picture_options import TONES
from torchprt.light import BUILT_IN as LIGHTS
from torchprt.light import WINDOWS as KNOWN
from torchprt.preview import built_in_environment
from torchprt.shade.display import TONE
from torchprt.shade.display import TONES as MAPS
from torchprt.transfer import save


def test_commands_know_the_names_without_waiting_for_torch():
    assert BUILT_IN == LIGHTS
    assert TONES == MAPS
    assert WINDOWS == KNOWN
    assert TONES[0] == TONE


@pytest.mark.parametrize("verb", ["shade", "render", "light"])
def test_a_name_that_is_none_is_told_what_there_is(refused, folder, tmp_path, verb):
    given = ["light", "stduio"] if verb == "light" else [verb, folder / "ball.safetensors", "--light", "stduio"]
    ends = "png" if verb == "render" else "npy"
    refused("'stduio'", "studio", "overcast", arguments=[*given, "-o", tmp_path / f"a.{ends}"])


@pytest.mark.parametrize("name", LIGHTS)
def test_a_light_is_written_as_coefficients_that_give_the_same(done, folder, tmp_path, name):
    done("light", name, "-o", tmp_path / "a.npy", "--order", 4)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), built_in_environment(name, 4).light)
    radiance = []
    for light in (name, tmp_path / "a.npy"):
        done("shade", folder / "ball.safetensors", "--light", light, "-o", tmp_path / "r.npy")
        radiance.append(np.load(tmp_path / "r.npy"))
    np.testing.assert_array_equal(*radiance)


def test_a_graph_takes_one_as_its_fixed_light(done, make_transfer, tmp_path, untyped):
    flat = make_transfer(side=3, order=3)
    glossy = replaced(random_glossy("exit", vertices=9, order=3, glossy=4), positions=flat.positions, faces=flat.faces)
    save(glossy, tmp_path / "a.safetensors")
    done("export", tmp_path / "a.safetensors", "-o", tmp_path / "a.onnx", "--fix-light", "sunset")


def test_compression_expects_one(done, folder, tmp_path):
    given = ["--clusters", 4, "--components", 2, "--importance", "studio,sky"]
    done("compress", folder / "ball.safetensors", "-o", tmp_path / "a.safetensors", *given)
