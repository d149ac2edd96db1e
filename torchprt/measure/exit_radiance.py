"""Exit radiance of glossy receivers: what a shader gives, and what the integral gives without any basis."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor

from torchprt.brdf import Brdf
from torchprt.errors import InputError
from torchprt.measure.sample import check_chosen
from torchprt.scene import Scene
from torchprt.sh import basis, check_directions, least_window, order_of, rotate
from torchprt.shade import EyeLayerModule, Shader
from torchprt.trace import Tracer
from torchprt.transport import hemisphere
from torchprt.transport.receivers import tangent_frames
from torchprt.transport.solve import vertex_receivers

# Numbers that an integrand takes at a time.
_BLOCK = 1 << 22


def exit_radiance(
    module: Shader, views: Float[Tensor, "D 3"], light: Float[Tensor, "B N 3"]
) -> Float[Tensor, "B D G 3"]:
    """Exit radiance of the glossy layer of a shader toward unit local directions `views`, the same for every receiver.

    What `module(light, view=...)` gives for the directions that these are in the world, without the specular weight
    and the diffuse layer. Raises InputError unless views have unit length, and if no layer depends on the eye.
    """
    check_directions(views)
    layers = [layer for layer in module.layers.values() if isinstance(layer, EyeLayerModule)]
    if not layers:
        raise InputError("the shader has no layer that depends on the eye: shade it without one")
    layer = layers[-1]
    local = views.to(layer.frames.dtype).unsqueeze(1).expand(-1, layer.points.shape[1], -1)
    with torch.no_grad():
        vectors = layer.toward(layer.exit_values(local))
    return torch.einsum("cndg,bnc->bdgc", vectors.expand(3, -1, -1, -1), light.to(vectors.dtype))


def exit_radiance_by_brute_force(
    scene: Scene,
    chosen: Int[Tensor, "g"],
    views: Float[Tensor, "D 3"],
    light: Float[Tensor, "B N 3"],
    *,
    rays: int = 1 << 15,
    seed: int = 0,
) -> Float64[Tensor, "B D g 3"]:
    """`int_H f(v, s) V(s) L(s) s_z ds` of the glossy receivers `chosen` toward unit local directions v, float64.

    The slow twin of every frame of glossy transfer: shadows alone, no exit functions, no specular weight. Visibility
    is traced along `rays` directions of the hemisphere; the light is what the coefficients `light` reconstruct to.
    Raises InputError if `chosen` names a glossy receiver that there is not, or views do not have unit length.
    """
    geometry = scene.geometry()
    check_chosen(chosen, len(geometry.glossy))
    check_directions(views)
    tracer = Tracer(geometry.positions, geometry.faces)
    rows = geometry.glossy[chosen]
    normals = geometry.receiver_normals[rows]
    receivers = vertex_receivers(geometry, tracer)[rows]
    frames = tangent_frames(normals, geometry.tangents[chosen])
    directions = hemisphere(rays, seed)
    harmonics = basis(directions, order_of(light.shape[-2])).contiguous()
    found = torch.zeros(len(views), len(chosen), harmonics.shape[1], dtype=torch.float64)
    material = geometry.gloss_of_glossy[chosen]
    for index, brdf in enumerate(geometry.gloss):
        kernel = _kernel(brdf, views.double(), directions)
        for some in torch.nonzero(material == index)[:, 0].split(max(1, _BLOCK // harmonics.numel())):
            escapes = tracer.visibility(receivers.origins[some], frames[some].float(), directions.float())
            seen = escapes.double().T.unsqueeze(-1) * harmonics.unsqueeze(1)
            found[:, some] = (kernel @ seen.flatten(1)).view(len(views), len(some), harmonics.shape[1])
    found[:, normals.abs().sum(-1) == 0] = 0
    local = rotate(light.double().unsqueeze(1), frames)
    return torch.einsum("dgn,bgnc->bdgc", found, local)


def random_lights(count: int, order: int = 5, seed: int = 0) -> Float64[Tensor, "B N 3"]:
    """Lights that are random over all directions and bands, grey, and nowhere negative.

    Coefficients are independent and of unit variance but for the first, which is 4; then the weakest window that leaves
    no negative radiance (`sh.least_window`) is applied to each light.
    Raises InputError if `order` or `count` is below 1.
    """
    for name, value in (("count", count), ("order", order)):
        if value < 1:
            raise InputError(f"{name} must be at least 1, not {value}")
    generator = torch.Generator().manual_seed(seed)
    light = torch.randn(count, order**2, 1, generator=generator, dtype=torch.float64)
    light[:, 0] = 4.0
    return least_window(light)[0].expand(-1, -1, 3)


def _kernel(brdf: Brdf, views: Tensor, directions: Tensor) -> Float64[Tensor, "D rays"]:
    weights = directions[:, 2] * (2 * math.pi / len(directions))
    kernel = weights.new_empty(len(views), len(directions))
    step = max(1, _BLOCK // len(directions) // 8)
    for start in range(0, len(views), step):
        part = slice(start, start + step)
        kernel[part] = brdf(views[part, None], directions) * weights
    return kernel
