"""How far is diffusion by the dipole from paths that scatter in a body, of a package that no one here wrote?

What differs is the model, and the test says by how much: the dipole is a solution for a flat half-space, where nothing is
known but diffusion. Of a ball of 16 mean free paths that is lit mostly from above it is a fifth too dark at the top and a
third at the bottom, in the right order.
"""

import math

import numpy as np
import pytest
import torch
from path_tracer import variant, vectors

from torchprt import sh
from torchprt.scene import Material, Object, Scene, Subsurface, make_mesh
from torchprt.shade import shader
from torchprt.transport import bake, frames, hemisphere

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")
SCATTERING, ABSORPTION, RADIUS = 1.0, 0.03, 8.0


def test_a_ball_agrees_with_paths_that_scatter_in_it():
    if fault := variant(mi):
        pytest.skip(fault)
    from scipy.spatial import ConvexHull

    points = sh.fibonacci(1500)[0].double()
    faces = torch.from_numpy(ConvexHull(points.numpy()).simplices.astype(np.int64))
    corners = points[faces]
    out = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).mul(corners[:, 0]).sum(-1)
    faces = torch.where(out[:, None] > 0, faces, faces.flip(1))
    medium = Subsurface(SCATTERING, ABSORPTION, 1.0)
    scene = Scene([Object(make_mesh(points, faces, normals=points), Material(subsurface=medium, millimetres=RADIUS))])
    # A light of order 2 that is 1 + y: nowhere negative.
    nodes = sh.fibonacci(4096)[0].double()
    light = (sh.basis(nodes, 2).T @ (1 + nodes[:, 1:2]) * (4 * math.pi / 4096)).expand(-1, 3).float()
    ours = shader(bake(scene, order=2, shadows=False, progress=False))(light)
    image = np.broadcast_to(1 + np.cos(np.pi * (np.arange(64) + 0.5) / 64)[:, None, None], (64, 128, 3))
    world = mi.load_dict(
        {
            "type": "scene",
            "sky": {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image, np.float32))},
            "ball": {
                "type": "sphere",
                "radius": RADIUS,
                "bsdf": {"type": "null"},
                "interior": {
                    "type": "homogeneous",
                    "albedo": SCATTERING / (SCATTERING + ABSORPTION),
                    "sigma_t": SCATTERING + ABSORPTION,
                },
            },
        }
    )
    # One point each of rings of one height: exit radiance is the cosine-weighted mean over directions.
    heights = torch.linspace(-0.95, 0.95, 9).double()
    normals = torch.stack([(1 - heights**2).sqrt(), heights, torch.zeros(9)], -1)
    directions = hemisphere(4096, seed=3).double()
    outward = (directions @ frames(normals).double()).reshape(-1, 3)
    origins = (normals * RADIUS).repeat_interleave(4096, 0) + outward * 0.01
    integrator = mi.load_dict({"type": "volpath", "max_depth": 512, "rr_depth": 256})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, len(origins))
    rays = mi.RayDifferential3f(vectors(mi.Point3f, origins), vectors(mi.Vector3f, -outward))
    seen, _, _ = integrator.sample(world, sampler, rays)
    seen = np.array(seen).reshape(3, 9, 4096).mean(0)
    theirs = (seen * (2 * directions[:, 2] / 4096).numpy()).sum(1)
    near = (points @ normals.T).argmax(0)
    found = ours[near, 0].numpy()
    # The dipole is darker: 5 % of that is the noise of 4096 paths a point.
    share = found / theirs
    assert share.min() > 0.6
    assert share.max() < 0.85
    assert np.corrcoef(found, theirs)[0, 1] > 0.998
