"""Are the pictures of a turntable those of the cameras and lights around the model?"""

import math

import numpy as np
import PIL.Image
import pytest
import torch
from transfers import random_glossy, replaced

from torchprt import light, sh
from torchprt.errors import InputError
from torchprt.preview import Environment, Orbit, Still, Studio, frame, save_gif, strip
from torchprt.shade import shader

SIZE = (24, 20)


def environment(image=True):
    picture = light.studio(16)
    return Environment("studio", light.project(picture, 4), picture if image else None)


@pytest.fixture
def transfer(make_transfer):
    return make_transfer(side=6, order=4)


def studio(transfer, **options):
    return Studio(transfer, shader(transfer), environment(), size=SIZE, **options)


def picture(value, height=4, width=6):
    return torch.full((height, width, 3), value)


# What it refuses


def test_refuses_a_backdrop_that_is_not_there(transfer):
    with pytest.raises(InputError, match="studio has no image"):
        Studio(transfer, shader(transfer), environment(image=False), background="environment")


@pytest.mark.parametrize("count", [0, -3])
def test_refuses_a_turntable_of_nothing(transfer, count):
    orbit = Orbit.around(transfer.positions)
    with pytest.raises(InputError, match="one or more"):
        list(studio(transfer).turntable(count, orbit, torch.eye(3)))
    with pytest.raises(InputError, match="one or more"):
        list(studio(transfer).light_turntable(count, orbit.camera(), torch.eye(3)))


@pytest.mark.parametrize("pictures", [[], [picture(0.0), picture(0.0, 5)]])
def test_refuses_a_strip_of_nothing_or_of_several_sizes(pictures):
    with pytest.raises(InputError, match="strip"):
        strip(pictures)


@pytest.mark.parametrize(("count", "rate"), [(0, 15.0), (2, 0.0), (2, -1.0), (2, 51.0), (2, math.nan)])
def test_refuses_an_animation_of_nothing_or_at_no_rate(count, rate, tmp_path):
    with pytest.raises(InputError, match="rate up to 50"):
        save_gif([picture(0.5)] * count, tmp_path / "a.gif", rate)
    assert not list(tmp_path.iterdir())


# Pictures


def test_a_picture_is_the_still_of_the_shaded_model(transfer):
    camera = frame(transfer.positions, aspect=SIZE[0] / SIZE[1])
    turn = sh.yaw_pitch_roll(torch.tensor([40.0, 10.0, 0.0]))
    found = studio(transfer, exposure=-1.0).picture(camera, turn)
    still = Still(transfer.positions, transfer.faces, size=SIZE, camera=camera)
    with torch.no_grad():
        wanted = still.picture(shader(transfer)(environment().light, turn), exposure=-1.0)
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-5)


def test_behind_the_model_is_the_turned_environment(transfer):
    camera = Orbit.around(transfer.positions, (0.3, 0.2, 1.0)).camera()
    turn = sh.yaw_pitch_roll(torch.tensor([90.0, 0.0, 0.0]))
    # One texel in four is a colour of its own, so a turn by a quarter shows as columns that move by a quarter.
    # As fine as the pixels are, so that it is shown as it is.
    image = torch.rand(64, 128, 3, generator=torch.Generator().manual_seed(0))
    around = {}
    for name, shown, rotation in (("turned", image, turn), ("moved", image.roll(-32, 1), torch.eye(3))):
        behind = Environment(name, environment().light, shown)
        made = Studio(transfer, shader(transfer), behind, size=SIZE, background="environment", tone="none")
        around[name] = made.picture(camera, rotation)
    edge = torch.ones(SIZE[1], SIZE[0], dtype=torch.bool)
    edge[2:-2, 2:-2] = False
    torch.testing.assert_close(around["turned"][edge], around["moved"][edge], rtol=0, atol=1e-3)
    assert float(around["moved"][edge].std()) > 0.05


def test_the_environment_behind_is_exposed_as_the_model_is(transfer):
    camera = frame(transfer.positions, aspect=SIZE[0] / SIZE[1])
    dark, bright = (
        studio(transfer, exposure=stops, background="environment").picture(camera, torch.eye(3))
        for stops in (-3.0, 0.0)
    )
    assert bool((bright[0] > dark[0]).all())


def test_the_camera_goes_once_around_and_sees_the_other_side(transfer):
    orbit = Orbit.around(transfer.positions, (1.0, 0.4, 0.3), sides=4)
    pictures = list(studio(transfer).turntable(4, orbit, torch.eye(3)))
    assert len(pictures) == 4
    torch.testing.assert_close(pictures[0], studio(transfer).picture(orbit.camera(), torch.eye(3)))
    behind = orbit.turned(math.pi, 0.0).camera()
    torch.testing.assert_close(pictures[2], studio(transfer).picture(behind, torch.eye(3)), rtol=0, atol=1e-3)
    assert not torch.allclose(pictures[0], pictures[2], atol=0.01)


def test_the_light_goes_once_around_and_the_model_stands(transfer):
    camera = frame(transfer.positions, aspect=SIZE[0] / SIZE[1])
    turn = sh.yaw_pitch_roll(torch.tensor([10.0, 20.0, 30.0]))
    pictures = list(studio(transfer).light_turntable(3, camera, turn))
    for number, found in enumerate(pictures):
        yaw = sh.yaw_pitch_roll(torch.tensor([120.0 * number, 0.0, 0.0]))
        torch.testing.assert_close(found, studio(transfer).picture(camera, yaw @ turn), rtol=0, atol=1e-5)
    assert not torch.allclose(pictures[0], pictures[1], atol=0.01)


def test_rays_are_traced_once_for_a_light_that_goes_around(transfer, monkeypatch):
    made = []

    class Counted(Still):
        def __init__(self, *arguments, **options):
            made.append(options["camera"])
            super().__init__(*arguments, **options)

    monkeypatch.setattr("torchprt.preview.turntable.Still", Counted)
    orbit = Orbit.around(transfer.positions)
    list(studio(transfer).light_turntable(5, orbit.camera(), torch.eye(3)))
    assert len(made) == 1
    list(studio(transfer).turntable(5, orbit, torch.eye(3)))
    assert len(made) == 6


def test_glossy_pictures_are_shaded_for_the_eye_of_the_camera(transfer):
    glossy = replaced(random_glossy(vertices=36), positions=transfer.positions, faces=transfer.faces)
    orbit = Orbit.around(transfer.positions, (1.0, 0.8, 0.3), sides=3)
    found = list(
        Studio(glossy, shader(glossy), environment(), size=SIZE, exposure=0.0).turntable(3, orbit, torch.eye(3))
    )
    for number, picture in enumerate(found):
        camera = orbit.turned(-2 * math.pi * number / 3, 0.0).camera()
        with torch.no_grad():
            radiance = shader(glossy)(environment().light, eye=torch.tensor(camera.eye))
        still = Still(glossy.positions, glossy.faces, size=SIZE, camera=camera)
        torch.testing.assert_close(picture, still.picture(radiance), rtol=0, atol=1e-3)


# Files


@pytest.mark.parametrize(("count", "columns", "shape"), [(1, None, (4, 6)), (4, None, (8, 12)), (5, None, (8, 18))])
def test_a_strip_is_about_square(count, columns, shape):
    found = strip([picture((number + 1) / 10) for number in range(count)], columns)
    assert found.shape == (*shape, 3)
    for number in range(count):
        row, column = divmod(number, shape[1] // 6)
        part = found[4 * row : 4 * row + 4, 6 * column : 6 * column + 6]
        assert torch.equal(part, picture((number + 1) / 10))
    assert bool((found[4 * ((count - 1) // (shape[1] // 6)) :, 6 * ((count - 1) % (shape[1] // 6) + 1) :] == 0).all())


def test_an_animation_has_every_picture_and_its_time(tmp_path):
    pictures = [picture(value) for value in (0.0, 0.5, 1.0, 0.5)]
    save_gif(pictures, tmp_path / "a.gif", 20)
    with PIL.Image.open(tmp_path / "a.gif") as opened:
        assert opened.n_frames == 4
        assert opened.info["loop"] == 0
        for number, wanted in enumerate(pictures):
            opened.seek(number)
            assert opened.info["duration"] == 50
            shown = torch.from_numpy(np.asarray(opened.convert("RGB")).copy()).float() / 255
            torch.testing.assert_close(shown, wanted, rtol=0, atol=1.01 / 255)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.gif"]


def test_a_gif_keeps_colours_to_what_a_palette_can(tmp_path):
    ramp = torch.linspace(0, 1, 64)
    shown = torch.stack([*torch.meshgrid(ramp, ramp, indexing="ij"), torch.full((64, 64), 0.3)], -1)
    save_gif([shown], tmp_path / "a.gif")
    with PIL.Image.open(tmp_path / "a.gif") as opened:
        found = torch.from_numpy(np.asarray(opened.convert("RGB")).copy()).float() / 255
    # 255 colours for a plane of the cube: about 16 steps along each side, dithered.
    assert float((found - shown).abs().mean()) < 1 / 32
