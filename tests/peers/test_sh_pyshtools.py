"""Against pyshtools: cilm arrays, orthonormal and without the Condon-Shortley sign."""

import warnings

import numpy as np
import pytest
import torch

from torchprt import sh

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pyshtools = pytest.importorskip("pyshtools")


def latitude_longitude(directions):
    x, y, z = directions.T.numpy()
    return np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x))


@pytest.mark.parametrize("order", [2, 6, 20])
def test_the_converted_light_is_the_same_function(order):
    light = torch.randn(order**2, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    directions, _ = sh.fibonacci(50)
    latitude, longitude = latitude_longitude(directions)
    ours = sh.evaluate(light, directions).T.numpy()
    for cilm, values in zip(sh.to_pyshtools(light).numpy(), ours, strict=True):
        theirs = pyshtools.SHCoeffs.from_array(cilm, normalization="ortho", csphase=1)
        # Degrees and back cost some eps of the angle, times the band.
        np.testing.assert_allclose(theirs.expand(lat=latitude, lon=longitude), values, atol=1e-13 * order)


def test_their_coefficients_become_our_light():
    cilm = np.zeros((2, 4, 4))
    cilm[0, 1, 0], cilm[1, 3, 2], cilm[0, 2, 1] = 0.5, -1.25, 2.0
    light = sh.from_pyshtools(torch.from_numpy(cilm)[None])
    directions, _ = sh.fibonacci(30)
    latitude, longitude = latitude_longitude(directions)
    theirs = pyshtools.SHCoeffs.from_array(cilm, normalization="ortho", csphase=1)
    np.testing.assert_allclose(
        sh.evaluate(light, directions)[:, 0].numpy(), theirs.expand(lat=latitude, lon=longitude), atol=1e-13
    )
