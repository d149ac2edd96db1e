"""How far an approximation is from its reference."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh import bands
from torchprt.shade import shader
from torchprt.transfer import Transfer


@dataclass(frozen=True)
class ErrorReport:
    """Difference of two sets of values. RMS figures are relative to the RMS of the whole reference.

    - `relative_rms`: over all values.
    - `max_error`: the largest single difference, relative to the largest magnitude of the reference.
    - `per_vertex [V]`: RMS of each vertex (of each receiver); its mean square is that of `relative_rms`.
    - `per_band [n]`: RMS of a coefficient of each band of the light; None for radiance, which has no bands.
    """

    relative_rms: float
    max_error: float
    per_vertex: Float[Tensor, " V"]
    per_band: Float[Tensor, " n"] | None = None

    def __str__(self) -> str:
        worst = float(self.per_vertex.max())
        return f"relative RMS {self.relative_rms:.3g}, largest {self.max_error:.3g}, worst vertex {worst:.3g}"


def relative_rms(value: Float[Tensor, "..."], reference: Float[Tensor, "..."]) -> float:
    """RMS of the difference over all elements, relative to the RMS of `reference`.

    Computed in float64 whatever the inputs are, after division by the largest value, so that 1e-30 and 1e30 are
    as good as 1. Law: unchanged if both are scaled by one factor.
    Raises InputError if the shapes differ, there is no element, one is not finite, or `reference` is zero
    everywhere.
    """
    difference, scale = _compared(value, reference)
    return float(difference.square().mean().sqrt() / scale)


def max_error(value: Float[Tensor, "..."], reference: Float[Tensor, "..."]) -> float:
    """Largest difference, relative to the largest magnitude in `reference`. Raises as `relative_rms`."""
    difference, _ = _compared(value, reference)
    # _compared has divided both by the largest magnitude.
    return float(difference.abs().max())


def psnr(image: Float[Tensor, "..."], reference: Float[Tensor, "..."], peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio in decibels, `10 log10(peak^2 / mean squared error)`; infinite if they are equal.

    For pictures that are shown, with values in [0, peak]. Raises InputError if the shapes differ, there is no
    element, one is not finite or `peak` is not positive.
    """
    from kornia.metrics import psnr as kornia_psnr

    if not peak > 0:
        raise InputError(f"peak must be positive, not {peak}")
    _check(image, reference)
    return float(kornia_psnr(image.double(), reference.double(), peak))


def transfer_error(transfer: Transfer, reference: Transfer) -> ErrorReport:
    """Error of diffuse transfer coefficients against those of `reference`, which may have more bands.

    Bands that `transfer` lacks count as zero, so the error of truncation is part of the figure. Albedo is not
    compared. Compressed transfer counts as what it stands for, lobes in the rest pose. Raises InputError if the two
    have other vertices or channels, one has other layers, or as `relative_rms`.
    """
    if (transfer.vertices, transfer.channels) != (reference.vertices, reference.channels):
        raise InputError(
            f"transfer has {transfer.vertices} vertices and {transfer.channels} channels but the reference has "
            f"{reference.vertices} and {reference.channels}: compare bakes of one scene"
        )
    if transfer.order > reference.order:
        raise InputError(
            f"transfer has order {transfer.order}, above the {reference.order} of the reference: exchange them or "
            "bake the reference with more bands"
        )
    found, wanted = (_vectors(each) for each in (transfer, reference))
    padded = torch.zeros_like(wanted)
    padded[:, : transfer.order**2] = found
    difference, scale = _compared(padded, wanted)
    band = bands(reference.order)
    squares = difference.square().mean((0, 2))
    per_band = torch.zeros(reference.order, dtype=torch.float64).index_add(0, band, squares)
    return ErrorReport(
        relative_rms=float(difference.square().mean().sqrt() / scale),
        max_error=float(difference.abs().max()),
        per_vertex=difference.square().mean((0, 1)).sqrt() / scale,
        per_band=(per_band / torch.bincount(band)).sqrt() / scale,
    )


def radiance_error(transfer: Transfer, reference: Transfer, light: Float[Tensor, "*B N 3"]) -> ErrorReport:
    """Error of the radiance that `transfer` gives under `light`, against that of `reference`; albedo applied.

    `light` has the order of `reference`; `transfer` of a lower order is shaded with the light's first bands.
    Raises InputError as `transfer_error`, or if the light is not of the order of the reference.
    """
    if transfer.vertices != reference.vertices or transfer.order > reference.order:
        raise InputError(
            f"transfer has {transfer.vertices} vertices and order {transfer.order} but the reference has "
            f"{reference.vertices} and {reference.order}: compare with a reference of one scene, of no lower order"
        )
    light = light.double()
    wanted = shader(reference, dtype=torch.float64)(light)
    found = shader(transfer, dtype=torch.float64)(light[..., : transfer.order**2, :])
    difference, scale = _compared(found, wanted)
    vertices = difference.square().movedim(-2, 0).reshape(reference.vertices, -1)
    return ErrorReport(
        relative_rms=float(difference.square().mean().sqrt() / scale),
        max_error=float(difference.abs().max()),
        per_vertex=vertices.mean(1).sqrt() / scale,
    )


def _vectors(transfer: Transfer) -> Float[Tensor, "C N V"]:
    """Diffuse transfer vectors in float64, without albedo."""
    if list(transfer.layers) != ["diffuse"]:
        raise InputError(f"transfer of kind '{transfer.kind}' is more than diffuse: compare the radiance that it gives")
    layer = shader(transfer, dtype=torch.float64).layers["diffuse"]
    return layer.toward(None)


def _check(value: Tensor, reference: Tensor) -> None:
    if value.shape != reference.shape:
        raise InputError(
            f"value has shape {tuple(value.shape)} but the reference {tuple(reference.shape)}: compare equal shapes"
        )
    if value.numel() == 0:
        raise InputError("value and reference are empty: there is nothing to compare")
    for name, tensor in (("value", value), ("reference", reference)):
        if not bool(torch.isfinite(tensor).all()):
            raise InputError(f"{name} holds NaN or infinite values: an error against them means nothing")


def _compared(value: Tensor, reference: Tensor) -> tuple[Tensor, Tensor]:
    """Difference and RMS of the reference in float64, both divided by the reference's largest magnitude."""
    _check(value, reference)
    value, reference = value.detach().double(), reference.detach().double()
    largest = reference.abs().max()
    if largest == 0:
        raise InputError("reference is zero everywhere: an error relative to it means nothing")
    return (value - reference) / largest, (reference / largest).square().mean().sqrt()
