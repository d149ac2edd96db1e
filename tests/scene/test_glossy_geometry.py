"""Does the geometry say which receivers are glossy, in which frame, and what lies behind them?"""

import math

import pytest
import torch

from torchprt import brdf
from torchprt.scene import Material, Object, Scene, TangentWarning, make_mesh, samples

SQUARE = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
HALVES = torch.tensor([[0, 1, 2], [0, 2, 3]])
PLAIN = make_mesh(SQUARE, HALVES, name="plain")
MAPPED = make_mesh(SQUARE + 2, HALVES, name="mapped", uv=SQUARE[:, [1, 0]])


# Misuse


def test_warns_where_streaks_have_no_direction():
    streaks = Material(gloss=brdf.Ward(0.2, 0.4))
    with pytest.warns(TangentWarning, match="plain has an anisotropic gloss .ward:0.2,0.4. and no texture"):
        Object(PLAIN, streaks)
    Object(MAPPED, streaks)
    Object(PLAIN, streaks, "blocker")
    Object(PLAIN, Material(gloss="phong:10"))


# A scene of all kinds


def scene() -> Scene:
    return Scene(
        [
            Object(PLAIN, Material(0.2)),
            Object(MAPPED, Material(gloss="phong:10", specular=0.5, two_sided=True)),
            Object(PLAIN, Material(0.3, translucency=0.5)),
            Object(PLAIN, Material(gloss="phong:10"), "blocker"),
            Object(PLAIN, Material(0.1, gloss="ggx:0.3", specular=(0.1, 0.2, 0.3))),
            Object(MAPPED, Material(gloss="phong:10", specular=0.25, translucency=0.75)),
        ]
    )


def test_glossy_receivers_are_named_in_order_with_their_gloss():
    geometry = scene().geometry()
    # Fronts of objects 0, 1, 2, 4, 5, then the reverse sides of 1, 2, 5.
    assert geometry.receivers == 32
    assert geometry.glossy.tolist() == [*range(4, 8), *range(12, 24), *range(28, 32)]
    assert geometry.gloss == (brdf.Phong(10.0), brdf.GGX(0.3))
    assert geometry.gloss_of_glossy.tolist() == [0] * 4 + [1] * 4 + [0] * 12
    assert geometry.tangent_fields == ("", "uv", "", "", "smooth", "uv")


def test_tangents_are_unit_orthogonal_and_the_same_on_both_sides():
    geometry = scene().geometry()
    normals = geometry.receiver_normals[geometry.glossy]
    assert geometry.tangents.shape == normals.shape
    # A few roundings of unit vectors.
    torch.testing.assert_close(geometry.tangents.norm(dim=1), torch.ones(20, dtype=torch.float64), rtol=0, atol=1e-15)
    assert (geometry.tangents * normals).sum(dim=1).abs().max() < 1e-15
    along_u = torch.tensor([[0.0, 1, 0]], dtype=torch.float64).expand(4, 3)
    torch.testing.assert_close(geometry.tangents[:4], along_u, rtol=0, atol=1e-15)
    assert torch.equal(geometry.tangents[12:16], geometry.tangents[:4])
    assert torch.equal(normals[12:16], -normals[:4])
    assert torch.equal(geometry.tangents[16:], geometry.tangents[8:12])


def test_specular_has_three_channels_only_if_one_is_coloured():
    geometry = scene().geometry()
    expected = [[0.5] * 3] * 4 + [[0.1, 0.2, 0.3]] * 4 + [[0.25] * 3] * 4 + [[0.5] * 3] * 4 + [[0.25] * 3] * 4
    assert torch.equal(geometry.specular, torch.tensor(expected))
    grey = Scene([Object(PLAIN, Material(gloss="phong:10", specular=0.5))]).geometry()
    assert torch.equal(grey.specular, torch.full((4, 1), 0.5))


def test_the_other_side_is_known_where_light_comes_through():
    geometry = scene().geometry()
    through = geometry.partner >= 0
    assert through.nonzero().flatten().tolist() == [*range(8, 12), *range(16, 20), *range(24, 32)]
    rows = through.nonzero().flatten()
    other = geometry.partner[rows]
    assert torch.equal(geometry.partner[other], rows)
    assert torch.equal(geometry.receiver_positions[other], geometry.receiver_positions[rows])
    assert torch.equal(geometry.receiver_normals[other], -geometry.receiver_normals[rows])
    assert torch.equal(geometry.translucency[through], torch.tensor([0.5] * 4 + [0.75] * 4 + [0.5] * 4 + [0.75] * 4))
    assert not geometry.translucency[~through].any()


def test_a_diffuse_scene_pays_nothing(monkeypatch):
    def never(*_):
        raise AssertionError("the smooth field was computed for a diffuse scene")

    monkeypatch.setattr("torchprt.scene.mesh.smooth_tangents", never)
    geometry = Scene([Object(PLAIN), Object(MAPPED)]).geometry()
    assert geometry.glossy.shape == geometry.gloss_of_glossy.shape == (0,)
    assert geometry.tangents.shape == (0, 3)
    assert geometry.specular.shape == (0, 1)
    assert geometry.gloss == ()
    assert geometry.tangent_fields == ("", "")
    assert geometry.partner.tolist() == [-1] * 8
    assert geometry.translucency.tolist() == [0.0] * 8


def test_the_field_of_a_mesh_is_computed_once(monkeypatch):
    mesh = make_mesh(SQUARE, HALVES)
    first = mesh.tangent_field
    monkeypatch.setattr("torchprt.scene.mesh.smooth_tangents", None)
    assert mesh.tangent_field is first


def test_a_vertex_without_a_normal_has_a_tangent():
    mesh = make_mesh(torch.cat([SQUARE, torch.full((1, 3), 9.0)]), HALVES)
    geometry = Scene([Object(mesh, Material(gloss="phong:10"))]).geometry()
    assert not geometry.receiver_normals[4].any()
    assert float(geometry.tangents[4].norm()) == pytest.approx(1, abs=1e-15)


# Requirements and reports


def test_one_gloss_makes_a_glossy_bake():
    diffuse = Object(PLAIN)
    assert Scene([diffuse]).requires().kind == "diffuse"
    assert Scene([diffuse, Object(PLAIN, Material(gloss="phong:10"))]).requires().kind == "glossy"
    assert Scene([diffuse, Object(PLAIN, Material(gloss="phong:10"), "blocker")]).requires().kind == "diffuse"
    assert Scene([Object(PLAIN, Material(translucency=0.5))]).requires().kind == "diffuse"


def test_coloured_specular_needs_three_channels_if_light_bounces():
    gold = Scene([Object(PLAIN, Material(gloss="phong:10", specular=(0.9, 0.6, 0.3)))])
    assert [gold.requires(n).channels for n in (0, 1, math.inf)] == [1, 3, 3]


def test_the_report_says_what_lies_on_a_mesh():
    text = str(scene())
    assert text.count("Gloss phong:10, tangents from the mesh") == 2
    assert text.count("Gloss ggx:0.3, tangents a smooth field") == 1
    assert "Translucency 0.75, both sides record." in text
    assert "Gloss" not in str(Scene([Object(PLAIN)]))


def test_the_teapot_is_glossy_and_all_its_vertices_have_frames():
    geometry = samples.teapot(8000).geometry()
    assert torch.equal(geometry.glossy, torch.arange(geometry.receivers))
    assert (geometry.tangents * geometry.receiver_normals).sum(dim=1).abs().max() < 1e-15
