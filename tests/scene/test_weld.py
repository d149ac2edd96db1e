"""Do the quick sorts of a mesh find what the plain ones find?"""

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from torchprt.scene.check import _components
from torchprt.scene.weld import _ordered, weld


def plain(positions):
    """Ranks of the rows, by their last number first: a sort by all coordinates at once."""
    return np.unique(positions[:, ::-1] + 0.0, axis=0, return_inverse=True)[1].ravel()


@pytest.mark.parametrize("levels", [1, 2, 5, 10**6])
def test_places_are_the_ranks_of_positions_however_many_stand_at_one_height(levels):
    random = np.random.default_rng(levels)
    positions = random.integers(-levels, levels, (400, 3)).astype(float)
    positions[::7] = positions[3]
    positions[positions == 0] *= random.choice([-1.0, 1.0], int((positions == 0).sum()))
    np.testing.assert_array_equal(weld(positions), plain(positions))


def test_no_vertex_has_no_place():
    assert weld(np.zeros((0, 3))).shape == (0,)


@pytest.mark.parametrize("largest", [3, 2**40, 2**62])
def test_keys_are_ordered_stably_also_where_their_number_does_not_fit_beside_them(largest):
    key = np.random.default_rng(0).integers(0, largest, 300) // 2
    order, ordered = _ordered(key)
    np.testing.assert_array_equal(order, np.argsort(key, kind="stable"))
    np.testing.assert_array_equal(ordered, key[order])


@pytest.mark.parametrize("faces", [1, 20, 60, 200])
def test_pieces_are_those_of_a_walk_through_all_edges(faces):
    for seed in range(20):
        corners = np.random.default_rng(seed).integers(0, 150, (faces, 3))
        tail, head = corners[:, [0, 1]].ravel(), corners[:, [1, 2]].ravel()
        graph = coo_matrix((np.ones(len(tail)), (tail, head)), (150, 150))
        label = connected_components(graph, directed=False)[1]
        assert _components(corners) == len(np.unique(label[corners]))
