"""How far is diffusion from a path tracer that no one here wrote, in a ball of a medium that bends light?

Mitsuba follows light through the medium and its smooth surface; what the surface mirrors is taken off. The dipole is
that of a half-space. So it is right where the ball is far larger than light goes, and too dark and too rich in contrast
where it is not: errors of the model. The bounds here are about what was measured.
"""

import math

import numpy as np
import pytest
import torch
from path_tracer import positive_light, variant, vectors
from trimesh.creation import icosphere

from torchprt import sh
from torchprt.scene import MATERIALS, Material, Object, Scene, make_mesh
from torchprt.shade import shader
from torchprt.transport import bake, frames, hemisphere

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")
POINTS, DIRECTIONS, SKIN = 24, 6000, MATERIALS["skin1"]


def ball(light, radius, colour):
    """A ball of one colour of a medium under a light, in Mitsuba."""
    height, width = 128, 256
    v, u = torch.meshgrid(
        (torch.arange(height).double() + 0.5) / height, (torch.arange(width).double() + 0.5) / width, indexing="ij"
    )
    theta, phi = math.pi * v, 2 * math.pi * u
    # Mitsuba's left edge looks along -z, where ours has its centre.
    sky = torch.stack([phi.sin() * theta.sin(), theta.cos(), -phi.cos() * theta.sin()], -1)
    image = (sh.basis(sky, math.isqrt(len(light))) @ light)[..., None].expand(-1, -1, 3).float().numpy()
    scattering, absorption = (float(each[colour]) for each in SKIN.coefficients)
    medium = {"type": "homogeneous", "phase": {"type": "isotropic"}, "sigma_t": scattering + absorption}
    medium["albedo"] = scattering / (scattering + absorption)
    surface = {"type": "dielectric", "int_ior": float(SKIN.eta), "ext_ior": 1.0}
    body = {"type": "sphere", "radius": radius, "bsdf": surface, "interior": medium}
    sky = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image))}
    return mi.load_dict({"type": "scene", "sky": sky, "body": body})


def mirrored(cosine):
    """Fresnel's reflectance of its surface."""
    eta = SKIN.eta
    inside = torch.sqrt(1 - (1 - cosine**2) / eta**2)
    across = (cosine - eta * inside) / (cosine + eta * inside)
    along = (eta * cosine - inside) / (eta * cosine + inside)
    return (across**2 + along**2) / 2


def traced(light, radius, colour, normals):
    """What leaves the inside of the ball at some points, as radiance of a diffuse surface."""
    local = hemisphere(DIRECTIONS, seed=7).double()
    away = (local @ frames(normals).double()).reshape(-1, 3)
    normal = normals.repeat_interleave(DIRECTIONS, 0)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, len(away))
    rays = mi.RayDifferential3f(
        vectors(mi.Point3f, (radius * (normal + 0.01 * away)).numpy()), vectors(mi.Vector3f, -away.numpy())
    )
    integrator = mi.load_dict({"type": "volpath", "max_depth": -1, "rr_depth": 16})
    # Nothing is computed before it is read, which the scene must live to see.
    world = ball(light, radius, colour)
    seen, _, _ = integrator.sample(world, sampler, rays)
    seen = torch.from_numpy(np.array(seen)[0].astype(np.float64)).view(len(normals), DIRECTIONS)
    reflected = 2 * (away * normal).sum(-1, keepdim=True) * normal - away
    sky = (sh.basis(reflected, math.isqrt(len(light))) @ light).view(len(normals), DIRECTIONS)
    return 2 * ((seen - mirrored(local[:, 2]) * sky) * local[:, 2]).mean(1)


def test_a_ball_of_skin_beside_a_path_tracer():
    if fault := variant(mi):
        pytest.skip(fault)
    points = torch.tensor(icosphere(4).vertices)
    mesh = make_mesh(points, torch.tensor(icosphere(4).faces), normals=points, name="ball")
    light = positive_light(3)[:, 0]
    rows = torch.randperm(len(mesh.positions), generator=torch.Generator().manual_seed(1))[:POINTS]
    normals = torch.nn.functional.normalize(mesh.positions[rows].double(), dim=-1)

    def ours(radius, **material):
        scene = Scene([Object(mesh, Material(**material))])
        baked = bake(scene, shadows=False, order=3, progress=False)
        return shader(baked)(light.float()[:, None].expand(-1, 3))[rows].double()

    plain = ours(1, albedo=1.0)[:, 0]
    found = {}
    for radius, colour in ((8.0, 0), (16.0, 2)):
        theirs = traced(light, radius, colour, normals)
        diffusing = ours(radius, subsurface=SKIN, millimetres=radius)[:, colour]
        shapes = [each / each.mean() - theirs / theirs.mean() for each in (diffusing, plain)]
        found[colour] = (
            float(diffusing.mean() / theirs.mean()),
            *(float(each.square().mean().sqrt()) for each in shapes),
        )
    # Red goes 6 mm before it is absorbed, blue less than 1. Of the noise of the path tracer 1.5 and 3.5 % are in these.
    level, shape, plain_shape = found[0]
    assert 0.6 < level < 0.8
    assert shape < 0.045 < 0.05 < plain_shape
    level, shape, _ = found[2]
    assert 0.93 < level < 1.07
    assert shape < 0.045
