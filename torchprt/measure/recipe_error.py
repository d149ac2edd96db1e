"""The one figure that recipes are compared by: what is lost under the light that they serve worst."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.measure.error import relative_rms

Radiance = Float[Tensor, "_ ..."] | Sequence[Float[Tensor, "..."]]
"""Exit radiance `[V, 3]` or `[E, V, 3]` under every light: of all receivers, toward every eye if it depends on one."""


def error_under(found: Radiance, wanted: Radiance) -> float:
    """The largest of `errors_under`: the error of a recipe under several lights.

    Raises InputError as that.
    """
    return max(errors_under(found, wanted))


def errors_under(found: Radiance, wanted: Radiance) -> list[float]:
    """Of each light, the RMS of the difference over all receivers, eyes and channels, relative to that of `wanted`.

    `found` may lack the eyes that `wanted` has, or the other way: what looks the same from everywhere is compared with
    each. Law: unchanged if the light and all it lights are scaled by one factor.
    Raises InputError without lights, if they are not equally many, if shapes differ otherwise, if a number is not
    finite, or if a light leaves `wanted` black.
    """
    if not len(wanted) or len(found) != len(wanted):
        raise InputError(f"radiance under {len(found)} lights and {len(wanted)} of the reference: give the same lights")
    errors = []
    for number, pair in enumerate(zip(found, wanted, strict=True)):
        ours, theirs = _alike(*pair)
        if not bool((theirs != 0).any()):
            raise InputError(f"the reference is black under light {number}: there is no error, give another light")
        errors.append(relative_rms(ours, theirs))
    return errors


def _alike(found: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Both with as many eyes as either has; other differences stay."""
    if found.ndim > 1 and wanted.ndim > 1 and found.shape[-2:] == wanted.shape[-2:]:
        one, other = found.shape[:-2].numel(), wanted.shape[:-2].numel()
        if 1 in (one, other):
            return torch.broadcast_tensors(found, wanted)  # type: ignore[return-value]
    return found, wanted
