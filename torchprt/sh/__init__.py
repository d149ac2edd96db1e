"""Spherical-harmonic algebra: basis, projection, rotation, convolution, windows, products."""

from .basis import bands as bands
from .basis import basis as basis
from .basis import check_directions as check_directions
from .basis import evaluate as evaluate
from .basis import order_of as order_of
from .quadrature import fibonacci as fibonacci
from .quadrature import gauss_legendre as gauss_legendre
from .quadrature import lebedev as lebedev
from .rotate import Rotation as Rotation
from .rotate import check_rotation as check_rotation
from .rotate import rotate as rotate
from .rotate import yaw_pitch_roll as yaw_pitch_roll
from .zonal import clamped_cosine as clamped_cosine
