"""Reflectance: models, tables of measurements, their matrices in spherical harmonics, factors over views."""

from .check import check_energy as check_energy
from .check import directional_albedo as directional_albedo
from .check import reciprocity_error as reciprocity_error
from .factor import Factors as Factors
from .factor import factor as factor
from .factor import hemisphere_map as hemisphere_map
from .factor import sample_hemisphere_map as sample_hemisphere_map
from .matrix import brdf_matrix as brdf_matrix
from .matrix import exit_chain as exit_chain
from .matrix import exit_error as exit_error
from .matrix import exit_kernel as exit_kernel
from .membrane import membrane as membrane
from .models import GGX as GGX
from .models import BlinnPhong as BlinnPhong
from .models import Brdf as Brdf
from .models import Lambert as Lambert
from .models import Model as Model
from .models import Phong as Phong
from .models import Ward as Ward
from .parse import parse as parse
from .tabulated import Measured as Measured
from .tabulated import Tabulated as Tabulated

__all__ = [
    "GGX",
    "BlinnPhong",
    "Brdf",
    "Factors",
    "Lambert",
    "Measured",
    "Model",
    "Phong",
    "Tabulated",
    "Ward",
    "brdf_matrix",
    "check_energy",
    "directional_albedo",
    "exit_chain",
    "exit_error",
    "exit_kernel",
    "factor",
    "hemisphere_map",
    "membrane",
    "parse",
    "reciprocity_error",
    "sample_hemisphere_map",
]
