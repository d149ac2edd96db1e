"""Do single lobes hold what a thin membrane does with light, however it is bent?"""

import pytest
import torch
from transfers import gloss

from torchprt import light, sh
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Scene, bend, make_mesh, samples
from torchprt.shade import shader
from torchprt.transport import bake, membrane_lobes

EPS = torch.finfo(torch.float32).eps


def sheet(translucency=0.3, **changes):
    ticks = torch.linspace(-1, 1, 5, dtype=torch.float64)
    y, x = torch.meshgrid(ticks, ticks, indexing="ij")
    corner = (torch.arange(4)[:, None] * 5 + torch.arange(4)).reshape(-1)
    quads = torch.stack([corner, corner + 1, corner + 6, corner + 5], -1)
    mesh = make_mesh(
        torch.stack([x, y + 1, 0.2 * (3 * x).sin()], -1).reshape(-1, 3),
        torch.cat([quads[:, :3], quads[:, [0, 2, 3]]]),
        **changes,
    )
    return Scene([Object(mesh, Material(0.5, translucency=translucency))])


@pytest.mark.parametrize("wrong", [-0.1, 1.5, torch.nan, torch.full((50,), 2.0)])
def test_refuses_a_translucency_that_is_no_share(wrong):
    with pytest.raises(InputError, match=r"leaves \[0, 1\]"):
        membrane_lobes(sheet(), translucency=wrong)


def test_refuses_a_translucency_of_other_receivers_and_an_order_of_none():
    with pytest.raises(InputError, match="25 values for 50 receivers"):
        membrane_lobes(sheet(), translucency=torch.zeros(25))
    with pytest.raises(InputError, match="order must be at least 1"):
        membrane_lobes(sheet(), order=0)


@pytest.mark.parametrize("translucency", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("order", [1, 3, 6, 12])
def test_vectors_are_those_of_both_clamped_cosines_by_quadrature(translucency, order):
    transfer = membrane_lobes(sheet(translucency), order=order)
    # The kink at the equator leaves (80 000)^(-3/4) of the rule.
    directions, _ = sh.fibonacci(80_000)
    normals = gloss(transfer).signal.axis[0, 0].mT.double()
    cosine = normals @ directions.mT
    kernel = (cosine.clamp(min=0) + translucency * (-cosine).clamp(min=0)) / torch.pi
    wanted = kernel @ sh.basis(directions, order) * (4 * torch.pi / len(directions))
    found = sh.zonal(gloss(transfer).signal.coefficients[0, 0, 0].mT.double(), normals)
    assert (found - wanted).abs().max() < 1e-4


def test_is_the_unshadowed_bake_of_the_same_scene():
    scene = sheet(0.4)
    transfer, baked = membrane_lobes(scene, order=5), bake(scene, order=5, shadows=False)
    lamps = light.project(light.studio(64), 5).float()
    one, other = shader(transfer)(lamps), shader(baked)(lamps)
    assert (one - other).abs().max() <= 32 * EPS * other.abs().max()
    assert torch.equal(transfer.faces, baked.faces)
    assert torch.equal(transfer.albedo, baked.albedo)


def test_translucency_may_differ_from_place_to_place():
    scene = sheet(0.5)
    share = torch.linspace(0, 1, 50)
    varied = membrane_lobes(scene, order=4, translucency=share)
    for row in (0, 20, 49):
        uniform = membrane_lobes(scene, order=4, translucency=float(share[row]))
        one, other = (gloss(each).signal.coefficients[..., row] for each in (varied, uniform))
        assert (one - other).abs().max() <= 2 * EPS


def test_light_from_behind_shows_through_and_only_as_much_as_is_let():
    flat = samples.wing(16)
    share = torch.linspace(0, 0.6, flat.geometry().receivers)
    upper = membrane_lobes(flat, order=6, translucency=share)
    below = light.directional((0.0, -1.0, 0.0), (1.0, 1.0, 1.0), order=6).float()
    above = light.directional((0.0, 1.0, 0.0), (1.0, 1.0, 1.0), order=6).float()
    shade = shader(upper)
    up = upper.normals[:, 1] > 0.9
    through, lit = shade(below)[up, 0], shade(above)[up, 0]
    # Order 6 of a clamped cosine leaks: up to 5 % of the brightest on the dark side.
    assert ((through - share[up] * lit).abs() <= 0.06 * lit).all()


def test_a_bent_membrane_is_a_membrane_baked_bent():
    scene = sheet(0.4)
    rest = membrane_lobes(scene, order=6)
    lamps = light.project(light.studio(64), 6).float()
    mesh = scene.objects[0].mesh
    posed = bend(mesh.positions, 1.2, 0.0, 2.0)
    bent = membrane_lobes(Scene([Object(make_mesh(posed, mesh.faces), Material(0.5, translucency=0.4))]), order=6)
    both = torch.cat([posed, posed])
    found = shader(rest)(lamps, positions=both.float())
    wanted = shader(bent)(lamps)
    # Normals of a mesh of 4 x 4 squares depend on how its faces are weighted.
    assert (found - wanted).norm() < 0.03 * wanted.norm()


def test_a_vertex_without_a_normal_gets_no_light():
    mesh = make_mesh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]]), torch.tensor([[0, 1, 2]]))
    transfer = membrane_lobes(Scene([Object(mesh, Material(0.5))]))
    transfer.check()
    assert gloss(transfer).signal.coefficients[..., 3].abs().max() == 0
