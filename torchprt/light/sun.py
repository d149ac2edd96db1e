"""The sun through the atmosphere, in linear sRGB."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.light.arguments import Number
from torchprt.sh.constant import remembered

# Half the angle under which the sun is seen, in radians (.2665 degrees).
HALF_ANGLE = math.radians(0.2665)

# Lumen per watt at 555 nm, by which spectral radiance becomes luminance.
_EFFICACY = 683.0

# Solar radiance outside the atmosphere, W / (m^2 nm sr), from 380 to 750 nm by 10 nm.
_SOLAR = """16559 16233.7 21127.5 25888.2 25829.1 24232.3 26760.5 29658.3 30545.4 30057.5 30663.7 28830.4 28712.1
27825 27100.6 27233.6 26361.3 25503.8 25060.2 25311.6 25355.9 25134.2 24631.5 24173.2 23685.3 23212.1 22827.7
22339.8 21970.2 21526.7 21097.9 20728.3 20240.4 19870.8 19427.2 19072.4 18628.9 18259.2"""

# Absorption of ozone, 1 / cm, at the same wavelengths (none is listed below 450 nm).
_OZONE = """0 0 0 0 0 0 0 .003 .006 .009 .014 .021 .03 .04 .048 .063 .075 .085 .103 .12 .12 .115 .125 .12 .105 .09
.079 .067 .057 .048 .036 .028 .023 .018 .014 .011 .01 .009"""

# Each lobe of the colour-matching functions: height, centre in nm, inverse widths below and above it.
_MATCHING = (
    ((0.362, 442.0, 0.0624, 0.0374), (1.056, 599.8, 0.0264, 0.0323), (-0.065, 501.1, 0.0490, 0.0382)),
    ((0.821, 568.8, 0.0213, 0.0247), (0.286, 530.9, 0.0613, 0.0322)),
    ((1.217, 437.0, 0.0845, 0.0278), (0.681, 459.0, 0.0385, 0.0725)),
)

_SRGB_OF_XYZ = (
    (3.2404542, -1.5371385, -0.4985314),
    (-0.9692660, 1.8760108, 0.0415560),
    (0.0556434, -0.2040259, 1.0572252),
)


def sun_radiance(zenith_angle: Float[Tensor, "*#B"], turbidity: Number) -> Float[Tensor, "... 3"]:
    """Radiance of the disc of the sun seen from the ground, linear sRGB, in units of 1000 cd / m^2.

    The solar spectrum dimmed by molecules, aerosols (`turbidity`, Angstrom exponent 1.3) and .35 cm of ozone.
    A sun within a few degrees of the horizon is redder than sRGB can say: the channel below 0 is made 0.
    Mixed gases and water vapour absorb beyond 689 nm only, where the eye sees next to nothing: they are left out.

    Source: Preetham, Shirley and Smits 1999, "A practical analytic model for daylight", appendix A.1 and table 2;
    colour matching: Wyman, Sloan and Shirley 2013, "Simple analytic approximations to the CIE XYZ color matching
    functions", the multi-lobe fit of the 1931 observer.
    """
    # A float32 air mass of 40 in an exponent would lose three digits.
    angle = zenith_angle.double()
    haze = torch.as_tensor(turbidity, dtype=torch.float64, device=angle.device)
    wavelength, ozone, matching = _tables(angle.device)
    mass = 1 / (angle.cos() + 0.15 * (93.885 - torch.rad2deg(angle)) ** -1.253)
    beta = 0.04608365822050 * haze - 0.04586025928522
    depth = 0.008735 * wavelength**-4.08 + beta[..., None] * wavelength**-1.3 + 0.35 * ozone
    xyz = torch.exp(-mass[..., None] * depth) @ matching
    return srgb_of_xyz(xyz).clamp(min=0).to(zenith_angle.dtype)


def srgb_of_xyz(xyz: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """Linear sRGB. Source: IEC 61966-2-1, white D65."""
    return xyz @ torch.tensor(_SRGB_OF_XYZ, dtype=xyz.dtype, device=xyz.device).T


@remembered(2)
def _tables() -> tuple[Tensor, Tensor, Tensor]:
    """Wavelengths in micrometres, ozone, and the XYZ of each step of the solar spectrum in 1000 cd / m^2."""
    solar, ozone = (torch.tensor([float(x) for x in t.split()], dtype=torch.float64) for t in (_SOLAR, _OZONE))
    wavelength = 380 + 10 * torch.arange(len(solar), dtype=torch.float64)
    matching = torch.stack([sum(_lobe(wavelength, *lobe) for lobe in lobes) for lobes in _MATCHING], dim=-1)
    return wavelength / 1000, ozone, matching * solar[:, None] * (10 * _EFFICACY / 1000)


def _lobe(wavelength: Tensor, height: float, centre: float, below: float, above: float) -> Tensor:
    offset = wavelength - centre
    return height * torch.exp(-0.5 * (offset * torch.where(offset < 0, below, above)) ** 2)
