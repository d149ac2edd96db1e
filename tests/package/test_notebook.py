"""Do notebooks show pictures of transfers and lights, and a line where there is none?"""

import io

import numpy as np
import PIL.Image
import pytest
import torch
from transfers import random_glossy

import torchprt
from torchprt import light
from torchprt.errors import InputError
from torchprt.preview import Picture, look, look_at_light

PNG = b"\x89PNG\r\n\x1a\n"


def pixels(png):
    with PIL.Image.open(io.BytesIO(png)) as opened:
        return torch.from_numpy(np.asarray(opened.convert("RGB")).copy()).float() / 255


# What is refused


@pytest.mark.parametrize("shape", [(3,), (8, 3), (4, 4), (16, 3, 3), (2, 9, 3)])
def test_what_is_no_light_is_refused(shape):
    with pytest.raises(InputError):
        look_at_light(torch.ones(shape))


def test_a_light_that_is_not_there_is_refused(make_transfer):
    with pytest.raises(InputError, match="nowhere"):
        look(make_transfer(), "nowhere")


def test_a_light_of_another_order_is_refused(make_transfer):
    with pytest.raises(InputError, match="order"):
        look(make_transfer(order=4), torch.ones(9, 3))


# Pictures


def test_a_picture_is_its_values(tmp_path):
    values = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(0))
    picture = Picture(values)
    assert repr(picture) == "Picture(7 x 5)"
    torch.testing.assert_close(pixels(picture._repr_png_()), values, rtol=0, atol=0.51 / 255)
    picture.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(PNG)


def test_a_light_is_bright_where_it_comes_from():
    # Longitude 0 is -z, in the middle; +x a quarter to the right of it.
    lamp = light.disc((1.0, 0.0, 0.0), 0.5, 1.0, 5).float()
    shown = look_at_light(lamp).values.sum(-1)
    row, column = divmod(int(shown.argmax()), shown.shape[1])
    assert abs(row / shown.shape[0] - 0.5) < 0.05
    assert abs(column / shown.shape[1] - 0.75) < 0.05


def test_all_that_is_a_light_is_shown_as_one(make_transfer):
    image = light.studio(32)
    lights = ["studio", image, light.project(image, 4)]
    for each in lights:
        assert look_at_light(each).values.shape[1] == 2 * look_at_light(each).values.shape[0]
        picture = look(make_transfer(order=4), each, size=(24, 20))
        assert picture.values.shape == (20, 24, 3)
        assert float(picture.values.std()) > 0.01


# Notebooks


@pytest.fixture
def formats():
    formatters = pytest.importorskip("IPython.core.formatters")

    class Shell:
        display_formatter = formatters.DisplayFormatter()

    shell = Shell()
    torchprt.load_ipython_extension(shell)
    yield lambda shown: shell.display_formatter.format(shown)[0]
    torchprt.unload_ipython_extension(shell)
    assert "image/png" not in shell.display_formatter.format(torch.ones(9, 3))[0]


def test_transfers_and_lights_are_shown_as_pictures(formats, make_transfer):
    for shown in (make_transfer(order=3), torch.ones(9, 3), light.studio(16), look_at_light("white")):
        assert formats(shown)["image/png"].startswith(PNG)


@pytest.mark.parametrize("shape", [(4, 3), (10, 3), (9,), (4, 8, 3), (9, 4)])
def test_other_tensors_are_shown_as_always(formats, shape):
    assert list(formats(torch.ones(shape))) == ["text/plain"]
    assert list(formats(torch.ones(9, 3, dtype=torch.int32))) == ["text/plain"]


def test_what_must_be_told_more_is_a_line(formats):
    shown = formats(random_glossy("incident"))
    assert list(shown) == ["text/plain"]
    assert shown["text/plain"].startswith("Transfer(")


# Lines


def test_a_transfer_is_one_line(make_transfer):
    made = make_transfer(side=5, order=4, bounces=1, transport="interreflected", error=0.01, signal=1.0)
    assert repr(made) == (
        "Transfer(diffuse, order 4, interreflected, 1 bounce, 1 channel, 25 receivers, 0.0 MB, error 1.00%)"
    )


def test_parts_say_shapes_and_not_numbers(make_transfer):
    made = make_transfer(side=5, order=4)
    layer = made.layers["diffuse"]
    assert repr(layer.signal) == "Dense(values=float32[1, 16, 25])"
    assert repr(layer) == "Diffuse(Dense(values=float32[1, 16, 25]), albedo=float32[25, 3])"
    assert "tensor(" not in repr(made.receivers) + repr(random_glossy("exit").layers)
