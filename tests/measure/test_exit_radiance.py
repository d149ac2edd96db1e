"""Is the reference that glossy transfer is judged by the integral that it says it is?"""

import math

import pytest
import torch
from shapes import square
from transfers import KINDS, gloss, random_glossy

from torchprt import brdf, sh
from torchprt.errors import InputError
from torchprt.measure import exit_radiance, exit_radiance_by_brute_force, random_lights, relative_rms
from torchprt.scene import Material, Object, Scene, load, make_mesh, samples
from torchprt.shade import shader
from torchprt.transport import bake, hemisphere

EPS = torch.finfo(torch.float64).eps
UP = torch.tensor([[0.0, 0, 1]], dtype=torch.float64)


def shiny(gloss="phong:10", **options):
    return Material(albedo=0.0, gloss=gloss, **options)


def shadowed(gloss="phong:10", resolution=5):
    blocker = samples.plane_and_blocker(3).objects[1]
    return Scene([Object(square(2.0, resolution), shiny(gloss)), Object(blocker.mesh, Material(0.0), "blocker")])


def everywhere(scene):
    return torch.arange(len(scene.geometry().glossy))


@pytest.mark.parametrize("chosen", [[9], [-1], [0, 25]])
def test_refuses_receivers_that_there_are_not(chosen):
    scene = load(square(resolution=3), material=shiny())
    with pytest.raises(InputError, match=f"receiver {chosen[-1]}: there are 9"):
        exit_radiance_by_brute_force(scene, torch.tensor(chosen), UP, random_lights(1), rays=16)


def test_refuses_views_that_are_not_of_unit_length():
    scene, light = load(square(resolution=3), material=shiny()), random_lights(1)
    with pytest.raises(InputError, match="unit"):
        exit_radiance_by_brute_force(scene, everywhere(scene), 2 * UP, light, rays=16)
    with pytest.raises(InputError, match="unit"):
        exit_radiance(shader(random_glossy(order=5)), 2 * UP.float(), light)


@pytest.mark.parametrize(("count", "order"), [(0, 5), (1, 0)])
def test_refuses_no_light(count, order):
    with pytest.raises(InputError, match="at least 1"):
        random_lights(count, order)


def test_nothing_asked_is_nothing_answered():
    scene = load(square(resolution=3), material=shiny())
    none = torch.zeros(0, dtype=torch.int64)
    assert exit_radiance_by_brute_force(scene, none, UP, random_lights(2), rays=16).shape == (2, 1, 0, 3)
    assert exit_radiance_by_brute_force(scene, everywhere(scene), UP[:0], random_lights(2), rays=16).shape[1] == 0


@pytest.mark.parametrize("order", [1, 2, 5])
def test_random_lights_are_nowhere_negative_grey_and_vary(order):
    lights = random_lights(5, order, seed=3)
    values = sh.evaluate(lights, sh.fibonacci(20_000)[0])
    # The promise of `sh.least_window`.
    assert float(values.min()) >= -1e-9 * float(values.max())
    assert bool((lights == lights[..., :1]).all())
    assert torch.equal(lights, random_lights(5, order, seed=3))
    if order > 1:
        assert len(torch.unique(lights[:, 1, 0])) == 5
        assert not torch.equal(lights, random_lights(5, order, seed=4))


def test_a_white_surface_in_a_white_world_is_white():
    scene = load(square(resolution=3), material=shiny("lambert"))
    light = torch.zeros(1, 4, 3, dtype=torch.float64)
    white = torch.tensor([1.0, 2.0, 0.0], dtype=torch.float64)
    light[:, 0] = white * math.sqrt(4 * math.pi)
    found = exit_radiance_by_brute_force(scene, everywhere(scene), hemisphere(7), light, rays=1000)
    # The mean of s_z over the set is 1/2 exactly.
    torch.testing.assert_close(found, white.expand_as(found), rtol=4000 * EPS, atol=0)


@pytest.mark.parametrize("gloss", ["ward:0.3,0.6", "ggx:0.4,0.04"])
def test_agrees_with_one_sum_for_each_receiver_and_view(gloss):
    """The same directions in a Python loop; the blocker is a square whose shadow is a matter of two comparisons."""
    floor = make_mesh(torch.tensor([[-0.5, 0, 0.5], [0.5, 0, 0.5], [0.0, 0, -0.5]]), torch.tensor([[0, 1, 2]]))
    floor = make_mesh(floor.positions, floor.faces, tangents=torch.tensor([[0.6, 0.0, 0.8]]).expand(3, 3))
    roof = square(1.0, 2, height=0.7, up=False)
    scene = Scene([Object(floor, shiny(gloss)), Object(roof, Material(0.0), "blocker")])
    views, directions, light = hemisphere(4, seed=2), hemisphere(97), random_lights(2, 3)
    found = exit_radiance_by_brute_force(scene, everywhere(scene), views, light, rays=97)
    model, tangent = brdf.parse(gloss), torch.tensor([0.6, 0.0, 0.8], dtype=torch.float64)
    normal = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    frame = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal])
    for g, point in enumerate(floor.positions):
        for d, view in enumerate(views):
            total = torch.zeros(2, 3, dtype=torch.float64)
            for s in directions:
                world = s @ frame
                x, _, z = (point + world * 0.7 / world[1]).tolist()
                if abs(x) < 0.5 and abs(z) < 0.5:
                    continue
                total += model(view, s) * s[2] * sh.evaluate(light, world[None])[:, 0] * (2 * math.pi / 97)
            torch.testing.assert_close(found[:, d, g], total, rtol=1e-6, atol=1e-7)


def test_agrees_with_the_matrix_of_a_high_order():
    scene = shadowed("phong:4")
    transfer = bake(scene, order=3, output_order=8, rays=1024, progress=False)
    light, views = random_lights(2, 3), hemisphere(30, seed=3)
    found = exit_radiance(shader(transfer), views, light)
    wanted = exit_radiance_by_brute_force(scene, everywhere(scene), views, light, rays=8192, seed=1)
    # Eight bands hold so broad a lobe; 1024 rays leave half a percent.
    assert relative_rms(found, wanted) < 6e-3
    # And the blocker matters.
    open_sky = bake(scene, order=3, output_order=8, shadows=False, progress=False)
    assert relative_rms(exit_radiance(shader(open_sky), views, light), wanted) > 0.05


def test_a_receiver_without_a_normal_sends_nothing():
    mesh = square(resolution=3)
    positions = torch.cat([mesh.positions, torch.tensor([[0.0, 3.0, 0.0]])])
    scene = load(make_mesh(positions, mesh.faces), material=shiny())
    found = exit_radiance_by_brute_force(scene, everywhere(scene), hemisphere(3), random_lights(1), rays=64)
    assert float(found[:, :, -1].abs().max()) == 0
    assert float(found[:, :, :-1].abs().min()) > 0


@pytest.mark.parametrize("kind", KINDS)
def test_is_what_a_call_gives_toward_the_same_directions(kind):
    transfer = random_glossy(kind, vertices=6, glossy=4, order=3, dtype=torch.float64, specular=(1, 1), diffuse=False)
    module = shader(transfer, **({"exponent": 8.0} if kind == "incident" else {}))
    light = torch.randn(2, 9, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    views = hemisphere(5, seed=1)
    found = exit_radiance(module, views, light)
    for row, vertex in enumerate(gloss(transfer).receivers.tolist()):
        world = views @ module.layers[kind].frames[:, :, row]
        called = module(light[:, None], view=world)[..., vertex, :] / gloss(transfer).specular
        torch.testing.assert_close(found[:, :, row], called, rtol=1e-11, atol=1e-11)
