"""Does a path tracer that no one here wrote see the same light at the vertices of a scan?

Both integrate over rays from the same points about the same normals, so what differs is the Monte Carlo error, our
interpolation of transfer between the vertices of a hit triangle, and Mitsuba's own ray offset (2e-4 of the bunny).
"""

import math

import numpy as np
import pytest
import torch
from path_tracer import arriving, positive_light, scene, variant

from torchprt.scene import load
from torchprt.shade import shader
from torchprt.trace import Tracer
from torchprt.transport import bake, frames, hemisphere
from torchprt.transport.solve import vertex_receivers

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")
ALBEDO = (0.6, 0.5, 0.4)
VERTICES, DIRECTIONS = 160, 4096
WHITE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(ALBEDO)}}


@pytest.fixture(scope="module")
def mitsuba():
    if fault := variant(mi):
        pytest.skip(fault)
    return mi


@pytest.fixture(scope="module")
def bunny(data):
    return load(data / "mesh" / "bunny.ply", albedo=ALBEDO)


@pytest.mark.parametrize(("bounces", "depth", "tolerance"), [(0, 1, 0.005), (math.inf, -1, 0.01)])
def test_exit_radiance_of_a_scan_agrees_with_a_path_tracer(mitsuba, bunny, bounces, depth, tolerance):
    geometry = bunny.geometry()
    chosen = torch.randperm(geometry.receivers, generator=torch.Generator().manual_seed(1))[:VERTICES]
    tracer = Tracer(geometry.positions, geometry.faces)
    origins = vertex_receivers(geometry, tracer)[chosen].origins
    in_world = (origins.double() / tracer.scale + tracer.centre).float().numpy()
    light = positive_light()
    world = scene(mitsuba, geometry, light, WHITE)
    directions = hemisphere(DIRECTIONS, seed=7)
    seen = arriving(mitsuba, world, depth, in_world, frames(geometry.receiver_normals[chosen]), directions)
    # Albedo times the cosine-weighted mean of what Mitsuba's path tracer sees along every direction.
    weights = (2 * directions[:, 2] / DIRECTIONS).numpy()
    theirs = np.einsum("pdc,d->pc", seen, weights) * np.array(ALBEDO)
    transfer = bake(bunny, rays=1024, bounces=bounces, progress=False)
    ours = shader(transfer)(light.float())[chosen].numpy()
    relative = np.sqrt(((ours - theirs) ** 2).mean() / (theirs**2).mean())
    assert relative <= tolerance
