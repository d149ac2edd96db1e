"""Which module shades which kind of transfer."""

from collections.abc import Iterable

import torch

from torchprt.shade.diffuse import DiffuseShader
from torchprt.transfer import DiffuseTransfer


def shader(transfer: DiffuseTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()) -> DiffuseShader:
    """The `nn.Module` that shades `transfer`.

    `dtype`: of its buffers (float32, or wider if the transfer is); `learn`: names of buffers that become
    parameters, such as "albedo". Raises InputError for a name that cannot be learned.
    """
    return DiffuseShader(transfer, dtype=dtype, learn=learn)
