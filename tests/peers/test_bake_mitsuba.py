"""Does a path tracer that no one here wrote see the same light at the vertices of a scan?

Both integrate over rays from the same points about the same normals, so what differs is the Monte Carlo error, our
interpolation of transfer between the vertices of a hit triangle, and Mitsuba's own ray offset (2e-4 of the bunny).
"""

import math

import numpy as np
import pytest
import torch

from torchprt import sh
from torchprt.bake import bake, frames, hemisphere
from torchprt.bake.solve import vertex_receivers
from torchprt.scene import load
from torchprt.shade import shader
from torchprt.trace import Tracer

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")
ALBEDO = (0.6, 0.5, 0.4)
VERTICES, DIRECTIONS, AT_ONCE = 200, 4096, 2048


@pytest.fixture(scope="module")
def mitsuba():
    try:
        mi.set_variant("llvm_ad_rgb")
        mi.Float([1.0, 2.0]) + 1
    except (ImportError, RuntimeError, AttributeError) as fault:
        pytest.skip(f"Mitsuba's LLVM variant does not run here (it needs the library libLLVM): {fault}")
    return mi


@pytest.fixture(scope="module")
def bunny(data):
    return load(data / "mesh" / "bunny.ply", albedo=ALBEDO)


@pytest.fixture(scope="module")
def light():
    """A light of order 5 that is positive everywhere."""
    coloured = torch.randn(25, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    coloured = coloured * 0.5 / (1 + sh.bands(5)[:, None])
    directions, _ = sh.fibonacci(20000)
    lowest = (sh.basis(directions, 5) @ coloured).amin(0)
    coloured[0] += (0.1 - lowest) * math.sqrt(4 * math.pi)
    return coloured


def mitsuba_scene(mi, geometry, light):
    height, width = 512, 1024
    v, u = torch.meshgrid(
        (torch.arange(height, dtype=torch.float64) + 0.5) / height,
        (torch.arange(width, dtype=torch.float64) + 0.5) / width,
        indexing="ij",
    )
    theta, phi = math.pi * v, 2 * math.pi * u
    # Mitsuba's left edge looks along -z, where ours has its centre.
    directions = torch.stack([phi.sin() * theta.sin(), theta.cos(), -phi.cos() * theta.sin()], -1)
    image = (sh.basis(directions.view(-1, 3), 5) @ light).view(height, width, 3).float().numpy()
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": list(ALBEDO)}})
    counts = len(geometry.positions), len(geometry.faces)
    mesh = mi.Mesh("mesh", *counts, has_vertex_normals=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(geometry.positions.float().numpy().ravel())
    parameters["vertex_normals"] = mi.Float(geometry.receiver_normals.float().numpy().ravel())
    parameters["faces"] = mi.UInt32(geometry.faces.numpy().astype(np.uint32).ravel())
    parameters.update()
    return mi.load_dict({"type": "scene", "mesh": mesh, "sky": {"type": "envmap", "bitmap": mi.Bitmap(image)}})


def exit_radiance(mi, scene, depth, origins, turned):
    """Albedo times the cosine-weighted mean of what Mitsuba's path tracer sees along every direction."""
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 64})
    directions = hemisphere(DIRECTIONS, seed=7)
    weights = 2 * directions[:, 2] / DIRECTIONS
    total = np.zeros((len(origins), 3))
    for start in range(DIRECTIONS // AT_ONCE):
        chosen = torch.arange(start, DIRECTIONS, DIRECTIONS // AT_ONCE)
        rays = (directions[chosen] @ turned).reshape(-1, 3).float().numpy()
        points = np.repeat(origins, AT_ONCE, axis=0)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(start, len(rays))
        point, ray = (
            [mi.Float(np.ascontiguousarray(values[:, axis])) for axis in range(3)] for values in (points, rays)
        )
        seen, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(mi.Point3f(*point), mi.Vector3f(*ray)))
        total += (np.array(seen).reshape(3, len(origins), AT_ONCE) * weights[chosen].numpy()).sum(-1).T
    return total * np.array(ALBEDO)


@pytest.mark.parametrize(("bounces", "depth", "tolerance"), [(0, 1, 0.005), (math.inf, -1, 0.01)])
def test_exit_radiance_of_a_scan_agrees_with_a_path_tracer(mitsuba, bunny, light, bounces, depth, tolerance):
    geometry = bunny.geometry()
    chosen = torch.randperm(geometry.receivers, generator=torch.Generator().manual_seed(1))[:VERTICES]
    tracer = Tracer(geometry.positions, geometry.faces)
    origins = vertex_receivers(geometry, tracer)[chosen].origins
    in_world = (origins.double() / tracer.scale + tracer.centre).float().numpy()
    scene = mitsuba_scene(mitsuba, geometry, light)
    theirs = exit_radiance(mitsuba, scene, depth, in_world, frames(geometry.receiver_normals[chosen]))
    transfer = bake(bunny, rays=2048, bounces=bounces, progress=False)
    ours = shader(transfer)(light.float())[chosen].numpy()
    relative = np.sqrt(((ours - theirs) ** 2).mean() / (theirs**2).mean())
    assert relative <= tolerance
