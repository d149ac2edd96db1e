"""Does the search learn from what an encoding turned out to leave?"""

import pytest
import torch

from torchprt.compression.resumable_passes import Passes
from torchprt.compression.search import Sizes, candidates, corrected

SIZES = [Sizes(64, 8, 0, 1000, 4e-4, 0.0), Sizes(64, 8, 192, 800, 4e-4, 4e-4), Sizes(64, 16, 256, 1200, 1e-4, 1e-4)]


def test_an_error_is_of_clusters_and_of_what_axes_cut():
    assert SIZES[0].error == pytest.approx(0.02)
    assert SIZES[1].error == pytest.approx(0.02 * 2 ** (1 / 3))


@pytest.mark.parametrize("tried", SIZES)
@pytest.mark.parametrize("part", [0.9, 1.0, 1.3])
def test_what_was_tried_is_then_expected_as_it_was(tried, part):
    reached = part * tried.error
    expected = corrected(SIZES, tried, reached)
    assert expected[SIZES.index(tried)].error == pytest.approx(reached)


def test_no_clusters_bring_back_what_axes_cut():
    # Half of what was expected: of 192 axes the other sizes are expected to have more than these cut.
    expected = corrected(SIZES, SIZES[0], 0.01)
    assert [each.cut for each in expected] == [each.cut for each in SIZES]
    assert expected[1].error > 0.02
    # As much as the axes alone cut, or less, is no reason to expect nothing of clusters.
    assert corrected(SIZES, SIZES[1], 0.019)[0].error > 0


def test_nothing_expected_is_nothing_learned():
    sizes = [Sizes(1, 1, 0, 10, 0.0, 0.0)]
    assert corrected(sizes, sizes[0], 0.5) == sizes


def test_more_clusters_are_not_tried_once_they_only_cost_more():
    generator = torch.Generator().manual_seed(0)
    # Twenty clusters in planes of their own.
    middle, axes = torch.randn(20, 24, generator=generator), torch.randn(20, 2, 24, generator=generator)
    label = torch.randint(20, (6000,), generator=generator)
    weights = torch.randn(6000, 1, 2, generator=generator)
    signal = middle[label] + (weights @ axes[label])[:, 0] + 0.01 * torch.randn(6000, 24, generator=generator)
    given = {"method": "iterative", "bits": 8, "seed": 0}
    every = candidates(signal, 10**9, passes=Passes(), **given)
    some = candidates(signal, 10**9, passes=Passes(), error=0.05, **given)
    assert max(size.clusters for size in some) < max(size.clusters for size in every)
    fewest = [min((s for s in sizes if s.error <= 0.05), key=lambda s: s.bytes) for sizes in (every, some)]
    assert fewest[0] == fewest[1]
    # None reaches it: then all are.
    assert candidates(signal, 10**9, passes=Passes(), error=1e-9, **given) == every
