"""Spherical-harmonic algebra: basis, projection, rotation, convolution, windows, products.

Order n is the number of bands, n^2 coefficients; the sign and the axes are those of docs/conventions.md.
"""

from .basis import bands as bands
from .basis import basis as basis
from .basis import check_directions as check_directions
from .basis import evaluate as evaluate
from .basis import order_of as order_of
from .convention import from_e3nn as from_e3nn
from .convention import from_pyshtools as from_pyshtools
from .convention import from_sign_free as from_sign_free
from .convention import to_e3nn as to_e3nn
from .convention import to_pyshtools as to_pyshtools
from .convention import to_sign_free as to_sign_free
from .hemisphere import hemisphere_error as hemisphere_error
from .hemisphere import hemisphere_gram as hemisphere_gram
from .hemisphere import hemisphere_projection as hemisphere_projection
from .hemisphere_basis import Projection as Projection
from .hemisphere_basis import exit_count as exit_count
from .hemisphere_basis import exit_functions as exit_functions
from .hemisphere_basis import hemisphere_basis as hemisphere_basis
from .hemisphere_basis import to_horizon as to_horizon
from .matrices import rotation_bands as rotation_bands
from .matrices import rotation_matrix as rotation_matrix
from .product import gaunt as gaunt
from .product import product as product
from .product import product_matrix as product_matrix
from .project import project_function as project_function
from .project import project_samples as project_samples
from .quadrature import fibonacci as fibonacci
from .quadrature import gauss_legendre as gauss_legendre
from .quadrature import gauss_legendre_hemisphere as gauss_legendre_hemisphere
from .quadrature import lebedev as lebedev
from .rotate import Rotation as Rotation
from .rotate import check_rotation as check_rotation
from .rotate import rotate as rotate
from .rotate import yaw_pitch_roll as yaw_pitch_roll
from .texels import cube_basis as cube_basis
from .texels import cube_directions as cube_directions
from .texels import cube_weights as cube_weights
from .texels import latlong_basis as latlong_basis
from .texels import latlong_directions as latlong_directions
from .texels import latlong_weights as latlong_weights
from .texels import project_cube as project_cube
from .texels import project_latlong as project_latlong
from .window import gauss as gauss
from .window import hann as hann
from .window import lanczos as lanczos
from .window import least_window as least_window
from .window import window as window
from .zonal import clamped_cosine as clamped_cosine
from .zonal import convolve as convolve
from .zonal import disc as disc
from .zonal import phong as phong
from .zonal import zonal as zonal

__all__ = [
    "Projection",
    "Rotation",
    "bands",
    "basis",
    "check_directions",
    "check_rotation",
    "clamped_cosine",
    "convolve",
    "cube_basis",
    "cube_directions",
    "cube_weights",
    "disc",
    "evaluate",
    "exit_count",
    "exit_functions",
    "fibonacci",
    "from_e3nn",
    "from_pyshtools",
    "from_sign_free",
    "gaunt",
    "gauss",
    "gauss_legendre",
    "gauss_legendre_hemisphere",
    "hann",
    "hemisphere_basis",
    "hemisphere_error",
    "hemisphere_gram",
    "hemisphere_projection",
    "lanczos",
    "latlong_basis",
    "latlong_directions",
    "latlong_weights",
    "least_window",
    "lebedev",
    "order_of",
    "phong",
    "product",
    "product_matrix",
    "project_cube",
    "project_function",
    "project_latlong",
    "project_samples",
    "rotate",
    "rotation_bands",
    "rotation_matrix",
    "to_e3nn",
    "to_horizon",
    "to_pyshtools",
    "to_sign_free",
    "window",
    "yaw_pitch_roll",
    "zonal",
]
