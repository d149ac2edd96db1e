"""Visibility for products on the fly: the constant tables, and what truncated visibility costs."""

from __future__ import annotations

import functools
import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf import Brdf, exit_kernel
from torchprt.sh import Projection, basis, gauss_legendre_hemisphere, hemisphere_basis
from torchprt.transport.directions import hemisphere
from torchprt.transport.glossy_tasks import GlossyJob
from torchprt.transport.rows import Recording

# Receivers whose matrices are compared.
_SAMPLE = 64


def on_the_fly(
    brdf: Brdf, recording: Recording, output_order: int, projection: Projection
) -> tuple[Float[Tensor, "M D"], int]:
    """The kernel of a material, weights included, at the nodes where visibility will meet the light, and their degree.

    The rule is exact for visibility times light times a kernel of twice the output order; `product_error` includes
    what it leaves.
    """
    degree = recording.output_order + recording.order + 2 * output_order - 4
    nodes, weights = gauss_legendre_hemisphere(max(degree, 0))
    return (exit_kernel(brdf, nodes, output_order, projection) * weights).to(torch.float32), max(degree, 0)


def product_error(
    task: GlossyJob, visibility: Float[Tensor, "G I"], degree: int, output_order: int, projection: Projection
) -> float | None:
    """Relative RMS of the exit radiance that the products give, against the matrices of the same rays: what truncated
    visibility costs, on some receivers, under white lights."""
    job, brdf, order = task.job, task.glossy.brdfs[0], task.job.order
    # Coefficients of an orthonormal basis have the norm of the function; others are as near as their Gram matrix.
    kernel = functools.partial(exit_kernel, brdf, order=output_order, projection=projection)
    if not len(visibility):
        return None
    some = torch.randperm(len(visibility), generator=torch.Generator().manual_seed(job.seed))[:_SAMPLE].sort().values
    directions = hemisphere(job.rays, job.seed)
    receivers = job.receivers[task.glossy.receivers[some]]
    escapes = job.tracer.visibility(receivers.origins, receivers.frames(), directions.float()).double()
    table = kernel(directions) * (2 * math.pi / len(directions))
    exact = (escapes[:, None] * table) @ basis(directions, order)
    nodes, weights = gauss_legendre_hemisphere(degree)
    seen = visibility[some].double() @ hemisphere_basis(nodes, task.recording.output_order).T
    found = (seen[:, None] * kernel(nodes) * weights) @ basis(nodes, order)
    size = float(exact.norm())
    return float((found - exact).norm()) / size if size > 0 else 0.0
