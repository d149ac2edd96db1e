"""Are the older ways of lighting what they say?"""

import math

import pytest
import torch
from transfers import gloss, random_glossy

from torchprt import light, sh
from torchprt.preview import modes

EPS = torch.finfo(torch.float32).eps


def normals(count=60, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_unshadowed_is_the_cosine_integral_over_the_hemisphere(order):
    lamp = torch.randn(order**2, 3, generator=torch.Generator().manual_seed(order), dtype=torch.float64)
    directions, weights = sh.gauss_legendre(64)
    radiance = sh.basis(directions, order) @ lamp
    for normal in normals(5).double():
        cosine = (directions @ normal).clamp(min=0)
        wanted = ((weights * cosine)[:, None] * radiance).sum(0) / math.pi
        found = modes.unshadowed(lamp, normal[None])[0]
        # The kink of the cosine: the rule of degree 64 leaves about 1 / degree^2.
        torch.testing.assert_close(found, wanted, rtol=0, atol=2e-3)


def test_a_constant_light_makes_white_surfaces_as_bright_as_itself():
    lamp = light.constant((1.0, 2.0, 3.0), 4).float()
    found = modes.unshadowed(lamp, normals())
    torch.testing.assert_close(found, torch.tensor([[1.0, 2.0, 3.0]]).expand(60, 3), rtol=0, atol=40 * EPS)


def test_one_lamp_is_the_lamp_where_there_is_only_one():
    toward = (0.3, 0.8, -0.5)
    lamp = light.directional(toward, (3.0, 2.0, 1.0), order=5).float()
    found = modes.one_lamp(lamp, normals())
    axis = torch.nn.functional.normalize(torch.tensor(toward), dim=0)
    wanted = (normals() @ axis).clamp(min=0)[:, None] * torch.tensor([3.0, 2.0, 1.0])
    torch.testing.assert_close(found, wanted, rtol=0, atol=200 * EPS)
    assert float(found.min()) == 0


@pytest.mark.parametrize("order", [1, 3])
def test_a_light_from_everywhere_is_one_lamp_from_above(order):
    found = modes.one_lamp(light.constant(1.0, order).float(), torch.tensor([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))
    assert bool((found[0] > 0).all())
    assert bool((found[1] == 0).all())


def test_black_light_is_black():
    for lit in (modes.unshadowed, modes.one_lamp):
        assert bool((lit(torch.zeros(9, 3), normals()) == 0).all())


def test_the_colour_of_a_glossy_surface_is_albedo_and_specular():
    transfer = random_glossy(glossy=3)
    found = modes.reflectance(transfer)
    for vertex in range(7):
        wanted = transfer.albedo[vertex].clone()
        for place, receiver in enumerate(gloss(transfer).receivers.tolist()):
            if receiver == vertex:
                wanted = (wanted + gloss(transfer).specular[place]).clamp(max=1)
        torch.testing.assert_close(found[vertex], wanted, rtol=0, atol=EPS)


@pytest.mark.parametrize("albedo", [(1, 1), (1, 3), ("V", 1), ("V", 3)])
def test_the_colour_of_a_diffuse_surface_is_its_albedo(make_transfer, albedo):
    transfer = make_transfer(albedo=albedo)
    assert torch.equal(modes.reflectance(transfer), transfer.albedo.expand(25, 3))
