"""Does a sweep try what the scene can use, each once, and nothing else?"""

import pytest

from torchprt.light import WINDOWS
from torchprt.measure.recipe import Recipe
from torchprt.measure.sweep import CLUSTERS, Choice, sweep

DIFFUSE = Choice(Recipe(10, 4096, bounces=3), 35_000)
GLOSSY = Choice(Recipe(8, 4096, bounces=2, frame="exit", output_order=8), 35_000, glosses=1)
GIVEN = Choice(Recipe(6, 512, bounces=2), 35_000, baked=True)
ALL = pytest.mark.parametrize("choice", [DIFFUSE, GLOSSY, GIVEN], ids=["diffuse", "glossy", "given"])
BOTH = pytest.mark.parametrize("quick", [False, True], ids=["whole", "quick"])


@ALL
@BOTH
def test_each_is_tried_once_and_none_asks_for_more_than_the_reference_has(choice, quick):
    found = sweep(choice, quick)
    assert len(set(found)) == len(found)
    assert found[0] == choice.base
    for recipe in found:
        assert recipe.order <= choice.reference.order
        assert recipe.bounces <= choice.reference.bounces
        assert recipe.rays <= choice.reference.rays


@ALL
def test_a_quick_sweep_is_a_part_of_the_whole(choice):
    quick, whole = sweep(choice, True), sweep(choice)
    assert len(quick) < len(whole) / 2
    assert set(quick) <= set(whole)


def test_the_reference_is_tried_and_no_other_shares_its_rays():
    found = sweep(DIFFUSE)
    assert found[-1] == DIFFUSE.reference
    assert all(recipe.rays < DIFFUSE.reference.rays for recipe in found[:-1])


def test_what_a_bake_makes_by_itself_is_the_base():
    assert DIFFUSE.base == Recipe(5, 1024, bounces=3)
    assert Choice(Recipe(3, 1, bounces=0), 10).base == Recipe(3, 1)


def test_where_nothing_reflects_no_bounce_is_tried():
    assert not any(recipe.bounces for recipe in sweep(Choice(Recipe(10, 4096), 35_000)))


def test_without_gloss_there_are_no_frames_and_with_it_no_lobes():
    assert not any(recipe.frame or recipe.factors for recipe in sweep(DIFFUSE))
    glossy = sweep(GLOSSY)
    assert {recipe.frame for recipe in glossy} == {"exit", "visibility"}
    assert any(recipe.factors for recipe in glossy)
    assert not any(recipe.lobes for recipe in glossy)


def test_two_glosses_have_no_factors_and_no_visibility():
    reference = GLOSSY.reference
    found = sweep(Choice(reference, 35_000, glosses=2))
    assert {recipe.frame for recipe in found} == {"exit"}
    assert not any(recipe.factors for recipe in found)


@BOTH
def test_of_a_bake_that_is_given_only_what_comes_after_it_changes(quick):
    for recipe in sweep(GIVEN, quick):
        assert recipe.replace(order=6).part("bake") == GIVEN.reference.part("bake")


def test_a_bake_that_is_compressed_stays_so():
    found = sweep(Choice(Recipe(6, 512), 35_000, baked=True, dense=False))
    assert not any(recipe.clusters or recipe.lobes or recipe.dtype != "float32" for recipe in found)
    assert {recipe.runtime for recipe in found} >= {"eager", "onnx"}
    assert {recipe.order for recipe in found} == {2, 3, 4, 5, 6}


def test_a_narrow_file_is_made_no_wider_by_types():
    found = sweep(Choice(Recipe(5, 512, dtype="float16"), 35_000, baked=True))
    assert {recipe.dtype for recipe in found if not (recipe.clusters or recipe.lobes)} == {"float16"}


@pytest.mark.parametrize("receivers", [0, 1, 162, 2000])
def test_few_receivers_have_few_clusters(receivers):
    for recipe in sweep(Choice(Recipe(10, 4096), receivers)):
        assert not recipe.clusters or 16 * recipe.clusters <= receivers
        assert not recipe.clusters or (recipe.components or 0) < recipe.order**2


def test_every_factor_is_tried():
    found = sweep(DIFFUSE)
    assert {recipe.window for recipe in found} == set(WINDOWS)
    assert {recipe.runtime for recipe in found} == {"eager", "compiled", "onnx"}
    assert {recipe.dtype for recipe in found} == {"float32", "float16", "bfloat16"}
    assert {recipe.bounces for recipe in found} == {0, 1, 2, 3}
    assert {recipe.shadows for recipe in found} == {True, False}
    assert {(recipe.clusters, recipe.components) for recipe in found} >= set(CLUSTERS)
    assert {recipe.lobes for recipe in found} == {None, 1, 2, 3}
    assert {recipe.adaptive for recipe in found} == {None, 0.005, 0.01, 0.02}
    assert {recipe.bits for recipe in found} == {None, 8, 32}
