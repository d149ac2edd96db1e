"""Spherical-harmonic algebra: basis, projection, rotation, convolution, windows, products.

Order n is the number of bands, n^2 coefficients; the sign and the axes are those of docs/conventions.md.
"""

from .basis import bands, basis, check_directions, evaluate, order_of
from .convention import from_e3nn, from_pyshtools, from_sign_free, to_e3nn, to_pyshtools, to_sign_free
from .hemisphere import hemisphere_error, hemisphere_gram, hemisphere_projection
from .hemisphere_basis import Projection, exit_count, exit_functions, hemisphere_basis, to_horizon
from .hemisphere_nodes import hemisphere_nodes
from .matrices import rotation_bands, rotation_matrix
from .product import gaunt, product, product_matrix
from .project import project_function, project_samples
from .quadrature import fibonacci, gauss_legendre, gauss_legendre_hemisphere, lebedev
from .rotate import Rotation, check_rotation, rotate, yaw_pitch_roll
from .texels import (
    cube_basis,
    cube_directions,
    cube_weights,
    latlong_basis,
    latlong_directions,
    latlong_weights,
    project_cube,
    project_latlong,
)
from .window import gauss, hann, lanczos, least_window, window
from .zonal import clamped_cosine, convolve, disc, phong, zonal

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
    "hemisphere_nodes",
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
