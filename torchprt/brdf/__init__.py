"""Reflectance: models, tables of measurements, their matrices in spherical harmonics, factors over views."""

from .check import check_energy as check_energy
from .check import directional_albedo as directional_albedo
from .check import reciprocity_error as reciprocity_error
from .matrix import brdf_matrix as brdf_matrix
from .matrix import exit_chain as exit_chain
from .matrix import exit_error as exit_error
from .matrix import exit_kernel as exit_kernel
from .models import GGX as GGX
from .models import BlinnPhong as BlinnPhong
from .models import Brdf as Brdf
from .models import Lambert as Lambert
from .models import Model as Model
from .models import Phong as Phong
from .models import Ward as Ward
from .parse import parse as parse

__all__ = [
    "GGX",
    "BlinnPhong",
    "Brdf",
    "Lambert",
    "Model",
    "Phong",
    "Ward",
    "brdf_matrix",
    "check_energy",
    "directional_albedo",
    "exit_chain",
    "exit_error",
    "exit_kernel",
    "parse",
    "reciprocity_error",
]
