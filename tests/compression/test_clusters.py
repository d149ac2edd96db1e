"""Vector quantisation: is every point where it belongs, whatever the points are?"""

import itertools

import pytest
import torch

from torchprt.compression import vector_quantise
from torchprt.errors import InputError

EPS = torch.finfo(torch.float32).eps


def blobs(clusters=6, points=40, width=5, spread=0.01, dtype=torch.float64, seed=0):
    """Points about far centres in random order, and the centre of each."""
    generator = torch.Generator().manual_seed(seed)
    centres = torch.randn(clusters, width, generator=generator, dtype=torch.float64)
    of = torch.arange(clusters).repeat_interleave(points)[torch.randperm(clusters * points, generator=generator)]
    data = centres[of] + spread * torch.randn(len(of), width, generator=generator, dtype=torch.float64)
    return data.to(dtype), of


def squared_error(data, label, means):
    return float((data.double() - means.double()[label]).square().sum())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((torch.zeros(3, 2), 0), "clusters is 0"),
        ((torch.zeros(3, 2), 4), "clusters is 4, but there are only 3 points"),
        ((torch.zeros(0, 2), 1), "clusters is 1, but there are only 0 points"),
        ((torch.zeros(3, 0), 1), r"data has shape \(3, 0\)"),
        ((torch.zeros(3, 2, dtype=torch.float16), 1), "data is torch.float16"),
        ((torch.tensor([[0.0], [torch.nan]]), 1), "not finite, first in row 1"),
        ((torch.tensor([[torch.inf], [0.0]]), 1), "not finite, first in row 0"),
    ],
)
def test_what_cannot_be_clustered_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        vector_quantise(*arguments)


def test_at_least_one_iteration_is_asked_for():
    with pytest.raises(InputError, match="iterations is 0"):
        vector_quantise(torch.zeros(3, 2), 2, iterations=0)


def test_one_point_is_its_own_mean():
    label, means = vector_quantise(torch.tensor([[1.0, -2.0]]), 1)
    assert label.tolist() == [0]
    assert means.tolist() == [[1.0, -2.0]]


def test_one_cluster_is_the_mean():
    data, _ = blobs()
    label, means = vector_quantise(data, 1)
    assert not label.any()
    torch.testing.assert_close(means[0], data.mean(0), rtol=0, atol=1e-14)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_separate_blobs_are_found(dtype):
    data, of = blobs(dtype=dtype)
    label, means = vector_quantise(data, 6)
    assert means.dtype == dtype
    # One label a blob and one blob a label.
    assert len({(int(a), int(b)) for a, b in zip(label, of, strict=True)}) == 6
    for k in range(6):
        # The mean of a few points of unit size, rounded once.
        torch.testing.assert_close(means[k], data[label == k].double().mean(0).to(dtype), rtol=EPS, atol=EPS)


def test_when_nothing_moves_every_point_is_with_the_nearest_mean():
    data = torch.randn(400, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    label, means = vector_quantise(data, 12, iterations=500)
    distances = torch.stack([(point - means).square().sum(1) for point in data])
    own = distances[torch.arange(len(data)), label]
    assert float((own - distances.min(1).values).max()) <= 1e-13


def test_every_iteration_lowers_the_error():
    data = torch.randn(3000, 8, generator=torch.Generator().manual_seed(2))
    errors = [squared_error(data, *vector_quantise(data, 30, iterations=i)) for i in (1, 2, 4, 8, 16)]
    assert all(after < before for before, after in itertools.pairwise(errors))


def test_as_many_clusters_as_points_leave_no_error():
    data = torch.randn(50, 4, generator=torch.Generator().manual_seed(3))
    label, means = vector_quantise(data, 50)
    assert sorted(label.tolist()) == list(range(50))
    assert torch.equal(means[label], data)


@pytest.mark.parametrize("clusters", [3, 7, 30])
def test_duplicates_are_no_obstacle(clusters):
    distinct = torch.tensor([[0.0, 1.0], [5.0, -2.0], [-3.0, 0.5]])
    data = distinct.repeat(10, 1)
    label, means = vector_quantise(data, clusters)
    torch.testing.assert_close(means[label], data, rtol=EPS, atol=EPS)


def test_a_constant_signal_is_one_mean():
    data = torch.full((20, 3), 7.0)
    label, means = vector_quantise(data, 5)
    assert torch.equal(means[label], data)


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_size_of_the_numbers_does_not_matter(scale):
    data, _ = blobs(dtype=torch.float32)
    label, means = vector_quantise(data, 6)
    scaled, large = vector_quantise(data * scale, 6)
    assert torch.equal(label, scaled)
    torch.testing.assert_close(large / scale, means, rtol=4 * EPS, atol=0)


def test_far_from_the_origin_is_no_different():
    data, of = blobs(spread=0.01)
    label, _ = vector_quantise(data + 1e6, 6)
    assert len({(int(a), int(b)) for a, b in zip(label, of, strict=True)}) == 6


def test_the_seed_decides_and_threads_do_not():
    data = torch.randn(20000, 12, generator=torch.Generator().manual_seed(4))
    first = vector_quantise(data, 16, seed=3, iterations=3)
    torch.set_num_threads(2)
    second = vector_quantise(data, 16, seed=3, iterations=3)
    assert torch.get_num_threads() == 2
    other = vector_quantise(data, 16, seed=4, iterations=3)
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    assert not torch.equal(first[1], other[1])


def test_no_gradient_is_kept():
    data = torch.randn(9, 2, requires_grad=True)
    assert not vector_quantise(data, 2)[1].requires_grad
