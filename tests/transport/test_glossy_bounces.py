"""Does light that bounces between glossy and diffuse surfaces arrive as it should?"""

import math

import pytest
import torch
from glossy_scenes import exit_radiance, floor_and_wall, frames_of, quiet, shiny, views
from shapes import bowl
from transfers import gloss, stored

from torchprt import brdf, sh
from torchprt.scene import Material, Points, load
from torchprt.trace import Tracer
from torchprt.transport import hemisphere
from torchprt.transport.solve import surfaces, vertex_receivers

# Small orders and default tangents on purpose: what is baked is compared with what should be.
pytestmark = [
    pytest.mark.filterwarnings("ignore::torchprt.transport.OrderWarning"),
    pytest.mark.filterwarnings("ignore::torchprt.scene.TangentWarning"),
]

# A constant light of radiance 1 has this first coefficient.
ONE = math.sqrt(4 * math.pi)


@pytest.mark.parametrize("bounces", [0, 1, 3])
@pytest.mark.parametrize("colour", [False, True])
def test_a_glossy_layer_that_is_lambertian_is_the_diffuse_layer(bounces, colour):
    """Half of the albedo as a glossy layer, by matrices and their own bounces: the sum is the diffuse bake."""
    share = (0.3, 0.2, 0.1) if colour else 0.3
    both = (0.6, 0.4, 0.2) if colour else 0.6
    layered = quiet(
        floor_and_wall(shiny("lambert", albedo=share, specular=share), 5), order=3, rays=128, bounces=bounces
    )
    # The same directions as those of the tangent frames.
    plain = quiet(floor_and_wall(Material(both), 5), order=3, rays=4096, bounces=bounces)
    glossy = exit_radiance(layered, views(3))
    # A constant lobe: 1 / pi of irradiance toward every eye, what a diffuse vector of albedo 1 gives.
    for eye in range(3):
        torch.testing.assert_close(glossy[:, :, eye].float(), stored(layered, "diffuse").mT, atol=1e-5, rtol=0)
    scale = float(stored(plain).abs().max())
    assert float((stored(layered, "diffuse") - stored(plain)).square().mean().sqrt()) < 0.01 * scale
    assert layered.channels == (3 if colour and bounces else 1)


def test_one_bounce_off_a_glossy_wall_agrees_with_brute_force():
    model = brdf.parse("phong:4")
    scene = floor_and_wall(shiny(model), 17, blocker=False)
    transfer = quiet(scene, order=3, output_order=6, rays=2048, bounces=1)
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    receivers = vertex_receivers(geometry, tracer)
    place = surfaces(geometry)
    directions = hemisphere(1024, seed=2)
    solid_angle = 2 * math.pi / len(directions)
    turned = receivers.frames().double()
    visible = tracer.visibility(receivers.origins, receivers.frames(), directions.float()).double()

    def direct(point, toward):
        """Exit radiance of a receiver toward world directions, for every coefficient: its own integral."""
        eyes = toward @ turned[point].T
        lobes = model(eyes[:, None], directions) * directions[:, 2] * solid_angle
        return (lobes * visible[point]) @ sh.basis(directions @ turned[point], 3)

    checked = 0
    for point in (17 * 8 + 8, 17 * 13 + 5, 17 * 17 + 17 * 2 + 9):
        hits = tracer.hits(
            receivers.origins[point : point + 1], receivers.frames()[point : point + 1], directions.float()
        )
        arriving = torch.zeros(len(directions), 9, dtype=torch.float64)
        for ray in torch.nonzero((hits.triangle[0] >= 0) & hits.front[0])[:, 0].tolist():
            corners = place.front[hits.triangle[0, ray]].tolist()
            u, v = float(hits.u[0, ray]), float(hits.v[0, ray])
            back = -(directions[ray : ray + 1] @ turned[point])
            for corner, weight in zip(corners, (1 - u - v, u, v), strict=True):
                arriving[ray] += weight * direct(corner, back)[0]
        eyes = views(12)
        lobes = model(eyes[:, None], directions) * directions[:, 2] * solid_angle
        wanted = direct(point, eyes @ turned[point]) + lobes @ arriving
        local = eyes @ turned[point] @ frames_of(transfer)[point].T
        got = sh.hemisphere_basis(local, 6) @ stored(transfer)[0, point].double()
        bounced = float((lobes @ arriving).norm() / wanted.norm())
        assert float((got - wanted).norm() / wanted.norm()) < 0.01
        checked += bounced > 0.05
    # The bounce must matter, or nothing was tested.
    assert checked >= 2


@pytest.mark.parametrize("frame", ["exit", "incident", "zero", "factors"])
def test_other_rows_hold_the_same_bounced_light(frame):
    """Unblocked eye-independent check: with a Lambertian gloss the recorded rows give the diffuse layer again."""
    scene = floor_and_wall(shiny("lambert", albedo=0.3, specular=0.4), 5, blocker=False)
    options = {"exit": {}, "incident": {"frame": "incident"}, "zero": {"projection": "zero"}, "factors": {"factors": 1}}
    transfer = quiet(scene, order=3, output_order=5, rays=128, bounces=2, **options[frame])
    assert transfer.bounces == 2
    assert transfer.transport == "interreflected"
    matrix = stored(transfer)[0].double()
    if frame == "incident":
        # Irradiance from incident radiance: the clamped cosine about the normal, whose tail above order 5 is small.
        lobe = sh.zonal(sh.clamped_cosine(5), torch.tensor([0.0, 0, 1], dtype=torch.float64)) / math.pi
        found, tolerance = lobe @ matrix, 0.03
    elif frame == "factors":
        found, tolerance = gloss(transfer).factors.double().mean((1, 2)) @ matrix, 1e-3
    elif frame == "zero":
        # A constant that is zero below the horizon, cut at order 5: its mean over the upper hemisphere.
        directions, weights = sh.gauss_legendre_hemisphere(20)
        found = (weights @ sh.basis(directions, 5)) @ matrix / (2 * math.pi)
        constant = sh.basis(directions, 5).mT @ weights
        found, tolerance = found / (float(constant @ constant) / (2 * math.pi)), 1e-3
    else:
        found, tolerance = exit_radiance(transfer, views(1))[0, :, 0], 1e-5
    wanted = stored(transfer, "diffuse")[0].T.double()
    assert float((found - wanted).norm() / wanted.norm()) < tolerance


def test_points_among_glossy_surfaces_receive_what_they_reflect():
    points = Points(torch.tensor([[0.3, 0.3, 0.0], [0.0, 0.1, 0.5]]), torch.tensor([[0.0, 0, -1], [0.0, 1, 0]]))
    plain = quiet(floor_and_wall(Material(0.6), 9), order=3, rays=2048, bounces=2, receivers=points)
    layered = quiet(
        floor_and_wall(shiny("lambert", albedo=0.3, specular=0.3), 9), order=3, rays=2048, bounces=2, receivers=points
    )
    assert layered.kind == "diffuse"
    assert layered.bounces == 2
    # The same directions at the points; the vertices around have other frames: their Monte Carlo error.
    assert float((stored(plain) - stored(layered)).abs().max()) < 2e-3
    direct = quiet(floor_and_wall(shiny(), 9), order=3, rays=64, receivers=points)
    assert direct.kind == "diffuse"


def test_a_bowl_of_white_paint_keeps_its_light():
    """A closed form with every bounce: glossy paint that is Lambertian in a bowl that sees equal areas equally."""
    mesh, opening = bowl(math.pi / 2, rings=12, segments=24)
    scene = load(mesh, material=shiny("lambert", specular=0.5))
    transfer = quiet(scene, order=2, output_order=2, rays=1024, bounces=math.inf)
    reading = exit_radiance(transfer, views(2))[0, :, :, 0] * ONE
    # Form factor 1/2 to the sky: the exit radiance of unit albedo is F / (1 - rho (1 - F)) under a constant light.
    wanted = opening / (1 - 0.5 * (1 - opening))
    assert float(reading.median()) == pytest.approx(wanted, rel=0.01)
