"""Does a path tracer that no one here wrote see the same caustics and shadows around a polished ring?

Both reflect about the same smooth normals; what differs is the Monte Carlo error, more than on plain surfaces because
caustics are narrow, and the interpolation of bounced light between the vertices of the plane.
"""

import numpy as np
import pytest
import torch
from path_tracer import arriving, positive_light, scene, variant

from torchprt.scene import Scene, mirror_of, samples
from torchprt.shade import shader
from torchprt.trace import Tracer
from torchprt.transport import bake, frames, hemisphere
from torchprt.transport.solve import vertex_receivers

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")
ALBEDO, DIRECTIONS = 0.5, 4096


def test_a_ring_on_a_plane_agrees_with_a_path_tracer():
    if fault := variant(mi):
        pytest.skip(fault)
    plane = samples.ring_on_plane(48, albedo=ALBEDO).objects[0]
    shiny = Scene([plane, mirror_of(samples.ring(96))])
    geometry = shiny.geometry()
    near = torch.nonzero(geometry.receiver_positions.norm(dim=-1) < 1.6)[:, 0]
    # Under the ring there is no light, nor anything to compare.
    near = near[(geometry.receiver_positions[near].norm(dim=-1) - 1).abs() > 0.07][::5]
    tracer = Tracer(geometry.positions, geometry.faces)
    in_world = (
        (vertex_receivers(geometry, tracer)[near].origins.double() / tracer.scale + tracer.centre).float().numpy()
    )
    light = positive_light()
    world = scene(
        mi,
        geometry,
        light,
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": [ALBEDO] * 3}},
        {"type": "conductor"},
    )
    directions = hemisphere(DIRECTIONS, seed=7)
    seen = arriving(mi, world, -1, in_world, frames(geometry.receiver_normals[near]), directions)
    theirs = np.einsum("pdc,d->pc", seen, (2 * directions[:, 2] / DIRECTIONS).numpy()) * ALBEDO
    ours = shader(bake(shiny, rays=2048, bounces=8, progress=False))(light.float())[near].numpy()
    without = shader(bake(Scene([plane]), shadows=False, progress=False))(light.float())[near].numpy()
    size = np.sqrt((theirs**2).mean())
    assert np.sqrt(((ours - theirs) ** 2).mean()) <= 0.01 * size
    assert np.sqrt(((without - theirs) ** 2).mean()) > 0.05 * size
