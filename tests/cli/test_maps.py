"""Does `shade` write the maps of what was recorded at texels, in the units that it says, for every light?"""

import math

import numpy as np
import pytest
from atlases import lit_cube
from environments import lamp, save_exr
from PIL import Image
from transfers import random_glossy

from torchprt.light.exr import read_exr
from torchprt.preview import automatic_exposure, built_in_environment
from torchprt.shade import display, shader
from torchprt.transfer import save


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    save(lit_cube(), folder / "cube.safetensors")
    save(random_glossy(vertices=5, diffuse=False), folder / "glossy.safetensors")
    save_exr(folder / "left.exr", lamp((-1.0, 0.2, 0.3)))
    save_exr(folder / "right.exr", lamp((1.0, 0.2, 0.3)))
    return folder


@pytest.fixture
def bake(folder):
    return folder / "cube.safetensors"


def radiance(word):
    found = built_in_environment(word, 3)
    return found.light, shader(lit_cube())(found.light)


# What is refused


def test_refuses_what_a_map_is_not(folder, bake, refused, tmp_path):
    for name, words in {"a.jpg": "cannot hold a map", "a.ply": "transfer.to_vertices"}.items():
        refused(name, words, arguments=["shade", bake, "-o", tmp_path / name])
    for option in (["--size", "40x30"], ["--distance", "3"], ["--backdrop", "white"]):
        words = (option[0], "a map has no camera", "torchprt render")
        refused(*words, arguments=["shade", bake, "-o", tmp_path / "a.png", *option])
    lamps = ["--emitter", "sphere:0,3,0,1,1,1,1"]
    refused("--emitter", "at texels", arguments=["shade", bake, "-o", tmp_path / "a.png", *lamps])
    glossy = ["shade", folder / "glossy.safetensors", "-o"]
    refused("a.exr is a map", "--texels", arguments=[*glossy, tmp_path / "a.exr"])
    refused("depends on the eye", "diffuse", arguments=[*glossy, tmp_path / "a.npy", "--irradiance"])
    both = ["--irradiance", "--white"]
    refused("are both given", arguments=["shade", bake, "-o", tmp_path / "a.exr", *both])
    twice = ["--light", "sky", "--light", "studio"]
    refused("a .glb shows one", arguments=["export", bake, "-o", tmp_path / "a.glb", *twice])
    refused("--order", "which is lit", arguments=["export", bake, "-o", tmp_path / "a.glb", "--order", "2"])


def test_refuses_two_lights_in_one_file(folder, bake, refused, tmp_path):
    two = ["--light", folder / "left.exr", "--light", folder / "right.exr"]
    refused("one file for 2 lights", "{light}", arguments=["shade", bake, "-o", tmp_path / "a.exr", *two])
    same = ["--light", folder / "left.exr", "--light", folder / "left.exr"]
    refused("left.exr would be of two lights", arguments=["shade", bake, "-o", tmp_path / "{light}.exr", *same])
    lamps = ["--emitter", "sphere:0,3,0,1,1,1,1"]
    ball = ["shade", folder / "glossy.safetensors", "-o", tmp_path / "{light}.npy"]
    refused("--emitter is given with 2 lights", arguments=[*ball, *two, *lamps])


# What is written


def test_npy_exr_and_png_are_the_map(bake, done, tmp_path):
    coefficients, wanted = radiance("studio")
    image = lit_cube().receivers.image(wanted)
    said = done("shade", bake, "-o", tmp_path / "a.npy", "--light", "studio")
    assert "216 texels, mean radiance" in said
    assert "exposure" not in said
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), image)
    done("shade", bake, "-o", tmp_path / "a.exr", "--light", "studio")
    np.testing.assert_allclose(read_exr(tmp_path / "a.exr"), image, rtol=2.0**-11)
    said = done("shade", bake, "-o", tmp_path / "a.png", "--light", "studio")
    stops = automatic_exposure(coefficients)
    assert f"exposure {stops:+.2f} stops" in said
    shown = (display(image, exposure=stops) * 255).round()
    np.testing.assert_allclose(np.asarray(Image.open(tmp_path / "a.png")), shown, atol=1)


def test_irradiance_is_pi_times_what_white_sends_and_has_no_albedo(bake, done, tmp_path):
    for name, option in (("a", "--irradiance"), ("b", "--white")):
        done("shade", bake, "-o", tmp_path / f"{name}.npy", "--light", "sky", option)
    irradiance, white = np.load(tmp_path / "a.npy"), np.load(tmp_path / "b.npy")
    np.testing.assert_allclose(irradiance, math.pi * white, rtol=1e-6)
    whole = lit_cube()
    _, wanted = radiance("sky")
    place = whole.receivers
    rows, columns = place.texel.long() // place.columns, place.texel.long() % place.columns
    albedo = whole.layers["diffuse"].albedo
    np.testing.assert_allclose(white[rows, columns] * albedo.numpy(), wanted, rtol=1e-5, atol=1e-5)
    # As they are shown they look alike.
    for name, option in (("a", "--irradiance"), ("b", "--white")):
        done("shade", bake, "-o", tmp_path / f"{name}.png", "--light", "sky", option)
    first, second = (np.asarray(Image.open(tmp_path / f"{name}.png")).astype(int) for name in "ab")
    assert abs(first - second).max() <= 1


def test_several_lights_are_the_files_of_each(folder, bake, done, tmp_path):
    words = ["--light", folder / "left.exr", "--light", folder / "right.exr", "--light", "sky"]
    (tmp_path / "maps").mkdir()
    done("shade", bake, "-o", tmp_path / "maps" / "{light}.npy", *words)
    for name, word in (("left", folder / "left.exr"), ("right", folder / "right.exr"), ("sky", "sky")):
        done("shade", bake, "-o", tmp_path / "one.npy", "--light", word)
        together = np.load(tmp_path / "maps" / f"{name}.npy")
        np.testing.assert_allclose(together, np.load(tmp_path / "one.npy"), rtol=1e-5, atol=1e-6)


def test_several_lights_on_gloss_at_vertices(folder, done, tmp_path):
    words = ["--light", "sky", "--light", "studio", "--eye", "1,2,3"]
    done("shade", folder / "glossy.safetensors", "-o", tmp_path / "of {light}.npy", *words)
    done("shade", folder / "glossy.safetensors", "-o", tmp_path / "one.npy", "--light", "sky", "--eye", "1,2,3")
    np.testing.assert_allclose(np.load(tmp_path / "of sky.npy"), np.load(tmp_path / "one.npy"), rtol=1e-4, atol=1e-5)


def test_a_picture_is_that_of_render(bake, done, tmp_path):
    done("render", bake, "-o", tmp_path / "a.png", "--size", "40x30", "--light", "sky")
    assert np.asarray(Image.open(tmp_path / "a.png")).shape == (30, 40, 3)


def test_export_writes_the_lit_model(bake, done, tmp_path):
    said = done("export", bake, "-o", tmp_path / "a.glb", "--light", "sky")
    assert "216 texels under sky" in said
    assert "TEXCOORD_1" in said
    done("shade", bake, "-o", tmp_path / "b.glb", "--light", "sky")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_a_light_of_a_model_at_vertices_is_refused(folder, refused, tmp_path):
    arguments = ["export", folder / "glossy.safetensors", "-o", tmp_path / "a.glb", "--light", "sky"]
    refused("--light is given", "transfer for every light", arguments=arguments)
