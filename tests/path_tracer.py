"""Mitsuba 3 about the same points, the same normals and the same light as a bake. `mi` is its module."""

import math

import numpy as np
import torch

from torchprt import sh
from torchprt.transport import frames, hemisphere


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


def sky(mi, light):
    """A light `[N, 3]` all around."""
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
    return {"type": "envmap", "bitmap": mi.Bitmap(image)}


def scene(mi, geometry, light, material, mirror=None, **more):
    """The triangles of a `Geometry` with our normals, of one Mitsuba material and one of its mirrors, under
    `light [N, 3]`, and what `more` there is."""
    return mi.load_dict({"type": "scene", "sky": sky(mi, light), **_meshes(mi, geometry, material, mirror), **more})


def medium(mi, volume):
    """The cells of a `Volume`, each uniform, in a box that nothing is seen of."""
    size = [count * step for count, step in zip(volume.shape, volume.spacing, strict=True)]
    place = mi.ScalarTransform4f().translate(list(volume.origin)).scale(size)

    def cells(values):
        # Mitsuba's fastest axis is x.
        grid = mi.VolumeGrid(np.ascontiguousarray(values.permute(2, 1, 0, 3).numpy()))
        return {"type": "gridvolume", "grid": grid, "filter_type": "nearest", "to_world": place, "raw": True}

    albedo = volume.albedo if len(volume.albedo) > 1 else volume.albedo.expand(math.prod(volume.shape), -1)
    inside = {
        "type": "heterogeneous",
        "sigma_t": cells(volume.extinction[..., None]),
        "albedo": cells(albedo.unflatten(0, volume.shape)),
        "phase": {"type": "isotropic"} if volume.isotropic else {"type": "hg", "g": volume.moments[1]},
    }
    # A cube is from -1 to 1.
    around = place.translate([0.5] * 3).scale(0.5)
    return {"type": "cube", "to_world": around, "interior": inside, "bsdf": {"type": "null"}}


def through_volume(mi, volume, light, eye, directions, paths, at_once=256, seed=0):
    """Radiance `[R, 3]` that comes to the eye along directions through a `Volume` under `light [N, 3]`, by so
    many paths each; and its standard error."""
    world = mi.load_dict({"type": "scene", "sky": sky(mi, light), "box": medium(mi, volume)})
    integrator = mi.load_dict({"type": "volpath", "max_depth": -1, "rr_depth": 1000})
    rays = np.repeat(directions.numpy(), at_once, 0)
    origins = np.repeat(eye.numpy()[None], len(rays), 0)
    means = []
    for part in range(paths // at_once):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed + part, len(rays))
        ray = mi.RayDifferential3f(vectors(mi.Point3f, origins), vectors(mi.Vector3f, rays))
        seen, _, _ = integrator.sample(world, sampler, ray)
        # Mitsuba's sampling of a narrow phase function is not a number for a path in some ten thousand.
        means.append(torch.from_numpy(np.array(seen)).T.reshape(-1, at_once, 3).double().nanmean(1))
    found = torch.stack(means)
    return found.mean(0), found.std(0) / math.sqrt(len(means))


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


def arriving(mi, world, depth, origins, frames, directions, at_once=2048, seed=0, kind="path"):
    """Radiance `[P, D, 3]` that arrives at points along local directions by paths of up to `depth` segments, one path
    each; -1 is as many as it takes. With 1 only the sky is seen. `kind` of integrator: `volpath` goes into volumes."""
    integrator = mi.load_dict({"type": kind, "max_depth": depth, "rr_depth": 64})
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


def under_lamp(mi, geometry, lamp, albedo, rows, samples=256, seed=0):
    """Exit radiance `[P, 3]` of the vertices `rows` of a `Geometry` under a `SphereEmitter` alone, by paths of one
    reflection: rays that look at them along their normals, from close by."""
    world = scene(mi, geometry, torch.zeros(1, 3, dtype=torch.float64), _white(albedo))
    shape = world.shapes()[0]
    shining = {
        "type": "sphere",
        "center": lamp.center.tolist(),
        "radius": float(lamp.radius),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": lamp.radiance.tolist()}},
    }
    world = mi.load_dict({"type": "scene", "mesh": shape, "lamp": shining})
    normals = geometry.receiver_normals[rows].float().numpy()
    # A little into one of the faces: a ray at a vertex may slip through.
    face = torch.zeros(len(geometry.positions), dtype=torch.long)
    face[geometry.faces.long().flatten()] = torch.arange(len(geometry.faces)).repeat_interleave(3)
    middles = geometry.positions[geometry.faces.long()[face[rows]]].mean(1)
    points = torch.lerp(geometry.positions[rows], middles, 0.02).float().numpy()
    size = float((geometry.positions.amax(0) - geometry.positions.amin(0)).max())
    integrator = mi.load_dict({"type": "path", "max_depth": 2, "rr_depth": 64})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(rows) * samples)
    origins = np.repeat(points + 2e-3 * size * normals, samples, axis=0)
    ways = np.repeat(-normals, samples, axis=0)
    seen, _, _ = integrator.sample(
        world, sampler, mi.RayDifferential3f(vectors(mi.Point3f, origins), vectors(mi.Vector3f, ways))
    )
    return np.array(seen).reshape(3, len(rows), samples).mean(2).T


def _white(albedo):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [albedo] * 3}}


def _ball(mi, light, radius, medium, colour):
    """A ball of one colour of a `Subsurface` under a light `[N]`."""
    height, width = 128, 256
    v, u = torch.meshgrid(
        (torch.arange(height).double() + 0.5) / height, (torch.arange(width).double() + 0.5) / width, indexing="ij"
    )
    theta, phi = math.pi * v, 2 * math.pi * u
    # Mitsuba's left edge looks along -z, where ours has its centre.
    sky = torch.stack([phi.sin() * theta.sin(), theta.cos(), -phi.cos() * theta.sin()], -1)
    image = (sh.basis(sky, math.isqrt(len(light))) @ light)[..., None].expand(-1, -1, 3).float().numpy()
    scattering, absorption = (float(each[colour]) for each in medium.coefficients)
    inside = {"type": "homogeneous", "phase": {"type": "isotropic"}, "sigma_t": scattering + absorption}
    inside["albedo"] = scattering / (scattering + absorption)
    surface = {"type": "dielectric", "int_ior": float(medium.eta), "ext_ior": 1.0}
    body = {"type": "sphere", "radius": radius, "bsdf": surface, "interior": inside}
    sky = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image))}
    return mi.load_dict({"type": "scene", "sky": sky, "body": body})


def _mirrored(cosine, eta):
    """Fresnel's reflectance of a smooth surface."""
    inside = torch.sqrt(1 - (1 - cosine**2) / eta**2)
    across = (cosine - eta * inside) / (cosine + eta * inside)
    along = (eta * cosine - inside) / (eta * cosine + inside)
    return (across**2 + along**2) / 2


def leaving_ball(mi, light, radius, medium, colour, normals, count):
    """What leaves the inside of a ball of one colour of a `Subsurface` at some points, by `count` paths each, as the
    radiance `[P]` of a diffuse surface; what its smooth surface mirrors is taken off."""
    local = hemisphere(count, seed=7).double()
    away = (local @ frames(normals).double()).reshape(-1, 3)
    normal = normals.repeat_interleave(count, 0)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, len(away))
    rays = mi.RayDifferential3f(
        vectors(mi.Point3f, (radius * (normal + 0.01 * away)).numpy()), vectors(mi.Vector3f, -away.numpy())
    )
    integrator = mi.load_dict({"type": "volpath", "max_depth": -1, "rr_depth": 16})
    # Nothing is computed before it is read, which the scene must live to see.
    world = _ball(mi, light, radius, medium, colour)
    seen, _, _ = integrator.sample(world, sampler, rays)
    seen = torch.from_numpy(np.array(seen)[0].astype(np.float64)).view(len(normals), count)
    reflected = 2 * (away * normal).sum(-1, keepdim=True) * normal - away
    sky = (sh.basis(reflected, math.isqrt(len(light))) @ light).view(len(normals), count)
    return 2 * ((seen - _mirrored(local[:, 2], float(medium.eta)) * sky) * local[:, 2]).mean(1)
