"""Is a recipe one point of the trade: checked, named, written and read back, and made into what runs?"""

import dataclasses
import itertools

import pytest
import torch

from torchprt.errors import InputError
from torchprt.light import constant, directional
from torchprt.measure import (
    Recipe,
    bake_recipe,
    frame_of,
    light_under,
    read_recipe,
    relative_rms,
    store_recipe,
    write_recipe,
)
from torchprt.scene import Material, Object, Scene, samples
from torchprt.shade import shader
from torchprt.transport import bake

RECIPES = [
    Recipe(),
    Recipe(order=2, shadows=False),
    Recipe(order=7, rays=64, bounces=2, window="least", runtime="onnx"),
    Recipe(frame="exit", output_order=3, clusters=4, components=2, shared=32, bits=8),
    Recipe(frame="visibility", visibility_order=4, dtype="bfloat16"),
    Recipe(frame="exit", factors=3, lobes=2, dtype="float16", runtime="compiled"),
    Recipe(adaptive=0.01),
]


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"order": 0}, "order of the recipe is 0"),
        ({"rays": 1.5}, "rays"),
        ({"bounces": -1}, "bounces"),
        ({"bounces": True}, "bounces"),
        ({"shadows": 1}, "shadows"),
        ({"window": "square"}, "none, hann"),
        ({"dtype": "int8"}, "float16"),
        ({"runtime": "fast"}, "onnx"),
        ({"frame": "eye"}, "exit, visibility"),
        ({"adaptive": float("nan")}, "adaptive"),
        ({"clusters": 4}, "clusters without components"),
        ({"clusters": 4, "components": 2, "lobes": 2}, "clusters and lobes"),
        ({"bits": 8}, "bits without clusters"),
        ({"shared": 8}, "shared axes without clusters"),
        ({"bounces": 1, "shadows": False}, "bounces without shadows"),
        ({"output_order": 3}, "output_order without frame exit"),
        ({"factors": 3}, "factors without frame exit"),
        ({"frame": "visibility", "lobes": 2}, "lobes"),
        ({"dtype": "bfloat16", "runtime": "onnx"}, "bfloat16"),
        ({"adaptive": 0.1, "runtime": "onnx"}, "adaptive"),
    ],
)
def test_refuses_what_cannot_be_or_does_not_go_together(untyped, fields, word):
    with pytest.raises(InputError, match=word):
        Recipe(**fields)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[bake", "not a .toml"),
        ("[bake]\nbands = 3", "unknown key 'bands'"),
        ("[cook]\norder = 3", r"unknown table \[cook\]"),
        ("order = 3", r"unknown table \[order\]"),
        ("[store]\norder = 3", "unknown key 'order'"),
        ("[bake]\norder = 'five'", "order of the recipe is 'five'"),
        ("[bake]\norder = true", "order of the recipe is True"),
        ("[predicted]\nerror = 'small'", "predicts what is no number"),
    ],
)
def test_a_bad_file_is_named(untyped, tmp_path, text, word):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=f"r.toml.*{word}"):
        read_recipe(path)


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda each: each.name)
def test_what_is_written_is_read_back(tmp_path, recipe):
    path = tmp_path / "r.toml"
    write_recipe(recipe, path, predicted={"error": 1e-3, "bytes": 4096}, notes=("why\nso", "because"))
    assert read_recipe(path) == (recipe, {"error": 1e-3, "bytes": 4096.0})
    assert path.read_text().startswith("# why\n# so\n# because\n")


def test_names_tell_recipes_apart():
    names = [each.name for each in RECIPES]
    assert all(one != other for one, other in itertools.combinations(names, 2))


def test_all_fields_stand_in_one_table():
    names = [name for table in Recipe.TABLES.values() for name in table]
    assert sorted(names) == sorted(field.name for field in dataclasses.fields(Recipe))


@pytest.fixture(scope="module")
def scene():
    return samples.plane_and_blocker(5)


@pytest.fixture(scope="module")
def light():
    return (constant(torch.ones(3), 6) + directional(torch.tensor([0.3, 0.9, 0.1]), torch.ones(3), order=6)).expand(
        2, -1, -1
    )


def test_a_recipe_is_a_bake_of_these_arguments(scene):
    recipe = Recipe(order=3, rays=64, bounces=1)
    made = bake_recipe(scene, recipe, progress=False)
    plain = bake(scene, order=3, rays=64, bounces=1, progress=False)
    assert torch.equal(made.layers["diffuse"].signal.values, plain.layers["diffuse"].signal.values)


def test_light_of_fewer_bands_is_refused(light):
    with pytest.raises(InputError, match="order 7 has 49"):
        light_under(Recipe(order=7), light)


@pytest.mark.parametrize("changes", [{}, {"runtime": "onnx"}, {"dtype": "float16"}, {"window": "hann"}])
def test_a_frame_is_the_shader_under_the_first_bands(untyped, scene, light, changes):
    recipe = Recipe(order=4, rays=64, **changes)
    made = bake_recipe(scene, recipe, progress=False)
    used = light_under(recipe, light)
    assert used.shape[-2] == 16
    found = frame_of(store_recipe(made, recipe), recipe, light)()
    # Two eps of float16, or the rounding of a graph.
    assert relative_rms(found, shader(made)(used)) < (2e-3 if changes.get("dtype") else 1e-5)


def test_a_glossy_frame_needs_an_eye():
    scene = Scene([Object(samples.plane_and_blocker(4).objects[0].mesh, Material(0.2, gloss="phong:8", specular=0.5))])
    recipe = Recipe(order=3, rays=16, frame="exit", output_order=3)
    made = bake_recipe(scene, recipe, progress=False)
    light = constant(torch.ones(3), 3)[None]
    with pytest.raises(InputError, match="give an eye"):
        frame_of(made, recipe, light)
    eye = torch.tensor([0.0, 5.0, 1.0])
    torch.testing.assert_close(frame_of(made, recipe, light, eye)(), shader(made)(light, eye=eye))


def test_clusters_are_of_the_layer_that_takes_the_most():
    scene = Scene([Object(samples.plane_and_blocker(8).objects[0].mesh, Material(0.2, gloss="phong:8", specular=0.5))])
    recipe = Recipe(order=3, rays=16, frame="exit", output_order=3, clusters=4, components=3, bits=8)
    made = store_recipe(bake_recipe(scene, recipe, progress=False), recipe)
    assert [layer.signal.approximates for layer in made.layers.values()] == [False, True]
