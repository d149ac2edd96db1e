"""Clusters that are drawn together, and points and triangles in the order of clusters."""

from __future__ import annotations

import heapq
from collections import Counter
from itertools import combinations

import torch
from jaxtyping import Int, Int64, Integer
from torch import Tensor

from torchprt.compression.coherence import check_mesh
from torchprt.errors import InputError


def superclusters(faces: Int[Tensor, "F 3"], label: Integer[Tensor, "V"], most: int) -> Int64[Tensor, "K"]:
    """The supercluster of every cluster, at most `most` clusters in each; K is the largest label and one.

    Starts with a supercluster for every cluster and joins the two that share the most triangles, until no two that
    may be joined share any: `overdraw(faces, superclusters(faces, label, most)[label])` falls, and no error is added.
    Superclusters are numbered from 0 in the order of their first clusters.

    Raises InputError if `most` is less than 1, or faces and label do not belong together.
    Source: Sloan et al. 2003, section 5.
    """
    check_mesh(faces, len(label))
    if most < 1:
        raise InputError(f"most is {most}: a supercluster holds at least one cluster")
    clusters = int(label.max()) + 1
    triangles = [set(corners) for corners in label[faces.long()].tolist()]
    triangles = [corners for corners in triangles if len(corners) > 1]
    members = [{k} for k in range(clusters)]
    touching: list[list[int]] = [[] for _ in range(clusters)]
    shared: Counter[tuple[int, int]] = Counter()
    for number, corners in enumerate(triangles):
        shared.update(combinations(sorted(corners), 2))
        for k in corners:
            touching[k].append(number)
    heap = [(-count, pair) for pair, count in shared.items()]
    heapq.heapify(heap)
    while heap:
        count, pair = heapq.heappop(heap)
        if shared[pair] != -count or len(members[pair[0]]) + len(members[pair[1]]) > most:
            continue
        # The one with fewer triangles becomes a part of the other: a triangle is rewritten few times.
        kept, gone = sorted(pair, key=lambda k: -len(touching[k]))
        for number in touching[gone]:
            corners = triangles[number]
            shared.subtract(combinations(sorted(corners), 2))
            corners.discard(gone)
            if kept not in corners:
                corners.add(kept)
                touching[kept].append(number)
            shared.update(combinations(sorted(corners), 2))
        changed = {pair for number in touching[gone] for pair in combinations(sorted(triangles[number]), 2)}
        for pair in changed:
            heapq.heappush(heap, (-shared[pair], pair))
        members[kept] |= members[gone]
        members[gone], touching[gone] = set(), []
    joined = torch.empty(clusters, dtype=torch.int64, device="cpu")
    for number, some in enumerate(sorted((sorted(some) for some in members if some), key=lambda some: some[0])):
        joined[some] = number
    return joined.to(label.device)


def cluster_order(
    faces: Int[Tensor, "F 3"], label: Integer[Tensor, "V"], supercluster: Int[Tensor, "K"] | None = None
) -> tuple[Int64[Tensor, "V"], Int64[Tensor, "F"]]:
    """The order of points, and that of triangles, in which superclusters and clusters are one after the other.

    With `points, triangles = cluster_order(...)`, `label[points]` is the new order of whatever belongs to points,
    `points.argsort()` leads back, and the mesh is `points.argsort()[faces[triangles]]`. A triangle stands with the
    first of its corners in that order. Within a cluster the order stays.

    Raises InputError if faces and label do not belong together, or a cluster has no supercluster.
    """
    check_mesh(faces, len(label))
    if supercluster is None:
        supercluster = torch.zeros(int(label.max()) + 1, dtype=torch.int64, device=label.device)
    if len(supercluster) <= int(label.max()):
        raise InputError(f"supercluster is of {len(supercluster)} clusters, but label names cluster {int(label.max())}")
    key = supercluster.long() * len(supercluster) + torch.arange(len(supercluster), device=label.device)
    points = key[label.long()].argsort(stable=True)
    return points, points.argsort()[faces.long()].amin(1).argsort(stable=True)
