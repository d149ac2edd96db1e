"""Compression of transfer: clusters of points, each in an affine subspace of its own; lobes that rotate."""

from .bilinear import fit_bilinear as fit_bilinear
from .clusters import vector_quantise as vector_quantise
from .coherence import make_coherent as make_coherent
from .coherence import overdraw as overdraw
from .compress import compress as compress
from .cpca import ClusteredPca as ClusteredPca
from .cpca import clustered_pca as clustered_pca
from .expected_light import light_importance as light_importance
from .expected_light import natural_light_importance as natural_light_importance
from .lobes import Lobes as Lobes
from .lobes import fit_lobes as fit_lobes
from .quantise import QuantisedPca as QuantisedPca
from .quantise import quantise as quantise
from .reorder import reorder as reorder
from .single_lobe import linear_axis as linear_axis
from .single_lobe import lobe_coefficients as lobe_coefficients
from .superclusters import cluster_order as cluster_order
from .superclusters import superclusters as superclusters
from .transfer import decompress as decompress
from .zonal import fit as fit

__all__ = [
    "ClusteredPca",
    "Lobes",
    "QuantisedPca",
    "cluster_order",
    "clustered_pca",
    "compress",
    "decompress",
    "fit",
    "fit_bilinear",
    "fit_lobes",
    "light_importance",
    "linear_axis",
    "lobe_coefficients",
    "make_coherent",
    "natural_light_importance",
    "overdraw",
    "quantise",
    "reorder",
    "superclusters",
    "vector_quantise",
]
