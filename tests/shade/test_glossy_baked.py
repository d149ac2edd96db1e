"""From a scene to radiance: does what was baked and shaded agree with the light traced from every receiver?"""

import math

import pytest
import torch
from shapes import disc, square

from torchprt import brdf, sh
from torchprt.scene import Material, Object, Scene
from torchprt.shade import shader, with_material
from torchprt.transport import bake

ORDER, ALBEDO, SPECULAR = 3, 0.3, 0.5
GLOSS = brdf.Phong(6)
EYE = torch.tensor([1.5, 1.2, 0.7], dtype=torch.float64)

# Default tangents: the gloss is isotropic.
pytestmark = pytest.mark.filterwarnings("ignore::torchprt.scene.TangentWarning")


def scene():
    """A floor that is diffuse and glossy, under a black disc."""
    floor = Object(square(2.0, 5), Material(albedo=ALBEDO, gloss=GLOSS, specular=SPECULAR))
    return Scene([floor, Object(disc(0.5, 0.5), Material(0.0), "blocker")])


def light():
    """Bands that fall off as those of photographs do."""
    values = torch.randn(ORDER**2, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return values / (1 + sh.bands(ORDER)[:, None])


def traced(positions):
    """Exit radiance by the definition: visibility, both layers and the light in 20 000 directions."""
    directions, weights = sh.fibonacci(40_000)
    directions, weights = directions[directions[:, 1] > 0], weights[0]
    incident = sh.evaluate(light(), directions)
    rows = []
    for place in positions.double():
        crossing = place + (0.5 - place[1]) / directions[:, 1:2] * directions
        seen = crossing[:, [0, 2]].norm(dim=-1) > 0.5
        toward = torch.nn.functional.normalize(EYE - place, dim=0)
        # Local z is the world's y.
        reflected = GLOSS(toward[[2, 0, 1]], directions[:, [2, 0, 1]])
        scattered = (ALBEDO / math.pi + SPECULAR * reflected) * directions[:, 1] * seen * weights
        rows.append((scattered[:, None] * incident).sum(0))
    return torch.stack(rows)


@pytest.fixture(scope="module")
def wanted():
    torch.set_num_threads(1)
    return traced(scene().geometry().positions[:25])


def baked(**options):
    return bake(scene(), order=ORDER, rays=2048, progress=False, **options)


def shaded(transfer, **options):
    return shader(transfer, **options)(light().float(), eye=EYE.float())


@pytest.mark.parametrize(
    "made",
    [
        lambda: shaded(baked(output_order=7)),
        lambda: shaded(baked(frame="incident", output_order=7), brdf=GLOSS),
        lambda: shaded(with_material(baked(frame="incident", output_order=7), GLOSS, 6)),
        lambda: shaded(baked(frame="visibility", output_order=7, visibility_order=8)),
    ],
    ids=["exit", "incident", "with_material", "visibility"],
)
def test_every_kind_agrees_with_light_traced_from_the_receivers(wanted, made):
    # Edges of the shadow in 2048 and in 20 000 directions, and what order 7 leaves of the lobe: each about .2 %.
    assert (made() - wanted).norm() < 0.006 * wanted.norm()


def test_factors_agree_with_it_as_far_as_they_reach(wanted):
    """They are made for unshadowed light; what a shadow adds to it they hold less well (1.4 % here, of order 3)."""
    few, many = (shaded(baked(factors=count)) for count in (3, 8))
    assert (many - wanted).norm() < 0.02 * wanted.norm() < 0.2 * (few - wanted).norm()
