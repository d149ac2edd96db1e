"""Compression of transfer: clusters of points, each in an affine subspace of its own."""

from .clusters import vector_quantise as vector_quantise
from .cpca import ClusteredPca as ClusteredPca
from .cpca import clustered_pca as clustered_pca

__all__ = ["ClusteredPca", "clustered_pca", "vector_quantise"]
