"""Does a material refuse to create light, and does text say the material that it names?"""

import math

import numpy as np
import pytest
import torch

from torchprt import brdf
from torchprt.errors import InputError
from torchprt.scene import EnergyWarning, Material, Object, load, make_mesh, read_material
from torchprt.scene.energy import reflected

CORNERS, SIDE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])
TRIANGLE = make_mesh(CORNERS, SIDE, name="triangle")
PAINTED = make_mesh(CORNERS, SIDE, colours=torch.eye(3), name="painted")


# Misuse


@pytest.mark.parametrize("specular", [-0.1, 1.1, math.nan, (0.2, 0.3, 2.0)])
def test_refuses_a_specular_outside_zero_to_one(specular):
    with pytest.raises(InputError, match=r"specular ranges .*give values in \[0, 1\]"):
        Material(gloss="phong:10", specular=specular)


def test_refuses_specular_of_another_shape_or_kind():
    with pytest.raises(InputError, match="specular has shape"):
        Material(gloss="phong:10", specular=(0.1, 0.2))
    with pytest.raises(InputError, match="specular 'vertex'"):
        Material(gloss="phong:10", specular="vertex")
    with pytest.raises(InputError, match="specular has 4 rows for the 3 vertices of triangle"):
        Object(TRIANGLE, Material(gloss="phong:10", specular=torch.full((4, 1), 0.1)))


def test_refuses_specular_without_a_gloss():
    with pytest.raises(InputError, match="specular is given without gloss"):
        Material(specular=0.3)


@pytest.mark.parametrize("translucency", [-0.1, 1.5, math.nan, math.inf])
def test_refuses_a_translucency_outside_zero_to_one(translucency):
    with pytest.raises(InputError, match=r"translucency is .*\[0, 1\]"):
        Material(translucency=translucency)


def test_refuses_a_gloss_that_is_not_known():
    with pytest.raises(InputError, match="velvet"):
        Material(gloss="velvet:3")


# Energy


def test_refuses_a_body_and_a_gloss_that_give_back_more_than_arrives():
    with pytest.raises(InputError, match=r"albedo up to 0.5 under gloss ggx:0.3.*lower albedo or specular"):
        Material(0.5, gloss="ggx:0.3")
    with pytest.raises(InputError, match=r"albedo of 0.9 with translucency 0.5 gives back 1.35 times"):
        Material(0.9, translucency=0.5)
    with pytest.raises(InputError, match="gives back"):
        Material(0.45, gloss="lambert", specular=0.2, translucency=1.0)


def test_takes_what_gives_back_all_of_it():
    Material(0.5, translucency=1.0)
    Material(0.8, translucency=0.25)
    Material(0.5, gloss="lambert", specular=0.5)
    Material(0.4, gloss="lambert", specular=0.2, translucency=1.0)


def test_every_vertex_and_channel_counts():
    fine, dark = torch.tensor([[0.1], [0.5], [0.1]]), torch.tensor([[0.9], [0.4], [0.9]])
    Material(fine, gloss="lambert", specular=dark)
    with pytest.raises(InputError, match="gives back"):
        Material(fine, gloss="lambert", specular=1 - fine + torch.tensor([[0.0], [0.1], [0.0]]))
    Material((0.9, 0.1, 0.1), gloss="lambert", specular=(0.1, 0.9, 0.9))
    with pytest.raises(InputError, match="gives back"):
        Material((0.9, 0.1, 0.1), gloss="lambert", specular=(0.2, 0.9, 0.9))


def test_colours_of_a_mesh_are_checked_when_it_is_known():
    material = Material("vertex", gloss="lambert", specular=0.5)
    with pytest.raises(InputError, match="painted with an albedo up to 1 under gloss lambert"):
        Object(PAINTED, material)
    Object(PAINTED, material, "blocker")
    with pytest.raises(InputError, match=r"painted with an albedo of 1 with translucency 0.5"):
        Object(PAINTED, Material("vertex", translucency=0.5))


def test_warns_if_only_some_directions_get_more_than_arrives():
    share = reflected(brdf.parse("phong:40"))
    albedo = 1 - 0.5 * (share.mean + share.peak)
    with pytest.warns(EnergyWarning, match="seen from some directions"):
        Material(albedo, gloss="phong:40")


def test_the_share_of_a_gloss_is_that_of_its_directional_albedo():
    # A sum over 2000 angles instead of Gauss-Legendre in their squared cosines.
    phong = brdf.Phong(40.0)
    z = (torch.arange(2000, dtype=torch.float64) + 0.5) / 2000
    views = torch.stack([(1 - z * z).sqrt(), 0 * z, z], -1)
    dense = float((brdf.directional_albedo(phong, views) * 2 * z).mean())
    assert reflected(phong).mean == pytest.approx(dense, rel=1e-3)
    # A white diffuse surface and a mirror-like lobe seen from above give back all.
    assert reflected(brdf.Lambert()).mean == pytest.approx(1, rel=1e-4)
    assert reflected(phong).peak == pytest.approx(1, rel=0.02)


def test_a_gloss_of_an_unhashable_kind_is_measured_too():
    class Unhashable(type(brdf.Lambert())):
        __hash__ = None

    assert reflected(Unhashable()).mean == pytest.approx(1, rel=1e-4)


# What a material says


def test_the_body_is_grey_unless_a_gloss_lies_on_it():
    assert Material().albedo == 0.5
    assert Material(gloss="phong:10").albedo == 0.0
    assert Material(0.2, gloss="ggx:0.3,0.04").albedo == 0.2


def test_text_becomes_a_model():
    assert Material(gloss="ggx:0.3,0.04").brdf == brdf.GGX(0.3, 0.04)
    assert Material(gloss=brdf.GGX(0.3, 0.04)).brdf == brdf.GGX(0.3, 0.04)
    assert Material().brdf is None


def test_a_translucent_sheet_has_two_sides():
    assert Material(translucency=0.5).two_sided
    assert not Material().two_sided


@pytest.mark.parametrize(("specular", "coloured"), [(0.5, False), ((0.5, 0.5, 0.5), False), ((0.5, 0.4, 0.5), True)])
def test_specular_colours_light(specular, coloured):
    material = Material(gloss="phong:10", specular=specular)
    assert material.coloured == coloured
    assert Object(TRIANGLE, material).coloured == coloured


# Text


@pytest.mark.parametrize("text", ["", "gold", "ggx", "ggx:2", "phong:a", "phong:1,2", "ggx:0.3,0.04.tom"])
def test_refuses_text_that_is_no_material(text):
    with pytest.raises(InputError, match="cannot be used, give"):
        read_material(text)


@pytest.mark.parametrize("text", ["membrane", "membrane:", "membrane:x", "membrane:2", "membrane:nan"])
def test_refuses_a_membrane_without_a_translucency(text):
    with pytest.raises(InputError, match=f"material '{text}'"):
        read_material(text)


@pytest.mark.parametrize(
    ("text", "model"),
    [("phong:40", brdf.Phong(40.0)), (" ggx:0.3,0.04", brdf.GGX(0.3, 0.04)), ("ward:0.1,0.4", brdf.Ward(0.1, 0.4))],
)
def test_text_names_a_gloss(text, model):
    material = read_material(text)
    assert material.brdf == model
    assert material.albedo == 0.0


def test_a_membrane_is_diffuse_and_translucent():
    material = read_material("membrane:0.5")
    assert (material.albedo, material.translucency, material.two_sided, material.brdf) == (0.5, 0.5, True, None)


# Files


@pytest.fixture
def toml(tmp_path):
    def write(text: str) -> str:
        path = tmp_path / "paint.toml"
        path.write_text(text)
        return str(path)

    return write


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("albedo = ", ["not a .toml file"]),
        ("colour = 1", ["'colour'", "albedo, two_sided"]),
        ("albedo = true", ["albedo = True", "give a number"]),
        ("albedo = 'red'", ["albedo = 'red'"]),
        ("albedo = [1, 2]", ["albedo of 2 numbers"]),
        ("albedo = [0.1, 'x', 0.3]", ["albedo = 'x'"]),
        ("albedo = 1.5", [r"ranges from 1.5"]),
        ("two_sided = 1", ["two_sided = 1", "true or false"]),
        ("translucency = 'thick'", ["translucency = 'thick'"]),
        ("translucency = 3", ["translucency is 3"]),
        ("specular = 0.5", ["specular is given without gloss"]),
        ("gloss = 3", ["gloss = 3"]),
        ("gloss = 'velvet:3'", ["gloss that cannot be used", "velvet"]),
        ("[gloss]\nroughness = 0.3", ["model = None"]),
        ("[gloss]\nmodel = 'velvet'", ["model = 'velvet'", "ggx"]),
        ("[gloss]\nmodel = 'ggx'\nshine = 1", ["'shine' in [gloss]", "roughness, f0"]),
        ("[gloss]\nmodel = 'ggx'", ["without all its numbers"]),
        ("[gloss]\nmodel = 'ggx'\nroughness = 'low'", ["[gloss] roughness = 'low'"]),
        ("[gloss]\nmodel = 'ggx'\nroughness = 7", ["[gloss] that cannot be used", "roughness"]),
        ("gloss = 'phong:3'\ntabulated = 'a.npy'", ["both gloss and tabulated"]),
    ],
)
def test_a_file_at_fault_is_named_with_the_key(toml, text, words):
    with pytest.raises(InputError) as caught:
        read_material(toml(text))
    message = str(caught.value)
    assert "\n" not in message
    for word in ["paint.toml", *words]:
        assert word in message


def test_a_file_that_is_missing_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml does not exist"):
        read_material(tmp_path / "none.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match=r"folder\.toml cannot be read"):
        read_material(str(tmp_path / "folder.toml"))
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"bytes\.toml is not a \.toml file"):
        read_material(str(tmp_path / "bytes.toml"))


def test_a_file_says_all_of_a_material(toml):
    material = read_material(
        toml("albedo = [0.3, 0.1, 0.05]\nspecular = 0.5\ntranslucency = 0.25\ntwo_sided = true\ngloss = 'ggx:0.3,0.04'")
    )
    assert material.albedo == [0.3, 0.1, 0.05]
    assert (material.specular, material.translucency, material.two_sided) == (0.5, 0.25, True)
    assert material.brdf == brdf.GGX(0.3, 0.04)
    assert read_material(toml("albedo = 'vertex'")).albedo == "vertex"
    assert read_material(toml("")).albedo == 0.5


def test_a_gloss_is_text_or_a_table(toml):
    table = read_material(toml("[gloss]\nmodel = 'ggx'\nroughness = 0.3\nf0 = 0.04"))
    assert table.brdf == read_material(toml("gloss = 'ggx:0.3,0.04'")).brdf == brdf.GGX(0.3, 0.04)
    assert read_material(toml("[gloss]\nmodel = 'ggx'\nroughness = 0.3")).brdf == brdf.GGX(0.3)


def test_a_measured_gloss_lies_beside_its_file(toml, tmp_path):
    values = np.full((3, 4, 5), 0.5 / np.pi, dtype=np.float32)
    np.save(tmp_path / "paint.npy", values)
    material = read_material(toml("tabulated = 'paint.npy'\nspecular = 0.5"))
    assert isinstance(material.brdf, brdf.Tabulated)
    assert torch.equal(material.brdf.values, torch.from_numpy(values).double())
    assert "paint.npy" in str(load(TRIANGLE, material=material))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (np.full((3, 4, 5), -1.0), "paint.npy cannot be used as a reflectance"),
        (np.zeros((3, 4)), "paint.npy cannot be used as a reflectance"),
        (np.full((3, 4, 5), 5.0), "gives back"),
        (np.full((3, 4, 5), 1j), "holds complex128"),
        (np.full((3, 4, 5), "x"), "paint.npy holds"),
        (None, "is not an .npy file"),
    ],
)
def test_a_measured_gloss_at_fault_is_named(toml, tmp_path, values, words):
    if values is None:
        (tmp_path / "paint.npy").write_text("text")
    else:
        np.save(tmp_path / "paint.npy", values)
    with pytest.raises(InputError, match=words):
        read_material(toml("tabulated = 'paint.npy'"))


def test_a_measured_gloss_that_is_missing_is_named(toml):
    with pytest.raises(InputError, match=r"none\.npy as tabulated, which does not exist"):
        read_material(toml("tabulated = 'none.npy'"))
    with pytest.raises(InputError, match="tabulated = 3"):
        read_material(toml("tabulated = 3"))


# Loading


def test_load_takes_a_material_and_an_albedo_beside_it():
    material = Material(0.2, gloss="ggx:0.3,0.04")
    assert load(TRIANGLE, material=material).objects[0].material.albedo == 0.2
    given = load(TRIANGLE, albedo=(0.3, 0.2, 0.1), two_sided=True, material=material).objects[0].material
    assert given.albedo == (0.3, 0.2, 0.1)
    assert given.two_sided
    assert given.brdf == brdf.GGX(0.3, 0.04)
    assert load(TRIANGLE, material="membrane:0.5").objects[0].material.translucency == 0.5
    assert load(TRIANGLE).objects[0].material.albedo == 0.5


def test_load_refuses_a_material_that_is_none():
    with pytest.raises(InputError, match="material 'glass'"):
        load(TRIANGLE, material="glass")
