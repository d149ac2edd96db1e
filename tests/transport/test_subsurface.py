"""Does light that enters a body leave it where and as much as the dipole says?"""

import numpy as np
import pytest
import torch
from glossy_scenes import quiet
from shapes import square
from transfers import stored

from torchprt.errors import InputError
from torchprt.progress import Silent
from torchprt.scene import MATERIALS, Material, Object, Scene, Subsurface, SubsurfaceWarning, make_mesh, read_material
from torchprt.sh import fibonacci
from torchprt.transport import Threads
from torchprt.transport.stages import Stages
from torchprt.transport.subsurface import Body, diffused

EPS = torch.finfo(torch.float32).eps


def ball(vertices=400, radius=1.0):
    """A closed mesh around the origin."""
    from scipy.spatial import ConvexHull

    points = fibonacci(vertices)[0].double()
    faces = torch.from_numpy(ConvexHull(points.numpy()).simplices.astype(np.int64))
    corners = points[faces]
    outward = (torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners[:, 0]).sum(-1)
    faces = torch.where(outward[:, None] > 0, faces, faces.flip(1))
    return make_mesh(points * radius, faces, normals=points, name="ball")


def body_of(mesh, medium, millimetres=1.0, **more):
    below = MATERIALS[medium] if isinstance(medium, str) else medium
    places = mesh.positions * millimetres
    return Body(torch.arange(len(places)), places, mesh.faces, below.dipole, 1.0, **more)


def through(body, light, threads=1):
    with Threads(threads) as workers:
        return diffused(body, light, 1, Stages(workers, Silent())).view(len(light), 3, -1)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"subsurface": "marble"}, r"millimetres.*marble@100"),
        ({"subsurface": "granite", "millimetres": 1}, "no medium"),
        ({"subsurface": "marble", "millimetres": 0}, "above 0"),
        ({"subsurface": "marble", "millimetres": float("nan")}, "above 0"),
        ({"subsurface": "marble", "millimetres": 1, "translucency": 0.5}, "thin sheets"),
        ({"subsurface": "marble", "millimetres": 1, "two_sided": True}, "two_sided"),
        ({"subsurface": "marble", "millimetres": 1, "mirror": 1.0}, "mirror"),
        ({"millimetres": 1}, "without subsurface"),
    ],
)
def test_a_body_that_cannot_be_is_refused(arguments, what):
    with pytest.raises(InputError, match=what):
        Material(**arguments)


@pytest.mark.parametrize("text", ["marble", "marble@", "marble@x", "marble@-1", "skin1@100+gloss", "subsurface:1@3"])
def test_text_of_a_body_that_cannot_be_is_named(text):
    with pytest.raises(InputError, match=rf"material '{text.replace('+', '.')}'"):
        read_material(text)


def test_a_body_is_said_in_a_word_or_in_a_file(tmp_path):
    read = read_material("skin1@100+ggx:0.35,0.03")
    assert (read.medium, read.millimetres, read.albedo) == (MATERIALS["skin1"], 100, 1.0)
    (tmp_path / "skin.toml").write_text('subsurface = "skin1"\nmillimetres = 100\ngloss = "ggx:0.35,0.03"\n')
    file = read_material(tmp_path / "skin.toml")
    assert (file.medium, file.millimetres, file.gloss) == (read.medium, read.millimetres, read.gloss)


def test_a_mesh_that_light_cannot_diffuse_in_is_told_with_the_numbers():
    with pytest.warns(SubsurfaceWarning, match=r"open \(16 edges"):
        Object(square(10.0, 5), Material(subsurface="skin1", millimetres=0.5))
    with pytest.warns(SubsurfaceWarning, match=r"edges of .* mm .* times the mean free path of marble, 0.46 mm"):
        Object(ball(), Material(subsurface="marble", millimetres=1000))


def test_a_body_of_one_face_or_none_is_no_fault():
    one = make_mesh(torch.eye(3).double(), torch.tensor([[0, 1, 2]]))
    assert bool(through(body_of(one, "skin1"), torch.ones(3, 2)).gt(0).all())
    none = Body(torch.arange(3), torch.eye(3).double(), torch.zeros(0, 3).long(), MATERIALS["skin1"].dipole, 1.0)
    assert not through(none, torch.ones(3, 2)).any()


def test_faces_without_area_send_nothing():
    mesh = ball(60)
    flat = torch.cat([mesh.faces, torch.tensor([[0, 0, 1], [2, 3, 2]])])
    light = torch.rand(60, 2)
    with_flat = through(body_of(make_mesh(mesh.positions, flat, normals=mesh.normals), "skin1"), light)
    torch.testing.assert_close(with_flat, through(body_of(mesh, "skin1"), light), rtol=1e-5, atol=1e-6)
    assert bool(with_flat.isfinite().all())


@pytest.mark.parametrize("millimetres", [2.0, 5.0, 2000.0])
def test_a_body_agrees_with_quadrature_over_all_its_faces(millimetres):
    """Brute force: every face in 400 parts, each a point; vertices' own faces are counted as a full turn."""
    mesh = ball(150)
    body = body_of(mesh, "marble", millimetres)
    light = (mesh.normals[:, :2] + 0.3).clamp(min=0).float()
    found = through(body, light).double()
    at, parts = (torch.arange(20) + 0.5) / 20, []
    for low in at:
        for high in at:
            root = high.sqrt()
            parts.append(torch.stack([1 - root, root * (1 - low), root * low]))
    share = torch.stack(parts).double()
    corners = body.positions[body.faces]
    points = torch.einsum("qk,fkx->fqx", share, corners)
    entering = torch.einsum("qk,fkw->fqw", share, light[body.faces].double()) * body.area[:, None, None] / len(share)
    exact = torch.zeros_like(found)
    for vertex in range(0, 150, 10):
        own = (body.faces == vertex).any(1)
        weight = torch.where(own, body.turn[vertex], 1.0)[:, None, None]
        profile = body.source.at_square(((points - body.positions[vertex]) ** 2).sum(-1)) * weight
        exact[vertex] = torch.einsum("fqc,fqw->cw", profile, entering)
    # Points of brute force are a twentieth of an edge apart: far more than a mean free path at the largest scale, where
    # only the total is known.
    if millimetres < 100:
        torch.testing.assert_close(found[::10], exact[::10], rtol=0, atol=0.01 * float(exact.max()))
    else:
        plain = body.source.total[:, None] * light[:, None].double()
        torch.testing.assert_close(found, plain.expand_as(found), rtol=0, atol=2e-3)


@pytest.mark.parametrize("edge", [0.4, 1.0, 3.0, 100.0, 1e5])
def test_a_half_space_under_constant_light_reflects_the_closed_form(edge):
    """The middle of a square: a disc about it is within, and the square within another."""
    body = body_of(square(edge * 24, 25), "skin1")
    found = through(body, torch.ones(625, 1))[312, :, 0].double()
    low, high = (body.source.within(torch.tensor(edge * 12 * far)) for far in (1.0, 2**0.5))
    assert bool((found >= low - 2e-3).all())
    assert bool((found <= high + 2e-3).all())
    if edge >= 3:
        torch.testing.assert_close(found, body.source.total, atol=1e-4, rtol=0)


@pytest.mark.parametrize(("more", "worst"), [({"spread": 0.1}, 0.04), ({}, 0.15)])
def test_a_searchlight_leaves_by_the_profile(more, worst):
    body = body_of(square(8.0, 41), "skin2", **more)
    light = torch.zeros(41 * 41, 1)
    middle = 20 * 41 + 20
    light[middle] = 1
    found = through(body, light)[:, :, 0].double()
    apart = body.positions.sub(body.positions[middle]).norm(dim=-1)
    # The light is a hat of one edge, whose volume is an edge squared; its width is a tenth of these distances.
    ring = (apart > 0.8) & (apart < 3.5)
    exact = body.source.profile(apart[ring]) * 0.2**2
    error = (found[ring] - exact).abs() / exact
    assert float(error.max()) < worst


def test_nothing_comes_back_where_nothing_scatters_and_all_where_nothing_absorbs():
    mesh, light = ball(200), torch.ones(200, 1)
    black = through(body_of(mesh, Subsurface(0.0, 1.0, 1.3)), light)
    assert float(black.abs().max()) == 0
    white = through(body_of(mesh, Subsurface(1.0, 0.0, 1.3), 1e4), light)
    torch.testing.assert_close(white, torch.ones_like(white), atol=1e-3, rtol=0)


def test_a_thin_body_gives_back_no_more_than_it_gets():
    flat = ball(300)
    thin = make_mesh(flat.positions * torch.tensor([20.0, 0.3, 20.0]), flat.faces, normals=flat.normals)
    found = through(body_of(thin, Subsurface(1.0, 0.0, 1.3)), torch.ones(300, 1))
    assert float(found.max()) <= 1 + 8 * EPS
    assert float(found.max()) > 0.99


def test_a_body_is_the_same_in_other_units_elsewhere_and_in_any_threads():
    mesh = ball(200)

    def vectors(scale, move, **more):
        placed = make_mesh(mesh.positions * scale + move, mesh.faces, normals=mesh.normals)
        scene = Scene([Object(placed, Material(subsurface="skin1", millimetres=5 / scale))])
        return stored(quiet(scene, order=3, shadows=False, **more))

    plain = vectors(1.0, 0.0)
    assert plain.shape == (3, 9, 200)
    assert torch.equal(plain, vectors(1.0, 0.0, threads=3))
    for scale, move in ((2.0**-20, 0.0), (2.0**20, 0.0), (1.0, 1e4)):
        torch.testing.assert_close(vectors(scale, move), plain, atol=2e-5, rtol=0)


def test_a_bake_has_the_light_that_diffused_and_it_bounces():
    """Light on a ball of ketchup leaves it red, and so does what the floor below gets from it."""
    lump = make_mesh(ball(200).positions + torch.tensor([0.0, 1.0, 0.0]), ball(200).faces)
    floor = Object(square(6.0, 7), Material(0.5))
    scene = Scene([Object(lump, Material(subsurface="ketchup", millimetres=10)), floor])
    none, one = (stored(quiet(scene, order=2, rays=256, bounces=count)) for count in (0, 1))
    assert none.shape == one.shape == (3, 4, 249)
    red, green = none[0, 0, :200], none[1, 0, :200]
    assert bool((red > 5 * green).all())
    # On the floor nothing diffuses: three times the same, and with a bounce more red than green.
    torch.testing.assert_close(none[0, :, 200:], none[1, :, 200:], atol=0, rtol=0)
    assert bool((one[0, 0, 200:] >= one[1, 0, 200:]).all())
    assert float((one[0, 0, 200:] - one[1, 0, 200:]).max()) > 0.003


def test_a_gloss_lies_over_a_body():
    said = {"subsurface": "marble", "millimetres": 10, "albedo": 0.5}
    scene = Scene([Object(ball(200), Material(**said, gloss="phong:2", specular=0.3))])
    transfer = quiet(scene, order=3, shadows=False)
    assert list(transfer.layers) == ["diffuse", "exit"]
    plain = quiet(Scene([Object(ball(200), Material(**said))]), order=3, shadows=False)
    assert torch.equal(transfer.layers["diffuse"].signal.values, stored(plain))
