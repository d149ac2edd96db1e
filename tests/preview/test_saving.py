"""Do pictures keep their colours in the formats that people have, and turntables their pace?"""

import sys

import numpy as np
import PIL.Image
import pytest
import torch
from faults import room_for

from torchprt.errors import InputError
from torchprt.preview import save_movie, save_mp4, save_picture
from torchprt.preview.saving import numbered
from torchprt.preview.video import measure_video


def gradient(height=16, width=24, opacity=None):
    """Smooth, as pictures are: what compression loses of it is little."""
    y, x = torch.meshgrid(torch.linspace(0, 1, height), torch.linspace(0, 1, width), indexing="ij")
    channels = [x, y, 0.5 * (x + y)] + ([] if opacity is None else [torch.full_like(x, opacity)])
    return torch.stack(channels, -1)


def read(path, mode="RGB"):
    with PIL.Image.open(path) as opened:
        return torch.from_numpy(np.asarray(opened.convert(mode)).copy()).float() / 255


# What it refuses


def test_refuses_another_suffix(tmp_path):
    with pytest.raises(InputError, match=r"a\.bmp must end in \.png, \.jpg, \.jpeg or \.webp"):
        save_picture(gradient(), tmp_path / "a.bmp")
    with pytest.raises(InputError, match=r"a\.png must end in \.gif, \.webp or \.mp4, or have #"):
        save_movie([gradient()], tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("pictures", [[], [gradient(), gradient(8)]])
@pytest.mark.parametrize("name", ["a.gif", "a.webp", "a.mp4", "a-#.png"])
def test_refuses_no_pictures_or_of_several_sizes(pictures, name, tmp_path):
    with pytest.raises(InputError, match="one or more, all of one size"):
        save_movie(pictures, tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "rate"), [("a.gif", 51), ("a.webp", 51), ("a.webp", 0), ("a.mp4", 121), ("a.mp4", -1)]
)
def test_refuses_a_pace_that_no_viewer_keeps(name, rate, tmp_path):
    with pytest.raises(InputError, match="up to"):
        save_movie([gradient()] * 2, tmp_path / name, rate)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.jpg", "a.gif", "a.mp4"])
def test_refuses_opacity_where_it_would_be_lost(name, tmp_path):
    save = save_picture if name == "a.jpg" else lambda picture, path: save_movie([picture], path)
    with pytest.raises(InputError, match=r"cannot hold transparency: write \.png or \.webp"):
        save(gradient(opacity=0.5), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_video_without_its_package_is_a_sentence(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"a video needs the package av: pip install 'torchprt\[video\]'"):
        save_mp4([gradient()], tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


# Pictures


@pytest.mark.parametrize(("name", "loss"), [("a.png", 0.51 / 255), ("a.jpg", 0.02), ("a.JPEG", 0.02), ("a.webp", 0.03)])
def test_a_picture_keeps_its_colours(name, loss, tmp_path):
    save_picture(gradient(64, 96), tmp_path / name)
    assert float((read(tmp_path / name) - gradient(64, 96)).abs().mean()) < loss
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["a.png", "a.webp"])
def test_opacity_is_kept(name, tmp_path):
    save_picture(gradient(opacity=0.5), tmp_path / name)
    torch.testing.assert_close(read(tmp_path / name, "RGBA")[..., 3], torch.full((16, 24), 128 / 255))


# Turntables


@pytest.mark.parametrize("name", ["a.webp", "a.gif"])
def test_an_animation_repeats_and_has_its_pace(name, tmp_path):
    shown = [gradient() * value for value in (0.2, 0.6, 1.0)]
    save_movie(shown, tmp_path / name, 20)
    with PIL.Image.open(tmp_path / name) as opened:
        assert opened.n_frames == 3
        assert opened.info["loop"] == 0
        for number, wanted in enumerate(shown):
            opened.seek(number)
            opened.load()
            assert opened.info["duration"] == 50
            found = torch.from_numpy(np.asarray(opened.convert("RGB")).copy()).float() / 255
            assert float((found - wanted).abs().mean()) < 0.05


def test_times_of_an_animation_add_up(tmp_path):
    # Thirty a second are no whole milliseconds.
    save_movie([gradient() * number / 30 for number in range(30)], tmp_path / "a.webp", 30)
    total = 0
    with PIL.Image.open(tmp_path / "a.webp") as opened:
        for number in range(opened.n_frames):
            opened.seek(number)
            opened.load()
            total += opened.info["duration"]
    assert total == 1000


@pytest.mark.parametrize(("height", "width"), [(64, 96), (63, 97)])
def test_a_video_has_every_picture_and_its_colours(height, width, tmp_path):
    av = pytest.importorskip("av")
    shown = [gradient(height, width) * value for value in (0.3, 0.6, 0.9)]
    save_mp4(shown, tmp_path / "a.mp4", 24)
    assert measure_video(tmp_path / "a.mp4") == (3, (width + width % 2, height + height % 2), pytest.approx(3 / 24))
    with av.open(str(tmp_path / "a.mp4")) as file:
        found = [torch.from_numpy(frame.to_ndarray(format="rgb24")).float() / 255 for frame in file.decode(video=0)]
    for frame, wanted in zip(found, shown, strict=True):
        # Colour has half the resolution, and 16 to 235 hold black to white.
        assert float((frame[:height, :width] - wanted).abs().mean()) < 0.02
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.mp4"]


def test_numbered_files(tmp_path):
    save_movie([gradient() * value for value in (0.5, 1.0)], tmp_path / "a-###.png")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a-000.png", "a-001.png"]
    torch.testing.assert_close(read(tmp_path / "a-001.png"), gradient(), rtol=0, atol=0.51 / 255)
    assert numbered("a#b##.png", 1234) == "a#b1234.png"


def test_a_picture_of_the_window_that_finds_no_room_is_told_of_and_the_window_stays(tmp_path):
    from types import SimpleNamespace

    from torchprt.preview.window import Window

    told, window = [], object.__new__(Window)
    noise = torch.rand(20, 30, 3).numpy()
    window.viewer = SimpleNamespace(capture_screen_float_buffer=lambda do_render: noise)
    window.pictures, window.say = tmp_path, told.append
    with room_for(100):
        window._save()
    assert "preview-1.png cannot be written" in told[0]
    assert not list(tmp_path.iterdir())
    window._save()
    assert told[1] == f"saved: {tmp_path / 'preview-1.png'}"


def test_a_still_after_a_turntable_is_a_still(tmp_path):
    save_movie([gradient(), gradient()], tmp_path / "a.webp")
    save_picture(gradient(8, 12), tmp_path / "b.webp")
    with PIL.Image.open(tmp_path / "b.webp") as opened:
        assert (opened.size, opened.n_frames) == ((12, 8), 1)
