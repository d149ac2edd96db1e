"""Vertices and triangles of clustered transfer in the order of clusters and superclusters."""

from __future__ import annotations

import dataclasses

import torch

from torchprt.compression.superclusters import cluster_order, superclusters
from torchprt.compression.transfer import faces_between
from torchprt.errors import InputError
from torchprt.transfer import Clustered, Layer, Transfer, Vertices


def reorder(transfer: Transfer, most: int = 8) -> Transfer:
    """The same receivers, those of a cluster one after the other, and clusters of one supercluster too.

    The clusters are those of the last layer that has them. A supercluster holds at most `most` clusters that share
    triangles; vertices that are in no cluster come last. `result.receivers.original [V]` says which vertex of
    `transfer` every one was: `result.receivers.in_mesh_order(radiance)` is in the former order. So a mesh is split for
    engines that draw a cluster at a time.

    Raises InputError if nothing is clustered, `most` is less than 1, there are no triangles, as in a volume, or the
    transfer is reordered already or no mesh.
    Source: Sloan, Hall, Hart and Snyder 2003, section 5.
    """
    clustered = [layer for layer in transfer.layers.values() if isinstance(layer.signal, Clustered)]
    vertices = transfer.receivers
    if not vertices.on_surface:
        raise InputError("there are no triangles in a volume, which engines could draw a cluster at a time: leave it")
    if not clustered or not isinstance(vertices, Vertices):
        raise InputError(f"transfer of kind '{transfer.kind}' has no clusters of vertices: compress it first")
    if vertices.original is not None:
        raise InputError("the transfer is reordered already: reorder what it was made from")
    chosen = clustered[-1]
    signal = chosen.signal
    assert isinstance(signal, Clustered)
    label, clusters = signal.label.long(), len(signal.mean)
    joined = torch.arange(clusters + 1, device=label.device)
    found = superclusters(faces_between(transfer, chosen), label, most)
    joined[: len(found)] = found
    joined[len(found) :] = len(found) + torch.arange(clusters + 1 - len(found), device=label.device)
    # Vertices without the layer are as a cluster of their own.
    whole = torch.full((transfer.vertices,), clusters, device=label.device)
    whole[chosen.index(transfer.vertices)] = label
    points, triangles = cluster_order(transfer.faces, whole, joined)
    place = torch.empty_like(points)
    place[points] = torch.arange(len(points), device=points.device)

    def moved(layer: Layer) -> Layer:
        if layer.receivers is None:
            return layer.take(points, None)
        receivers = place[layer.receivers.long()]
        order = receivers.argsort()
        return layer.take(order, receivers[order].to(layer.receivers.dtype))

    return dataclasses.replace(
        transfer,
        receivers=vertices.replace(
            positions=vertices.positions[points],
            normals=vertices.normals[points],
            faces=place[vertices.faces.long()][triangles].to(vertices.faces.dtype),
            original=points,
            sight=None if vertices.sight is None else vertices.sight[points],
            blend=None if vertices.blend is None else vertices.blend[points],
        ),
        layers={name: moved(layer) for name, layer in transfer.layers.items()},
    )
