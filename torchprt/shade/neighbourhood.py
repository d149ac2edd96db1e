"""What an object does to light, read by receivers that it has never seen, wherever it has gone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.functional import embedding_bag, pad

from torchprt.errors import InputError
from torchprt.sh import Rotation, check_rotation, rotate
from torchprt.sh.basis import values_are_at_hand
from torchprt.sh.derivatives import with_all_derivatives
from torchprt.sh.precision import at_least_single, widened
from torchprt.sh.shapes import broadcast_shapes
from torchprt.shade.lattice import Lattice
from torchprt.shade.layer import LayerModule, layer_module
from torchprt.shade.receiving import DIFFUSE, Receiving
from torchprt.shade.shader import turned_light
from torchprt.shade.signal import Making, signal_module
from torchprt.transfer import Neighbourhood, Transfer

Pose = Tensor | tuple[Tensor, Tensor]
"""Where an object has gone from its place at rest: matrices `[..., 4, 4]`, or a rotation `[..., 3, 3]` and a
translation `[..., 3]`."""


class NeighbourhoodShader(nn.Module):
    """Radiance of receivers around an object that was baked by `transport.bake_neighbourhood`, which may be anywhere.

    The light is turned into the frame of the object and put under the matrices of all nodes, once. What the object
    changes of it, `M l - l`, is read trilinearly at each receiver, integrated against the reflectance of the receiver
    (`receiving`, diffuse if omitted) and added to what the plain light gives, which is exact. So beyond the grid
    nothing is changed: over its outermost cells the change falls to zero as the smooth step `t^2 (3 - 2 t)` of the
    distance t from its border, in cells. A receiver costs 8 (3 M) multiplications for the reading, however complex the
    object is.

    Made of the layer `Neighbourhood` of a transfer, dense or clustered; `dtype` as for `shader`.
    Laws: linear in the light; light, pose, receivers (and eye) turned together change nothing; channels do not mix;
    where the object has no effect the radiance is that of the plain light, to rounding.
    What it leaves out: what receivers block and reflect themselves, other objects in the box, and bands of what arrives
    above the output order.
    Raises InputError if the transfer has no such layer.
    Source: Sloan, Kautz and Snyder 2002, section 8, equations 6, 9 and 12.
    """

    def __init__(self, transfer: Transfer, *, receiving: Receiving = DIFFUSE, dtype: torch.dtype | None = None) -> None:
        super().__init__()
        grid = transfer.receivers.as_grid()
        layers = [layer for layer in transfer.layers.values() if isinstance(layer, Neighbourhood)]
        if len(layers) != 1:
            raise InputError(
                f"transfer of kind '{transfer.kind}' has {len(layers)} neighbourhoods: give one that has one"
            )
        (layer,) = layers
        if dtype is None:
            dtype = torch.promote_types(torch.float32, layer.signal.dtype)
        self.order, self.output_order = layer.order, layer.output_order
        self.receiving = receiving
        self.shape = tuple(grid.shape)
        with torch.device("cpu"):
            self.signal = signal_module(layer.signal, Making(transfer.receivers, dtype))
            self.turn = Rotation(self.order, dtype)
            self.lattice = Lattice(grid, dtype)
        self.to(layer.signal.tensors()[layer.signal.stored[0]].device)

    @property
    def dtype(self) -> torch.dtype:
        """Of what is stored and multiplied; places and directions are float32 at least."""
        return next(self.signal.buffers()).dtype

    @property
    def needs(self) -> frozenset[str]:
        """What a call takes beside light, receivers and pose: "eye" if the receivers are glossy."""
        return self.receiving.needs

    def extra_repr(self) -> str:
        nodes = "x".join(map(str, self.shape))
        return f"order={self.order}, output_order={self.output_order}, nodes={nodes}, receiving={self.receiving}"

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        positions: Float[Tensor, "*#B R 3"],
        normals: Float[Tensor, "*#B R 3"],
        pose: Pose | None = None,
        albedo: float | int | Tensor = 1.0,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
    ) -> Float[Tensor, "... R 3"]:
        """Linear exit radiance of receivers at `positions` with unit `normals`, both in the world; zero where a
        normal is.

        `light [..., N, 3]` of the world and `rotation [..., 3, 3]`, which turns it, as for `Shader`. `pose`: where the
        object has gone (at rest if omitted): a batch are frames of an animation. `albedo`: a number or a tensor
        `[..., 3]` or `[..., R, 3]` that all is multiplied with, that of a diffuse receiver, or the weight of its lobe.
        `eye` or `view` if the receivers are glossy. All batches broadcast; gradients flow to light, rotation, pose,
        positions, normals, albedo and eye. Where a receiver moves from cell to cell or over the border, its gradient
        with respect to positions jumps.

        Raises InputError if the light is of another order, shapes do not fit, an eye is missing or not needed or,
        outside of a traced graph, if positions are not finite, normals are neither of unit length nor zero, or `pose`
        or `rotation` is none within 1e-4.
        """
        plain, change = self.parts(light, rotation, positions=positions, normals=normals, pose=pose, eye=eye, view=view)
        return weighed(plain + change, albedo)

    def parts(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        positions: Float[Tensor, "*#B R 3"],
        normals: Float[Tensor, "*#B R 3"],
        pose: Pose | None = None,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
    ) -> tuple[Float[Tensor, "... R 3"], Float[Tensor, "... R 3"]]:
        """What the plain light gives for an albedo of 1, and what the object adds to it; as `forward`."""
        light, turned, moved, positions = self._given(light, rotation, positions, pose)
        wanted = light.dtype
        normals = self._normals(normals)
        rows = self.receiving.rows(normals, self.order, positions, eye, view)
        plain = rows.to(self.dtype) @ light.to(self.dtype)
        change = self._changes(light, positions, turned, moved)
        count = self.output_order**2
        # What arrives is in the frame of the object, and so must be what it is integrated against.
        if turned is None:
            local = rows[..., :count]
        else:
            local = self.receiving.turned(normals, self.output_order, positions, eye, view, turned)
        added = (change * local.to(self.dtype).unsqueeze(-2)).sum(-1)
        lit = normals.abs().amax(-1, keepdim=True) > 0
        return torch.where(lit, plain, 0).to(wanted), torch.where(lit, added, 0).to(wanted)

    def light_at(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        positions: Float[Tensor, "*#B R 3"],
        pose: Pose | None = None,
    ) -> Float[Tensor, "... R N 3"]:
        """The light that arrives at points of the world, SH coefficients in the world, for `under_field`: receivers
        with transfer of their own.

        Bands above the output order are those of the plain light. Raises InputError as `forward`.
        """
        light, turned, moved, positions = self._given(light, rotation, positions, pose)
        change = self._changes(light, positions, turned, moved).to(light.dtype).mT
        if turned is not None:
            # The receivers are as channels of one light.
            receivers = change.shape[-3]
            columns = change.movedim(-3, -2).flatten(-2)
            change = rotate(columns, turned.to(columns.dtype)).unflatten(-1, (receivers, 3)).movedim(-2, -3)
        missing = self.order**2 - self.output_order**2
        return light.unsqueeze(-3) + pad(change, (0, 0, 0, missing))

    def _given(
        self, light: Tensor, rotation: Tensor | None, positions: Tensor, pose: Pose | None
    ) -> tuple[Tensor, Tensor | None, Tensor | None, Tensor]:
        """The light of the world, rotation and translation of the object, and the positions, checked."""
        if positions.ndim < 2 or positions.shape[-1] != 3:
            raise InputError(f"positions have shape {list(positions.shape)}: give [..., R, 3]")
        if values_are_at_hand(positions) and not bool(positions.isfinite().all()):
            raise InputError("positions hold NaN or infinity: give finite numbers")
        turned, moved = motion(pose)
        return turned_light(light, rotation, self.turn), turned, moved, positions

    def _normals(self, normals: Tensor) -> Tensor:
        normals = widened(normals).to(at_least_single(self.dtype))
        if values_are_at_hand(normals):
            length = torch.linalg.vector_norm(normals, dim=-1)
            if not bool((((length - 1).abs() <= 1e-3) | (length == 0)).all()):
                raise InputError("normals must be of unit length, or zero for a receiver without one: normalise them")
        return normals

    def _changes(
        self, light: Tensor, positions: Tensor, turned: Tensor | None, moved: Tensor | None
    ) -> Float[Tensor, "... R 3 M"]:
        """`M l - l` at the receivers, in the frame of the object."""
        wide, count = at_least_single(self.dtype), self.output_order**2
        here = positions if moved is None else positions - moved.unsqueeze(-2)
        here = here.to(wide)
        if turned is not None:
            turned = turned.to(wide)
            here = here @ turned
            back = turned.mT
            light = self.turn(light, back) if torch.compiler.is_compiling() else rotate(light, back.to(light.dtype))
        light = light.to(self.dtype)
        # One row a node, of all that is read there.
        field = self.signal.under(light) - light[..., :count, :].mT.unsqueeze(-1)
        batch = light.shape[:-2]
        table = field.flatten(-3, -2).mT.reshape(-1, 3 * count)
        index, weights = self.lattice(here)
        everyone = broadcast_shapes(batch, index.shape[:-2])
        number = torch.arange(math.prod(batch), device=index.device).view(*batch, 1, 1) * math.prod(self.shape)
        index = (index + number).expand(*everyone, *index.shape[-2:]).reshape(-1, 8)
        weights = weights.to(self.dtype).expand(*everyone, *weights.shape[-2:])
        receivers = weights.shape[-2]
        read = self.blend(table, index, weights.reshape(-1, 8))
        return read.view(*everyone, receivers, 3, count)

    def blend(
        self, table: Float[Tensor, "T D"], index: Int[Tensor, "K 8"], weights: Float[Tensor, "K 8"]
    ) -> Float[Tensor, "K D"]:
        """Weighted sums of eight rows each."""
        return with_all_derivatives(_bags, _gathered, table, weights, index)


def _bags(table: Tensor, weights: Tensor, index: Tensor) -> Tensor:
    return embedding_bag(index, table, mode="sum", per_sample_weights=weights)


def _gathered(table: Tensor, weights: Tensor, index: Tensor) -> Tensor:
    return (table.index_select(0, index.flatten()).unflatten(0, index.shape) * weights.unsqueeze(-1)).sum(1)


def motion(pose: Pose | None) -> tuple[Float[Tensor, "*B 3 3"] | None, Float[Tensor, "*B 3"] | None]:
    """Rotation and translation of a pose; None and None at rest.

    Raises InputError if it has another shape or, where values may be looked at, is no rigid motion within 1e-4.
    """
    if pose is None:
        return None, None
    if isinstance(pose, tuple):
        turned, moved = pose
    else:
        if pose.shape[-2:] != (4, 4):
            raise InputError(f"pose has shape {list(pose.shape)}: give [..., 4, 4], or a rotation and a translation")
        turned, moved = pose[..., :3, :3], pose[..., :3, 3]
        if values_are_at_hand(pose) and not bool(
            (pose[..., 3, :] - pose.new_tensor([0.0, 0, 0, 1])).abs().le(1e-4).all()
        ):
            raise InputError("pose has a last row other than 0, 0, 0, 1: give rigid motions that act on columns")
    if turned.shape[-2:] != (3, 3) or moved.shape[-1:] != (3,):
        raise InputError(
            f"pose is a rotation of shape {list(turned.shape)} and a translation of shape {list(moved.shape)}: give "
            "[..., 3, 3] and [..., 3]"
        )
    check_rotation(turned, "pose")
    if values_are_at_hand(moved) and not bool(moved.isfinite().all()):
        raise InputError("pose moves by NaN or infinity: give finite numbers")
    return turned, moved


def weighed(radiance: Float[Tensor, "*B R 3"], albedo: float | int | Tensor) -> Float[Tensor, "*B R 3"]:
    """Times an albedo, one number or a tensor."""
    return radiance * (albedo.to(radiance.dtype) if isinstance(albedo, Tensor) else albedo)


def by_ratio(
    parts: Sequence[tuple[Float[Tensor, "*#B R 3"], Float[Tensor, "*#B R 3"]]], guard: float = 1e-3
) -> Float[Tensor, "... R 3"]:
    """Radiance of receivers near several objects, of the `parts` of each: what each lets through is multiplied.

    `plain * prod_k (plain + change_k) / plain`, each ratio guarded as `(r p + e^2) / (p^2 + e^2)`, e being `guard`
    times the largest plain radiance of the batch: where there is next to no plain light a ratio is 1. One object is
    exact up to the guard, and none gives the plain light. Two objects whose shadows overlap are as if they were
    independent, which misses that they may block the same light: of the sum of all changes that is further off.
    Raises InputError without parts.
    """
    if not parts:
        raise InputError("by_ratio was given no parts: give those of one object or more")
    plain = parts[0][0]
    least = (guard * plain.detach().abs().amax((-2, -1), keepdim=True)).square() + torch.finfo(plain.dtype).tiny
    total = plain
    for _, change in parts:
        total = total * (1 + change * plain / (plain.square() + least))
    return total


@layer_module.register(Neighbourhood)
def _none_of_its_own(layer: Neighbourhood, making: Making) -> LayerModule:
    raise InputError(
        "a neighbourhood has no radiance of its own: receivers read it, as shade.NeighbourhoodShader(transfer) does"
    )
