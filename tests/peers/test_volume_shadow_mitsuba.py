"""Does a path tracer that no one here wrote see the same light below a cloud: its shadow, and what it scatters down?

Both integrate over rays from the same points, so what differs is the Monte Carlo error of one path a ray, and what
cells keep of the light inside of them, its mean.
"""

import math

import numpy as np
import pytest
from path_tracer import arriving, medium, positive_light, scene, variant
from shapes import square

from torchprt.scene import Material, Object, Scene, Volume, samples
from torchprt.shade import shader
from torchprt.trace import Tracer
from torchprt.transport import bake, bake_volume, frames, hemisphere
from torchprt.transport.solve import vertex_receivers

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")
ALBEDO, DIRECTIONS = 0.6, 2048


@pytest.fixture(scope="module")
def mitsuba():
    if fault := variant(mi):
        pytest.skip(fault)
    return mi


def rms(values):
    return np.sqrt((values**2).mean())


def test_what_comes_through_and_from_a_cloud_agrees_with_a_path_tracer(mitsuba):
    cloud = samples.cloud(24)
    cloud = Volume(cloud.extinction, cloud.albedo, origin=(-1.0, 0.2, -1.0), spacing=cloud.spacing)
    plane = Scene([Object(square(3.0, 5), Material(ALBEDO))])
    geometry = plane.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    origins = vertex_receivers(geometry, tracer).origins
    in_world = (origins.double() / tracer.scale + tracer.centre).float().numpy()
    light, directions = positive_light(), hemisphere(DIRECTIONS, seed=7)
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0] * 3}}
    world = scene(mitsuba, geometry, light, white, cloud=medium(mitsuba, cloud))
    sent = bake_volume(cloud, blockers=plane, rays=512, bounces=math.inf, progress=False)
    weights = (2 * directions[:, 2] / DIRECTIONS).numpy()
    open_sky = shader(bake(plane, rays=1024, progress=False))(light.float()).numpy()
    seen = arriving(mitsuba, world, -1, in_world, frames(geometry.receiver_normals), directions, kind="volpath")
    theirs = ALBEDO * np.einsum("pdc,d->pc", seen, weights)
    ours = shader(bake(plane, rays=1024, volume=sent, progress=False))(light.float()).numpy()
    # The Monte Carlo error of so many paths is .5 % of the light, and a tenth of that in the mean.
    assert rms(ours - theirs) <= 0.01 * rms(theirs)
    assert abs(ours.mean() / theirs.mean() - 1) <= 0.003
    # The cloud itself changes much more.
    assert rms(open_sky - theirs) >= 0.08 * rms(theirs)
