import pytest
import torch

from torchprt.brdf import GGX, BlinnPhong, Lambert, Measured, Phong, Tabulated, Ward, parse
from torchprt.errors import InputError


@pytest.mark.parametrize(
    "text",
    [
        "", "ggx", "ggx:", "ggx:a", "ggx:0.3,0.04,1", "ggx:0", "ward:0.1", "phong:-1", "phong:nan", "phong:inf",
        "lambert:1", "mirror", "Lambert", "ggx 0.3", "phong:40,", "blinn:1e999",
    ],
)  # fmt: skip
def test_refuses_other_text_and_shows_it(text):
    with pytest.raises(InputError, match=f"'{text}'"):
        parse(text)


def test_says_what_there_is():
    with pytest.raises(InputError, match=r"lambert, phong:40, blinn:40, ggx:0\.3"):
        parse("shiny")
    with pytest.raises(InputError, match="ward' takes roughness_x, roughness_y"):
        parse("ward:0.1")


def test_a_table_or_a_function_cannot_be_read_back():
    for brdf in (Tabulated(torch.ones(2, 2, 2)), Measured(lambda v, s: (v * s).sum(-1), "paint")):
        with pytest.raises(InputError, match="give the table or the function itself"):
            parse(brdf.spec)


@pytest.mark.parametrize(
    ("text", "brdf"),
    [
        ("lambert", Lambert()),
        ("phong:40", Phong(40)),
        ("phong:0", Phong(0.0)),
        ("blinn:12.5", BlinnPhong(12.5)),
        ("ggx:0.3", GGX(0.3)),
        ("ggx:0.3,0.04", GGX(0.3, 0.04)),
        ("ward:0.1,0.4", Ward(0.1, 0.4)),
    ],
)
def test_text_and_model_are_one(text, brdf):
    assert parse(text) == brdf
    assert brdf.spec == text
    assert parse(f"  {text} ") == brdf


def test_every_digit_survives():
    for value in (0.1 + 0.2, 1 / 3, 0.012345678901234567):
        assert parse(GGX(value).spec) == GGX(value)
    assert parse(Phong(1e-30).spec) == Phong(1e-30)
    assert parse(Phong(1e30).spec) == Phong(1e30)
    assert parse(GGX(torch.tensor(0.3, dtype=torch.float64)).spec) == GGX(0.3)
