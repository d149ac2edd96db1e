"""Is a measurement found again by what it is of, and never taken for another?"""

import pytest
import torch
from shapes import square

from torchprt.errors import InputError
from torchprt.measure.keep import Kept, default_folder, key_of, key_of_scene, key_of_transfer
from torchprt.scene import Material, Object, Scene, make_mesh


@pytest.fixture
def kept(tmp_path):
    return Kept(tmp_path / "kept")


def test_a_record_that_is_damaged_is_named(kept):
    kept.keep("abc", {"error": 0.5})
    path = kept.folder / "ab" / "abc.json"
    for content in ("{", "[1]", "\xff"):
        path.write_text(content, encoding="latin-1")
        with pytest.raises(InputError, match=r"abc\.json .*remove it, and it is measured again"):
            kept.record("abc")


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(InputError, match="cannot be made"):
        Kept(tmp_path / "taken").keep("abc", {})


def test_nothing_is_there_at_first_and_nothing_is_made_by_asking(kept):
    assert kept.record("abc") is None
    assert not kept.has_transfer("abc")
    assert kept.bytes == 0
    assert not kept.folder.exists()


def test_what_is_kept_comes_back(kept, make_transfer):
    assert kept.keep("abc", {"error": 0.1, "errors": [1, 2]}) == kept.record("abc")
    transfer = make_transfer()
    kept.keep_transfer("abd", transfer)
    assert kept.has_transfer("abd")
    assert key_of_transfer(kept.transfer("abd")) == key_of_transfer(transfer)
    assert kept.bytes > transfer.bytes


def test_what_is_partial_goes(kept):
    folder = kept.partial("abc")
    folder.mkdir()
    kept.done("abc")
    kept.done("never begun")
    assert not folder.exists()


def test_the_folder_is_that_of_the_user(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "torchprt" / "tradeoff"


def test_every_part_of_what_it_is_of_makes_another_key():
    ones = torch.ones(2, 3)
    keys = [
        key_of("error"),
        key_of("time"),
        key_of("error", order=5),
        key_of("error", order=6),
        key_of("error", [ones]),
        key_of("error", [ones.double()]),
        key_of("error", [ones.view(3, 2)]),
        key_of("error", [2 * ones]),
    ]
    assert len(set(keys)) == len(keys)
    assert key_of("error", [ones], order=5) == key_of("error", [ones.clone()], order=5)


def test_scenes_are_told_apart_by_what_a_bake_would_see():
    def scene(material, size=1.0, role="receiver", name="square"):
        mesh = square(size)
        mesh = make_mesh(mesh.positions, mesh.faces, name=name)
        floor = Object(square(2.0, height=-1.0), Material(0.5))
        return Scene([floor, Object(mesh, material, role)])

    keys = [
        key_of_scene(scene(Material(0.5))),
        key_of_scene(scene(Material(0.6))),
        key_of_scene(scene(Material((0.5, 0.5, 0.4)))),
        key_of_scene(scene(Material(0.5), size=1.1)),
        key_of_scene(scene(Material(0.5, two_sided=True))),
        key_of_scene(scene(Material(0.0), role="blocker")),
        key_of_scene(scene(Material(0.0, gloss="phong:10"))),
        key_of_scene(scene(Material(0.0, gloss="phong:20"))),
        key_of_scene(scene(Material(0.0, gloss="phong:20", specular=0.5))),
    ]
    assert len(set(keys)) == len(keys)
    assert key_of_scene(scene(Material(0.5), name="other")) == keys[0]


def test_bakes_are_told_apart_by_their_numbers(make_transfer):
    transfer = make_transfer()
    others = [make_transfer(seed=1), make_transfer(order=3), transfer.to(torch.float16), transfer.to_order(3)]
    keys = [key_of_transfer(each) for each in (transfer, *others)]
    assert len(set(keys)) == len(keys)
