"""Does light that arrives at a patch diffuse below its relief, and through it where it is thin?"""

import math

import pytest
import torch
from transfers import stored

from torchprt import sh
from torchprt.errors import InputError
from torchprt.scene import MATERIALS, Subsurface, height_field, samples
from torchprt.transport import bake_patch, patch_transfer

SKIN = MATERIALS["skin1"]
FEW = {"size": 6, "rays": 64, "order": 3, "threads": 1}
WHITE = math.sqrt(4 * math.pi)


def flat(count=8):
    return height_field(torch.zeros(count, count))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"subsurface": "granite", "millimetres": 5}, "'granite' is no medium"),
        ({"subsurface": "marble"}, "by millimetres how wide a tile is"),
        ({"subsurface": "marble", "millimetres": 0}, "millimetres is 0"),
        ({"subsurface": "marble", "millimetres": float("nan")}, "millimetres is nan"),
        ({"subsurface": "marble", "millimetres": 5, "thickness": -0.1}, "thickness is -0.1"),
        ({"subsurface": "marble", "millimetres": 5, "albedo": 0.5}, "albedo and subsurface are both given"),
        ({"millimetres": 5}, "millimetres is given without subsurface"),
        ({"thickness": 0.1}, "thickness is given without subsurface"),
    ],
)
def test_refuses_what_is_no_body_below_a_patch(options, message):
    with pytest.raises(InputError, match=message):
        patch_transfer(flat(), **FEW, **options)


@pytest.mark.parametrize("millimetres", [1, 10, 1e4])
def test_a_flat_patch_is_a_half_space(millimetres):
    """Whether light goes as far as all of the patch and on, or nowhere near the next vertex."""
    baked = patch_transfer(flat(), **FEW, subsurface=SKIN, millimetres=millimetres)
    plane = patch_transfer(flat(), **FEW, albedo=1.0)
    wanted = stored(plane) * (SKIN.reflectance * SKIN.entering).float()[:, None, None]
    # What is far is gathered from clusters.
    assert (stored(baked) - wanted).abs().max() < 1e-3 * wanted.abs().max()


@pytest.mark.parametrize("thickness", [None, 0.05])
def test_a_patch_shifted_by_half_is_its_map_shifted_by_half(thickness):
    mesh = samples.waffle(12)
    moved = height_field(mesh.positions[:, 2].view(13, 13)[:12, :12].roll((6, 6), (0, 1)))
    options = FEW | {"rays": 256, "subsurface": "skin1", "millimetres": 5, "thickness": thickness}
    one = stored(patch_transfer(mesh, **options)).view(3, 9, 6, 6).roll((3, 3), (2, 3))
    other = stored(patch_transfer(moved, **options)).view(3, 9, 6, 6)
    # As the patches that do not scatter: shadows end with the tiles that are there, rays fall beside edges.
    assert (one - other).norm() < 0.01 * one.norm()


def test_light_goes_from_lit_walls_to_the_dark_between_them():
    mesh = samples.waffle(12)
    light = sh.basis(torch.tensor([0.8, 0.0, 0.6]), 3)
    plain, inside = (
        stored(patch_transfer(mesh, **FEW, **options))[0].T @ light
        for options in ({"albedo": 1.0}, {"subsurface": "skin1", "millimetres": 2.0})
    )
    plain, inside = plain / plain.mean(), inside / inside.mean()
    assert inside.std() < 0.6 * plain.std()


def test_light_from_behind_comes_through_the_thin_bottom_of_a_waffle():
    mesh, options = samples.waffle(12), FEW | {"subsurface": "skin1", "millimetres": 20.0}
    behind = sh.basis(torch.tensor([0.0, 0.0, -1.0]), 3)
    thin, thick = (stored(patch_transfer(mesh, **options, thickness=value)).mT @ behind for value in (0.03, None))
    mesh_pits = patch_transfer(mesh, **FEW).positions[:, 2]
    pit, wall = mesh_pits < 0.3 * mesh_pits.max(), mesh_pits > 0.9 * mesh_pits.max()
    assert min(int(pit.sum()), int(wall.sum())) > 0
    assert float(thin[0, pit].min()) > 1.5 * float(thin[0, wall].max()) > 0
    # Red goes farthest.
    assert float(thin[0, pit].mean()) > float(thin[1, pit].mean()) > float(thin[2, pit].mean())
    # Three bands of a cosine from above are a sixteenth of it from below, no more.
    assert float(thick.max()) < 0.2 * float(thin[0, pit].mean())


def test_nothing_is_won_in_a_white_medium():
    white = Subsurface(1.0, 0.0, 1.3)
    options = FEW | {"subsurface": white, "millimetres": 3.0, "thickness": 0.05}
    baked = patch_transfer(samples.waffle(12), **options)
    assert float((stored(baked)[:, 0] / WHITE * 4 * math.pi).max()) <= white.entering * (1 + 1e-5)


def test_a_gloss_lies_over_it_and_lobes_hold_both():
    options = {"subsurface": "marble", "millimetres": 10, "gloss": "ggx:0.3,0.04", "factors": 2}
    baked = bake_patch(samples.waffle(8), size=4, rays=32, order=3, lobes=1, threads=1, **options)
    assert baked.kind == "zonal diffuse + zonal factored"
    assert baked.layers["diffuse"].signal.shape[1] == 3


def test_bounces_between_walls_add_light_before_it_diffuses():
    options = FEW | {"subsurface": "marble", "millimetres": 10}
    without, with_them = (
        stored(patch_transfer(samples.waffle(12), **options, bounces=count))[:, 0].mean(1) for count in (0, 2)
    )
    assert bool((with_them > 1.005 * without).all())
    assert bool((with_them < 1.3 * without).all())
