"""Are bakes shared only where they are the same, and is what one costs told as it was timed?"""

import pytest
import torch
from glossy_scenes import floor_and_wall, shiny
from shapes import square

from torchprt.errors import InputError
from torchprt.measure.keep import Kept
from torchprt.measure.model import bake_recipe
from torchprt.measure.recipe import Recipe
from torchprt.measure.subject import FileSubject, SceneSubject
from torchprt.progress import Silent
from torchprt.scene import Material, Object, Scene

SILENT = Silent()


def room(albedo=0.5):
    """A floor under a lid that sends light back to it."""
    return Scene([Object(square(2.0), Material(albedo)), Object(square(1.0, height=0.7, up=False), Material(0.8))])


def values(transfer):
    return {name: layer.signal.dense().values for name, layer in transfer.layers.items()}


def same(one, other, tolerance=0.0):
    ours, theirs = values(one), values(other)
    assert ours.keys() == theirs.keys()
    return all((ours[name] - each).abs().max() <= tolerance * each.abs().max() for name, each in theirs.items())


@pytest.fixture
def subject(tmp_path):
    def make(scene, order=6, rays=256):
        made = SceneSubject(scene, Kept(tmp_path / "kept"), order=order, rays=rays, threads=1)
        made.begin(SILENT)
        return made

    return make


def test_a_bake_without_its_reflectance_is_refused(make_transfer):
    from torchprt.transport import bake

    open_ = bake(floor_and_wall(shiny()), order=3, rays=16, frame="incident", progress=False)
    with pytest.raises(InputError, match="leaves the reflectance open"):
        FileSubject(open_)


@pytest.mark.parametrize("scene", [room(), room((0.2, 0.5, 0.9))], ids=["grey", "coloured"])
@pytest.mark.parametrize("bounces", [0, 2])
def test_a_bake_of_fewer_bands_is_the_first_columns_of_one_of_more(scene, bounces, subject):
    shared = subject(scene)
    for order in (2, 4):
        recipe = Recipe(order, 64, bounces=bounces)
        alone = bake_recipe(scene, recipe, progress=False)
        assert same(shared.baked(recipe, SILENT), alone)
        assert alone.channels == shared.channels(recipe)


@pytest.mark.parametrize(
    "recipe",
    [
        Recipe(3, 64, frame="exit", output_order=3),
        Recipe(3, 64, frame="exit", output_order=2, bounces=1),
        # Without a word of it as many bands as the light has.
        Recipe(3, 64, frame="exit"),
        Recipe(3, 64, frame="exit", factors=2),
        Recipe(3, 64, frame="visibility", visibility_order=4),
        Recipe(3, frame="exit", shadows=False),
    ],
    ids=lambda recipe: recipe.name,
)
@pytest.mark.filterwarnings("ignore::torchprt.transport.OrderWarning")
def test_so_are_matrices_and_what_is_made_for_an_order_is_baked_at_it(recipe, subject):
    scene = floor_and_wall(shiny("phong:5"), resolution=5)
    shared = subject(scene, order=4, rays=128)
    # Bounces between matrices are products of other shapes, which add up a few dozen numbers in another order.
    tolerance = 16 * torch.finfo(torch.float32).eps if recipe.bounces else 0.0
    assert same(shared.baked(recipe, SILENT), bake_recipe(scene, recipe, progress=False), tolerance)


def test_the_reference_follows_light_until_it_is_spent(subject):
    found = subject(room())
    assert found.choice.reference.bounces > 1
    assert subject(Scene([Object(square(), Material(0.0))])).choice.reference.bounces == 0


def test_the_reference_has_rays_of_its_own(subject):
    found = subject(room(), rays=256)
    few = bake_recipe(room(), Recipe(6, 256, bounces=found.choice.reference.bounces), progress=False, seed=0)
    assert not same(found.baked(found.choice.reference, SILENT), few)


def test_nothing_is_baked_twice(subject, monkeypatch):
    first = subject(room())
    recipes = [Recipe(order, rays) for order in (2, 3, 5) for rays in (16, 64)]
    wanted = [first.baked(recipe, SILENT) for recipe in recipes]
    first.more(SILENT)
    assert len({first.key_of_bake(recipe) for recipe in recipes}) == 2

    def refuse(*arguments, **options):
        raise AssertionError("baked again")

    monkeypatch.setattr("torchprt.measure.subject.bake_recipe", refuse)
    second = subject(room())
    assert all(same(second.baked(recipe, SILENT), each) for recipe, each in zip(recipes, wanted, strict=True))
    assert second.more_seconds == 0
    second.more(SILENT)
    with pytest.raises(AssertionError, match="baked again"):
        second.baked(Recipe(2, 32), SILENT)


def test_a_bake_that_is_stopped_goes_on_and_all_of_its_time_counts(subject, monkeypatch, tmp_path):
    found = subject(room())
    recipe = found.choice.base

    def stopped(*arguments, **options):
        sum(range(10**5))
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("torchprt.measure.subject.bake_recipe", stopped)
        with pytest.raises(KeyboardInterrupt):
            found.baked(recipe, SILENT)
    (spent,) = [each for each in (tmp_path / "kept").rglob("*-spent.json") if found.key_of_bake(recipe) in each.name]
    before = found.kept.record(spent.stem)["seconds"]
    assert before > 0
    assert found.seconds(recipe) == (None, "unknown")
    found.baked(recipe, SILENT)
    assert found.kept.record(found.key_of_bake(recipe))["seconds"] > before


def test_seconds_are_timed_or_lie_between_what_was_timed(subject):
    found = subject(room())
    base = found.choice.base
    top = base.replace(order=6)
    found.baked(base, SILENT)
    found.more(SILENT)
    # As if the lowest had taken half of the highest.
    (low,) = [
        found.kept.record(path.stem) for path in found.kept.folder.rglob("*.json") if "order 2" in path.read_text()
    ]
    keys = [path.stem for path in found.kept.folder.rglob("*.json") if "order 2" in path.read_text()]
    found.kept.keep(keys[0], {**low, "seconds": 1.0})
    found.kept.keep(found.key_of_bake(base), {"seconds": 3.0})
    assert found.seconds(top) == (3.0, "timed")
    assert found.seconds(base.replace(order=2)) == (pytest.approx(1.0), "interpolated")
    seconds, how = found.seconds(base.replace(order=4))
    assert how == "interpolated"
    # 4^2 lies 12 of 32 above 2^2.
    assert seconds == pytest.approx(1 + 2 * 12 / 32)


def test_a_file_is_its_own_reference(make_transfer):
    transfer = make_transfer(order=4, rays=64, bounces=2, transport="interreflected")
    found = FileSubject(transfer)
    assert found.choice.reference == found.choice.base == Recipe(4, 64, bounces=2)
    assert found.baked(found.choice.reference, SILENT) is transfer
    assert found.baked(Recipe(3, 64, bounces=2), SILENT).order == 3
    assert found.seconds(found.choice.reference) == (None, "given")
    assert FileSubject(transfer.to(torch.float16)).choice.base.dtype == "float16"
    unshadowed = FileSubject(make_transfer(transport="unshadowed"))
    assert unshadowed.choice.base.shadows is False
