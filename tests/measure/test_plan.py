"""Is the planned recipe right enough, cheap, and told why?"""

import pytest
import torch

from torchprt.errors import InputError
from torchprt.light import constant, directional
from torchprt.measure import Probe, Recipe, bake_recipe, frame_of, plan, relative_rms, store_recipe
from torchprt.measure.cost import frame_costs, repeated
from torchprt.scene import Material, Object, Scene, make_mesh, samples
from torchprt.shade import shader

WHITE = torch.ones(3, dtype=torch.float64)


def sun(order=5):
    direction = torch.tensor([0.4, 0.8, 0.2], dtype=torch.float64)
    return (constant(WHITE, order) + directional(direction, WHITE, order=order))[None]


def ball():
    """Closed and convex: nothing shadows it."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=3)
    return Scene([Object(make_mesh(sphere.vertices, sphere.faces, normals=sphere.vertices), Material(0.5))])


@pytest.mark.parametrize(
    ("asked", "word"),
    [
        ({"error": 0.0}, "error is 0"),
        ({"error": float("nan")}, "error"),
        ({"milliseconds": -1.0}, "milliseconds is -1"),
        ({"bytes": 0}, "bytes is 0"),
    ],
)
def test_refuses_limits_that_are_none(asked, word):
    with pytest.raises(InputError, match=word):
        plan(ball(), sun(), **asked)


def test_refuses_what_to_make_least_that_is_not_known(untyped):
    with pytest.raises(InputError, match="milliseconds, bytes or seconds"):
        plan(ball(), sun(), least="watts")


def test_refuses_no_light():
    with pytest.raises(InputError, match="no light"):
        plan(ball(), torch.zeros(0, 9, 3))


def test_says_what_can_be_reached_where_nothing_does():
    with pytest.raises(InputError, match=r"error is 1e-09.*nearest has"):
        plan(samples.plane_and_blocker(8), sun(), error=1e-9)
    with pytest.raises(InputError, match=r"keeps to bytes 100: .* the smallest .* bytes"):
        plan(samples.plane_and_blocker(8), sun(), error=0.05, bytes=100)


def test_what_is_convex_needs_no_shadow_and_no_bounce():
    found = plan(ball(), sun(), error=0.01)
    assert not found.recipe.shadows
    assert found.recipe.bounces == 0
    assert "no shadows" in str(found)
    assert "nothing is glossy" in str(found)


def test_a_light_without_high_bands_needs_few():
    light = torch.zeros(1, 49, 3, dtype=torch.float64)
    light[:, :4] = sun()[:, :4]
    found = plan(ball(), light, error=0.01)
    assert found.recipe.order == 2
    assert any(line.startswith("no bands from 2 to 6") for line in found.not_required)


def test_colour_that_bounces_needs_bounces_and_shadow_alone_none():
    assert plan(samples.coloured_box(6), sun(), error=0.1).recipe.bounces > 0
    assert plan(samples.plane_and_blocker(12), sun(), error=0.05).recipe.bounces == 0


@pytest.mark.parametrize("least", ["milliseconds", "bytes", "seconds"])
@pytest.mark.parametrize("error", [0.1, 0.02])
def test_the_recipe_keeps_to_the_error_in_the_whole_scene(error, least):
    scene = samples.plane_and_blocker(40)
    found = plan(scene, sun(7), error=error, least=least, count=200)
    reference = shader(bake_recipe(scene, Recipe(order=7, rays=8192), progress=False, seed=3))
    made = store_recipe(bake_recipe(scene, found.recipe, progress=False), found.recipe)
    achieved = relative_rms(frame_of(made, found.recipe, sun(7))(), reference(sun(7).float()))
    assert achieved <= error
    assert found.predicted["error"] <= found.predicted["bound"] <= error
    assert found.predicted["bytes"] == pytest.approx(made.bytes, rel=0.05 if found.recipe.clusters else 1e-6)


def test_bytes_are_fewer_where_they_are_made_least():
    scene = samples.plane_and_blocker(60)
    quick, small = (
        plan(scene, sun(5), error=0.06, least=least, count=100).predicted["bytes"]
        for least in ("milliseconds", "bytes")
    )
    assert small < 0.8 * quick


def test_a_limit_alone_is_used_up_for_the_least_error():
    scene = samples.plane_and_blocker(20)
    errors = [plan(scene, sun(6), bytes=bytes, count=120).predicted["error"] for bytes in (8_000, 40_000)]
    assert errors[1] < 0.5 * errors[0]


def test_a_glossy_scene_gets_a_frame_that_holds_its_gloss():
    objects = samples.plane_and_blocker(7).objects
    scene = Scene([Object(objects[0].mesh, Material(0.2, gloss="phong:10", specular=0.5)), *objects[1:]])
    found = plan(scene, sun(3), error=0.1, count=60)
    assert found.recipe.frame in ("exit", "visibility")
    assert found.predicted["bound"] <= 0.1


def test_the_same_seed_is_the_same_error():
    scene = samples.plane_and_blocker(12)
    one, other = (Probe(scene, sun(4), count=40, seed=3).error(Recipe(order=3, rays=64)) for _ in range(2))
    assert one == other


def test_repeated_transfer_is_that_of_the_same_receivers_again():
    objects = samples.plane_and_blocker(5).objects
    patch = Object(objects[0].mesh, Material(0.2, gloss="phong:10", specular=0.5))
    scene = Scene([patch, Object(objects[1].mesh, Material(0.4))])
    probe = Probe(scene, sun(3), torch.tensor([[0.0, 5.0, 1.0]], dtype=torch.float64), output_order=3)
    recipe = Recipe(order=3, rays=16, frame="exit", output_order=3)
    once = probe.baked(recipe)
    often = repeated(once, 3 * once.vertices + 1)
    eye = torch.tensor([0.0, 5.0, 1.0])
    one, three = (shader(each)(sun(3).float(), eye=eye) for each in (once, often))
    torch.testing.assert_close(three, one.repeat(1, 3, 1))
    time, size = frame_costs({recipe: probe.sized(recipe, 1)}, 10 * once.vertices, sun(3)[0], eye, rounds=1)[recipe]
    assert size == 10 * once.bytes
    assert time.median > 0
