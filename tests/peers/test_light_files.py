"""Do Radiance and OpenEXR files that Mitsuba writes read as Mitsuba reads them?"""

import numpy as np
import pytest

from torchprt import light

mitsuba = pytest.importorskip("mitsuba")


@pytest.mark.parametrize("width", [5, 64])
@pytest.mark.parametrize("suffix", ["hdr", "exr"])
def test_files_of_mitsuba_read_bit_for_bit(tmp_path, suffix, width):
    mitsuba.set_variant("scalar_rgb")
    random = np.random.default_rng(width)
    pixels = random.uniform(0.2, 1, (32, width, 3)) * 10.0 ** random.integers(-3, 4, (32, width, 1))
    pixels[5:9] = pixels[5, 3]
    path = tmp_path / f"image.{suffix}"
    mitsuba.Bitmap(pixels.astype(np.float32)).write(str(path))
    theirs = np.array(mitsuba.Bitmap(str(path)), dtype=np.float32)
    assert np.array_equal(light.read(path).numpy(), theirs)
