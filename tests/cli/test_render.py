"""Does `render` show what it is asked for, and say why where it cannot?"""

import subprocess
import sys

import numpy as np
import PIL.Image
import pytest
from environments import lamp, save_exr
from transfers import KINDS, random_glossy, replaced
from zonal_transfers import random_zonal

import torchprt as prt


def pixels(path):
    with PIL.Image.open(path) as opened:
        return np.asarray(opened.convert("RGB")).astype(int)


# What render refuses


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-o", "a.tga"], ["must end in .png, .jpg, .jpeg, .webp, .gif or .mp4"]),
        (["-o", "a.gif", "--backdrop", "transparent"], ["a.gif cannot hold: write .png or .webp"]),
        (["-o", "none/a.png"], ["does not exist, make it first"]),
        (["--size", "0x5"], ["--size is '0x5'"]),
        (["--turntable", 3, "--light-turntable", 3], ["both given"]),
        (["--rate", 0], ["--rate is 0.0"]),
        (["--rate", "nan"], ["--rate is nan"]),
        (["--exposure", "inf"], ["--exposure is inf"]),
        (["--view", "0,0,0"], ["--view is '0,0,0'"]),
        (["--rotate", "1,2,3,4"], ["--rotate is '1,2,3,4'"]),
        (["--window", "x"], ["--window is 'x'"]),
        (["--tone", "x"], ["--tone is 'x'"]),
        (["--light", "none.exr"], ["none.exr"]),
        (["--light", "sunet"], ["light 'sunet'", "studio", "sunset"]),
        (["--light", "light.npy", "--background"], ["--background", "light.npy is no image"]),
        (["--background", "--backdrop", "white"], ["both given"]),
        (["--backdrop", "#12"], ["--backdrop is '#12'"]),
        (["--backdrop", "transparent", "-o", "a.gif"], ["transparent", "a.gif"]),
        (["--target", "1,2"], ["--target is '1,2'"]),
        (["--distance", 0], ["--distance is 0"]),
        (["--distance", "nan"], ["--distance is nan"]),
        (["--fov", 180], ["--fov is 180"]),
        (["--material", "phong:4"], ["--material is given"]),
    ],
)
def test_render_refuses(refused, folder, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    np.save("light.npy", np.ones((16, 3)))
    given = arguments if "-o" in arguments else [*arguments, "-o", "a.png"]
    refused(*words, arguments=["render", folder / "ball.safetensors", *given])


def test_render_refuses_more_pictures_than_anyone_wants(misused, folder, tmp_path):
    arguments = ["render", folder / "ball.safetensors", "-o", tmp_path / "a.png", "--turntable", 100_000]
    misused("--turntable", "720", arguments=arguments)


# What render writes


def test_a_still_shows_the_lamp_on_its_side(done, folder, tmp_path):
    common = ["--light", folder / "lamp.exr", "--size", "60x50", "--view", "0,0,1"]
    said = done("render", folder / "ball.safetensors", "-o", tmp_path / "a.png", *common)
    assert "1 picture of 60 x 50" in said
    shown = pixels(tmp_path / "a.png")
    assert shown.shape == (50, 60, 3)
    # The lamp is at +x, which is on the right of a camera that looks along -z.
    assert shown[20:30, 38:42].mean() > shown[20:30, 18:22].mean() + 40
    done("render", folder / "ball.safetensors", "-o", tmp_path / "b.png", *common, "--rotate", "180,0,0")
    turned = pixels(tmp_path / "b.png")
    assert turned[20:30, 38:42].mean() < turned[20:30, 18:22].mean() - 40


def test_the_background_is_the_environment(done, folder, tmp_path):
    common = ["--light", folder / "lamp.exr", "--size", "60x50", "--view", "-1,0,0"]
    for name, more in (("plain", []), ("shown", ["--background"])):
        done("render", folder / "ball.safetensors", "-o", tmp_path / f"{name}.png", *common, *more)
    plain, shown = pixels(tmp_path / "plain.png"), pixels(tmp_path / "shown.png")
    # The camera looks along +x, into the lamp: behind the ball, and wider than it.
    assert np.array_equal(plain[25, 30], shown[25, 30])
    assert shown[1, 1].max() < plain[1, 1].max() or shown[25, 2].max() > plain[25, 2].max()
    assert not np.array_equal(plain[0], shown[0])


def test_exposure_is_taken_from_the_light_unless_it_is_given(done, folder, tmp_path):
    save_exr(tmp_path / "dim.exr", lamp((1.0, 0.0, 0.0)) / 64)
    save_exr(tmp_path / "lamp.exr", lamp((1.0, 0.0, 0.0)))
    shown = {}
    for name, light, more in (("a", "lamp", []), ("b", "dim", []), ("c", "dim", ["--exposure", "0"])):
        arguments = ["--light", tmp_path / f"{light}.exr", "--size", "40x40", *more]
        done("render", folder / "ball.safetensors", "-o", tmp_path / f"{name}.png", *arguments)
        shown[name] = pixels(tmp_path / f"{name}.png")
    assert np.abs(shown["a"] - shown["b"]).max() <= 2
    assert shown["c"].mean() < shown["b"].mean() - 5


@pytest.mark.parametrize("which", ["--turntable", "--light-turntable"])
def test_turntables_are_sheets_or_animations(done, folder, tmp_path, which):
    common = ["--light", folder / "lamp.exr", "--size", "30x24", which, 3]
    said = done("render", folder / "ball.safetensors", "-o", tmp_path / "a.png", *common)
    assert "3 pictures of 30 x 24" in said
    assert pixels(tmp_path / "a.png").shape == (48, 60, 3)
    done("render", folder / "ball.safetensors", "-o", tmp_path / "a.gif", *common, "--rate", 10)
    with PIL.Image.open(tmp_path / "a.gif") as opened:
        assert opened.n_frames == 3
        assert opened.info["duration"] == 100


@pytest.mark.parametrize("kind", [*KINDS, "zonal", "clustered"])
def test_every_kind_of_bake_is_rendered(done, make_transfer, tmp_path, kind):
    flat = make_transfer(side=4, order=4)
    if kind == "zonal":
        transfer = random_zonal(side=4, order=4)
    elif kind == "clustered":
        transfer = prt.compress(flat, clusters=2, components=1)
    else:
        transfer = replaced(random_glossy(kind, vertices=16, glossy=9), positions=flat.positions, faces=flat.faces)
    prt.save_transfer(transfer, tmp_path / "a.safetensors")
    more = ["--material", "phong:4"] if kind == "incident" else []
    said = done("render", tmp_path / "a.safetensors", "-o", tmp_path / "a.png", "--size", "32x24", *more)
    assert "1 picture of 32 x 24" in said
    assert pixels(tmp_path / "a.png").std() > 1


def test_rendering_needs_neither_open3d_nor_matplotlib(folder, tmp_path):
    code = (
        "import sys\n"
        f"sys.argv = ['torchprt', 'render', {str(folder / 'ball.safetensors')!r}, '-o', {str(tmp_path / 'a.png')!r}, "
        "'--size', '16x16']\n"
        "from torchprt.cli import main\n"
        "try:\n    main()\n"
        "finally:\n    print('LOADED', *[name for name in ('open3d', 'matplotlib', 'onnx') if name in sys.modules])\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-1].split() == ["LOADED"]
