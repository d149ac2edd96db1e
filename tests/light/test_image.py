"""Does reading an image give the radiance that was written, and refuse what cannot be used?"""

import struct
import warnings
import zlib

import numpy as np
import OpenEXR
import PIL.Image
import pytest
import torch

from torchprt.errors import InputError
from torchprt.light import DamagedImageWarning, inspect, read, read_with_report
from torchprt.light.rgbe import read_rgbe


@pytest.fixture
def pixels():
    return np.random.default_rng(1).uniform(0.01, 100.0, (16, 32, 3)).astype(np.float32)


def write_exr(path, channels, **header):
    full = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(full, channels) as file:
        file.write(str(path))
    return path


def quads_of(pixels):
    """Shared-exponent bytes by frexp, one pixel at a time."""
    quads = np.zeros((*pixels.shape[:2], 4), np.uint8)
    for index in np.ndindex(pixels.shape[:2]):
        largest = float(pixels[index].max())
        if largest > 1e-32:
            _, exponent = np.frexp(largest)
            quads[index] = [*(int(value * 256.0 / 2.0**exponent) for value in pixels[index]), exponent + 128]
    return quads


def header(height, width, size=None, extra=""):
    size = size or f"-Y {height} +X {width}"
    return f"#?RADIANCE\n{extra}FORMAT=32-bit_rle_rgbe\n\n{size}\n".encode()


def new_runs(quads):
    """Every other stretch of eight pixels as a run where it is constant, the others as literals."""
    out = bytearray()
    for row in quads:
        out += bytes([2, 2, len(row) >> 8, len(row) & 255])
        for component in row.T:
            start = 0
            while start < len(component):
                piece = component[start : start + 8]
                constant = len(set(piece.tolist())) == 1
                out += bytes([128 + len(piece), piece[0]]) if constant else bytes([len(piece), *piece])
                start += 8
    return bytes(out)


def old_runs(quads):
    out, flat = bytearray(), quads.reshape(-1, 4)
    index = 0
    while index < len(flat):
        end = index
        while end + 1 < len(flat) and (flat[end + 1] == flat[index]).all():
            end += 1
        out += bytes(flat[index])
        repeats = end - index
        while repeats:
            out += bytes([1, 1, 1, repeats & 255])
            repeats >>= 8
        index = end + 1
    return bytes(out)


# Misuse first.


@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.png"])
def test_refuses_a_missing_an_empty_and_a_foreign_file_by_name(tmp_path, name):
    path = tmp_path / name
    with pytest.raises(InputError, match=name):
        read(path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match=f"{name} is empty"):
        read(path)
    path.write_bytes(b"ply\nformat ascii 1.0\n")
    with pytest.raises(InputError, match=f"{name} is no image"):
        read(path)
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path)


def test_refuses_an_exr_cut_anywhere(tmp_path, pixels):
    whole = write_exr(tmp_path / "whole.exr", {"RGB": np.tile(pixels, (4, 4, 1))}).read_bytes()
    path = tmp_path / "cut.exr"
    for length in {4, 8, 100, *range(300, len(whole), len(whole) // 9), len(whole) - 1}:
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"cut\.exr is damaged or truncated"):
            read(path)


@pytest.mark.parametrize("coding", [new_runs, old_runs, lambda quads: quads.tobytes()])
def test_refuses_a_radiance_picture_cut_anywhere(tmp_path, pixels, coding):
    whole = header(16, 32) + coding(quads_of(pixels))
    path = tmp_path / "cut.hdr"
    for length in {2, 20, 50, 60, *range(70, len(whole), len(whole) // 9), len(whole) - 1}:
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"cut\.hdr"):
            read(path)


@pytest.mark.parametrize(
    "content",
    [
        header(16, 32, "16 by 32"),
        header(16, 32, "-Y 16 +Y 32"),
        b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n\1\2\3\4",
        header(1, 1, extra="EXPOSURE=much\n") + b"\1\2\3\4",
        header(1, 2) + b"\1\1\1\1\1\1\1\1",
        header(1, 2) + b"\3\2\1\x80\1\1\1\5",
        header(999999, 999999),
        header(1, 16) + b"\2\2\0\7" + bytes(100),
    ],
)
def test_refuses_a_damaged_radiance_picture(tmp_path, content):
    path = tmp_path / "bad.hdr"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.hdr"):
        read(path)


@pytest.mark.parametrize("size", ["-Y 0 +X 0", "-Y 0 +X 8", "-Y 8 +X 0"])
def test_refuses_an_image_without_pixels(tmp_path, size):
    path = tmp_path / "none.hdr"
    path.write_bytes(header(0, 0, size))
    with pytest.raises(InputError, match="no pixels"):
        read(path)
    with pytest.raises(InputError, match="no pixels"):
        inspect(torch.zeros(0, 4, 3))


def test_refuses_a_truncated_picture_and_a_colour_png_of_16_bits(tmp_path):
    picture = PIL.Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 128, 3), np.uint8))
    for suffix in ("png", "jpg"):
        path = tmp_path / f"cut.{suffix}"
        picture.save(path)
        path.write_bytes(path.read_bytes()[:3000])
        with pytest.raises(InputError, match="damaged or truncated"):
            read(path)

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    deep = tmp_path / "deep.png"
    lines = b"".join(b"\0" + bytes(12) for _ in range(2))
    deep.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", 2, 2, 16, 2, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(lines))
        + chunk(b"IEND", b"")
    )
    with pytest.raises(InputError, match="16 bits"):
        read(deep)


def test_refuses_an_exr_that_would_be_read_wrongly(tmp_path, pixels):
    plane = np.ascontiguousarray(pixels[..., 0])
    with pytest.raises(InputError, match="no channels R, G, B"):
        read(write_exr(tmp_path / "depth.exr", {"Z": plane}))
    with pytest.raises(InputError, match="several layers"):
        read(write_exr(tmp_path / "layers.exr", {f"{a}.{b}": plane for a in "LM" for b in "RGB"}))
    window = (np.array([0, 0], np.int32), np.array([63, 31], np.int32))
    with pytest.raises(InputError, match="crop"):
        read(write_exr(tmp_path / "crop.exr", {"RGB": pixels}, displayWindow=window))
    acescg = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    with pytest.raises(InputError, match="primaries"):
        read(write_exr(tmp_path / "aces.exr", {"RGB": pixels}, chromaticities=acescg))


# What was written is what is read.


@pytest.mark.parametrize("kind", ["scan lines", "tiles"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("names", ["RGB", "RGBA", "R G B", "b g r a", "Combined.R Combined.G Combined.B depth.Z"])
def test_reads_back_every_exr_exactly(tmp_path, pixels, kind, dtype, names):
    stored = pixels.astype(dtype)
    alpha = np.full_like(stored[..., :1], 0.5)
    if names in ("RGB", "RGBA"):
        channels = {names: np.concatenate([stored, alpha], -1)[..., : len(names)].copy()}
    else:
        planes = {"r": 0, "g": 1, "b": 2}
        channels = {
            name: np.ascontiguousarray(stored[..., planes[last]] if last in planes else alpha[..., 0])
            for name, last in ((name, name.split(".")[-1].lower()) for name in names.split())
        }
    tiles = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()} if kind == "tiles" else {}
    image = read(write_exr(tmp_path / "image.exr", channels, **tiles))
    assert image.dtype == torch.float32
    assert np.array_equal(image.numpy(), stored.astype(np.float32))


def test_repeats_luminance_alone(tmp_path, pixels):
    plane = np.ascontiguousarray(pixels[..., 0])
    image = read(write_exr(tmp_path / "y.exr", {"Y": plane}))
    assert np.array_equal(image.numpy(), np.repeat(plane[..., None], 3, -1))


def flat(quads):
    return quads.tobytes()


# New runs need at least eight pixels in a line.
CODINGS = [(new_runs, (8, 300)), (old_runs, (1, 7, 8, 300)), (flat, (1, 7, 8, 300))]


@pytest.mark.parametrize(("coding", "width"), [(coding, width) for coding, widths in CODINGS for width in widths])
def test_reads_back_every_coding_of_a_radiance_picture(tmp_path, coding, width):
    random = np.random.default_rng(width)
    pixels = random.uniform(0, 1, (6, width, 3)).astype(np.float32) * np.float32(10.0) ** random.integers(-6, 6)
    pixels[2:4] = pixels[2, 0]  # a run longer than 255, across scan lines
    pixels[5] = 0
    quads = quads_of(pixels)
    path = tmp_path / "image.hdr"
    path.write_bytes(header(6, width) + coding(quads) + b"trailing")
    image = read(path).numpy()
    exact = np.ldexp(quads[..., :3].astype(np.float64), quads[..., 3:].astype(int) - 136)
    exact[quads[..., 3] == 0] = 0
    assert np.array_equal(image, exact.astype(np.float32))
    # A mantissa has eight bits, cut: one part in 128 of the largest channel.
    assert (np.abs(image - pixels) <= pixels.max(-1, keepdims=True) / 128).all()


def test_radiance_pictures_turn_and_undo_their_exposure(tmp_path):
    quads = quads_of(np.random.default_rng(3).uniform(1, 2, (4, 8, 3)).astype(np.float32))
    path = tmp_path / "image.hdr"

    def image_of(stored, size, extra=""):
        path.write_bytes(header(0, 0, size, extra) + stored.tobytes())
        return read_rgbe(path)

    upright = image_of(quads, "-Y 4 +X 8")
    assert np.array_equal(image_of(quads[::-1], "+Y 4 +X 8"), upright)
    assert np.array_equal(image_of(quads[:, ::-1], "-Y 4 -X 8"), upright)
    assert np.array_equal(image_of(quads.transpose(1, 0, 2), "+X 8 -Y 4"), upright)
    assert np.array_equal(image_of(quads.transpose(1, 0, 2)[::-1, ::-1], "-X 8 +Y 4"), upright)
    exposed = image_of(quads, "-Y 4 +X 8", "EXPOSURE=2\nEXPOSURE=4\nCOLORCORR=1 2 4\n")
    assert np.array_equal(exposed * np.float32([8, 16, 32]), upright)


def test_decodes_srgb_of_8_and_16_bits(tmp_path):
    ramp = np.arange(256, dtype=np.uint8).reshape(8, 32)
    grey = tmp_path / "grey.png"
    PIL.Image.fromarray(ramp).save(grey)
    alpha = tmp_path / "alpha.png"
    PIL.Image.fromarray(np.stack([ramp, ramp, ramp, ramp], -1), "RGBA").save(alpha)
    deep = tmp_path / "deep.png"
    PIL.Image.fromarray(ramp.astype(np.uint16) * 257).save(deep)
    for path in (grey, alpha, deep):
        image = read(path)
        value = image[..., 1].flatten().double()
        assert (image == image[..., :1]).all()
        assert value[0] == 0
        assert value[255] == 1
        # Encoded again by the standard's other direction, each level comes back.
        back = torch.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
        assert torch.allclose(back * 255, torch.arange(256.0).double(), atol=1e-3)


# Damage.


def test_negative_values_become_zero_and_are_told(tmp_path, pixels):
    pixels[3, 4] = [-1, 2, -5]
    path = write_exr(tmp_path / "negative.exr", {"RGB": pixels})
    with pytest.warns(DamagedImageWarning, match=r"negative\.exr: 2 values are negative, down to -5: .* set to 0"):
        image = read(path)
    assert np.array_equal(image.numpy(), np.maximum(pixels, 0))


def test_values_that_are_not_finite_are_refused_or_mended(tmp_path, pixels):
    pixels[:] = 1
    pixels[5, 0, 0] = np.nan
    pixels[5, 31, 0] = 3
    pixels[4, :2, 0] = 7
    pixels[6, :2, 0] = 9
    pixels[0, 9:14, 1] = np.inf
    path = write_exr(tmp_path / "broken.exr", {"RGB": pixels})
    with pytest.raises(InputError, match=r"broken\.exr holds 1 NaN and 5 infinite values.*repair=True"):
        read(path)
    image, report = read_with_report(path, repair=True)
    # Neighbours across the seam count: 1, 1, 1, 3, 7, 7, 9, 9 has the lower middle 3.
    assert image[5, 0, 0] == 3
    assert (image[0, 9:14, 1] == 1).all()
    assert report.repaired
    assert report.damaged
    assert "median of their finite neighbours" in str(report)
    with pytest.warns(DamagedImageWarning, match="1 NaN and 5 infinite"):
        read(path, repair=True)
    pixels[..., 2] = np.nan
    with pytest.raises(InputError, match="without any finite value"):
        read(write_exr(tmp_path / "hopeless.exr", {"RGB": pixels}), repair=True)


def test_a_hole_fills_from_its_border_inward():
    from torchprt.light.damage import mend

    image = torch.ones(9, 18, 3, dtype=torch.float64)
    image[1:8, 2:9] = float("nan")
    mended, report = mend(image, "hole", repair=True)
    assert (mended == 1).all()
    assert report.nan == 7 * 7 * 3


def test_a_sound_image_is_read_without_a_word(tmp_path, pixels):
    path = write_exr(tmp_path / "sound.exr", {"RGB": pixels})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(path)
    report = read_with_report(path)[1]
    assert not report.damaged
    assert "no damage" in str(report)
    assert (report.minimum, report.maximum) == (float(pixels.min()), float(pixels.max()))


def test_a_sun_with_a_dead_channel_is_reported_and_a_dark_blue_sky_is_not():
    image = torch.ones(32, 64, 3)
    image[10:] *= torch.tensor([0.0, 0.0, 1.0])
    assert inspect(image).dead_channels == ()
    image[3, 3] = torch.tensor([0.0, 1e-4, 5000.0])
    report = inspect(image)
    assert report.dead_channels == ("red", "green")
    assert report.dead_pixels == 1
    assert str(report).startswith("red or green is zero in 1 of the brightest pixels (up to 5000)")


def test_real_photographs_hold_what_is_known_of_them(data):
    paths = sorted((data / "hdri").glob("*.exr"))
    assert len(paths) >= 6
    for path in paths:
        with pytest.warns(DamagedImageWarning, match="negative"):
            image = read(path)
        _, report = read_with_report(path)
        with OpenEXR.File(str(path)) as file:
            raw = file.channels()["RGB"].pixels.astype(np.float32)
        assert report.negative == (raw < 0).sum() > 0
        assert report.lowest == -raw.min()
        assert np.array_equal(image.numpy(), np.maximum(raw, 0))
        assert report.dead_channels == (("red", "green") if path.stem == "park" else ())
