"""Lines of text as a small picture, for windows that have none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

SIZE, LINE, MARGIN = 14, 19, 9
GROUND, INK = (24, 26, 30), (235, 235, 230)


def panel(lines: Sequence[str]) -> UInt8[Tensor, "H W 3"]:
    """sRGB of the lines on a dark ground, as wide as the widest; what is behind a tab stands in one column."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(SIZE)
    parts = [line.partition("\t") for line in lines]
    column = max((font.getlength(left) for left, tab, _ in parts if tab), default=0) + MARGIN
    widths = [column + font.getlength(right) if tab else font.getlength(left) for left, tab, right in parts]
    page = Image.new("RGB", (int(max(widths, default=0)) + 1 + 2 * MARGIN, LINE * len(lines) + 2 * MARGIN), GROUND)
    pen = ImageDraw.Draw(page)
    for number, (left, _, right) in enumerate(parts):
        height = MARGIN + LINE * (number + 0.5)
        pen.text((MARGIN, height), left, fill=INK, font=font, anchor="lm")
        pen.text((MARGIN + column, height), right, fill=INK, font=font, anchor="lm")
    return torch.from_numpy(np.asarray(page).copy())
