"""Mitsuba 3 about the same points, the same normals and the same light as a bake. `mi` is its module."""

import math

import numpy as np
import torch

from torchprt import sh


def variant(mi):
    """The vectorised variant, or the reason why there is none here."""
    try:
        mi.set_variant("llvm_ad_rgb")
        mi.Float([1.0, 2.0]) + 1
    except (ImportError, RuntimeError, AttributeError) as fault:
        return f"Mitsuba's LLVM variant does not run here (it needs the library libLLVM): {fault}"
    return None


def positive_light(order=5):
    """A coloured light that is positive everywhere, [N, 3]."""
    light = torch.randn(order**2, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    light = light * 0.5 / (1 + sh.bands(order)[:, None])
    directions, _ = sh.fibonacci(20000)
    lowest = (sh.basis(directions, order) @ light).amin(0)
    light[0] += (0.1 - lowest) * math.sqrt(4 * math.pi)
    return light


def scene(mi, geometry, light, material, mirror=None):
    """The triangles of a `Geometry` with our normals, of one Mitsuba material and one of its mirrors, under
    `light [N, 3]`."""
    height, width = 512, 1024
    v, u = torch.meshgrid(
        (torch.arange(height, dtype=torch.float64) + 0.5) / height,
        (torch.arange(width, dtype=torch.float64) + 0.5) / width,
        indexing="ij",
    )
    theta, phi = math.pi * v, 2 * math.pi * u
    # Mitsuba's left edge looks along -z, where ours has its centre.
    directions = torch.stack([phi.sin() * theta.sin(), theta.cos(), -phi.cos() * theta.sin()], -1).view(-1, 3)
    image = (sh.basis(directions, math.isqrt(len(light))) @ light).view(height, width, 3).float().numpy()
    sky = {"type": "envmap", "bitmap": mi.Bitmap(image)}
    return mi.load_dict({"type": "scene", "sky": sky, **_meshes(mi, geometry, material, mirror)})


def _meshes(mi, geometry, material, mirror):
    bodies = {"mesh": (geometry.faces[geometry.mirror < 0], geometry.receiver_normals, material)}
    if len(geometry.reflectance):
        bodies = {"mesh": (bodies["mesh"][0], geometry.mirror_normals, material)}
        bodies["mirror"] = (geometry.faces[geometry.mirror >= 0], geometry.mirror_normals, mirror)
    found = {}
    for name, (faces, normals, body) in bodies.items():
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(body)
        mesh = mi.Mesh(name, len(geometry.positions), len(faces), has_vertex_normals=True, props=properties)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(geometry.positions.float().numpy().ravel())
        parameters["vertex_normals"] = mi.Float(normals.float().numpy().ravel())
        parameters["faces"] = mi.UInt32(faces.numpy().astype(np.uint32).ravel())
        parameters.update()
        found[name] = mesh
    return found


def arriving(mi, world, depth, origins, frames, directions, at_once=2048, seed=0):
    """Radiance `[P, D, 3]` that arrives at points along local directions by paths of up to `depth` segments, one path
    each; -1 is as many as it takes. With 1 only the sky is seen."""
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 64})
    found = np.empty((len(origins), len(directions), 3), np.float32)
    parts = math.ceil(len(directions) / at_once)
    for start in range(parts):
        chosen = torch.arange(start, len(directions), parts)
        rays = (directions[chosen] @ frames).reshape(-1, 3)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed + start, len(rays))
        points = vectors(mi.Point3f, np.repeat(origins, len(chosen), axis=0))
        seen, _, _ = integrator.sample(world, sampler, mi.RayDifferential3f(points, vectors(mi.Vector3f, rays)))
        found[:, chosen.numpy()] = np.array(seen).reshape(3, len(origins), len(chosen)).transpose(1, 2, 0)
    return found


def reflectance(mi, material, views, directions):
    """f times the cosine of the light `[P, D]`, for local views `[P, 3]` and lights `[D, 3]`, from Mitsuba."""
    interaction = mi.SurfaceInteraction3f()
    interaction.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    interaction.wi = vectors(mi.Vector3f, np.repeat(np.asarray(views), len(directions), axis=0))
    lights = vectors(mi.Vector3f, np.tile(np.asarray(directions), (len(views), 1)))
    value = mi.load_dict(material).eval(mi.BSDFContext(), interaction, lights)
    return np.array(value)[0].reshape(len(views), len(directions))


def vectors(kind, rows):
    """An array of Mitsuba's points or vectors from rows x, y, z."""
    columns = np.ascontiguousarray(np.asarray(rows, np.float32).T)
    return kind(*columns)
