"""Do clusters and lobes hold signals of any size, and those in which one receiver outshines all others?"""

import pytest
import torch

from torchprt.compression import clustered_pca, fit_lobes, quantise
from torchprt.errors import InputError

# The checks of shapes would take most of the time.
pytestmark = pytest.mark.usefixtures("untyped")
METHODS = ("iterative", "vq")
SIZES = {"1e-30": 1e-30, "1": 1.0, "1e30": 1e30}


def signals():
    some = torch.randn(40, 16, generator=torch.Generator().manual_seed(0))
    hot = 1e-3 * some
    hot[7] = 1e6
    return {
        "plain": some,
        "one hot receiver": hot,
        "one hot number": 1e-3 * some + 1e6 * torch.eye(40, 16),
        "all equal": some[:1].expand(40, 16).contiguous(),
        "nothing": torch.zeros(40, 16),
        "on one line": some[:, :1] * some[:1],
    }


def off(found, wanted):
    """RMS relative to the largest number, and to 1 where there is none."""
    return float((found.double() - wanted.double()).square().mean().sqrt() / (wanted.double().abs().max() or 1))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", signals())
def test_clusters_say_what_they_lose_and_lose_no_more(name, method, size):
    data = signals()[name] * SIZES[size]
    made = clustered_pca(data, 4, 0 if method == "vq" else 3, method=method)
    found = made.reconstruct()
    assert found.isfinite().all()
    lost = (found.double() - data.double()).square().sum(-1)
    torch.testing.assert_close(lost, made.error.double(), rtol=1e-2, atol=1e-9 * float(data.double().square().sum()))
    plain = clustered_pca(signals()[name], 4, 0 if method == "vq" else 3, method=method).reconstruct()
    assert off(found, data) == pytest.approx(off(plain, signals()[name]), rel=1e-2, abs=1e-6)


@pytest.mark.parametrize("name", signals())
@pytest.mark.parametrize("bits", [8, 16])
def test_bytes_lose_their_step_and_float16_says_where_it_ends(name, bits):
    data = signals()[name]
    packed = clustered_pca(data, 4, 3, method="iterative")
    if data.abs().max() > 65504:
        with pytest.raises(InputError, match="float16 does not hold: scale the data"):
            quantise(data, packed, bits=bits)
        return
    made = quantise(data, packed, bits=bits).restore().reconstruct()
    assert off(made, data) <= off(packed.reconstruct(), data) + (1 / 256 if bits == 8 else 2**-10)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", signals())
def test_lobes_say_what_they_lose(name, size):
    data = (signals()[name] * SIZES[size]).unsqueeze(1)
    made = fit_lobes(data, 2)
    found = made.reconstruct()
    assert found.isfinite().all()
    assert made.axis.isfinite().all()
    plain = fit_lobes(signals()[name].unsqueeze(1), 2).reconstruct()
    assert off(found, data) == pytest.approx(off(plain, signals()[name].unsqueeze(1)), rel=1e-2, abs=1e-5)
