import math

import numpy as np
import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError


def by_quadrature(function, order, start=0.0):
    """A_l = 2 pi int h(z) P_l(z) dz over [start, 1] where `function` is smooth, by Gauss-Legendre."""
    # 64 nodes are exact up to degree 127.
    nodes, weights = np.polynomial.legendre.leggauss(64)
    z = start + (1 - start) * (nodes + 1) / 2
    legendre = np.polynomial.legendre.legvander(z, order - 1)
    return torch.from_numpy(2 * np.pi * (weights * (1 - start) / 2 * function(z)) @ legendre)


@pytest.mark.parametrize("call", [sh.clamped_cosine, lambda n: sh.phong(1.0, n), lambda n: sh.disc(0.1, n)])
def test_refuses_an_order_below_one(call):
    with pytest.raises(InputError, match="order"):
        call(0)


def test_refuses_impossible_lobes_and_caps():
    with pytest.raises(InputError, match="exponent"):
        sh.phong(-1.0, 3)
    for angle in (-0.1, 3.2, math.nan):
        with pytest.raises(InputError, match="half_angle"):
            sh.disc(angle, 3)


def test_refuses_a_kernel_of_another_order():
    with pytest.raises(InputError, match="2 bands but the light has order 3"):
        sh.convolve(torch.zeros(9, 3), torch.ones(2))


@pytest.mark.parametrize("order", [1, 2, 9, 32])
def test_clamped_cosine_is_its_integral(order):
    ours = sh.clamped_cosine(order)
    # The weights of the reference are good to some 1e-14.
    torch.testing.assert_close(ours, by_quadrature(lambda z: z, order), atol=5e-14, rtol=0)
    published = torch.tensor([math.pi, 2 * math.pi / 3, math.pi / 4, 0, -math.pi / 24, 0, math.pi / 64])[:order]
    torch.testing.assert_close(ours[:7].float(), published)


@pytest.mark.parametrize("exponent", [0, 1, 2, 7, 100])
def test_a_phong_lobe_is_its_integral(exponent):
    lobe = by_quadrature(lambda z: (exponent + 1) / (2 * np.pi) * z**exponent, 20)
    # Nodes near 1 are raised to the exponent, and their rounding with them.
    torch.testing.assert_close(sh.phong(exponent, 20), lobe, atol=1e-13 * (1 + exponent), rtol=0)


def test_a_phong_lobe_of_exponent_one_is_the_clamped_cosine_over_pi():
    torch.testing.assert_close(sh.phong(1, 32) * math.pi, sh.clamped_cosine(32), atol=1e-15, rtol=1e-14)


def test_phong_lobes_stay_stable_up_to_a_million():
    mpmath = pytest.importorskip("mpmath")
    for k in (1e-3, 0.5, 1e4, 1e6):
        # Exact for l = 31: (k+1) int z^k P_l dz, from the coefficients of P_l, with 60 digits.
        with mpmath.workdps(60):
            coefficients = mpmath.taylor(lambda z: mpmath.legendre(31, z), 0, 31)
            exact = sum(c * (mpmath.mpf(k) + 1) / (mpmath.mpf(k) + j + 1) for j, c in enumerate(coefficients))
        assert sh.phong(k, 32)[31].item() == pytest.approx(float(exact), rel=1e-13, abs=1e-18)


def test_phong_lobes_are_learnable_and_batched():
    exponent = torch.tensor([0.0, 1.0, 12.5, 1e3], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda k: sh.phong(k, 8), exponent)
    for k, row in zip(exponent.tolist(), sh.phong(exponent, 8), strict=True):
        torch.testing.assert_close(row, sh.phong(k, 8), atol=0, rtol=0)


@pytest.mark.parametrize("angle", [1e-30, 1e-9, 1e-4, 0.0047, 1.0, math.pi / 2, 3.0, math.pi])
def test_a_cap_keeps_its_relative_accuracy_down_to_nothing(angle):
    mpmath = pytest.importorskip("mpmath")
    with mpmath.workdps(120):
        c = mpmath.cos(mpmath.mpf(angle))
        exact = [2 * mpmath.pi * (1 - c)] + [
            2 * mpmath.pi * (mpmath.legendre(l - 1, c) - mpmath.legendre(l + 1, c)) / (2 * l + 1) for l in range(1, 33)
        ]
        largest = max(abs(value) for value in exact)
        errors = [abs(ours - value) / largest for ours, value in zip(sh.disc(angle, 33).tolist(), exact, strict=True)]
    # The recurrence rounds three times a step, and its values grow like l^2.
    assert max(errors) < 33 * 4 * 2**-52


def test_caps_of_no_size_and_of_the_whole_sphere():
    assert torch.equal(sh.disc(0.0, 6), torch.zeros(6, dtype=torch.float64))
    whole = torch.zeros(6, dtype=torch.float64)
    whole[0] = 4 * math.pi
    torch.testing.assert_close(sh.disc(math.pi, 6), whole, atol=1e-14, rtol=0)
    angle = torch.tensor([0.1, 1.5, 3.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda a: sh.disc(a, 6), angle)


@pytest.mark.parametrize("order", [1, 4, 12])
def test_zonal_functions_depend_only_on_the_angle_to_their_axis(order):
    axis, _ = sh.fibonacci(5)
    kernel = torch.rand(order, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    light = sh.zonal(kernel, axis)
    directions, _ = sh.fibonacci(40)
    z = (directions @ axis.mT).numpy()
    l = np.arange(order)
    expected = np.polynomial.legendre.legvander(z, order - 1) @ (kernel.numpy() * (2 * l + 1) / (4 * np.pi))
    torch.testing.assert_close(
        sh.evaluate(light.mT, directions), torch.from_numpy(expected), atol=1e-13 * order, rtol=0
    )


def test_convolution_broadcasts_and_keeps_the_dtype_of_the_light():
    light, kernel = torch.ones(4, 1, 9, 3), torch.rand(5, 3, dtype=torch.float64)
    result = sh.convolve(light, kernel)
    assert result.shape == (4, 5, 9, 3)
    assert result.dtype == torch.float32
    assert torch.equal(result[2, 3, 4], kernel[3, 2].float().expand(3))
