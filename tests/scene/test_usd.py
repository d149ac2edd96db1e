"""Do the meshes of a USD stage come in where and as the stage draws them?"""

import sys

import numpy as np
import pytest
import torch

from torchprt.errors import InputError
from torchprt.scene import read_mesh

HEAD = '#usda 1.0\n(\n    upAxis = "{up}"\n)\n'
MESH = """def Mesh "square"
{{
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (9, 9, 9)]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    {more}
}}
"""
SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [9, 9, 9]]


@pytest.fixture
def read(tmp_path):
    """`read(text)`: the mesh of a stage of this text."""
    pytest.importorskip("pxr", reason="usd-core is not installed")

    def read(text, up="Y"):
        (tmp_path / "a.usda").write_text(HEAD.format(up=up) + text)
        return read_mesh(tmp_path / "a.usda")

    return read


def mesh(more=""):
    return MESH.format(more=more)


def test_without_the_library_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    for suffix in ("usd", "usda", "usdc", "usdz"):
        (tmp_path / f"a.{suffix}").write_text(HEAD)
        with pytest.raises(InputError, match=rf"a\.{suffix} needs the package usd-core.*torchprt\[usd\]"):
            read_mesh(tmp_path / f"a.{suffix}")


@pytest.mark.parametrize("content", ["hello", "#usda 1.0\ndef Mesh {", "PXR-USDC\0\0\0"])
@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
def test_a_damaged_file_is_refused_in_a_sentence(content, suffix, tmp_path, capfd):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    (tmp_path / f"a.{suffix}").write_text(content)
    with pytest.raises(InputError, match=rf"a\.{suffix} ") as caught:
        read_mesh(tmp_path / f"a.{suffix}")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_faces_that_name_nothing_are_refused(read):
    with pytest.raises(InputError, match="holds no vertices"):
        read('def Xform "empty" {}')
    with pytest.raises(InputError, match="names vertex 7 of 5"):
        read(mesh().replace("[0, 1, 2, 3]", "[0, 1, 2, 7]"))
    with pytest.raises(InputError, match="without all their corners"):
        read(mesh().replace("[4]", "[5]"))
    with pytest.raises(InputError, match="has 1 values on /square"):
        read(mesh('texCoord2f[] primvars:st = [(0, 0)] (interpolation = "vertex")'))


def test_polygons_become_triangles_in_the_order_of_the_file(read):
    found = read(mesh())
    assert found.positions.tolist() == SQUARE
    assert found.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert found.report.unreferenced_vertices == 1
    found = read(
        mesh("int[] holeIndices = [0]").replace("[4]", "[3, 5]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 1, 2, 3, 4]")
    )
    assert found.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]


@pytest.mark.parametrize("kind", ["vertex", "varying", "faceVarying"])
def test_texture_coordinates_give_tangents(read, kind):
    pairs = "(0, 0), (0, 1), (1, 1), (1, 0)" + ("" if kind == "faceVarying" else ", (5, 5)")
    found = read(mesh(f'texCoord2f[] primvars:st = [{pairs}] (interpolation = "{kind}")'))
    assert found.uv.tolist() == [[[0, 0], [0, 1], [1, 1]], [[0, 0], [1, 1], [1, 0]]]
    np.testing.assert_allclose(found.tangents[:4], np.tile([0.0, 1, 0], (4, 1)), atol=1e-15)


def test_colours_are_linear_and_of_a_vertex_or_of_all(read):
    found = read(mesh("color3f[] primvars:displayColor = [(0.1, 0.2, 0.3)]"))
    assert torch.equal(found.colours[:4], torch.tensor([[0.1, 0.2, 0.3]]).expand(4, 3))


def test_a_vertex_of_several_normals_is_repeated(read):
    normals = "[(0, 0, 1), (1, 0, 0), (0, 0, 1), (0, 0, 1), (0, 1, 0), (0, 1, 0)]"
    two = mesh(f'normal3f[] normals = {normals} (interpolation = "faceVarying")')
    found = read(two.replace("[4]", "[3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]"))
    assert found.positions[:, :2].tolist() == [[0, 0], [1, 0], [1, 1], [1, 1], [0, 1], [9, 9]]
    assert found.normals[:5].tolist() == [[0, 0, 1], [1, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 0]]
    # The order in which normals sort is that of the copies.
    assert found.faces.tolist() == [[0, 1, 2], [0, 3, 4]]


def test_meshes_stand_where_the_stage_puts_them(read):
    inner = mesh('double3 xformOp:translate = (1, 0, 0)\n uniform token[] xformOpOrder = ["xformOp:translate"]')
    turned = 'double xformOp:rotateZ = 90\n uniform token[] xformOpOrder = ["xformOp:rotateZ"]\n'
    found = read(f'def Xform "all" {{ {turned} {inner} }}')
    np.testing.assert_allclose(found.positions[:4], [[0, 1, 0], [0, 2, 0], [-1, 2, 0], [-1, 1, 0]], atol=1e-14)


@pytest.mark.parametrize("left", [False, True])
def test_the_outside_stays_outside(read, left):
    mirror = 'double3 xformOp:scale = (-1, 1, 1)\n uniform token[] xformOpOrder = ["xformOp:scale"]\n'
    normals = (
        'normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1)] (interpolation = "vertex")\n'
    )
    order = 'uniform token orientation = "leftHanded"\n' if left else ""
    for more in ("", mirror):
        found = read(mesh(normals + order + more))
        # A left-handed square seen from +z shows its back; its normal is what the file says.
        assert found.report.opposed_normals == (4 if left else 0)
        assert found.normals[:4, 2].tolist() == [1.0] * 4


def test_z_up_is_turned_to_y_up(read):
    found = read(mesh(), up="Z")
    np.testing.assert_array_equal(found.positions[:4], [[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]])
    assert found.normals[0].tolist() == [0, 1, 0]


def test_what_is_hidden_or_only_a_guide_is_left_out_and_what_is_no_mesh_is_noted(read):
    hidden = mesh('token visibility = "invisible"').replace("square", "a")
    guide = mesh('uniform token purpose = "guide"').replace("square", "b")
    found = read(hidden + guide + mesh() + 'def Sphere "ball" {}\n')
    assert len(found.positions) == 5
    assert found.report.notes == ("1 object that is no mesh left out.",)


def test_instances_and_references_are_drawn(read, tmp_path):
    (tmp_path / "part.usda").write_text(HEAD.format(up="Y") + f'def Xform "part" {{ {mesh()} }}\n')
    one = (
        'def "{0}" (\n    instanceable = true\n    prepend references = @./part.usda@</part>\n)\n'
        "{{\n    double3 xformOp:translate = ({1}, 0, 0)\n"
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}}\n'
    )
    found = read(one.format("a", 0) + one.format("b", 20))
    assert found.positions[:, 0].tolist() == [0, 1, 1, 0, 9, 20, 21, 21, 20, 29]


def test_the_first_time_is_taken(read):
    moving = (
        mesh()
        .replace("point3f[] points = [", "point3f[] points.timeSamples = { 3: [")
        .replace("(9, 9, 9)]", "(9, 9, 9)], 4: [(7, 7, 7)] }")
    )
    assert read(moving).positions.tolist() == SQUARE


@pytest.mark.parametrize("suffix", ["usdc", "usd"])
def test_a_binary_file_holds_the_same(suffix, tmp_path):
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    stage = usd.Stage.CreateInMemory()
    layer = stage.GetRootLayer()
    layer.ImportFromString(HEAD.format(up="Y") + mesh())
    layer.Export(str(tmp_path / f"a.{suffix}"))
    assert read_mesh(tmp_path / f"a.{suffix}").positions.tolist() == SQUARE
