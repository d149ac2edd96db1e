"""Do a few receivers tell what recipes lose at all of them?"""

import math

import pytest
import torch

from torchprt.errors import InputError
from torchprt.light import constant, directional
from torchprt.measure import Probe, Recipe, bake_recipe, receivers_of, relative_rms, sample_scene
from torchprt.scene import Material, Object, Scene, samples
from torchprt.shade import shader
from torchprt.transfer import Transfer

EYES = torch.tensor([[0.5, 6.0, 2.0], [-4.0, 3.0, 0.0]], dtype=torch.float64)


def lights(order=5):
    white, sun = torch.ones(3, dtype=torch.float64), torch.tensor([0.4, 0.8, 0.2], dtype=torch.float64)
    return torch.stack([constant(white, order) + directional(sun, white, order=order), constant(3 * white, order)])


def plane(material, resolution=24):
    sample = samples.plane_and_blocker(resolution)
    return Scene([Object(sample.objects[0].mesh, material), *sample.objects[1:]])


def radiance(transfer: Transfer, light, order):
    module = shader(transfer, dtype=torch.float64)
    used = light[:, : order**2]
    if "eye" in module.needs:
        return torch.stack([module(used, eye=eye) for eye in EYES], 1)
    return module(used)[:, None]


def test_refuses_a_glossy_scene_without_eyes():
    with pytest.raises(InputError, match="give eyes"):
        Probe(plane(Material(0.2, gloss="phong:8", specular=0.5), 5), lights(3), count=4)


def test_refuses_a_light_under_which_all_is_black():
    with pytest.raises(InputError, match="black"):
        Probe(plane(Material(0.5), 5), torch.zeros(1, 9, 3), count=4)


@pytest.mark.parametrize(
    "material", [Material(0.5), Material(0.2, gloss="phong:8", specular=0.5)], ids=["diffuse", "glossy"]
)
@pytest.mark.parametrize("changes", [{"order": 3}, {"rays": 64}, {"shadows": False}])
def test_the_error_is_that_of_all_receivers_within_the_bound(material, changes):
    scene = plane(material)
    glossy = material.gloss is not None
    frame = {"frame": "exit", "output_order": 4} if glossy else {}
    probe = Probe(scene, lights(), EYES, count=150, output_order=4)
    recipe = Recipe(**({"order": 5, "rays": 1024} | frame | changes))
    found = probe.error(recipe)
    reference = bake_recipe(scene, Recipe(order=5, rays=8192, **frame), progress=False)
    made = bake_recipe(scene, recipe, progress=False, seed=1)
    wanted = radiance(reference, lights(), 5)
    errors = [relative_rms(a, b) for a, b in zip(radiance(made, lights(), recipe.order), wanted, strict=True)]
    # Twice what the bound allows of chance, which is 2 deviations.
    assert abs(found.error - max(errors)) <= 2 * (found.bound - found.error) + 0.05 * found.error
    assert found.error > 0


def test_of_a_small_scene_all_receivers_count_and_the_error_is_exact():
    scene = plane(Material(0.5), 6)
    probe = Probe(scene, lights(), count=400)
    assert len(probe.rows) == probe.receivers
    found = probe.error(Recipe(order=2, rays=64))
    assert found.error == found.bound


def test_bounces_add_what_they_add_in_the_whole_scene():
    scene = samples.coloured_box(6)
    probe = Probe(scene, lights(), count=30)
    assert probe.bounces >= 2
    without, once, more = (probe.error(Recipe(order=5, rays=4096, bounces=n)).error for n in (0, 1, probe.bounces))
    assert without > 1.5 * once > 3 * more
    reference = bake_recipe(scene, Recipe(order=5, rays=1024), progress=False, bounces=math.inf)
    flat = bake_recipe(scene, Recipe(order=5, rays=1024), progress=False)
    errors = [
        relative_rms(a, b) for a, b in zip(radiance(flat, lights(), 5), radiance(reference, lights(), 5), strict=True)
    ]
    assert without == pytest.approx(max(errors), rel=0.25)


def test_the_light_scales_out():
    scene = plane(Material(0.5), 8)
    one, other = (Probe(scene, scale * lights(3), count=20).error(Recipe(order=2, rays=64)) for scale in (1.0, 1e10))
    assert one.error == pytest.approx(other.error, rel=1e-9)


@pytest.mark.parametrize("count", [0, 10_000])
def test_a_sample_refuses_a_count_that_there_is_not(count):
    with pytest.raises(InputError, match=f"count is {count}"):
        sample_scene(plane(Material(0.5), 6), count)


def test_a_sample_refuses_membranes():
    scene = plane(Material(0.5, translucency=0.5), 6)
    with pytest.raises(InputError, match="translucent"):
        sample_scene(scene, 4)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_sample_has_materials_and_transfer_of_the_whole_scene(seed):
    albedo = torch.rand(10**2, 3, generator=torch.Generator().manual_seed(3))
    gloss = Material(albedo / 4, gloss="phong:8", specular=0.4)
    ball = samples.plane_and_blocker(9)
    scene = Scene(
        [
            Object(ball.objects[0].mesh, gloss),
            Object(ball.objects[1].mesh, Material(0.6, two_sided=True)),
        ]
    )
    few, rows, chosen = sample_scene(scene, 25, seed)
    assert torch.equal(chosen, chosen.unique())
    recipe = Recipe(order=3, rays=128, frame="exit", output_order=3)
    whole = radiance(receivers_of(bake_recipe(scene, recipe, progress=False), chosen), lights(3), 3)
    part = radiance(receivers_of(bake_recipe(few, recipe, progress=False), rows), lights(3), 3)
    # The same rays meet the same surfaces: float32 sums.
    assert relative_rms(part, whole) < 1e-5
