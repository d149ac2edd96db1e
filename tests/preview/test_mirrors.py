"""Do mirrors show what is in front of them: the model, lit, and beyond it what surrounds the scene?"""

import dataclasses
import math

import pytest
import torch

from torchprt import light
from torchprt.errors import InputError
from torchprt.preview import Camera, Environment, Session, Still, Studio
from torchprt.preview.environment import seen_along
from torchprt.scene import Material, Object, Scene, make_mesh
from torchprt.shade import shader
from torchprt.transport import bake

# Facing +z, through the origin, as wide as any picture here.
SHEET = torch.tensor([[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [-9.0, 9.0, 0.0]])
FACES = torch.tensor([[0, 1, 2], [0, 2, 3]])
OUT = torch.tensor([0.0, 0.0, 1.0]).expand(4, 3)
FRONT = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), field=40.0)


def mirror(share=(1.0, 1.0, 1.0)):
    return SHEET, OUT, torch.tensor(share).expand(4, 3), FACES


# A triangle behind the camera, which faces the mirror.
BEHIND = torch.tensor([[1.0, -1.0, 8.0], [-1.0, -1.0, 8.0], [0.0, 1.5, 8.0]])


def test_refuses_half_a_mirror(make_transfer):
    with pytest.raises(InputError, match="give all or none"):
        make_transfer(side=2).receivers.replace(mirror_faces=FACES)


def test_a_mirror_shows_the_model_the_wrong_way_round_and_in_its_own_colour():
    face = torch.tensor([[0, 1, 2]])
    colours = torch.tensor([[1.0, 0.0, 0.25], [0.0, 1.0, 0.5], [0.5, 0.5, 1.0]])
    camera = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), field=30.0)
    share = (0.9, 0.5, 0.2)
    shown = Still(BEHIND, face, size=(40, 40), camera=camera, mirrors=mirror(share)).radiance(colours)
    # The same by hand: the image of the triangle behind the mirror, its corners in the other order.
    image = Still(BEHIND * torch.tensor([1.0, 1.0, -1.0]), face.flip(1), size=(40, 40), camera=camera).radiance(colours)
    assert float((image > 0).float().mean()) > 0.02
    # At angles of up to 21 degrees Schlick's formula adds less than (1 - cos 21)^5.
    torch.testing.assert_close(shown, image * torch.tensor(share), rtol=0, atol=2e-5)


def test_a_mirror_shows_what_surrounds_the_scene():
    lamp = light.studio(64)
    still = Still(BEHIND, torch.tensor([[0, 2, 1]]), size=(16, 12), camera=FRONT, samples=1, mirrors=mirror((0.5,) * 3))
    assert len(still.sky) == 16 * 12 - int((still.sky[:, 2] <= 0).sum())
    around = seen_along(lamp, still.sky)
    shown = still.radiance(torch.zeros(3, 3), 7.0, around)
    # Each pixel looks along its own direction, turned about the sheet; nothing of the background is seen.
    expected = 0.5 * seen_along(lamp, FRONT.directions(16, 12).float() * torch.tensor([1.0, 1.0, -1.0]))
    dark = (shown == 0).all(-1)
    torch.testing.assert_close(shown[~dark], expected[~dark], rtol=2e-3, atol=1e-4)
    # The triangle's reverse stands in the way of a few.
    assert 0 < int(dark.sum()) < 30
    assert float(still.coverage.min()) == 1.0


def test_a_bake_with_a_mirror_is_pictured_with_it(make_transfer):
    sheet = make_mesh(SHEET / 9, FACES, normals=OUT, name="sheet")
    floor = make_mesh(torch.tensor([[-2.0, -1, -2], [2, -1, -2], [2, -1, 2], [-2, -1, 2]]), FACES.flip(1), name="floor")
    with_it = bake(Scene([Object(floor), Object(sheet, Material(mirror=0.9))]), order=3, rays=16, progress=False)
    plain = dataclasses.replace(with_it, receivers=with_it.receivers.replace(**dict.fromkeys(MIRROR_PARTS)))
    lit = Environment("studio", light.project(light.studio(16), 3), light.studio(16))
    camera = Camera((0.0, 1.0, 4.0), (0.0, -0.4, 0.0))
    first, other = (
        Studio(each, shader(each), lit, size=(24, 24)).picture(camera, torch.eye(3)) for each in (with_it, plain)
    )
    assert float((first - other).abs().max()) > 0.1


MIRROR_PARTS = ("mirror_positions", "mirror_normals", "mirror_reflectance", "mirror_faces")


def test_the_window_shows_the_environment_in_mirrors(make_transfer):
    transfer = make_transfer(side=3, order=3)
    parts = dict(zip(MIRROR_PARTS, mirror((0.5, 0.25, 1.0)), strict=True))
    transfer = dataclasses.replace(transfer, receivers=transfer.receivers.replace(**parts))
    image = light.studio(64)
    session = Session({"bake": transfer}, [Environment("studio", light.project(image, 3), image)])
    colours = session.mirror_colours()
    eye = session.eye
    toward = torch.nn.functional.normalize(eye - SHEET, dim=-1)
    reflected = 2 * toward[:, 2:] * OUT - toward
    share = torch.tensor([0.5, 0.25, 1.0])
    share = share + (1 - share) * (1 - toward[:, 2:].abs()) ** 5
    expected = session._display((seen_along(image, reflected) * share).float())
    torch.testing.assert_close(colours, expected, rtol=0, atol=0.05)
    session.turn_light(1000, 0)
    assert not torch.equal(session.mirror_colours(), colours)
    assert Session({"bake": make_transfer(side=3)}, session.environments).mirror_colours() is None
    assert math.isclose(session.radius, Session({"bake": make_transfer(side=3, order=3)}, session.environments).radius)
