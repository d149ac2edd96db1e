"""Are the right texture coordinates taken, and is what is wrong with them said or mended?"""

import warnings

import numpy as np
import pytest
import torch
from texel_scenes import card, cube, halves, plane
from textured_files import gltf, sheet

from torchprt.errors import InputError
from torchprt.scene import Lightmap, Material, Object, Scene, make_mesh, read_mesh
from torchprt.scene.charts import AtlasWarning, charts_of
from torchprt.scene.ground import ground
from torchprt.scene.rasterise import overlap
from torchprt.scene.texel_samples import texel_samples

WHOLE = (0.0, 0.0, 1.0, 1.0)


def with_uv(uv, mesh=None, more=None, v_up=False, name="sheet"):
    """A mesh with other texture coordinates, [F, 3, 2], and further sets."""
    mesh = plane(2) if mesh is None else mesh
    return make_mesh(mesh.positions, mesh.faces, uv=uv, more_uv=more or {}, v_up=v_up, name=name)


def charts(*meshes, uv=None, size=32, gutter=1, **material):
    return charts_of([Object(mesh, Material(**material)) for mesh in meshes], uv, size, size, gutter)


def square(low, high, mesh=None):
    """Texture coordinates of a plane of four cells from `low` to `high`."""
    return plane(2, uv=(*low, *high)).uv


def shared(found, size=256) -> float:
    """The share of texels with a place in several faces."""
    return overlap(np.concatenate([each.numpy() for each in found.uv]), size, size)


# What a caller asks for


def test_a_set_that_is_missing_is_refused_with_those_that_there_are():
    two = with_uv(square((0, 0), (1, 1)), more={2: square((0, 0), (0.5, 0.5))})
    with pytest.raises(InputError, match=r"sheet has no set 1 of texture coordinates, it has 0, 2: use --uv unwrap"):
        charts(two, uv=1)
    assert torch.equal(charts(two, uv=2).uv[0], square((0, 0), (0.5, 0.5)))
    bare = make_mesh(two.positions, two.faces, name="bare")
    with pytest.raises(InputError, match="bare has no set 0 of texture coordinates, it has none"):
        charts(bare, uv=0)


def test_a_set_that_leaves_the_square_is_refused_when_it_is_asked_for_and_passed_over_else():
    wide = with_uv(square((0.2, 0.2), (1.7, 0.9)))
    with pytest.raises(InputError, match=r"sheet: set 0 of the texture .* leaves the square from 0 to 1 with 4 faces"):
        charts(wide, uv=0)
    found = charts(wide)
    assert found.notes[0] == "charts are made by xatlas, because set 0 leaves the square with 4 faces"
    assert 0 <= found.uv[0].min() <= found.uv[0].max() <= 1


def test_a_set_that_lies_on_itself_is_warned_of_when_it_is_asked_for_and_passed_over_else():
    pairs = square((0, 0), (1, 1)).clone()
    pairs[1::2] = pairs[0::2]
    folded = with_uv(pairs)
    with pytest.warns(AtlasWarning, match=r"sheet: set 0 of the texture .* at one place, on 100.0% of the texels"):
        assert torch.equal(charts(folded, uv=0).uv[0], folded.uv)
    found = charts(folded)
    assert "because set 0 puts several faces at one place on 100.0% of the texels" in found.notes[0]
    assert shared(found) == 0


def test_the_set_for_light_comes_before_the_one_for_pictures():
    both = with_uv(square((0, 0), (1, 1)), more={1: square((0.1, 0.1), (0.4, 0.4))})
    found = charts(both)
    assert torch.equal(found.uv[0], both.more_uv[1])
    assert found.notes[0] == "set 1 of the texture coordinates"
    # Not of all objects: set 0, which lies side by side here.
    one = with_uv(square((0, 0), (0.4, 1)), more={1: square((0, 0), (1, 1))})
    other = with_uv(square((0.5, 0), (1, 1)), name="other")
    found = charts(one, other)
    assert found.notes[0] == "set 0 of the texture coordinates"
    assert torch.equal(found.uv[0], one.uv)


def test_no_coordinates_at_all_are_made():
    bare = make_mesh(cube().positions, cube().faces, name="bare")
    found = charts(bare)
    assert found.notes[0] == "charts are made by xatlas, because bare has no set 0"
    assert int(found.chart[0].max()) == 5
    assert shared(found) == 0
    assert charts(cube(), uv="unwrap").notes[0] == "charts are made by xatlas, as asked"


# What is wrong with coordinates


def test_faces_without_coordinates_are_on_no_chart_and_that_is_said():
    pairs = square((0, 0), (1, 1)).clone()
    pairs[3, 1, 0], pairs[5] = torch.nan, torch.inf
    found = charts(with_uv(pairs), uv=0)
    assert found.uv[0].isnan().all((1, 2)).nonzero()[:, 0].tolist() == [3, 5]
    assert not found.uv[0].isinf().any()
    assert "2 faces without texture coordinates or area on no chart" in found.notes
    # When it is not asked for, all faces get a place.
    anew = charts(with_uv(pairs))
    assert "because set 0 lacks 2 faces" in anew.notes[0]
    assert anew.uv[0].isfinite().all()


def test_faces_without_area_on_the_map_are_said():
    pairs = square((0, 0), (1, 1)).clone()
    pairs[3] = pairs[3, :1]
    found = charts(with_uv(pairs))
    assert "1 face without area on the map" in " ".join(found.notes)
    collapsed = charts(with_uv(torch.full((8, 3, 2), 0.5)))
    assert "because set 0 gives no area to 8 faces" in collapsed.notes[0]


def test_mirrored_charts_are_fine_and_said():
    plain, mirrored = plane(2), with_uv(square((0.9, 0.1), (0.1, 0.9)))
    assert not any("mirrored" in each for each in charts(plain).notes)
    found = charts(mirrored)
    assert "8 faces mirrored on the map" in found.notes
    assert torch.equal(found.uv[0], mirrored.uv)


def test_a_chart_of_another_tile_is_brought_back():
    away = with_uv(square((3.1, -2.9), (3.9, -2.1)))
    found = charts(away)
    assert torch.allclose(found.uv[0], square((0.1, 0.1), (0.9, 0.9)))
    assert "1 chart beside the square brought back by whole numbers" in found.notes
    # Onto another one: that is no map of light.
    pairs = torch.cat([square((0, 0), (1, 1)), square((1, 0), (2, 1))])
    two = make_mesh(
        torch.cat([plane(2).positions, plane(2, height=1).positions]),
        torch.cat([plane(2).faces, plane(2).faces + 9]),
        uv=pairs,
    )
    assert "several faces at one place" in charts(two).notes[0]


def test_v_runs_down_whatever_the_file_had():
    up = with_uv(square((0.1, 0.6), (0.9, 0.9)), v_up=True)
    found = charts(up, uv=0).uv[0]
    assert torch.allclose(found[..., 1], 1 - up.uv[..., 1])
    assert torch.equal(found[..., 0], up.uv[..., 0])


def test_files_keep_all_their_sets_and_the_way_of_v(tmp_path):
    positions, faces, uv = sheet(2)
    file = gltf([])
    more = {"TEXCOORD_0": uv, "TEXCOORD_1": uv / 2}
    primitive = file.primitive(faces.astype(np.uint32).ravel(), POSITION=positions, **more)
    file.tree["meshes"] = [{"primitives": [primitive]}]
    mesh = read_mesh(file.save(tmp_path / "a.glb"))
    assert mesh.uv_sets == [0, 1]
    assert np.allclose(mesh.uv_set(1).numpy(), uv[faces] / 2, atol=1e-7)
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0.25\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    mesh = read_mesh(tmp_path / "a.obj")
    assert mesh.uv_set(0)[0, :, 1].tolist() == [0.75, 1, 0]


def test_a_chart_smaller_than_a_texel_has_one_and_is_counted():
    scene = Scene([Object(plane(2, uv=(0.26, 0.26, 0.28, 0.28)), Material((0.1, 0.2, 0.3)))])
    samples = texel_samples(scene, scene.geometry(), Lightmap(8, uv=0, samples=1))
    assert samples.raster.texel.tolist() == [2 * 8 + 2]
    assert samples.points.albedo[0].tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert any(each.startswith("1 chart smaller than a texel") for each in samples.notes)


# Several objects


def test_objects_that_lie_on_each_other_are_packed_with_texels_of_one_size():
    small, large = plane(2, -0.5, 0.5, name="small"), plane(2, -1, 1, uv=WHOLE, name="large")
    for asked in (None, 0):
        found = charts(small, large, uv=asked, size=128)
        assert found.notes[0] == "set 0 of the texture coordinates of 2 objects, packed side by side"
        assert shared(found) == 0
        wide = [float(each[..., 0].max() - each[..., 0].min()) for each in found.uv]
        assert wide[1] / wide[0] == pytest.approx(2, rel=0.05)


def test_what_records_nothing_is_on_no_chart():
    objects = [Object(plane(2)), card(), Object(cube(), Material(mirror=0.9))]
    found = charts_of(objects, None, 32, 32, 1)
    assert found.uv[0].isfinite().all()
    assert found.uv[1].isnan().all()
    assert found.uv[2].isnan().all()
    assert charts_of([card()], None, 32, 32, 1).uv[0].isnan().all()


@pytest.mark.parametrize("asked", [0, "unwrap"])
def test_a_ground_has_a_chart_of_its_own_that_leaves_most_of_the_map_to_what_stands_on_it(asked):
    objects = [Object(cube(2.0))]
    objects += ground(objects)
    found = charts_of(objects, asked, 256, 256, 2)
    assert any(each.startswith("the ground has 1/2 of the texels") for each in found.notes)
    sizes = []
    for object, pairs in zip(objects, found.uv, strict=True):
        corners = object.mesh.positions[object.mesh.faces]
        area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1)
        one, other = pairs[:, 1] - pairs[:, 0], pairs[:, 2] - pairs[:, 0]
        flat = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).abs()
        sizes.append((area, flat, corners.mean(1)))
    assert shared(found, 512) == 0
    assert sizes[1][1].sum() < 0.4 * sizes[0][1].sum()
    near = sizes[1][2].norm(dim=1) < 1.2
    share = (sizes[1][1][near].sum() / sizes[1][0][near].sum()) / (sizes[0][1].sum() / sizes[0][0].sum())
    assert float(share) == pytest.approx(0.25, rel=0.1)


def test_a_ground_of_the_users_that_is_coarse_or_not_level_has_a_chart_too():
    hill = plane(2, -9, 9)
    hill = make_mesh(hill.positions + torch.tensor([0.0, 1, 0]) * hill.positions[:, :1] ** 2, hill.faces, name="hill")
    for floor in (plane(1, -9, 9, name="floor"), hill):
        found = charts_of([Object(cube()), Object(floor, role="ground")], None, 64, 64, 1)
        assert shared(found) == 0
        assert found.uv[1].isfinite().all()


# What hangs together


def test_a_chart_is_what_shares_edges_on_the_surface_and_on_the_map():
    assert charts(halves()).chart[0].tolist() == [0, 0, 1, 1]
    assert len(charts(cube()).chart[0].unique()) == 6
    # Two triangles that meet in a corner alone.
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [-1, 0, 0], [-1, 0, -1.0]])
    bow = make_mesh(corners, np.array([[0, 2, 1], [0, 4, 3]]))
    pairs = bow.positions[bow.faces][..., [0, 2]] / 4 + 0.5
    assert charts(make_mesh(bow.positions, bow.faces, uv=pairs)).chart[0].tolist() == [0, 1]


def test_a_fit_map_is_not_warned_of(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = charts(cube(), uv=0)
    assert found.notes == ("set 0 of the texture coordinates",)


@pytest.mark.parametrize("name", ["fins.ply", "folds.ply"])
def test_thin_and_folded_surfaces_are_unwrapped(data, name):
    mesh = read_mesh(data / "hard" / name)
    found = charts_of([Object(mesh)], None, 256, 256, 1)
    assert shared(found) == 0
    assert found.uv[0].isfinite().all()
