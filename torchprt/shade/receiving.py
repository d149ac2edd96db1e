"""What receivers make of the light that arrives: the function of direction that it is integrated against."""

from __future__ import annotations

import abc
import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from torchprt.brdf import Brdf, exit_kernel
from torchprt.errors import InputError
from torchprt.sh import (
    Projection,
    bands,
    basis,
    clamped_cosine,
    exit_functions,
    gauss_legendre_hemisphere,
    phong,
    rotate,
    to_horizon,
)
from torchprt.sh.shapes import broadcast_shapes
from torchprt.shade.view_directions import toward_eye

_DEGREE = 96


class Receiving(abc.ABC, nn.Module):
    """How receivers reflect, chosen at run time: exit radiance is `sum_i w_i l_i` of the light that arrives, on all
    sides, `w` being the SH coefficients of reflectance times cosine above the horizon of the receiver."""

    needs: frozenset[str] = frozenset()

    def check(self, eye: Tensor | None, view: Tensor | None) -> None:
        """InputError if an eye is given that plays no part."""
        if "eye" not in self.needs and not (eye is None and view is None):
            raise InputError("eye or view is given, but diffuse receivers look the same from everywhere: omit it")

    @abc.abstractmethod
    def rows(
        self, normals: Tensor, order: int, positions: Tensor, eye: Tensor | None, view: Tensor | None
    ) -> Float[Tensor, "*B R N"]:
        """The coefficients in the world, of `order`."""

    @abc.abstractmethod
    def turned(
        self, normals: Tensor, order: int, positions: Tensor, eye: Tensor | None, view: Tensor | None, frame: Tensor
    ) -> Float[Tensor, "*B R N"]:
        """The same in a frame that has turned by `frame [*B, 3, 3]` from the world."""


class _About(Receiving):
    """Functions that are symmetric about an axis: turning them is turning the axis."""

    @abc.abstractmethod
    def axis(self, normals: Tensor, positions: Tensor, eye: Tensor | None, view: Tensor | None) -> Tensor:
        """Unit, in the world."""

    @abc.abstractmethod
    def kernel(self, order: int, like: Tensor) -> Float[Tensor, "*R n"]:
        """A coefficient a band, as `sh.zonal` has them."""

    def rows(
        self, normals: Tensor, order: int, positions: Tensor, eye: Tensor | None, view: Tensor | None
    ) -> Float[Tensor, "*B R N"]:
        self.check(eye, view)
        axis = self.axis(normals, positions, eye, view)
        return basis(axis, order) * self.kernel(order, axis)[..., bands(order).to(axis.device)]

    def turned(
        self, normals: Tensor, order: int, positions: Tensor, eye: Tensor | None, view: Tensor | None, frame: Tensor
    ) -> Float[Tensor, "*B R N"]:
        axis = self.axis(normals, positions, eye, view)
        axis = axis @ frame.to(axis.dtype)
        return basis(axis, order) * self.kernel(order, axis)[..., bands(order).to(axis.device)]


class DiffuseReceiving(_About):
    """A clamped cosine about the normal, over pi. Source: Sloan, Kautz and Snyder 2002, equation 6."""

    def axis(self, normals: Tensor, positions: Tensor, eye: Tensor | None, view: Tensor | None) -> Tensor:
        return normals

    def kernel(self, order: int, like: Tensor) -> Float[Tensor, "*R n"]:
        return clamped_cosine(order).to(like) / math.pi


DIFFUSE = DiffuseReceiving()


class PhongReceiving(_About):
    """A Phong lobe of this exponent about the mirrored view, as `IncidentLayer` has it.

    Nothing blocks it below the horizon of the receiver. Raises InputError unless the exponent is finite and not
    negative.
    Source: Sloan, Kautz and Snyder 2002, section 4.2.
    """

    needs = frozenset({"eye"})
    exponent: Tensor

    def __init__(self, exponent: float | int | Tensor) -> None:
        super().__init__()
        value = torch.as_tensor(exponent, dtype=torch.float32)
        if value.ndim or not bool(value.isfinite() & (value >= 0)):
            raise InputError(f"exponent of a Phong lobe is {exponent}: give one number, zero or more")
        self.register_buffer("exponent", value)

    def axis(self, normals: Tensor, positions: Tensor, eye: Tensor | None, view: Tensor | None) -> Tensor:
        toward = directions_to(positions, eye, view).to(normals.dtype)
        return 2 * (toward * normals).sum(-1, keepdim=True) * normals - toward

    def kernel(self, order: int, like: Tensor) -> Float[Tensor, "*R n"]:
        return phong(self.exponent.to(like), order)


class BrdfReceiving(Receiving):
    """Any isotropic BRDF: its exit functions of `output_order`, that of the light if omitted.

    Source: Sloan, Hall, Hart and Snyder 2003, section 3: rows of exit matrices, on an unblocked hemisphere.
    """

    needs = frozenset({"eye"})
    chain: Tensor

    def __init__(self, brdf: Brdf, order: int, *, output_order: int | None = None, projection: Projection = "optimal"):
        """`order` of the light."""
        super().__init__()
        self.order, self.output_order, self.projection = order, output_order or order, projection
        nodes, weights = gauss_legendre_hemisphere(_DEGREE)
        kernel = exit_kernel(brdf, nodes, self.output_order, projection)
        chain = (kernel * weights) @ basis(nodes, order)
        self.register_buffer("chain", chain)

    def rows(
        self, normals: Tensor, order: int, positions: Tensor, eye: Tensor | None, view: Tensor | None
    ) -> Float[Tensor, "*B R N"]:
        toward = directions_to(positions, eye, view).to(normals.dtype)
        frame = frames_about(normals)
        toward = torch.broadcast_to(toward, broadcast_shapes(toward.shape, normals.shape))
        local = to_horizon((frame @ toward.unsqueeze(-1))[..., 0])
        chain = self.chain[:, : order * order].to(local)
        values = exit_functions(local, self.output_order, self.projection) @ chain
        back = frame.mT.expand(*values.shape[:-1], 3, 3)
        return rotate(values.unsqueeze(-1), back)[..., 0]

    def turned(
        self, normals: Tensor, order: int, positions: Tensor, eye: Tensor | None, view: Tensor | None, frame: Tensor
    ) -> Float[Tensor, "*B R N"]:
        rows = self.rows(normals, order, positions, eye, view)
        # Receivers are as channels.
        return rotate(rows.mT, frame.mT.to(rows.dtype)).mT


def directions_to(positions: Tensor, eye: Tensor | None, view: Tensor | None) -> Float[Tensor, "*B #R 3"]:
    """Unit directions toward the eye in the world. Raises InputError unless exactly one of the two is given."""
    toward = toward_eye(positions.movedim(-1, 0), eye, view).movedim(0, -1)
    return normalize(toward, dim=-1)


def frames_about(normals: Float[Tensor, "*B R 3"]) -> Float[Tensor, "*B R 3 3"]:
    """Right-handed frames whose rows are two tangents and the normal; for functions that no turn about it changes.

    Source: Duff and others 2017, "Building an Orthonormal Basis, Revisited".
    """
    x, y, z = normals.unbind(-1)
    sign = torch.where(z < 0, -1.0, 1.0).to(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    first = torch.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    second = torch.stack([b, sign + y * y * a, -y], -1)
    return torch.stack([first, second, normals], -2)
