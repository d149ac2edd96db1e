import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError

PAIRS = [
    (sh.to_sign_free, sh.from_sign_free),
    (sh.to_e3nn, sh.from_e3nn),
    (sh.to_pyshtools, sh.from_pyshtools),
]


@pytest.mark.parametrize(("to", "back"), PAIRS)
@pytest.mark.parametrize("order", [1, 2, 7])
@pytest.mark.parametrize("batch", [(), (4,), (0, 2)])
def test_there_and_back_is_the_same_light(to, back, order, batch):
    light = torch.randn(*batch, order**2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    # e3nn's axes are a dense rotation a band; the others only move numbers.
    torch.testing.assert_close(back(to(light)), light, atol=1e-13, rtol=0)


@pytest.mark.parametrize("to", [to for to, _ in PAIRS])
def test_refuses_counts_that_are_not_square(to):
    with pytest.raises(InputError, match="square"):
        to(torch.zeros(5, 3))


def test_refuses_an_empty_cilm():
    with pytest.raises(InputError, match="empty"):
        sh.from_pyshtools(torch.zeros(3, 2, 0, 0))
