"""Several pictures on one sheet, each with a line of text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

LINE, GAP = 22, 6


def sheet(pictures: Sequence[Float[Tensor, "H W 3"]], labels: Sequence[str], columns: int) -> Float[Tensor, "I J 3"]:
    """The pictures (sRGB, all of one size) row by row on white, each under its label.

    Raises InputError if there is none, if their sizes differ, or if there is not one label for each.
    """
    if not pictures or len(pictures) != len(labels) or columns < 1:
        raise InputError(f"a sheet of {len(pictures)} pictures with {len(labels)} labels: give one label for each")
    if len({tuple(picture.shape) for picture in pictures}) != 1:
        raise InputError("pictures of a sheet must all have one size")
    from PIL import Image, ImageDraw, ImageFont

    height, width, _ = pictures[0].shape
    rows = -(-len(pictures) // columns)
    size = columns * (width + GAP) + GAP, rows * (height + LINE + GAP) + GAP
    page = Image.new("RGB", size, "white")
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(14)
    for number, (picture, label) in enumerate(zip(pictures, labels, strict=True)):
        x = GAP + number % columns * (width + GAP)
        y = GAP + number // columns * (height + LINE + GAP)
        pen.text((x + width / 2, y + LINE / 2), label, fill="black", font=font, anchor="mm")
        values = (picture.detach().cpu().clamp(0, 1) * 255).round().to(torch.uint8).numpy()
        page.paste(Image.fromarray(np.ascontiguousarray(values)), (x, y + LINE))
    return torch.from_numpy(np.asarray(page).copy()).to(torch.float32) / 255
