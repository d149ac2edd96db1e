"""Does "auto" follow light exactly as far as it matters, and go on after an interruption?"""

import itertools
import math

import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, make_mesh, samples
from torchprt.transport import bake


def baked(scene, bounces, rays=64, **more):
    return bake(scene, order=3, rays=rays, bounces=bounces, progress=False, threads=1, **more)


def values(transfer):
    return list(transfer.layers.values())[-1].signal.values


def ball(material):
    mesh = trimesh.creation.icosphere(2)
    return Scene([Object(make_mesh(mesh.vertices, mesh.faces), material)])


def corner(material):
    """Two squares that face each other askew."""
    points = [[0.0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]]
    mesh = make_mesh(torch.tensor(points), torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    return Scene([Object(mesh, material)])


# Misuse


@pytest.mark.parametrize("bounces", [-1, 0.5, math.nan, -math.inf])
def test_refuses_what_is_no_number_of_bounces(bounces):
    with pytest.raises(InputError, match="bounces is"):
        baked(ball(Material(0.5)), bounces)


# How many


@pytest.mark.parametrize("albedo", [0.9, 0.5, 0.2])
def test_it_stops_at_the_first_bounce_that_adds_less_than_a_hundredth(albedo):
    scene = corner(Material(albedo))
    found = baked(scene, "auto")
    count = found.bounces
    assert count >= 1
    last = [values(baked(scene, number)) for number in range(count + 1)]
    for number, (before, after) in enumerate(itertools.pairwise(last), 1):
        adds = float((after - before).norm() / after.norm())
        assert (adds < 1e-2) == (number == count), (number, adds)
    assert torch.equal(values(found), last[-1])


def test_brighter_surfaces_take_more():
    counts = [baked(samples.coloured_box(4), "auto").bounces]
    counts += [baked(corner(Material(albedo)), "auto").bounces for albedo in (0.9, 0.1)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1]


@pytest.mark.parametrize(
    "material", [Material(0.5), Material((0.5, 0.2, 0.1)), Material((0.5, 0.2, 0.1), gloss="ggx:0.5", specular=0.3)]
)
@pytest.mark.parametrize("bounces", ["auto", math.inf])
def test_around_a_convex_body_there_is_none(material, bounces):
    scene = ball(material)
    found, plain = baked(scene, bounces), baked(scene, 0)
    assert (found.bounces, found.transport, found.channels) == (0, "shadowed", 1)
    for name, layer in plain.layers.items():
        assert torch.equal(found.layers[name].signal.values, layer.signal.values)
    assert found.error == plain.error


def test_black_surfaces_need_no_hits(tmp_path):
    found = baked(corner(Material(0.0)), "auto", checkpoint=tmp_path / "kept", keep=True)
    assert found.bounces == 0
    (chunk,) = (tmp_path / "kept").glob("chunk-*")
    from safetensors.torch import load_file

    assert list(load_file(chunk)) == ["transfer"]


def test_it_is_none_where_there_can_be_none():
    assert bake(corner(Material(0.5)), order=3, shadows=False, bounces="auto").bounces == 0
    glossy = corner(Material(gloss="ggx:0.5"))
    assert baked(glossy, "auto", frame="visibility").bounces == 0
    assert baked(glossy, "auto", frame="incident").bounces >= 1


@pytest.mark.parametrize("frame", ["exit", "incident"])
def test_gloss_is_followed_as_far(frame):
    scene = corner(Material(0.4, gloss="ggx:0.5", specular=0.5))
    found = baked(scene, "auto", frame=frame)
    assert torch.equal(values(found), values(baked(scene, found.bounces, frame=frame)))
    fewer = values(baked(scene, found.bounces - 1, frame=frame))
    assert float((values(found) - fewer).norm() / values(found).norm()) < 0.03


def test_points_take_the_bounces_of_the_vertices_and_one_more():
    scene = corner(Material(0.8))
    points = Points(torch.tensor([[0.5, 0.2, 0.5]]), torch.tensor([[0.0, 1.0, 0.0]]))
    found = baked(scene, "auto", receivers=points)
    assert found.bounces == baked(scene, "auto").bounces + 1
    assert torch.equal(values(found), values(baked(scene, found.bounces, receivers=points)))


# Interruption


def test_it_goes_on_from_what_another_count_has_traced(tmp_path):
    scene, folder = samples.coloured_box(4), tmp_path / "kept"
    baked(scene, 1, checkpoint=folder, keep=True)
    stamps = {each.name: each.stat().st_mtime_ns for each in folder.iterdir()}
    found = baked(scene, "auto", checkpoint=folder, keep=True)
    assert {each.name: each.stat().st_mtime_ns for each in folder.iterdir()} == stamps
    assert torch.equal(values(found), values(baked(scene, "auto")))


def test_points_of_another_way_to_stop_are_baked_anew(tmp_path):
    from torchprt.transport import CheckpointWarning

    scene, folder = corner(Material(0.8)), tmp_path / "kept"
    points = Points(torch.tensor([[0.5, 0.2, 0.5]]), torch.tensor([[0.0, 1.0, 0.0]]))
    baked(scene, math.inf, receivers=points, checkpoint=folder, keep=True)
    with pytest.warns(CheckpointWarning):
        found = baked(scene, "auto", receivers=points, checkpoint=folder, keep=True)
    assert torch.equal(values(found), values(baked(scene, "auto", receivers=points)))
