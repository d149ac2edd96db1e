"""Compression of transfer: clusters of points, each in an affine subspace of its own; lobes that rotate."""

from .bilinear import fit_bilinear
from .clusters import vector_quantise
from .coherence import make_coherent, overdraw
from .compress import compress, foretell
from .cpca import ClusteredPca, clustered_pca
from .expected_light import light_importance, natural_light_importance
from .lobes import Lobes, fit_lobes
from .quantise import QuantisedPca, quantise
from .reorder import reorder
from .sampled import SampledWarning
from .single_lobe import linear_axis, lobe_coefficients
from .superclusters import cluster_order, superclusters
from .transfer import decompress
from .zonal import fit

__all__ = [
    "ClusteredPca",
    "Lobes",
    "QuantisedPca",
    "SampledWarning",
    "cluster_order",
    "clustered_pca",
    "compress",
    "decompress",
    "fit",
    "fit_bilinear",
    "fit_lobes",
    "foretell",
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
