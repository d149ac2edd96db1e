"""Reflectance: models, tables of measurements, their matrices in spherical harmonics, factors over views."""

from .check import check_energy, directional_albedo, reciprocity_error
from .dipole import Dipole, dipole, fresnel_average
from .factor import Factors, factor, hemisphere_map, sample_hemisphere_map
from .matrix import brdf_matrix, exit_chain, exit_error, exit_kernel
from .membrane import membrane
from .models import GGX, BlinnPhong, Brdf, Lambert, Model, Phong, Ward
from .parse import parse
from .tabulated import Measured, Tabulated

__all__ = [
    "GGX",
    "BlinnPhong",
    "Brdf",
    "Dipole",
    "Factors",
    "Lambert",
    "Measured",
    "Model",
    "Phong",
    "Tabulated",
    "Ward",
    "brdf_matrix",
    "check_energy",
    "dipole",
    "directional_albedo",
    "exit_chain",
    "exit_error",
    "exit_kernel",
    "factor",
    "fresnel_average",
    "hemisphere_map",
    "membrane",
    "parse",
    "reciprocity_error",
    "sample_hemisphere_map",
]
