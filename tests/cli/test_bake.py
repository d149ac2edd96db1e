"""Do the options of `bake` do what they say?"""

import math

import numpy as np
import onnxruntime
import pytest
import torch
import trimesh
from environments import save_exr
from transfers import stored

from torchprt.shade import shader
from torchprt.transfer import load


def test_several_meshes_follow_each_other(done, folder, tmp_path):
    trimesh.creation.box(transform=trimesh.transformations.translation_matrix([0, -3, 0])).export(tmp_path / "box.ply")
    done("bake", folder / "ball.ply", tmp_path / "box.ply", "-o", tmp_path / "a.safetensors", "--rays", 16)
    transfer = load(tmp_path / "a.safetensors")
    assert transfer.vertices == 162 + 8
    assert float(transfer.positions[162:, 1].max()) < -2


@pytest.fixture
def corner(tmp_path):
    """A floor and a red wall on it, the colours in the file; sRGB 255 is albedo 1."""
    wall = trimesh.Trimesh([[-1, 0, -1], [1, 0, -1], [1, 2, -1], [-1, 2, -1]], [[0, 1, 2], [0, 2, 3]], process=False)
    floor = trimesh.Trimesh([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], [[0, 1, 2], [0, 2, 3]], process=False)
    wall = wall.subdivide().subdivide()
    floor = floor.subdivide().subdivide()
    wall.visual.vertex_colors = [[255, 0, 0, 255]] * len(wall.vertices)
    floor.visual.vertex_colors = [[255, 255, 255, 255]] * len(floor.vertices)
    trimesh.util.concatenate([floor, wall]).export(tmp_path / "corner.ply")
    return tmp_path / "corner.ply", len(floor.vertices)


def baked(done, path, *options, rays=256):
    output = path.with_suffix(".safetensors")
    said = done("bake", path, "-o", output, "--order", 3, "--rays", rays, *options)
    return load(output), said


def test_bounces_need_three_channels_only_if_albedo_has_colour(done, corner):
    path, _ = corner
    cases = [
        # The file has colours, which are taken unless an albedo is given.
        ([], 3, 3, 4),
        (["--albedo", 0.5], 1, 1, 3),
        (["--albedo", 0.5, "--bounces", 1], 1, 1, 1),
        (["--albedo", "0.5,0.5,0.5", "--bounces", 1], 1, 1, 1),
        (["--albedo", "0.9,0.1,0.1", "--bounces", 0], 1, 3, 0),
        (["--albedo", "0.9,0.1,0.1", "--bounces", 2], 3, 3, 2),
        (["--albedo", "vertex", "--bounces", 0], 1, 3, 0),
        (["--albedo", "vertex", "--bounces", 1], 3, 3, 1),
    ]
    for options, channels, colours, bounces in cases:
        transfer, said = baked(done, path, *options, rays=16)
        assert (transfer.channels, transfer.albedo.shape[1], transfer.bounces) == (channels, colours, bounces), options
        assert f"{channels} channel" in said


def test_light_takes_the_colour_of_a_wall_along(done, corner, tmp_path):
    path, floor = corner
    transfer, _ = baked(done, path, "--albedo", "vertex", "--bounces", "inf")
    assert transfer.bounces > 1
    save_exr(tmp_path / "white.exr", np.ones((16, 32, 3)))
    radiance = {}
    for bounces in ("0", "inf"):
        baked(done, path, "--albedo", "vertex", "--bounces", bounces)
        arguments = ["--light", tmp_path / "white.exr", "-o", tmp_path / "r.npy"]
        done("shade", path.with_suffix(".safetensors"), *arguments)
        radiance[bounces] = np.load(tmp_path / "r.npy")[:floor].mean(0)
    np.testing.assert_allclose(radiance["0"], radiance["0"][0], rtol=1e-5)
    assert radiance["inf"][0] > 1.02 * radiance["0"][0]
    # The wall reflects no green and no blue.
    np.testing.assert_allclose(radiance["inf"][1:], radiance["0"][1:], rtol=1e-5)


def test_a_blocker_casts_shadow_and_records_nothing(done, folder, tmp_path):
    trimesh.creation.box((8, 0.1, 8), trimesh.transformations.translation_matrix([0, 1.5, 0])).export(
        tmp_path / "b.ply"
    )
    arguments = ["bake", folder / "ball.ply", "--order", 4, "--rays", 64, "-o", tmp_path / "a.safetensors"]
    said = done(*arguments, "--blocker", tmp_path / "b.ply")
    assert "b.ply (blocker)" in said
    transfer, free = load(tmp_path / "a.safetensors"), load(folder / "ball.safetensors")
    assert transfer.vertices == free.vertices == 162
    top = int(free.positions[:, 1].argmax())
    # The mean of what the top of the ball sees of a constant sky.
    assert float(stored(transfer)[0, 0, top]) < 0.3 * float(stored(free)[0, 0, top])
    bottom = int(free.positions[:, 1].argmin())
    assert torch.equal(stored(transfer)[..., bottom], stored(free)[..., bottom])


def test_two_sided_surfaces_record_both_sides(done, corner, tmp_path):
    path, _ = corner
    transfer, _ = baked(done, path, "--two-sided", rays=16)
    single, _ = baked(done, path, rays=16)
    count = single.vertices
    assert transfer.vertices == 2 * count
    assert torch.equal(transfer.normals[count:], -transfer.normals[:count])
    assert torch.equal(transfer.positions[:count], single.positions)


def test_unshadowed_traces_nothing_and_is_the_closed_form(done, corner, tmp_path):
    path, _ = corner
    transfer, _ = baked(done, path, "--unshadowed")
    assert (transfer.transport, transfer.rays, transfer.error) == ("unshadowed", 0, None)
    # A cosine over a hemisphere, over pi: sqrt(4 pi) / 4 pi * pi / pi.
    expected = 1 / math.sqrt(4 * math.pi)
    torch.testing.assert_close(stored(transfer)[0, 0], torch.full((transfer.vertices,), expected), rtol=1e-6, atol=0)
    assert not list(tmp_path.glob("*.partial"))


def test_half_stores_half_the_bytes_and_shades_nearly_the_same(done, shaded, corner, folder, tmp_path):
    path, _ = corner
    whole, _ = baked(done, path, rays=16)
    half, said = baked(done, path, "--half", rays=16)
    assert stored(half).dtype == torch.float16
    assert 2 * half.bytes == whole.bytes
    assert "float16" in said
    assert torch.equal(stored(half), stored(whole).half())
    assert shaded(folder / "lamp.exr", transfer=path.with_suffix(".safetensors")).dtype == np.float32


def test_in_parts_is_the_same_file(done, corner, refused, monkeypatch, tmp_path):
    path, _ = corner
    bake, out = ["bake", path, "--rays", 16, "--bounces", 1, "--half"], tmp_path / "parts.safetensors"
    whole = tmp_path / "whole.safetensors"
    assert "written part by part" not in done(*bake, "-o", whole)
    done(*bake, "-o", out, "--in-parts", "--sample-points", 8)
    assert load(out).receivers.sampled()[0].shape == (8, 3)
    assert not list(tmp_path.glob("*.partial"))
    monkeypatch.setattr("torchprt.memory.available", lambda: 1000)
    assert "0.0 GB of memory are free: written part by part" in done(*bake, "-o", out)
    assert out.read_bytes() == whole.read_bytes()
    assert "written part by part" not in done(*bake, "-o", out, "--whole")
    plan = tmp_path / "plan.toml"
    refused("--in-parts is given", arguments=["bake", path, "-o", out, "--plan", plan, "--in-parts"])


def test_seed_and_threads_do_what_they_say(done, corner):
    path, _ = corner
    first, again, other = (
        baked(done, path, *options, rays=16)[0]
        for options in (["--seed", 1, "--threads", 1], ["--seed", 1, "--threads", 3], ["--seed", 2])
    )
    assert torch.equal(stored(first), stored(again))
    assert not torch.equal(stored(first), stored(other))
    assert (first.seed, other.seed) == (1, 2)


def test_every_mesh_may_have_a_material_of_its_own(done, refused, folder, tmp_path):
    plate = trimesh.creation.box((6, 0.1, 6), trimesh.transformations.translation_matrix([0, -1.2, 0])).subdivide()
    plate.export(tmp_path / "plate.ply")
    ball, out = folder / "ball.ply", tmp_path / "a.safetensors"
    said = done("bake", f"{tmp_path / 'plate.ply'}=0.8,0.4,0.2", f"{ball}=mirror:gold", "-o", out, "--rays", 32)
    assert "ball.ply (mirror)" in said
    assert "320 faces of mirrors" in said
    transfer = load(out)
    assert (transfer.vertices, transfer.channels) == (len(plate.vertices), 3)
    assert transfer.albedo[0].tolist() == pytest.approx([0.8, 0.4, 0.2])
    said = done("bake", tmp_path / "plate.ply", f"{ball}=ggx:0.4", "-o", out, "--rays", 16, "--bounces", 1)
    assert "2 objects: plate.ply (26), ball.ply (162)" in said
    assert load(out).layers["exit"].signal.shape[0] == 162
    refused("every mesh says its own", arguments=["bake", f"{ball}=mirror", "-o", out, "--albedo", 0.5])
    refused("no mirror: write mirror", arguments=["bake", f"{ball}=mirror:tin", tmp_path / "plate.ply", "-o", out])
    # A mirror alone records nothing, on a ground it throws its caustic.
    refused("only blockers and mirrors", arguments=["bake", ball, "--material", "mirror", "-o", out])
    done("bake", ball, "--material", "mirror", "--ground", "-o", out, "--rays", 8, "--bounces", 0)
    assert load(out).receivers.ground().all()


@pytest.mark.usefixtures("untyped")
def test_one_of_several_objects_is_exported_alone(done, refused, folder, tmp_path):
    trimesh.creation.box(transform=trimesh.transformations.translation_matrix([0, -3, 0])).export(tmp_path / "box.ply")
    bake = tmp_path / "a.safetensors"
    done("bake", folder / "ball.ply", tmp_path / "box.ply", "-o", bake, "--rays", 16, "--bounces", 1)
    done("export", bake, "-o", tmp_path / "box.onnx", "--only", "box.ply")
    graph = onnxruntime.InferenceSession(tmp_path / "box.onnx")
    assert graph.get_outputs()[0].shape[1] == 8
    transfer = load(bake)
    alone = transfer.only("box.ply")
    light = torch.randn(transfer.order**2, 3)
    torch.testing.assert_close(shader(alone)(light), shader(transfer)(light)[162:])
    refused("has no object 'cup.ply'", arguments=["export", bake, "-o", tmp_path / "cup.onnx", "--only", "cup.ply"])
