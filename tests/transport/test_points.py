"""Do points with a gloss record what a vertex in their place would?"""

import math

import pytest
import torch
from glossy_scenes import floor_and_wall, quiet, shiny
from shapes import bowl
from transfers import gloss, stored

import torchprt as prt
from torchprt.errors import InputError
from torchprt.scene import Glosses, Material, Object, Points, Scene, load, make_mesh
from torchprt.transport import OrderWarning, bake
from torchprt.transport.points import among

pytestmark = [pytest.mark.filterwarnings("ignore::torchprt.transport.OrderWarning")]

UP = torch.tensor([[0.0, 1.0, 0.0]])
COLOUR = (0.3, 0.2, 0.1)
PAINT = "ggx:0.4,0.4"


def in_a_bowl():
    """A glossy coloured bowl, and points at its vertices of the same paint."""
    mesh, _ = bowl(math.pi / 2, rings=6, segments=12)
    points = Points(mesh.positions, mesh.normals, COLOUR, PAINT, 0.5, mesh.tangent_field)
    return Scene([Object(mesh, Material(COLOUR, gloss=PAINT, specular=0.5))]), points


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"specular": 0.5}, "specular is given without gloss"),
        ({"gloss": "ward:0.1,0.4"}, "1 points under the anisotropic gloss .* are missing"),
        ({"gloss": "ward:0.1,0.4", "tangents": UP}, "along the normal"),
        (
            {"gloss": Glosses((prt.brdf.parse(PAINT),), torch.zeros(2, dtype=torch.int64))},
            "gloss has shape .* 1 points",
        ),
        ({"gloss": "mirror"}, "mirror"),
        ({"gloss": "lambert", "albedo": 0.5}, "gives back 1.5 times"),
        ({"gloss": PAINT, "specular": 1.5}, r"specular .*\[0, 1\]"),
        ({"gloss": PAINT, "specular": torch.ones(2, 1)}, "specular has 2 rows"),
        ({"gloss": PAINT, "tangents": UP * math.nan}, "tangents of the points are not finite"),
    ],
)
def test_refuses_points_that_cannot_shine(given, match):
    with pytest.raises(InputError, match=match):
        Points(torch.zeros(1, 3), UP, **given)


def test_refuses_frames_that_several_glosses_cannot_have():
    two = Glosses((prt.brdf.parse(PAINT), prt.brdf.parse("phong:4")), torch.tensor([0, 1]))
    points = Points(torch.zeros(2, 3), UP.expand(2, 3), gloss=two)
    for options in ({"frame": "visibility"}, {"factors": 3}):
        with pytest.raises(InputError, match="one glossy material but there are 2"):
            quiet(floor_and_wall(Material(0.5), 3), order=2, rays=8, receivers=points, **options)


def test_points_without_a_gloss_refuse_what_is_of_gloss():
    points = Points(torch.zeros(1, 3), UP)
    with pytest.raises(InputError, match="for glossy materials"):
        quiet(floor_and_wall(Material(0.5), 3), order=2, rays=8, receivers=points, frame="incident")


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"bounces": 2},
        {"frame": "incident", "bounces": 1},
        {"factors": 4, "bounces": 1},
        {"frame": "visibility"},
    ],
)
def test_points_at_vertices_record_what_the_vertices_record(options):
    scene, points = in_a_bowl()
    wanted = quiet(scene, order=4, rays=128, **options)
    found = quiet(scene, order=4, rays=128, receivers=points, **options)
    assert found.kind == wanted.kind
    assert found.bounces == wanted.bounces
    for name in wanted.layers:
        one, other = stored(wanted, name), stored(found, name)
        # Rays of vertices start a step toward the middle of their faces, so that a few on the rim go the other side of
        # an edge; all others are the same.
        differs = (one - other).movedim(-1 if name in ("diffuse", "visibility") else 1, 0).flatten(1).norm(dim=1)
        scale = one.norm() / len(differs) ** 0.5
        assert float(differs.quantile(0.7) / scale) < 1e-4
        assert float((one - other).norm() / one.norm()) < 0.06
    assert torch.equal(gloss(found).tangents, gloss(wanted).tangents)
    assert gloss(found).materials == gloss(wanted).materials
    assert found.error == pytest.approx(wanted.error, rel=0.1)
    # And they are seen from an eye alike.
    light = torch.randn(16, 3, generator=torch.Generator().manual_seed(0))
    reflectance = {"brdf": prt.brdf.parse(PAINT)} if wanted.kind.endswith("incident") else {}
    eye = torch.tensor([0.3, 0.2, 3.0])
    seen = [prt.shader(each, **reflectance)(light, eye=eye) for each in (wanted, found)]
    assert float((seen[0] - seen[1]).norm() / seen[0].norm()) < 0.06


def test_unshadowed_points_have_the_closed_form_of_the_vertices():
    scene, points = in_a_bowl()
    wanted, found = (quiet(scene, order=4, shadows=False, receivers=each) for each in (None, points))
    for name in wanted.layers:
        torch.testing.assert_close(stored(found, name), stored(wanted, name), rtol=0, atol=1e-6)


def test_glossy_points_see_what_diffuse_surfaces_reflect():
    """A Lambertian gloss on points, in a scene that has no gloss: twice the diffuse layer, bounces and colours too."""
    scene = floor_and_wall(Material((0.6, 0.4, 0.2)), 9)
    positions, normals = torch.tensor([[0.3, 0.3, 0.0], [0.0, 0.1, 0.5]]), torch.tensor([[0.0, 0, -1], [0.0, 1, 0]])
    points = Points(positions, normals, 0.3, "lambert", 0.3)
    found = quiet(scene, order=3, rays=256, bounces=2, receivers=points)
    assert (found.kind, found.bounces, found.channels) == ("diffuse + exit", 2, 3)
    # e_0 of the hemisphere is constant, 1 / sqrt(2 pi): exit radiance of unit albedo.
    constant = stored(found)[:, :, 0] / math.sqrt(2 * math.pi)
    torch.testing.assert_close(constant, stored(found, "diffuse").permute(0, 2, 1), rtol=0, atol=1e-5)
    plain = quiet(scene, order=3, rays=256, bounces=2, receivers=Points(positions, normals, 0.3))
    torch.testing.assert_close(stored(plain), stored(found, "diffuse"), rtol=0, atol=1e-6)


def test_points_of_several_glosses_and_none_are_told_apart():
    two = Glosses((prt.brdf.parse(PAINT), prt.brdf.parse("phong:4")), torch.tensor([1, -1, 0, 1]))
    points = Points(torch.tensor([[0.0, 0.2, 0]]).expand(4, 3), UP.expand(4, 3), 0.2, two, specular=0.3)
    found = quiet(floor_and_wall(Material(0.5), 5), order=3, rays=64, bounces=1, receivers=points)
    layer = gloss(found)
    assert layer.receivers.tolist() == [0, 2, 3]
    assert [text.split(":")[0] for text in layer.materials] == ["ggx", "phong"]
    assert torch.equal(stored(found)[:, 0], stored(found)[:, 2])
    assert float((stored(found)[:, 0] - stored(found)[:, 1]).abs().max()) > 0.01
    # Where no tangent is given any frame will do, but it is one.
    torch.testing.assert_close(layer.tangents.norm(dim=-1), torch.ones(3))
    assert not (layer.tangents * found.normals[[0, 2, 3]]).sum(-1).any()


def test_a_given_tangent_turns_the_streaks():
    along = [
        Points(torch.zeros(1, 3), UP, gloss="ward:0.1,0.4", tangents=torch.tensor([t]))
        for t in ([1.0, 0, 0], [0.0, 0, 2])
    ]
    scene = floor_and_wall(Material(0.5), 3, blocker=False)
    one, other = (quiet(scene, order=4, shadows=False, receivers=each) for each in along)
    # A quarter turn about y of points and light alike changes nothing.
    turned = prt.sh.rotate(torch.randn(16, 3, generator=torch.Generator().manual_seed(1)), torch.eye(3))
    quarter = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    eye = torch.tensor([1.0, 2.0, 0.5])
    wanted = prt.shader(one)(turned, eye=eye)
    found = prt.shader(other)(prt.sh.rotate(turned, quarter.T), eye=quarter.T @ eye)
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-5)
    assert not torch.allclose(prt.shader(other)(turned, eye=eye), wanted, rtol=0.01)


def test_points_beside_a_coloured_convex_body_take_endless_bounces():
    """Nothing that rays of the body meet reflects: its transfer has one channel, what it sends has three."""
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    body = make_mesh(corners, torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    points = Points(torch.tensor([[1.0, 1.0, 1.0]]), torch.tensor([[-1.0, -1, -1]]), 0.3, PAINT)
    for paint in (Material(COLOUR), Material(COLOUR, gloss="ggx:0.5,0.4")):
        scene = load(body, material=paint)
        found = quiet(scene, order=3, rays=64, bounces=math.inf, receivers=points)
        once = quiet(scene, order=3, rays=64, bounces=1, receivers=points)
        assert found.channels == 3
        assert torch.equal(stored(found), stored(once))


def test_warns_of_an_order_that_is_too_low_for_points_and_for_what_they_see():
    points = Points(torch.zeros(1, 3), UP, gloss="phong:300")
    plain = Points(torch.zeros(1, 3), UP)
    with pytest.warns(OrderWarning, match="phong:300"):
        bake(floor_and_wall(Material(0.5), 3), order=3, rays=8, progress=False, receivers=points)
    with pytest.warns(OrderWarning, match="phong:200"):
        bake(floor_and_wall(shiny("phong:200"), 3), order=3, rays=8, bounces=1, progress=False, receivers=plain)


def test_a_scene_seen_by_points_keeps_its_faces_and_reflects_to_nobody():
    scene, points = in_a_bowl()
    geometry = scene.geometry()
    found = among(points, geometry)
    assert torch.equal(found.faces, geometry.faces)
    assert found.receivers == len(points.positions)
    assert bool((found.receiver_of_vertex < 0).all())
    assert len(found.display_faces) == 0
