"""`%load_ext torchprt` in a notebook: transfers and lights are shown as pictures."""

from __future__ import annotations

from typing import Any

from torchprt.errors import InputError

# Coefficients of fewer bands, and smaller maps, may as well be any other numbers.
LEAST_ORDER, LEAST_ROWS = 3, 8


def load_ipython_extension(shell: Any) -> None:
    """Enters the pictures in the display of an IPython shell; what is no picture is shown as it always is."""
    formatter = shell.display_formatter.formatters["image/png"]
    formatter.for_type_by_name("torchprt.transfer.transfer", "Transfer", transfer_png)
    formatter.for_type_by_name("torch", "Tensor", light_png)


def unload_ipython_extension(shell: Any) -> None:
    """Takes them out again."""
    import torch

    from torchprt.transfer import Transfer

    formatter = shell.display_formatter.formatters["image/png"]
    for kind in (Transfer, torch.Tensor):
        formatter.type_printers.pop(kind, None)
        formatter.deferred_printers.pop((kind.__module__, kind.__name__), None)


def transfer_png(transfer: Any) -> bytes | None:
    """A transfer under the built-in studio light; None if it cannot be drawn without being told more."""
    from torchprt.preview import look

    try:
        return look(transfer)._repr_png_()
    except InputError:
        return None


def light_png(light: Any) -> bytes | None:
    """A tensor that has the shape of a light, `[N, 3]` of order 3 and more or `[H, 2H, 3]`; None for all others."""
    import math

    from torchprt.preview import look_at_light

    shape = tuple(light.shape)
    coefficients = len(shape) == 2 and shape[1] == 3 and math.isqrt(shape[0]) ** 2 == shape[0] >= LEAST_ORDER**2
    image = len(shape) == 3 and shape[2] == 3 and shape[1] == 2 * shape[0] >= 2 * LEAST_ROWS
    if not (coefficients or image) or not light.is_floating_point():
        return None
    try:
        return look_at_light(light)._repr_png_()
    except InputError:
        return None
