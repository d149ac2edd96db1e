"""Receivers whose rays say nothing are filled from their neighbours along the surface."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.scene.weld import weld
from torchprt.transfer import Sight
from torchprt.transfer.pieces import NUMBERS
from torchprt.transport.task import Once

# Faces of one surface that meet at a seam, where vertices are repeated, as `scene.normals` has it.
SMOOTH = 0.5


@dataclass
class Validity:
    """How the receivers of a bake see: `sight [V]`, numbers of `Sight`; which are filled, `rows [I]`, and from what:
    `between [I, I]` and `beside [I, V]`, the two parts of the graph Laplacian of the surface."""

    sight: UInt8[Tensor, "V"]
    rows: Int[Tensor, "I"]
    between: csr_matrix
    beside: csr_matrix
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)

    def fill(self, arriving: Float[Tensor, "V W"]) -> None:
        """Rows that see nothing get the harmonic continuation of those around them, in place.

        Laws: linear, so that filling transfer and then lighting it is lighting it and then filling; a new value is
        never outside the range of the values around; what is constant around stays constant.
        """
        if not len(self.rows):
            return
        factors = self.once("factors", lambda: splu(self.between.tocsc()))
        # Of the rows that are around alone, and some columns at a time: the table may be larger than memory.
        around = np.unique(self.beside.indices)
        beside, number = self.beside[:, around], torch.from_numpy(around).long()
        step = max(1, NUMBERS // max(len(self.rows), len(around), 1))
        for start in range(0, arriving.shape[1], step):
            some = slice(start, start + step)
            known = arriving[number, some].numpy().astype(np.float64)
            arriving[self.rows, some] = torch.from_numpy(factors.solve(beside @ known)).to(arriving.dtype)

    def among(self, chosen: Int[Tensor, "G"]) -> Validity:
        """The same for tables with a row for each of the `chosen` receivers, which are filled among themselves."""
        number = torch.full((len(self.sight),), -1)
        number[chosen] = torch.arange(len(chosen))
        mine = np.flatnonzero((number[self.rows] >= 0).numpy())
        beside, between = self.beside[mine][:, chosen.numpy()], self.between[mine][:, mine]
        return _system(self.sight[chosen], number[self.rows[mine]], between, beside)


def filling(geometry: Geometry, normals: Float[Tensor, "V 3"], sight: UInt8[Tensor, "V"]) -> Validity:
    """How receivers of a scene that are marked as filled are filled; those that no valid one can be reached from are
    marked as blind."""
    rows = np.flatnonzero((sight == Sight.FILLED).numpy())
    return along(_links(geometry, normals, rows), sight)


def along(links: csr_matrix, sight: UInt8[Tensor, "V"]) -> Validity:
    """How receivers that are marked as filled are filled along `links [V, V]`, symmetric, 1 between neighbours."""
    rows = np.flatnonzero((sight == Sight.FILLED).numpy())
    links = links[rows]
    beside = links @ diags((sight != Sight.FILLED).double().numpy())
    return _system(sight, torch.from_numpy(rows), -links[:, rows], beside)


def _system(sight: Tensor, rows: Tensor, off_diagonal: csr_matrix, beside: csr_matrix) -> Validity:
    """The Laplacian of `rows`, without the pieces that touch no valid receiver."""
    between = off_diagonal - diags(off_diagonal.diagonal())
    count, piece = connected_components(between, directed=False)
    weight = np.asarray(beside.sum(axis=1)).ravel()
    reached = np.bincount(piece, weight, count)[piece] > 0
    sight = sight.clone()
    sight[rows[torch.from_numpy(~reached)]] = int(Sight.BLIND)
    between, beside, weight = between[reached][:, reached], beside[reached], weight[reached]
    whole = between + diags(weight - np.asarray(between.sum(axis=1)).ravel())
    return Validity(sight, rows[torch.from_numpy(reached)], whole.tocsr(), beside.tocsr())


def _links(geometry: Geometry, normals: Tensor, rows: np.ndarray) -> csr_matrix:
    """Neighbours of `rows` along the surface: over an edge, or at the same place on the same side (a seam)."""
    count = geometry.receivers
    wanted = np.zeros(count, dtype=bool)
    wanted[rows] = True
    faces = geometry.display_faces.numpy()
    faces = faces[wanted[faces].any(axis=1)]
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    first, second = _copies(geometry.receiver_positions.numpy(), normals.numpy(), rows)
    one, other = np.concatenate([tail, first]), np.concatenate([head, second])
    one, other = one[one != other], other[one != other]
    both = np.concatenate([one, other]), np.concatenate([other, one])
    links = coo_matrix((np.ones(len(both[0])), both), (count, count)).tocsr()
    # A neighbour counts once, over however many faces.
    links.data[:] = 1
    return links


def _copies(positions: np.ndarray, normals: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a row and another receiver at its place whose normals agree, or where a normal is missing."""
    place = weld(positions)
    order = np.argsort(place, kind="stable")
    start = np.searchsorted(place[order], np.arange(place.max(initial=-1) + 2))
    sizes = (start[1:] - start[:-1])[place[rows]]
    first = np.repeat(rows, sizes)
    within = np.arange(len(first)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    second = order[start[place[first]] + within]
    agree = np.einsum("ij,ij->i", normals[first], normals[second]) > SMOOTH
    agree |= ~normals[first].any(axis=1) | ~normals[second].any(axis=1)
    keep = (first != second) & agree
    return first[keep], second[keep]
