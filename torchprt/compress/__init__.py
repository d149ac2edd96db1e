"""Compression of transfer: clusters of points, each in an affine subspace of its own."""

from .clusters import vector_quantise as vector_quantise
from .coherence import make_coherent as make_coherent
from .coherence import overdraw as overdraw
from .cpca import ClusteredPca as ClusteredPca
from .cpca import clustered_pca as clustered_pca
from .superclusters import cluster_order as cluster_order
from .superclusters import superclusters as superclusters

__all__ = [
    "ClusteredPca",
    "cluster_order",
    "clustered_pca",
    "make_coherent",
    "overdraw",
    "superclusters",
    "vector_quantise",
]
