"""Clustered PCA: does it give back what was put in, and is every method as good as it says?"""

import itertools

import pytest
import torch

from torchprt.compression import clustered_pca, vector_quantise
from torchprt.errors import InputError

EPS = torch.finfo(torch.float32).eps


def smooth(side=45, width=12, seed=0, dtype=torch.float32):
    """A smooth surface in `width` dimensions, as transfer over a mesh is: flat in the middle, more and more curved.

    With noise a thousand times smaller.
    """
    generator = torch.Generator().manual_seed(seed)
    ticks = torch.linspace(-1, 1, side, dtype=torch.float64)
    place = torch.stack(torch.meshgrid(ticks, ticks, indexing="ij"), -1).view(-1, 2)
    waves = torch.randn(2, width, generator=generator, dtype=torch.float64) * 3
    phases = 6.28 * torch.rand(width, generator=generator, dtype=torch.float64)
    data = torch.sin(place**3 @ waves + phases)
    return (data + 0.001 * torch.randn(data.shape, generator=generator, dtype=torch.float64)).to(dtype)


def flats(clusters=5, components=2, width=9, points=60, dtype=torch.float64):
    """Points of affine subspaces that lie far apart."""
    generator = torch.Generator().manual_seed(0)
    means = 20 * torch.randn(clusters, 1, width, generator=generator, dtype=torch.float64)
    axes = torch.randn(clusters, components, width, generator=generator, dtype=torch.float64)
    weights = torch.randn(clusters, points, components, generator=generator, dtype=torch.float64)
    return (means + weights @ axes).flatten(0, 1).to(dtype)


def total(packed):
    return float(packed.error.sum())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"clusters": 11}, "clusters is 11, but there are only 10 points"),
        ({"clusters": 0}, "clusters is 0"),
        ({"components": -1}, "components is -1"),
        ({"components": 5}, "components is 5, but a point has only 4 numbers"),
        ({"iterations": 0}, "iterations is 0"),
        ({"method": "vq"}, "components is 1: vector quantisation has none"),
        ({"method": "pca"}, "clusters is 2: plain PCA has one"),
        ({"importance": torch.ones(3)}, r"importance has shape \(3,\): pass \[4\] or \[4, 4\]"),
        ({"importance": torch.ones(3, 3)}, r"importance has shape \(3, 3\)"),
        ({"importance": torch.tensor([1.0, 0, 1, 1])}, "importance is not positive everywhere"),
        ({"importance": torch.tensor([1.0, torch.nan, 1, 1])}, "importance holds a number that is not finite"),
        ({"importance": torch.ones(4, 4)}, "importance is not positive definite"),
        ({"importance": -torch.eye(4)}, "importance is not positive definite"),
        ({"importance": torch.eye(4) + torch.eye(4).roll(1, 0)}, "importance is not symmetric"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        clustered_pca(torch.arange(40.0).view(10, 4), **({"clusters": 2, "components": 1} | arguments))


def test_a_number_that_is_not_finite_is_refused():
    data = torch.ones(10, 4)
    data[7, 2] = torch.nan
    with pytest.raises(InputError, match="not finite, first in row 7"):
        clustered_pca(data, 2, 1)


@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
def test_one_point_is_stored_as_it_is(method):
    packed = clustered_pca(torch.tensor([[1.0, -2.0, 3.0]]), 1, 2, method=method)
    assert packed.reconstruct().tolist() == [[1.0, -2.0, 3.0]]
    assert total(packed) == 0


@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_affine_subspaces_are_recovered_to_rounding(method, dtype):
    data = flats(dtype=dtype)
    packed = clustered_pca(data, 5, 2, method=method)
    # Means, axes and weights are rounded once each.
    rounding = 8 * torch.finfo(dtype).eps * float(data.abs().max())
    torch.testing.assert_close(packed.reconstruct(), data, rtol=0, atol=rounding)
    assert float(packed.error.max().sqrt()) <= rounding * data.shape[1] ** 0.5


@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
def test_subspaces_of_more_numbers_than_clusters_are_sought_in_are_recovered_too(method):
    data = flats(clusters=4, components=3, width=200, dtype=torch.float32)
    packed = clustered_pca(data, 4, 3, method=method)
    torch.testing.assert_close(packed.reconstruct(), data, rtol=0, atol=8 * EPS * float(data.abs().max()))


@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
@pytest.mark.parametrize("clusters", [3, 8, 40])
def test_duplicates_are_no_obstacle(method, clusters):
    data = torch.tensor([[0.0, 1, 2], [5, -2, 1], [-3, 0.5, 0]]).repeat(20, 1)
    packed = clustered_pca(data, clusters, 2, method=method)
    torch.testing.assert_close(packed.reconstruct(), data, rtol=0, atol=20 * EPS)


@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
def test_a_constant_signal_is_stored_without_error(method):
    data = torch.full((30, 4), -2.5)
    assert torch.equal(clustered_pca(data, 3, 2, method=method).reconstruct(), data)


def test_without_components_it_is_vector_quantisation():
    data = smooth()
    label, means = vector_quantise(data, 20, seed=5)
    for method in ("vq", "static", "iterative", "adaptive"):
        packed = clustered_pca(data, 20, 0, method=method, seed=5)
        assert torch.equal(packed.label, label)
        assert torch.equal(packed.reconstruct(), means[label])
        assert packed.weights.shape == (len(data), 0)


@pytest.mark.parametrize("width", [12, 150])
def test_one_cluster_is_plain_pca(width):
    data = smooth(width=width, dtype=torch.float64)
    packed = clustered_pca(data, 1, 4, method="pca")
    centred = data - data.mean(0)
    values = torch.linalg.svdvals(centred)
    assert total(packed) == pytest.approx(float(values[4:].square().sum()), rel=1e-10)
    axes = packed.basis
    torch.testing.assert_close(axes @ axes.T, torch.eye(4, dtype=torch.float64), rtol=0, atol=1e-12)


def test_every_cluster_is_the_pca_of_its_points():
    data = smooth(dtype=torch.float64)
    packed = clustered_pca(data, 12, 3)
    for k in range(12):
        points = data[packed.label == k]
        mean = points.mean(0)
        _, _, axes = torch.linalg.svd(points - mean, full_matrices=False)
        best = mean + (points - mean) @ axes[:3].T @ axes[:3]
        torch.testing.assert_close(packed.reconstruct()[packed.label == k], best, rtol=0, atol=1e-9)
        assert float(packed.cluster_error[k]) == pytest.approx(float((points - best).square().sum()), rel=1e-6)


@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
@pytest.mark.parametrize("width", [12, 150])
def test_the_error_is_that_of_the_reconstruction(method, width):
    data = smooth(width=width)
    packed = clustered_pca(data, 10, 3, method=method)
    difference = packed.reconstruct().double() - data.double()
    # The reconstruction is rounded to float32 on the way out, the error is not.
    torch.testing.assert_close(packed.error, difference.square().sum(1), rtol=1e-3, atol=1e-9)
    assert float(packed.cluster_error.sum()) == pytest.approx(total(packed), rel=1e-12)


def test_more_components_and_more_clusters_leave_less_error():
    data = smooth()
    components = [total(clustered_pca(data, 16, n)) for n in range(6)]
    clusters = [total(clustered_pca(data, k, 2)) for k in (1, 4, 16, 64)]
    for errors in (components, clusters):
        assert all(after < before for before, after in itertools.pairwise(errors))


@pytest.mark.parametrize("components", [1, 2, 4])
def test_iterative_is_better_than_static_and_adaptive_than_iterative(components):
    data = smooth()
    static, iterative, adaptive = (
        total(clustered_pca(data, 24, components, method=method)) for method in ("static", "iterative", "adaptive")
    )
    assert iterative < 0.9 * static
    assert adaptive < iterative


def test_adaptive_stores_no_more_weights():
    data = smooth()
    packed = clustered_pca(data, 24, 3, method="adaptive")
    assert int((packed.sizes * packed.counts).sum()) <= 3 * len(data)
    assert int(packed.counts.max()) > int(packed.counts.min())
    assert packed.weights.shape[1] == int(packed.counts.max())
    beyond = torch.arange(packed.weights.shape[1]) >= packed.counts[packed.label, None]
    assert not packed.weights[beyond].any()
    assert len(packed.basis) == int(packed.offsets[-1]) == int(packed.counts.sum())


def test_the_reconstruction_is_the_formula():
    data = smooth()
    packed = clustered_pca(data, 24, 3, method="adaptive")
    result = packed.reconstruct()
    for p in range(0, len(data), 97):
        k = int(packed.label[p])
        rows = packed.basis[packed.offsets[k] : packed.offsets[k + 1]]
        expected = packed.mean[k] + packed.weights[p, : len(rows)] @ rows
        torch.testing.assert_close(result[p], expected, rtol=0, atol=8 * EPS)


def test_bytes_count_what_is_stored():
    packed = clustered_pca(smooth(), 24, 3)
    representatives, weights, labels, counts = 24 * 4 * 12, 2025 * 3, 2025, 2 * 24
    assert packed.bytes() == 4 * (representatives + weights) + labels + counts
    assert packed.bytes(weight_bits=8, representative_bits=16) == 2 * representatives + weights + labels + counts


@pytest.mark.parametrize("matrix", [False, True])
def test_importance_lowers_the_error_that_it_weighs(matrix):
    data = smooth(dtype=torch.float64)
    weight = 0.5 ** torch.arange(12.0, dtype=torch.float64)
    importance = weight.diag() + 0.01 if matrix else weight
    measure = importance if matrix else importance.diag()

    def weighed(packed):
        difference = packed.reconstruct() - data
        return float(((difference @ measure) * difference).sum())

    plain, aware = clustered_pca(data, 16, 2), clustered_pca(data, 16, 2, importance=importance)
    assert weighed(aware) < 0.7 * weighed(plain)
    assert total(aware) == pytest.approx(weighed(aware), rel=1e-9)
    rows = aware.basis[aware.offsets[3] : aware.offsets[4]]
    torch.testing.assert_close(rows @ measure @ rows.T, torch.eye(2, dtype=torch.float64), rtol=0, atol=1e-9)


def test_equal_importance_changes_nothing():
    data = smooth(dtype=torch.float64)
    plain, equal = (clustered_pca(data, 9, 2, importance=i) for i in (None, torch.full((12,), 4.0)))
    assert torch.equal(plain.label, equal.label)
    torch.testing.assert_close(equal.reconstruct(), plain.reconstruct(), rtol=0, atol=1e-12)
    torch.testing.assert_close(equal.error, 4 * plain.error, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1e30])
@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
def test_the_size_of_the_numbers_does_not_matter(scale, method):
    data = smooth()
    scaled = clustered_pca(data * scale, 12, 2, method=method)
    reference = clustered_pca(data, 12, 2, method=method)
    assert scaled.reconstruct().isfinite().all()
    # Rounding decides to whom points between two clusters belong: a per mille of the error.
    assert total(scaled) / scale**2 == pytest.approx(total(reference), rel=0.05)


@pytest.mark.parametrize("method", ["static", "iterative", "adaptive"])
def test_the_seed_decides_and_threads_do_not(method):
    data = smooth(side=100)
    first = clustered_pca(data, 16, 2, method=method, iterations=1, seed=3)
    torch.set_num_threads(2)
    second = clustered_pca(data, 16, 2, method=method, iterations=1, seed=3)
    other = clustered_pca(data, 16, 2, method=method, iterations=1, seed=4)
    for name in ("label", "mean", "basis", "offsets", "weights", "error"):
        assert torch.equal(getattr(first, name), getattr(second, name))
    assert not torch.equal(first.label, other.label)


def test_no_gradient_is_kept():
    packed = clustered_pca(smooth().requires_grad_(), 4, 2)
    assert not packed.weights.requires_grad
