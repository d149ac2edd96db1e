"""Are the figures of a sweep those of its recipes, is nothing measured twice, and does what is stopped go on?"""

import csv

import pytest
import torch
from glossy_scenes import floor_and_wall, shiny
from PIL import Image
from shapes import square

from torchprt import light, sh
from torchprt.errors import InputError
from torchprt.measure import relative_rms
from torchprt.measure.model import bake_recipe
from torchprt.measure.recipe import Recipe, read_recipe
from torchprt.measure.tradeoff import tradeoff
from torchprt.measure.tradeoff_files import check_folder, save_tradeoff, table
from torchprt.scene import Material, Object, Scene
from torchprt.shade import shader
from torchprt.transport import bake

BASE = Recipe(3, 32, bounces=1)
RECIPES = [BASE, BASE.replace(order=2), BASE.replace(window="hann"), BASE.replace(clusters=4, components=2, bits=8)]


def room(albedo=0.5):
    """A floor under a lid that sends light back to it, finer than the lid."""
    lid = square(1.0, height=0.7, up=False)
    return Scene([Object(square(2.0, 9), Material(albedo)), Object(lid, Material((0.8, 0.3, 0.2)))])


def lights(order=4):
    return {name: light.project(light.built_in(name, 32), order) for name in ("studio", "sky")}


@pytest.fixture(autouse=True, scope="module")
def small():
    """Pictures and rounds of timing that are enough to be looked for."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("torchprt.measure.views.SIZE", (96, 72))
        patched.setattr("torchprt.measure.side_by_side.ROUNDS", 1)
        yield


@pytest.fixture
def swept(tmp_path):
    def run(source=None, given=None, eyes=None, **options):
        options = {"order": 4, "rays": 64, "recipes": RECIPES, "keep": tmp_path / "kept", "progress": False} | options
        return tradeoff(room() if source is None else source, lights() if given is None else given, eyes, **options)

    return run


@pytest.fixture(scope="module")
def found(small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept")
    return tradeoff(
        room(), lights(), order=4, rays=64, recipes=RECIPES, keep=folder, progress=False, threads=1, name="room"
    )


def test_misuse_is_one_sentence(swept, make_transfer):
    with pytest.raises(InputError, match="needs a light"):
        swept(given={})
    with pytest.raises(InputError, match="light 'dim' has 3 bands, the reference 4"):
        swept(given={"dim": torch.ones(9, 3)})
    with pytest.raises(InputError, match="needs recipes"):
        swept(recipes=[])
    with pytest.raises(InputError, match=r"'order 5, 32 rays, 1 bounce' has more bands than the reference, 4"):
        swept(recipes=[BASE.replace(order=5)])
    with pytest.raises(InputError, match="black under light 0"):
        swept(given={"night": torch.zeros(16, 3)})


def test_errors_are_those_of_the_worst_light_against_the_unwindowed_reference(found):
    best = shader(bake_recipe(room(), Recipe(4, 64), bounces=found.reference.bounces, seed=1, progress=False))
    for recipe, point in zip(RECIPES[:3], found.points, strict=False):
        ours = shader(bake_recipe(room(), recipe, progress=False))
        window = sh.hann(recipe.order) if recipe.window == "hann" else torch.ones(recipe.order)
        for name, lamp in lights().items():
            used = sh.window(lamp[: recipe.order**2], window.to(lamp)).float()
            wanted = relative_rms(ours(used), best(lamp.float()))
            # Vectors to the rounding of float32: those of many bands are cut.
            assert point.errors[name] == pytest.approx(wanted, rel=1e-4)
        assert point.error == max(point.errors.values())


def test_what_is_stored_is_what_is_measured(found):
    dense, _, _, packed = found.points
    assert dense.bytes == bake_recipe(room(), BASE, progress=False).bytes
    assert packed.bytes < dense.bytes
    assert packed.error != dense.error
    assert packed.store_seconds > 0
    assert all(point.seconds > 0 and point.bake_seconds > 0 for point in found.points)
    # Of the same shapes.
    assert found.points[2].timing == dense.timing


def test_the_reference_is_no_candidate(swept):
    first = swept()
    found = swept(recipes=[BASE, first.reference])
    assert [point.error for point in found.points][1] == 0.0
    assert [point.recipe for point in found.candidates] == [BASE]
    assert [point.recipe for point in found.fronts()] == [BASE]
    assert found.points[1].psnr == 100.0
    assert found.points[1].flip == 0.0


def test_nothing_is_measured_twice(swept, monkeypatch):
    first = swept()

    def refuse(*arguments, **options):
        raise AssertionError("measured again")

    for name in ("subject.bake_recipe", "sweeping.Sweeping._measure", "side_by_side.time_it"):
        monkeypatch.setattr(f"torchprt.measure.{name}", refuse)
    assert swept().points == first.points
    # Nor a part of it.
    assert swept(recipes=RECIPES[:2]).points[0].errors == first.points[0].errors


def test_another_light_needs_no_other_bake_and_no_other_time(swept, monkeypatch):
    first = swept()

    def refuse(*arguments, **options):
        raise AssertionError("measured again")

    for name in ("subject.bake_recipe", "side_by_side.time_it"):
        monkeypatch.setattr(f"torchprt.measure.{name}", refuse)
    second = swept(given={"overcast": light.project(light.built_in("overcast", 32), 4)})
    assert [point.timing for point in second.points] == [point.timing for point in first.points]
    assert second.points[0].error != first.points[0].error


def test_what_is_stopped_goes_on(swept, monkeypatch):
    from torchprt.measure.sweeping import Sweeping

    measured, measure = [], Sweeping._measure

    def stopped(self, recipe, report):
        if len(measured) == 2:
            raise KeyboardInterrupt
        measured.append(recipe)
        measure(self, recipe, report)

    with monkeypatch.context() as patched:
        patched.setattr(Sweeping, "_measure", stopped)
        with pytest.raises(KeyboardInterrupt):
            swept()
    again = []

    def counted(self, recipe, report):
        again.append(recipe)
        measure(self, recipe, report)

    monkeypatch.setattr(Sweeping, "_measure", counted)
    assert len(swept().points) == len(RECIPES)
    assert sorted(map(str, measured + again)) == sorted(map(str, RECIPES))


def test_adaptive_shading_of_no_threshold_is_that_of_all_bands_and_a_threshold_loses_something(swept):
    whole = Recipe(6, 32)
    recipes = [whole, whole.replace(adaptive=0.0), whole.replace(adaptive=0.05), whole.replace(adaptive=1e9)]
    found = swept(given=lights(6), order=6, recipes=recipes)
    error, same, some, most = [point.error for point in found.points]
    assert same == pytest.approx(error, rel=1e-4)
    assert error < some < most
    assert len({point.timing for point in found.points}) == 4


def test_a_graph_is_made_once_and_loses_only_rounding(swept, untyped, monkeypatch):
    from torchprt.measure import sweeping

    made, make = [], sweeping.runner_of

    def counted(transfer, recipe):
        made.append(recipe.runtime)
        return make(transfer, recipe)

    monkeypatch.setattr(sweeping, "runner_of", counted)
    found = swept(recipes=[BASE, BASE.replace(runtime="onnx")])
    assert made.count("onnx") == 1
    eager, graph = found.points
    # Sums of nine products in another order.
    assert graph.error == pytest.approx(eager.error, rel=1e-4)
    assert graph.timing != eager.timing


def test_one_bar_tells_all_of_it(swept):
    heard = []

    class Listener:
        def start(self, stage, total, done=0):
            heard.append((stage, total, done))

        def advance(self, count):
            heard.append(count)

    swept(progress=Listener())
    (name, total, done), *told = heard
    assert (name, done) == ("tradeoff", 0)
    assert sum(told) == total


def test_of_a_bake_only_what_comes_after_it_is_tried(swept, untyped):
    transfer = bake(room(), order=4, rays=32, progress=False)
    quick = swept(transfer, recipes=None, quick=True)
    assert quick.base.recipe == quick.reference
    assert quick.base.error < 1e-6
    assert quick.base.bake_seconds is None
    assert {point.recipe.rays for point in quick.points} == {32}
    assert {point.recipe.order for point in quick.points} == {2, 3, 4}


@pytest.mark.filterwarnings("ignore::torchprt.transport.OrderWarning")
def test_gloss_is_seen_from_every_eye(swept):
    scene = floor_and_wall(shiny("phong:5"), resolution=5)
    eyes = torch.tensor([[0.5, 1.5, 4.0], [2.0, 1.0, 3.0]])
    base = Recipe(3, 32, frame="exit", output_order=3)
    found = swept(scene, recipes=[base], eyes=eyes)
    best = shader(bake_recipe(scene, found.reference, seed=1, progress=False))
    ours = shader(bake_recipe(scene, base, progress=False))
    for name, lamp in lights().items():
        lamp = lamp.float()
        wanted = torch.stack([best(lamp, eye=eye) for eye in eyes])
        seen = torch.stack([ours(lamp[:9], eye=eye) for eye in eyes])
        assert found.points[0].errors[name] == pytest.approx(relative_rms(seen, wanted), rel=1e-3)
    assert len(found.views.cameras) == 2


def test_everything_is_written_and_recipes_come_back(found, tmp_path):
    folder = tmp_path / "out"
    save_tradeoff(found, folder)
    written = sorted(path.name for path in folder.iterdir())
    front = found.fronts()
    recipes = [f"recipe-{number:02}.toml" for number in range(1, len(front) + 1)]
    assert written == sorted(["front.png", "pareto.png", "table.csv", "table.md", *recipes])
    for name, point in zip(recipes, front, strict=True):
        recipe, measured = read_recipe(folder / name)
        assert recipe == point.recipe
        assert measured["error"] == point.error
        assert measured["bytes"] == point.bytes
    with (folder / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [point.recipe.name for point in found.points]
    assert [float(row["error"]) for row in rows] == [point.error for point in found.points]
    assert (folder / "table.md").read_text().count("\n| ") == 2 + len(found.points)
    for name in ("front.png", "pareto.png"):
        with Image.open(folder / name) as picture:
            assert min(picture.size) > 60
    # A second time in place of the first.
    save_tradeoff(found, folder)
    assert sorted(path.name for path in folder.iterdir()) == written


def test_a_folder_of_something_else_is_refused_and_kept(found, tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "table.csv").write_text("mine")
    with pytest.raises(InputError, match="holds something that is no sweep"):
        save_tradeoff(found, tmp_path / "other")
    assert (tmp_path / "other" / "table.csv").read_text() == "mine"
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="file"):
            check_folder(place)


def test_the_reference_alone_is_nothing_to_compare(swept, tmp_path):
    transfer = bake(room(), order=3, rays=16, progress=False)
    found = swept(transfer, recipes=[Recipe(3, 16)])
    with pytest.raises(InputError, match="only the reference was tried"):
        save_tradeoff(found, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_recipes_of_one_name_are_two_rows(swept):
    packed = BASE.replace(clusters=4, components=2)
    found = swept(recipes=[BASE, packed, packed.replace(bits=32)])
    names = [row.name for row in table(found).rows]
    assert names[2] == f"{names[1]} #2"


def test_a_table_numbers_the_points_of_the_front(found):
    numbers = [row.extra.get("front") for row in table(found).rows]
    assert sorted(number for number in numbers if number) == list(range(1, len(found.fronts()) + 1))
