"""Pictures as images of Pillow, and those as the bytes of a file."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def image_of(picture: Float[Tensor, "H W C"]) -> Any:
    """sRGB values in [0, 1] as an image of Pillow, of 8 bits."""
    from PIL import Image

    values = (picture.detach().cpu().clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    return Image.fromarray(np.ascontiguousarray(values))


def encoded(image: Any, format: str, **options: Any) -> bytes:
    """The file of an image. In memory: Pillow does not notice when a disk takes only a part of a JPEG."""
    stream = io.BytesIO()
    image.save(stream, format=format, **options)
    return stream.getvalue()
