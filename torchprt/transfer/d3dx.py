"""Reading what D3DX 9 saved: `.prt`, transfer vectors, and `.pca`, the same in clusters."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.suffixes import check_readable
from torchprt.transfer.clustered import Clustered
from torchprt.transfer.dense import Dense
from torchprt.transfer.layer import Diffuse
from torchprt.transfer.receivers import Receivers, Texels, Vertices
from torchprt.transfer.transfer import Transfer

if TYPE_CHECKING:
    from torchprt.transfer.signal import Signal

SUFFIXES = (".prt", ".pca")
# Unsigned numbers of 32 bits that a file begins with; those of a .pca have two more.
_HEADER = ("NumSamples", "NumCoeffs", "NumChannels", "TexWidth", "TexHeight", "bIsTex")
_COMPRESSED = ("NumClusters", "NumPCA")


def load_d3dx(
    path: str | os.PathLike[str],
    receivers: Receivers | None = None,
    *,
    albedo: Float[Tensor, "#V #3"] | None = None,
) -> Transfer:
    """Diffuse transfer that D3DX 9 saved, `D3DXSavePRTBufferToFile` (`.prt`) or `D3DXSavePRTCompBufferToFile` (`.pca`).

    Such a file holds numbers alone. `receivers` are where they were recorded, the vertices of the mesh in its order:
    without them they are at no place, have no normals and no faces, and can be lit but not drawn. Of a texture they
    are the texels of the file. `albedo [V or 1, 3 or 1]` is 1 if it is not given, and must be if
    `ID3DXPRTEngine::MultiplyAlbedo` was called: the vectors then have it. How light came there, with how many rays, and
    what compression cost, the file does not say: `transport` is "shadowed", `error` None, `squared_error` 0.

    D3DX has the basis, the signs and the order of this project, and divides by pi as it does: no number is changed. Its
    worlds are usually left-handed; lights must be in the same one.
    Layout, little-endian: a header of 6 UINT, then `float[samples][channels][coefficients]`. A .pca has 8 UINT, then
    `float[clusters][1 + vectors][channels][coefficients]`, the mean first, `float[samples][vectors]` of weights and,
    with more than one cluster, `UINT[samples]` of clusters. The documentation of the functions gives the headers, the
    blocks and their sizes; the order within a block is that of `ID3DXPRTBuffer::LockBuffer`, and for a .pca that in
    which `ID3DXPRTCompBuffer::ExtractBasis` and `ExtractPCA` hand them out.

    Raises InputError, naming the file, if it is missing, its size is not the one that its header says, coefficients are
    no square number, channels neither 1 nor 3, a value is not finite, or `receivers` are others.
    Source: Microsoft, Direct3D 9 reference, "D3DXSavePRTBufferToFile", "D3DXSavePRTCompBufferToFile", "PRT Equations".
    """
    path = check_readable(path, "give a .prt or .pca that D3DX saved")
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path} must end in .prt or .pca")
    names = _HEADER if suffix == ".prt" else _HEADER + _COMPRESSED
    said = _header(path, names)
    samples, numbers = said["NumSamples"], said["NumChannels"] * said["NumCoeffs"]
    clusters, vectors = said.get("NumClusters", 0), said.get("NumPCA", 0)
    basis = clusters * (1 + vectors) * numbers
    floats = samples * numbers if suffix == ".prt" else basis + samples * vectors
    labels = samples if clusters > 1 else 0
    expected = 4 * (len(names) + floats + labels)
    found = path.stat().st_size
    if found != expected:
        raise InputError(
            f"{path} has {found} bytes, but its header says {expected}: it is cut short, or nothing that D3DX saved"
        )
    data = np.fromfile(path, "<f4", floats, offset=4 * len(names))
    values = torch.from_numpy(data.astype(np.float32))
    shape = (said["NumChannels"], said["NumCoeffs"])
    signal: Signal
    if suffix == ".prt":
        signal = Dense(values=values.view(samples, *shape).permute(1, 2, 0).contiguous())
    else:
        whole = np.fromfile(path, "<u4", labels, offset=4 * (len(names) + floats)).astype(np.int64)
        label = torch.from_numpy(whole) if labels else torch.zeros(samples, dtype=torch.int64)
        signal = _clustered(values[:basis].view(clusters, 1 + vectors, numbers), values[basis:], label, shape)
    where = _where(path, said, receivers)
    layer = Diffuse(albedo=torch.ones(1, 1) if albedo is None else albedo, signal=signal)
    try:
        transfer = Transfer(receivers=where, layers={"diffuse": layer})
        transfer.check()
    except InputError as fault:
        raise InputError(f"{path}: {fault}") from fault
    return transfer


def _header(path: Path, names: tuple[str, ...]) -> dict[str, int]:
    """The numbers at the head of a file. InputError if no transfer can be of them."""
    with open(path, "rb") as file:
        head = file.read(4 * len(names))
    if len(head) < 4 * len(names):
        raise InputError(f"{path} has {len(head)} bytes, less than the {4 * len(names)} of the header of D3DX")
    said = dict(zip(names, np.frombuffer(head, "<u4").tolist(), strict=True))
    order = math.isqrt(said["NumCoeffs"])
    if not said["NumSamples"] or order < 1 or order * order != said["NumCoeffs"] or said["NumChannels"] not in (1, 3):
        raise InputError(
            f"{path} says {said['NumSamples']} samples of {said['NumCoeffs']} coefficients in {said['NumChannels']} "
            "channels, which is no transfer: D3DX writes a square number of coefficients in 1 or 3 channels"
        )
    if said["bIsTex"] and said["TexWidth"] * said["TexHeight"] != said["NumSamples"]:
        raise InputError(
            f"{path} says {said['NumSamples']} samples of a texture of {said['TexWidth']} x {said['TexHeight']} "
            "texels: it is damaged"
        )
    if said.get("NumClusters", 1) < 1:
        raise InputError(f"{path} says that it has no cluster: it is damaged")
    return said


def _clustered(means: Tensor, weights: Tensor, label: Tensor, shape: tuple[int, int]) -> Clustered:
    """The clusters `[K, 1 + P, Q]` of a file, means first."""
    clusters, count, numbers = means.shape
    none = torch.zeros(0)
    return Clustered(
        label=label.to(torch.int32),
        weights=weights.contiguous(),
        mean=means[:, 0].contiguous(),
        basis=means[:, 1:].reshape(-1, numbers).contiguous(),
        shared=torch.zeros(0, shape[0], 1, shape[1]),
        offsets=torch.arange(clusters + 1, dtype=torch.int32) * (count - 1),
        low=none,
        step=none,
        squared_error=torch.zeros(len(label)),
        method="D3DX",
    )


def _where(path: Path, said: dict[str, int], receivers: Receivers | None) -> Receivers:
    samples = said["NumSamples"]
    if receivers is None:
        if said["bIsTex"]:
            return Texels(rows=said["TexHeight"], columns=said["TexWidth"])
        nowhere = torch.zeros(samples, 3)
        return Vertices(positions=nowhere, normals=nowhere.clone(), faces=torch.zeros(0, 3, dtype=torch.int32))
    if receivers.count != samples:
        raise InputError(
            f"{path} holds {samples} samples, but {receivers.count} receivers are given: give the mesh it was made for"
        )
    return receivers
