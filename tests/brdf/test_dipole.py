"""Does light that diffuses below a plane come out again as the dipole has it?"""

import itertools
import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from torchprt.brdf import dipole, fresnel_average
from torchprt.errors import InputError
from torchprt.scene import MATERIALS, Subsurface, read_subsurface

EPS = torch.finfo(torch.float64).eps


@pytest.mark.parametrize("eta", [0.99, 4.1, float("nan"), -1.3, float("inf")])
def test_an_index_that_no_body_has_is_refused(eta):
    with pytest.raises(InputError, match="eta is"):
        fresnel_average(eta)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (((-1.0, 1.0, 1.0), 0.1), "numbers from 0"),
        ((1, (0.1, float("nan"), 0.0)), "numbers from 0"),
        ((1, float("inf")), "numbers from 0"),
        (((1.0, 2.0), 0.1), "one or three"),
        (((1.0, 0.0, 1.0), 0.0), "both 0 in green"),
        ((1, 0.1, 0.5), "eta is 0.5"),
    ],
)
def test_what_is_no_medium_is_refused(arguments, what):
    with pytest.raises(InputError, match=what):
        Subsurface(*arguments)


@pytest.mark.parametrize("text", ["granite", "subsurface:1,2,3", "subsurface:1,1,1,.1,.1,.1,x", "marble:2", ""])
def test_text_that_says_no_medium_names_those_there_are(text):
    with pytest.raises(InputError, match=r"marble.*subsurface:0.74"):
        read_subsurface(text)


def test_a_medium_by_its_coefficients_is_the_one_by_its_name():
    named = MATERIALS["skin1"]
    read = read_subsurface("subsurface:0.74,0.88,1.01,0.032,0.17,0.48,1.3")
    assert (read.scattering, read.absorption, read.eta) == (named.scattering, named.absorption, named.eta)
    assert read_subsurface(read.text) == read
    with pytest.raises(InputError, match=r"subsurface:.*numbers from 0"):
        read_subsurface("subsurface:-1,1,1,.1,.1,.1,1.3")


def test_measured_media_reflect_what_the_paper_says():
    """Its table has coefficients and reflectances: two columns that check each other. It rounds to .01 and uses a fit
    for what the surface reflects; chicken1 in blue is the one that does not follow from its coefficients."""
    table = {
        "apple": (0.85, 0.84, 0.53),
        "chicken1": (0.31, 0.15, 0.13),
        "chicken2": (0.32, 0.16, 0.10),
        "cream": (0.98, 0.90, 0.73),
        "ketchup": (0.16, 0.01, 0.00),
        "marble": (0.83, 0.79, 0.75),
        "potato": (0.77, 0.62, 0.21),
        "skimmilk": (0.81, 0.81, 0.69),
        "skin1": (0.44, 0.22, 0.13),
        "skin2": (0.63, 0.44, 0.34),
        "spectralon": (1.00, 1.00, 1.00),
        "wholemilk": (0.91, 0.88, 0.76),
    }
    assert table.keys() == MATERIALS.keys()
    for name, reflectance in table.items():
        assert MATERIALS[name].reflectance.tolist() == pytest.approx(reflectance, abs=0.01), name


@pytest.mark.parametrize("eta", [1.0, 1.0001, 1.3, 1.5, 4.0])
def test_what_a_surface_reflects_of_a_uniform_light_is_fresnel_averaged(eta):
    def reflected(angle):
        inside = math.asin(min(math.sin(angle) / eta, 1.0))
        if angle + inside < 1e-9:
            return 0.0
        across = (math.sin(angle - inside) / math.sin(angle + inside)) ** 2
        along = (math.tan(angle - inside) / math.tan(angle + inside)) ** 2
        return (across + along) * math.sin(angle) * math.cos(angle)

    exact, _ = quad(reflected, 0, math.pi / 2, epsabs=1e-11, limit=400)
    assert fresnel_average(eta) == pytest.approx(exact, abs=1e-8)
    if eta in (1.3, 1.5):
        # The fit that the paper uses, of what is reflected from inside.
        fitted = -1.440 / eta**2 + 0.710 / eta + 0.668 + 0.0636 * eta
        assert 1 - (1 - fresnel_average(eta)) / eta**2 == pytest.approx(fitted, abs=1e-3)


@pytest.mark.parametrize("name", ["marble", "skin1", "ketchup", "spectralon"])
def test_the_profile_over_the_plane_integrates_to_what_a_half_space_reflects(name):
    source = MATERIALS[name].dipole
    distances = torch.tensor([0.0, 0.01, 0.3, 2.0, 30.0], dtype=torch.float64)
    closed = source.within(distances)
    for colour in range(3):

        def ring(log, colour=colour):
            radius = math.exp(log)
            return float(source.profile(torch.tensor(radius))[colour]) * 2 * math.pi * radius**2

        steps = np.log([1e-7, 0.01, 0.3, 2.0, 30.0])
        parts = [quad(ring, low, high, epsabs=1e-10, epsrel=1e-8)[0] for low, high in itertools.pairwise(steps)]
        assert closed[1:, colour].tolist() == pytest.approx(np.cumsum(parts), abs=1e-6)
    assert closed[0].abs().max() <= EPS
    torch.testing.assert_close(source.within(torch.tensor(1e12)), source.total, atol=1e-9, rtol=0)


def test_nothing_is_lost_without_absorption_and_nothing_comes_back_without_scattering():
    one = torch.ones(1, dtype=torch.float64)
    assert float(dipole(one, 0 * one, 1.4).total) == pytest.approx(1, abs=4 * EPS)
    assert float(dipole(0 * one, one, 1.4).total) == 0
    # Between them it falls without a step.
    totals = torch.cat([dipole(one, share * one, 1.4).total for share in torch.logspace(-8, 4, 40).double()])
    assert bool((totals[1:] < totals[:-1]).all())
    assert float(totals[0]) > 0.999


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_a_medium_in_other_units_is_the_same_medium(scale):
    scattering, absorption = torch.tensor([[2.19, 2.62, 3.0], [0.0021, 0.0041, 0.0071]], dtype=torch.float64)
    one, other = dipole(scattering, absorption, 1.5), dipole(scattering / scale, absorption / scale, 1.5)
    distance = torch.tensor([0.0, 0.5, 7.0], dtype=torch.float64)
    torch.testing.assert_close(other.profile(distance * scale) * scale**2, one.profile(distance), rtol=1e-12, atol=0)
    torch.testing.assert_close(other.total, one.total, rtol=1e-12, atol=0)
