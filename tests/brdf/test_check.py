"""How much light comes back? Against closed forms, and where it is too much."""

import math

import pytest
import torch

from torchprt import sh
from torchprt.brdf import (
    GGX,
    BlinnPhong,
    Lambert,
    Measured,
    Phong,
    Tabulated,
    Ward,
    check_energy,
    directional_albedo,
    reciprocity_error,
)
from torchprt.errors import InputError

NORMAL = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
SHARP = [Lambert(), Phong(0), Phong(1), Phong(40), Phong(1000), BlinnPhong(10), BlinnPhong(1000), GGX(0.01), GGX(0.05),
         GGX(0.3), GGX(1), GGX(0.2, 0.04), Ward(0.05, 0.05), Ward(0.1, 0.4), Ward(1, 1)]  # fmt: skip


def tilted(*degrees):
    theta = torch.tensor(degrees, dtype=torch.float64).deg2rad()
    return torch.stack([theta.sin(), torch.zeros_like(theta), theta.cos()], -1)


def test_refuses_directions_that_are_not_unit():
    with pytest.raises(InputError, match="view"):
        directional_albedo(Lambert(), torch.tensor([[0.0, 0.0, 2.0]]))


def test_refuses_a_lobe_too_narrow_to_integrate():
    needle = Measured(lambda v, s: torch.exp(-((v - s).square().sum(-1) * 1e9)) * 1e9, "needle", width=1e-4)
    with pytest.raises(InputError, match="needle"):
        directional_albedo(needle, tilted(50.0))


def test_no_view_has_no_albedo_and_one_below_the_horizon_has_none():
    assert directional_albedo(GGX(0.3), torch.zeros(0, 3)).shape == (0,)
    assert directional_albedo(GGX(0.3), tilted(90.5, 180)).tolist() == [0, 0]
    assert directional_albedo(GGX(0.3), NORMAL.float()).shape == ()


# 1e-4 of the RMS is what the quadrature promises.
@pytest.mark.parametrize("degrees", [0, 30, 75, 89, 89.99])
def test_a_white_diffuse_surface_gives_all_light_back(degrees):
    assert float(directional_albedo(Lambert(), tilted(degrees))) == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("exponent", [1, 10, 1000, 1e5])
def test_phong_and_blinn_phong_are_normalised_at_normal_incidence(exponent):
    for model in (Phong, BlinnPhong):
        assert float(directional_albedo(model(exponent), NORMAL)) == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("degrees", [0, 40, 80])
def test_phong_of_exponent_one_against_its_closed_form(degrees):
    """int max(r . s, 0) s_z ds over the hemisphere is (pi + (pi - ...)): by brute force, with the edge on the grid."""
    # About the mirror direction: f s_z is r_z cos^2 + r_x sin cos cos(psi), over the part above the horizon.
    theta = math.radians(degrees)
    z, weights = torch.linspace(0, 1, 4001, dtype=torch.float64), torch.full((4001,), 1 / 4000, dtype=torch.float64)
    weights[[0, -1]] /= 2
    psi = (torch.arange(4000, dtype=torch.float64) + 0.5) * (2 * math.pi / 4000)
    height = math.cos(theta) * z[:, None] + math.sin(theta) * (1 - z * z).sqrt()[:, None] * psi.cos()
    total = (weights[:, None] * z[:, None] * height.clamp(min=0)).sum() * (2 * math.pi / 4000)
    expected = float(total) * 3 / (2 * math.pi)
    assert float(directional_albedo(Phong(1), tilted(degrees))) == pytest.approx(expected, rel=2e-4)


@pytest.mark.parametrize("degrees", [0, 40, 80])
def test_phong_of_exponent_zero_is_diffuse_light_from_half_of_the_directions(degrees):
    """Those less than 90 degrees from the mirror direction: (1 + cos) / 2 of the cosine, by hand."""
    expected = (1 + math.cos(math.radians(degrees))) / 2
    # 1e-3 is what the quadrature promises of an edge.
    assert float(directional_albedo(Phong(0), tilted(degrees))) == pytest.approx(expected, rel=2e-3)


def test_ggx_of_full_roughness_at_normal_incidence():
    """1 - log 2, by hand."""
    assert float(directional_albedo(GGX(1), NORMAL)) == pytest.approx(1 - math.log(2), rel=1e-6)


@pytest.mark.parametrize("a", [0.05, 0.3, 1.0])
def test_ward_at_normal_incidence(a):
    """1 - a^2 (1 - exp(-1 / a^2)), by hand, with u = tan^2 of the half direction."""
    expected = 1 - a * a * (1 - math.exp(-1 / (a * a)))
    assert float(directional_albedo(Ward(a, a), NORMAL)) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("brdf", [Phong(20), BlinnPhong(20), GGX(0.4, 0.1), Ward(0.5, 0.25)], ids=lambda b: b.spec)
def test_agrees_with_a_rule_that_knows_nothing_of_lobes(brdf):
    views = tilted(0, 20, 50, 70)
    lights, weights = sh.gauss_legendre_hemisphere(500)
    brute = (brdf(views[:, None], lights) * lights[:, 2] * weights).sum(-1)
    # Phong has a kink at 90 degrees from the mirror, whose power 20 is smooth.
    torch.testing.assert_close(directional_albedo(brdf, views), brute, rtol=1e-4, atol=0)


@pytest.mark.parametrize("shape", [(4, 5, 6), (3, 4, 5, 6)])
def test_the_albedo_of_a_random_table_agrees_with_a_rule_that_knows_nothing_of_cells(shape):
    table = Tabulated(torch.rand(shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64))
    views = tilted(0.5, 20, 50, 89)
    lights, weights = sh.gauss_legendre_hemisphere(500)
    brute = (table(views[:, None], lights) * lights[:, 2] * weights).sum(-1)
    # The edges between cells cost the rule the square of its steps.
    torch.testing.assert_close(directional_albedo(table, views), brute, rtol=1e-4, atol=0)


@pytest.mark.parametrize("brdf", SHARP, ids=lambda brdf: brdf.spec)
def test_no_model_creates_light(brdf):
    check_energy(brdf)


@pytest.mark.parametrize(("brdf", "factor"), [(GGX(0.1), 2.0), (Phong(60), 1.01), (Lambert(), 1.002)])
def test_says_how_much_light_is_created_and_where(brdf, factor):
    # Turned into anisotropic functions, so that azimuths are looked at too.
    brighter = Measured(lambda v, s: factor * brdf(v, s), "bright", width=brdf.width)
    with pytest.raises(InputError, match=r"'measured:bright' gives back (1\.0|1\.9|2)\S* times .* degrees"):
        check_energy(brighter)


def test_says_at_which_angle():
    # Above 1 toward the horizon alone.
    table = torch.ones(46, 46, 2, dtype=torch.float64) / math.pi
    table[40:] *= 1.5
    with pytest.raises(InputError, match=r"1\.5 times the light it receives at (80|82|84|86|88|89\.5) degrees"):
        check_energy(Tabulated(table))


def test_albedo_takes_tensors_for_numbers():
    parameter = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    albedo = directional_albedo(GGX(parameter), NORMAL)
    assert not albedo.requires_grad
    assert float(albedo) == float(directional_albedo(GGX(0.3), NORMAL))
    with pytest.raises(InputError, match="roughness holds 2"):
        directional_albedo(GGX(torch.tensor([0.3, 0.4])), NORMAL)


def test_reciprocity_error_sees_a_direction_of_light():
    assert reciprocity_error(Ward(0.1, 0.4)) < 1e-12
    assert reciprocity_error(Measured(lambda v, s: v[..., 2] ** 2 * s[..., 2], "one way")) > 0.1
    assert reciprocity_error(Tabulated(torch.zeros(2, 2, 2))) == 0
