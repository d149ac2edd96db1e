"""Does a path tracer that no one here wrote see the same light leave glossy vertices toward the same eyes?

Mitsuba says what arrives at a vertex along each of 4096 directions, by its own visibility, paths and sampling, and
what its own microfacets make of it. Rays start where ours do; normals are ours. (It has no Phong.)
"""

import math

import numpy as np
import path_tracer
import pytest
import torch
from shapes import bowl

from torchprt import sh
from torchprt.scene import load
from torchprt.shade import shader
from torchprt.trace import Tracer
from torchprt.transport import bake, frames, hemisphere
from torchprt.transport.solve import vertex_receivers

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")
VERTICES, DIRECTIONS, EYES = 150, 4096, 8


@pytest.fixture(scope="module", autouse=True)
def mitsuba():
    fault = path_tracer.variant(mi)
    if fault:
        pytest.skip(fault)


def conductor(roughness):
    return {
        "type": "roughconductor", "distribution": "ggx", "alpha": roughness, "material": "none", "sample_visible": True,
    }  # fmt: skip


class Place:
    """Some vertices of a scene, and eyes all around it."""

    def __init__(self, scene):
        self.geometry = geometry = scene.geometry()
        generator = torch.Generator().manual_seed(1)
        self.chosen = torch.randperm(geometry.receivers, generator=generator)[:VERTICES]
        tracer = Tracer(geometry.positions, geometry.faces)
        origins = vertex_receivers(geometry, tracer)[self.chosen].origins
        self.origins = (origins.double() / tracer.scale + tracer.centre).numpy()
        self.frames = frames(geometry.receiver_normals[self.chosen])
        low, high = geometry.positions.amin(0), geometry.positions.amax(0)
        self.eyes = ((low + high) / 2 + 1.5 * (high - low).norm() * sh.fibonacci(EYES)[0]).float()
        toward = self.eyes[:, None].double() - geometry.receiver_positions[self.chosen]
        toward = torch.nn.functional.normalize(toward, dim=-1)
        self.views = torch.einsum("pij,epj->epi", self.frames, toward)
        # The cosine of the eye; below the horizon of a vertex nothing is compared.
        self.above, self.grazing = self.views[..., 2] > 0.02, (self.views[..., 2] > 0.02) & (self.views[..., 2] < 0.25)

    def theirs(self, light, material, depth):
        """Exit radiance `[E, P, 3]` by Mitsuba's paths."""
        world = path_tracer.scene(mi, self.geometry, light, material)
        directions = hemisphere(DIRECTIONS, seed=7)
        radiance = path_tracer.arriving(mi, world, depth, self.origins, self.frames, directions)
        return np.stack(
            [
                np.einsum("pd,pdc->pc", path_tracer.reflectance(mi, material, views, directions), radiance)
                for views in self.views
            ]
        ) * (2 * math.pi / DIRECTIONS)

    def ours(self, light, transfer):
        """The same by a bake."""
        return shader(transfer)(light.float(), eye=self.eyes)[:, self.chosen].numpy()


def relative(difference, wanted, where):
    """Relative RMS."""
    where = where.numpy()
    return float(np.sqrt((difference[where] ** 2).mean() / (wanted[where] ** 2).mean()))


def gloss(roughness):
    return f"ggx:{roughness}"


# Five bands hold a lobe of .5 in shadow, a lobe of .3 wants eight; what is left is 256 rays a vertex.
@pytest.mark.parametrize(("roughness", "order"), [(0.5, 5), (0.3, 8)])
def test_shadowed_exit_radiance_of_a_scan_agrees(data, roughness, order):
    scene, light = load(data / "mesh" / "bunny.ply", material=gloss(roughness)), path_tracer.positive_light()
    place = Place(scene)
    theirs = place.theirs(light, conductor(roughness), 1)
    ours = place.ours(light, bake(scene, rays=256, output_order=order, progress=False))
    assert relative(ours - theirs, theirs, place.above) < 0.015
    assert relative(ours - theirs, theirs, place.grazing) < 0.02


def test_light_between_the_surfaces_of_a_scan_agrees(data):
    """An eighth of the surfaces that rays hit show their front while their interpolated normals look away. There
    Mitsuba sees black, we what they send along their horizon: most of the difference."""
    scene, light = load(data / "mesh" / "bunny.ply", material=gloss(0.3)), path_tracer.positive_light()
    place = Place(scene)
    shadowed, theirs = (place.theirs(light, conductor(0.3), depth) for depth in (1, 2))
    ours = place.ours(light, bake(scene, rays=256, bounces=1, progress=False))
    assert relative(ours - theirs, theirs, place.above) < 0.025
    assert relative(ours - theirs, theirs, place.grazing) < 0.035
    # Without the bounce it would not.
    assert relative(shadowed - theirs, theirs, place.above) > 0.1


def test_light_that_bounces_without_end_in_a_smooth_bowl_agrees():
    """Two thirds of the light have bounced. No normals look away here: of the 2.3 % that differ 1.8 are the noise of
    one path a direction."""
    mesh, _ = bowl(math.radians(60), rings=20, segments=40)
    scene, light = load(mesh, material=gloss(0.3)), path_tracer.positive_light()
    place = Place(scene)
    shadowed, theirs = (place.theirs(light, conductor(0.3), depth) for depth in (1, -1))
    ours = place.ours(light, bake(scene, rays=256, bounces=math.inf, progress=False))
    assert relative(ours - theirs, theirs, place.above) < 0.03
    assert relative(ours - theirs, theirs, place.grazing) < 0.04
    # All channels and eyes together: noise and interpolation have gone, a bias would stay.
    assert abs(ours[place.above].sum() / theirs[place.above].sum() - 1) < 0.005
    assert relative(shadowed - theirs, theirs, place.above) > 0.5
