"""Clusters in one piece on the mesh: fewer triangles that straddle clusters."""

from __future__ import annotations

import heapq

import torch
from jaxtyping import Float, Int, Integer
from torch import Tensor

from torchprt.compression.clustering_data import check
from torchprt.compression.cpca import ClusteredPca, project
from torchprt.compression.importance import root_of, weighed
from torchprt.compression.subspaces import Subspaces, fit, groups, one_thread, pieces
from torchprt.errors import InputError

# Passes of reclassification and refitting: one spends what the refit before it gave back.
_PASSES = 6


def overdraw(faces: Int[Tensor, "F 3"], label: Integer[Tensor, "V"]) -> float:
    """Clusters among the corners of a triangle, the mean over all triangles: how often it is drawn, 1 to 3.

    Raises InputError if there is no triangle, or one with a corner that has no label.
    Source: Sloan et al. 2003, section 5.
    """
    check_mesh(faces, len(label))
    return float(_drawn(label[faces.long()]).double().mean())


def check_mesh(faces: Tensor, points: int) -> None:
    """InputError if `faces` are not triangles over so many points."""
    if len(faces) == 0:
        raise InputError("faces is empty: clusters are made coherent over triangles")
    if int(faces.min()) < 0 or int(faces.max()) >= points:
        raise InputError(
            f"faces names the vertices {int(faces.min())} to {int(faces.max())}, but there are {points} points"
        )


def _drawn(corners: Tensor) -> Tensor:
    a, b, c = corners.unbind(1)
    return 1 + (b != a).long() + ((c != a) & (c != b)).long()


def make_coherent(
    data: Float[Tensor, "V S"],
    packed: ClusteredPca,
    faces: Int[Tensor, "F 3"],
    *,
    budget: float = 0.05,
    importance: Tensor | None = None,
) -> ClusteredPca:
    """`packed` with points moved to clusters of their neighbours on the mesh, and all subspaces fitted again.

    Points move in the order of overdraw saved for error added, as long as the squared error of all points is at most
    `1 + budget` times what it was; the refit gives back a part of that, which is spent again. Numbers of PCA vectors
    stay. `data` and `importance` are those that `packed` was made from.

    Raises InputError if `budget` is negative, or data, packed and faces do not belong together.
    Source: Sloan et al. 2003, section 5.
    """
    check_mesh(faces, len(data))
    check(data, 1, 1)
    if not budget >= 0:
        raise InputError(f"budget is {budget}: it must be 0 or more, as 0.05 for 5 % more error")
    packed.check_data(data)
    with torch.no_grad(), one_thread():
        root = None if importance is None else root_of(importance, data)
        metric = data if root is None else weighed(data, root)
        edges = _edges(faces.long())

        def refit(label: Tensor) -> Subspaces:
            spaces = fit(metric, label, len(packed.mean), packed.weights.shape[1])
            spaces.counts = packed.counts
            return spaces

        best, label, spaces = packed, packed.label, refit(packed.label)
        allowed = (1 + budget) * float(packed.error.sum())
        for _ in range(_PASSES):
            label = _reclassified(metric, label, spaces, faces, edges, allowed - spaces.error())
            if torch.equal(label, best.label):
                break
            spaces = refit(label)
            best = project(data, label, spaces, root)
        return best


def _edges(faces: Tensor) -> Tensor:
    """Pairs of neighbours `[E, 2]`, both ways round."""
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return _distinct(torch.cat([edges, edges.flip(1)]))


def _distinct(pairs: Tensor) -> Tensor:
    """Each of the pairs `[n, 2]` once, in order: as `unique(dim=0)`, many times faster."""
    base = int(pairs.max()) + 1
    key = (pairs[:, 0] * base + pairs[:, 1]).unique()
    return torch.stack([key // base, key % base], 1)


def _reclassified(
    data: Tensor, label: Tensor, spaces: Subspaces, faces: Tensor, edges: Tensor, allowed: float
) -> Tensor:
    """Labels after the greedy moves that add at most `allowed` of squared error."""
    # Wherever a point may come to want to go: clusters of its neighbours and of theirs.
    reach = _distinct(torch.stack([edges[:, 0], label[edges[:, 1]]], 1))
    pairs = _distinct(torch.cat([reach, _joined(edges, reach, len(label))]))
    pairs = pairs[label[pairs[:, 0]] != pairs[:, 1]]
    own = torch.stack([torch.arange(len(label), device=label.device), label], 1)
    added = _distance(data, spaces, pairs) - _distance(data, spaces, own)[pairs[:, 0]]
    options: dict[int, list[tuple[int, float]]] = {}
    for point, cluster, more in zip(pairs[:, 0].tolist(), pairs[:, 1].tolist(), added.tolist(), strict=True):
        options.setdefault(point, []).append((cluster, more))
    return torch.tensor(_greedy(label.tolist(), faces, options, allowed), device=label.device)


def _joined(edges: Tensor, reach: Tensor, points: int) -> Tensor:
    """`reach`, pairs of point and cluster sorted by point, handed on along all edges."""
    counts = torch.bincount(reach[:, 0], minlength=points)
    starts = counts.cumsum(0) - counts
    many = counts[edges[:, 1]]
    edge = torch.arange(len(edges), device=edges.device).repeat_interleave(many)
    place = torch.arange(len(edge), device=edges.device) - (many.cumsum(0) - many)[edge]
    return torch.stack([edges[edge, 0], reach[starts[edges[edge, 1]] + place, 1]], 1)


def _distance(data: Tensor, spaces: Subspaces, pairs: Tensor) -> Tensor:
    """Squared error of a point in a cluster, for pairs `[n, 2]` of both."""
    clusters, rows, _ = spaces.basis.shape
    kept = torch.arange(rows, device=data.device) < spaces.counts[:, None]
    result = data.new_zeros(len(pairs), dtype=torch.float64)
    for chosen, which, real in groups(pairs[:, 1], clusters, data.shape[1]):
        basis = spaces.basis[chosen] * kept[chosen, :, None]
        for some, of in pieces(which, real, data.shape[1]):
            centred = data[pairs[some, 0]].double() - spaces.mean[chosen, None]
            along = centred @ basis.mT
            result[some[of]] = (centred.square().sum(2) - along.square().sum(2)).clamp(min=0)[of]
    return result


def _greedy(label: list[int], faces: Tensor, options: dict[int, list[tuple[int, float]]], allowed: float) -> list[int]:
    """Moves in falling order of overdraw saved for error added: a heap whose entries are checked when they surface."""
    corners: list[list[int]] = faces.tolist()
    around: list[list[tuple[int, int]]] = [[] for _ in label]
    for a, b, c in corners:
        around[a].append((b, c))
        around[b].append((c, a))
        around[c].append((a, b))

    def saved(point: int, cluster: int) -> int:
        own, fewer = label[point], 0
        for b, c in around[point]:
            first, second = label[b], label[c]
            fewer += (own != first and own != second) - (cluster != first and cluster != second)
        return fewer

    def offer(point: int) -> tuple[float, int, int, float] | None:
        """The best move of a point."""
        best: tuple[float, int, int, float] | None = None
        spent = errors.get(point, 0.0)
        for cluster, more in options.get(point, ()):
            if cluster == label[point]:
                continue
            fewer, price = saved(point, cluster), more - spent
            if fewer > 0:
                rank = -fewer / price if price > 0 else -float("inf")
                if best is None or rank < best[0]:
                    best = (rank, point, cluster, price)
        return best

    errors: dict[int, float] = {}
    heap = [move for point in options if (move := offer(point)) is not None]
    heapq.heapify(heap)
    while heap:
        move = heapq.heappop(heap)
        _, point, cluster, price = move
        now = offer(point)
        if now != move:
            # Its neighbours moved since: it waits with what it is worth now.
            if now is not None:
                heapq.heappush(heap, now)
            continue
        if price > allowed:
            continue
        allowed -= price
        errors[point] = errors.get(point, 0.0) + price
        label[point] = cluster
        for b, c in around[point]:
            for other in (b, c):
                if (again := offer(other)) is not None:
                    heapq.heappush(heap, again)
    return label
