"""What do fewer bytes cost, and is what is stored what the error says?"""

import pytest
import torch

from torchprt.compression import ClusteredPca, clustered_pca, quantise
from torchprt.errors import InputError


def signal(side=40, width=10, seed=0):
    generator = torch.Generator().manual_seed(seed)
    ticks = torch.linspace(-1, 1, side, dtype=torch.float64)
    place = torch.stack(torch.meshgrid(ticks, ticks, indexing="ij"), -1).view(-1, 2)
    waves = 3 * torch.randn(2, width, generator=generator, dtype=torch.float64)
    phases = 6.28 * torch.rand(width, generator=generator, dtype=torch.float64)
    return torch.sin(place**3 @ waves + phases).float()


def squared_error(data, packed):
    return (packed.reconstruct().double() - data.double()).square().sum(1)


def test_what_cannot_be_stored_is_refused():
    data = signal()
    packed = clustered_pca(data, 4, 2)
    with pytest.raises(InputError, match="bits is 4: weights are stored in 8 or 16"):
        quantise(data, packed, bits=4)
    with pytest.raises(InputError, match="packed is of 1600 points of 10 numbers"):
        quantise(data[:7], packed)
    for scale in (1e6, 1e-6):
        with pytest.raises(InputError, match=r"mean of packed reaches .*, which float16 does not hold"):
            quantise(data * scale, clustered_pca(data * scale, 4, 2))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("method", ["iterative", "adaptive"])
def test_the_error_is_that_of_what_is_stored(bits, method):
    data = signal()
    stored = quantise(data, clustered_pca(data, 20, 3, method=method), bits=bits)
    torch.testing.assert_close(stored.error, squared_error(data, stored.restore()), rtol=1e-12, atol=0)
    assert stored.code.dtype == (torch.uint8 if bits == 8 else torch.float16)
    assert stored.mean.dtype == stored.basis.dtype == torch.float16


@pytest.mark.parametrize("bits", [8, 16])
def test_a_weight_is_off_by_half_a_step(bits):
    data = signal()
    packed = clustered_pca(data, 20, 3)
    restored = quantise(data, packed, bits=bits).restore()
    for k in range(20):
        exact, found = packed.weights[packed.label == k], restored.weights[packed.label == k]
        most, least = exact.amax(0), exact.amin(0)
        step = (most - least) / 255 if bits == 8 else torch.maximum(most, -least) * 2.0**-10
        # Representatives are rounded by 2^-11 as well, which turns the axes and moves the mean.
        slack = 4 * 2.0**-11 * data[packed.label == k].norm(dim=1).amax()
        assert ((found - exact).abs() <= step / 2 + slack).all()


def test_sixteen_bits_cost_nearly_nothing_and_eight_little():
    data = signal()
    packed = clustered_pca(data, 20, 3)
    plain = float(packed.error.sum())
    sixteen, eight = (float(quantise(data, packed, bits=bits).error.sum()) for bits in (16, 8))
    assert plain < sixteen < 1.001 * plain
    assert plain < eight < 1.05 * plain


def test_weights_make_up_for_rounded_representatives():
    data = signal()
    packed = clustered_pca(data, 20, 3)
    better = quantise(data, packed, bits=16)
    rounded = ClusteredPca(
        packed.label, better.mean.float(), better.basis.float(), packed.offsets, packed.weights.half().float(),
        packed.error,
    )  # fmt: skip
    assert float(better.error.sum()) < float(squared_error(data, rounded).sum())


def test_with_importance_weights_are_the_best_for_the_weighed_error():
    data = signal()
    importance = 0.3 ** torch.arange(10.0)
    packed = clustered_pca(data, 20, 3, importance=importance)
    aware, blind = quantise(data, packed, bits=16, importance=importance), quantise(data, packed, bits=16)
    difference = aware.restore().reconstruct().double() - data
    torch.testing.assert_close(aware.error, (difference.square() * importance.double()).sum(1), rtol=1e-9, atol=1e-20)
    other = (blind.restore().reconstruct().double() - data).square() @ importance.double()
    assert float(aware.error.sum()) < float(other.sum())
    assert float(aware.error.sum()) < 1.01 * float(packed.error.sum())


@pytest.mark.parametrize("bits", [8, 16])
def test_a_constant_signal_and_no_components_are_stored(bits):
    data = torch.full((9, 3), 0.5)
    for components in (0, 2):
        restored = quantise(data, clustered_pca(data, 2, components), bits=bits).restore()
        assert torch.equal(restored.reconstruct(), data)


def test_bytes_are_counted():
    data = signal()
    packed = clustered_pca(data, 20, 3)
    representatives, weights, labels, counts = 2 * 20 * 4 * 10, 1600 * 3, 1600, 2 * 20
    assert quantise(data, packed, bits=16).bytes() == representatives + 2 * weights + labels + counts
    assert quantise(data, packed, bits=8).bytes() == representatives + weights + labels + counts + 8 * 60
