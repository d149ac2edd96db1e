"""Vertices and triangles of clustered transfer in the order of clusters and superclusters."""

from __future__ import annotations

import dataclasses
from typing import Any

import torch
from torch import Tensor

from torchprt.compression.superclusters import cluster_order, superclusters
from torchprt.compression.transfer import receiver_faces
from torchprt.errors import InputError
from torchprt.transfer import ClusteredTransfer, CompressedTransfer


def reorder(transfer: CompressedTransfer, most: int = 8) -> CompressedTransfer:
    """The same receivers, those of a cluster one after the other, and clusters of one supercluster too.

    A supercluster holds at most `most` clusters that share triangles; vertices that are in no cluster come last.
    `result.original [V]` says which vertex of `transfer` every one was: `radiance[original.argsort()]` is in the former
    order. So a mesh is split for engines that draw a cluster at a time.

    Raises InputError if `most` is less than 1, there are no triangles, or the transfer is reordered already.
    Source: Sloan, Hall, Hart and Snyder 2003, section 5.
    """
    if len(transfer.original):
        raise InputError("the transfer is reordered already: reorder what it was made from")
    label, clusters = transfer.label.long(), len(transfer.mean)
    joined = torch.arange(clusters + 1, device=label.device)
    found = superclusters(receiver_faces(transfer), label, most)
    joined[: len(found)] = found
    joined[len(found) :] = len(found) + torch.arange(clusters + 1 - len(found), device=label.device)
    # Vertices without a glossy layer are as a cluster of their own.
    whole = torch.full((transfer.vertices,), clusters, device=label.device)
    receivers = torch.arange(transfer.vertices, device=label.device)
    if not isinstance(transfer, ClusteredTransfer):
        receivers = transfer.glossy.long()
    whole[receivers] = label
    points, triangles = cluster_order(transfer.faces, whole, joined)
    place = torch.empty_like(points)
    place[points] = torch.arange(len(points), device=points.device)
    moved = place[receivers].argsort()
    changes: dict[str, Any] = {
        "positions": transfer.positions[points],
        "normals": transfer.normals[points],
        "faces": place[transfer.faces.long()][triangles].to(transfer.faces.dtype),
        "label": transfer.label[moved],
        "weights": _moved_weights(transfer, moved),
        "squared_error": transfer.squared_error[moved],
        "original": points,
    }
    if len(transfer.albedo) > 1:
        changes["albedo"] = transfer.albedo[points]
    if not isinstance(transfer, ClusteredTransfer):
        changes |= {"glossy": place[receivers][moved].to(transfer.glossy.dtype), "tangents": transfer.tangents[moved]}
        if len(transfer.specular) > 1:
            changes["specular"] = transfer.specular[moved]
        if transfer.diffuse.shape[2]:
            changes["diffuse"] = transfer.diffuse[..., points].contiguous()
    return dataclasses.replace(transfer, **changes)


def _moved_weights(transfer: CompressedTransfer, moved: Tensor) -> Tensor:
    count = transfer.counts[transfer.label.long()]
    starts = (count.cumsum(0) - count)[moved]
    count = count[moved]
    first = count.cumsum(0) - count
    place = torch.arange(len(transfer.weights), device=moved.device) - first.repeat_interleave(count)
    return transfer.weights[starts.repeat_interleave(count) + place]
