import math

import numpy as np
import pytest
import torch

from torchprt import sh
from torchprt.brdf import membrane
from torchprt.errors import InputError


@pytest.mark.parametrize("translucency", [-0.1, 1.1, math.nan])
def test_refuses_a_translucency_out_of_range(translucency):
    with pytest.raises(InputError, match="translucency"):
        membrane(translucency, 4)


def test_refuses_an_order_below_one():
    with pytest.raises(InputError, match="order"):
        membrane(0.3, 0)


def test_the_published_values():
    published = torch.tensor([1.3, 0.466667, 0.325, 0, -0.0541667, 0, 0.0203125, 0], dtype=torch.float64)
    # Printed to six digits.
    torch.testing.assert_close(membrane(0.3, 8), published, atol=5e-7, rtol=0)


@pytest.mark.parametrize("translucency", [0, 0.3, 1.0])
@pytest.mark.parametrize("order", [1, 2, 3, 32])
def test_agrees_with_quadrature(translucency, order):
    nodes, weights = np.polynomial.legendre.leggauss(64)
    z = (nodes + 1) / 2
    front, back = (np.polynomial.legendre.legvander(side * z, order - 1) for side in (1, -1))
    expected = (weights * z) @ front + translucency * (weights * z) @ back
    torch.testing.assert_close(membrane(translucency, order), torch.from_numpy(expected), atol=1e-14, rtol=0)


def test_an_opaque_sheet_is_a_clamped_cosine():
    torch.testing.assert_close(membrane(0, 9), sh.clamped_cosine(9) / math.pi, atol=1e-15, rtol=0)


def test_gradients_flow_to_the_translucency():
    translucency = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: membrane(t, 6), translucency)
