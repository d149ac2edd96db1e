"""Fitting and classification against explicit loops in float64."""

import pytest
import torch

from torchprt.compression.subspaces import classify, fill_empty, fit, groups, pieces


def signal(points=300, width=6, seed=0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    data = torch.randn(points, width, generator=generator, dtype=torch.float64)
    return (data * 0.6 ** torch.arange(width)).to(dtype)


def labels(points=300, clusters=7, seed=1):
    """Of very different frequency; cluster 3 is empty, cluster 5 has one point, cluster 6 fewer than dimensions."""
    generator = torch.Generator().manual_seed(seed)
    label = (clusters * torch.rand(points, generator=generator) ** 3).long().clamp(max=2)
    label[:5] = torch.tensor([5, 6, 6, 6, 4])
    label[20:60] = 4
    return label


def by_svd(data, label, cluster, rows):
    """Mean, axes and squared singular values of one cluster."""
    points = data[label == cluster].double()
    mean = points.mean(0)
    _, values, axes = torch.linalg.svd(points - mean, full_matrices=False)
    return mean, axes[:rows], values[:rows].square()


@pytest.mark.parametrize("cluster", [0, 1, 2, 4, 6])
@pytest.mark.parametrize("rows", [0, 1, 3, 6])
def test_a_fit_is_the_singular_value_decomposition_of_the_cluster(cluster, rows):
    data, label = signal(), labels()
    found = fit(data, label, 7, rows)
    mean, axes, values = by_svd(data, label, cluster, rows)
    rank = min(rows, int((label == cluster).sum()) - 1)
    # Gram matrices lose half of the digits of small singular values; those here are above 1e-2 of the largest.
    torch.testing.assert_close(found.mean[cluster], mean, rtol=0, atol=1e-14)
    torch.testing.assert_close(found.energy[cluster, :rank], values[:rank], rtol=1e-10, atol=0)
    cosines = (found.basis[cluster, :rank] * axes[:rank]).sum(1).abs()
    torch.testing.assert_close(cosines, torch.ones_like(cosines), rtol=0, atol=1e-10)
    torch.testing.assert_close(found.spread[cluster], (data[label == cluster] - mean).square().sum())


def test_fewer_points_than_dimensions_give_no_more_axes_than_there_are():
    found = fit(signal(), labels(), 7, 6)
    lengths = found.basis.square().sum(2)
    torch.testing.assert_close(lengths[6], torch.tensor([1.0, 1, 0, 0, 0, 0], dtype=torch.float64))
    assert not lengths[5].any()
    assert not lengths[3].any()
    assert found.sizes.tolist()[3:] == [0, 41, 1, 3]


def test_energy_is_the_error_that_the_axes_remove():
    data, label = signal(), labels()
    found = fit(data, label, 7, 3)
    centred = data - found.mean[label]
    along = (centred[:, None] * found.basis[label]).sum(2)
    left = float((centred.square().sum(1) - along.square().sum(1)).sum())
    assert found.error() == pytest.approx(left, rel=1e-12)


def test_a_cluster_larger_than_a_piece_is_fitted_in_pieces(monkeypatch):
    data, label = signal(), labels()
    whole = fit(data, label, 7, 3)
    monkeypatch.setattr("torchprt.compression.subspaces._NUMBERS", 100)
    split = fit(data, label, 7, 3)
    torch.testing.assert_close(split.energy, whole.energy, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("numbers", [50, 1000, 1 << 21])
def test_groups_hold_every_point_once(numbers, monkeypatch):
    monkeypatch.setattr("torchprt.compression.subspaces._NUMBERS", numbers)
    label = labels()
    seen = torch.zeros(len(label), dtype=torch.int64)
    for chosen, points, real in groups(label, 7, 6):
        for some, of in pieces(points, real, 6):
            seen[some[of]] += 1
            assert torch.equal(label[some], chosen[:, None].expand_as(some))
    assert (seen == 1).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("counts", [[0] * 7, [2] * 7, [3, 0, 6, 1, 2, 5, 4]])
def test_classification_finds_the_nearest_subspace(counts, dtype):
    data, label = signal(dtype=dtype), labels()
    spaces = fit(data, label, 7, 6)
    spaces.counts = torch.tensor(counts)
    found, error = classify(data, spaces)
    distances = torch.zeros(len(data), 7, dtype=torch.float64)
    for p, point in enumerate(data.double()):
        for k in range(7):
            rest = point - spaces.mean[k]
            for axis in spaces.basis[k, : counts[k]]:
                rest = rest - (rest @ axis) * axis
            distances[p, k] = rest @ rest
    # Sums of squares of numbers up to 5 cancel down to the distance.
    rounding = 100 * torch.finfo(dtype).eps * float(data.square().sum(1).max())
    least = distances.min(1).values
    assert float((distances[torch.arange(len(data)), found] - least).max()) <= rounding
    assert float((error.double() - least).abs().max()) <= rounding


def test_empty_clusters_take_the_worst_fitted_points():
    label = torch.tensor([0, 0, 0, 0, 2, 2])
    error = torch.tensor([0.1, 3.0, 0.0, 0.2, 1.0, 0.5])
    assert fill_empty(label, error, 4).tolist() == [0, 1, 0, 0, 3, 2]


def test_a_lone_point_and_one_without_error_stay():
    label = torch.tensor([0, 1, 1])
    assert fill_empty(label, torch.tensor([9.0, 0.0, 0.0]), 3).tolist() == [0, 1, 1]


def test_without_empty_clusters_nothing_moves():
    label = torch.tensor([0, 1, 1])
    assert fill_empty(label, torch.tensor([1.0, 2.0, 3.0]), 2) is label
