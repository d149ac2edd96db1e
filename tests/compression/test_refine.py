"""Which clusters are missed least, and who gets PCA vectors: against explicit loops in float64."""

import pytest
import torch

from torchprt.compression import clustered_pca
from torchprt.compression.refine import grow, hand_out, missed_least, surplus
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.subspaces import Subspaces, fit, runners_up


def signal(points=400, width=5, seed=0):
    generator = torch.Generator().manual_seed(seed)
    data = torch.randn(points, width, generator=generator, dtype=torch.float64)
    return data * 0.6 ** torch.arange(width)


def spaces(clusters=8, rows=2):
    data = signal()
    return data, fit(data, clustered_pca(data, clusters, rows, method="static").label, clusters, rows)


def distances(data, found):
    table = torch.zeros(len(data), len(found.mean), dtype=torch.float64)
    for p, point in enumerate(data):
        for k, count in enumerate(found.counts.tolist()):
            rest = point - found.mean[k]
            for axis in found.basis[k, :count]:
                rest = rest - (rest @ axis) * axis
            table[p, k] = rest @ rest
    return table


@pytest.mark.parametrize("counts", [[2] * 8, [0, 1, 2, 2, 1, 0, 0, 2]])
def test_the_second_nearest_is_the_nearest_of_the_others(counts):
    data, found = spaces()
    found.counts = torch.tensor(counts)
    label, other, further = runners_up(data, found)
    nearest, order = distances(data, found).sort(1)
    assert torch.equal(label, order[:, 0])
    assert torch.equal(other, order[:, 1])
    torch.testing.assert_close(further, nearest[:, 1] - nearest[:, 0], rtol=0, atol=1e-13)


def test_what_is_missed_least_costs_least():
    data, found = spaces()
    nearest, order = distances(data, found).sort(1)
    cost = torch.stack([(nearest[:, 1] - nearest[:, 0])[order[:, 0] == k].sum() for k in range(8)])
    assert missed_least(data, found, 1, 1).tolist() == [int(cost.argmin())]
    dropped = missed_least(data, found, 3, 1).tolist()
    assert dropped[0] == int(cost.argmin())
    assert cost[dropped].tolist() == sorted(cost[dropped].tolist())


def test_of_two_clusters_that_replace_each_other_one_stays():
    """Two halves of one line, and one cluster far away: either half can be dropped without loss, not both."""
    ticks = torch.linspace(-1, 1, 50, dtype=torch.float64)
    line = torch.stack([ticks, torch.zeros_like(ticks)], 1)
    data = torch.cat([line, 10 + signal(50, 2)])
    label = torch.cat([(ticks > 0).long(), torch.full((50,), 2)])
    dropped = missed_least(data, fit(data, label, 3, 1), 2, 1).tolist()
    assert len(dropped) == 1
    assert dropped[0] in (0, 1)


def test_an_empty_cluster_is_dropped_first():
    data = signal()
    label = torch.arange(len(data)) % 3
    found = fit(data, torch.where(label == 1, 3, label), 4, 1)
    # Where nobody is: it has no points to lose.
    found.mean[1] = 1e3
    assert missed_least(data, found, 1, 1).tolist() == [1]


def test_there_are_never_more_clusters_to_begin_with_than_points():
    assert surplus(10, 4) == 8
    assert surplus(10, 7) == 10
    assert surplus(10, 10) == 10


@pytest.mark.parametrize("clusters", [2, 5])
def test_growing_ends_with_the_clusters_that_were_asked_for(clusters):
    data = signal()
    start = surplus(len(data), clusters)
    label = grow(data, torch.arange(len(data)) % start, clusters, 2, 2, Passes())
    assert label.unique().tolist() == list(range(clusters))


def test_vectors_go_where_a_weight_removes_most_error():
    energy = torch.tensor([[8.0, 6.0, 1.0], [9.0, 0.1, 0.0], [3.0, 2.5, 2.0]], dtype=torch.float64)
    sizes = torch.tensor([4, 9, 1])
    found = Subspaces(torch.zeros(3, 5), torch.zeros(3, 3, 5), energy, energy.sum(1), sizes, torch.ones(3).long())
    # Error removed by a weight: 2, 1.5, .25 for the first; 1, .01 for the second; 3, 2.5, 2 for the third.
    counts = hand_out(found, 1)
    # Fourteen weights: three of the third, two times four of the first; nine more for the second are too many.
    assert counts.tolist() == [2, 0, 3]
    assert hand_out(found, 2).tolist() == [3, 1, 3]
    assert hand_out(found, 0).tolist() == [0, 0, 0]
