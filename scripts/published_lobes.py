"""Figures of Sloan, Luna and Snyder 2005 beside ours."""

import torch

from torchprt import sh
from torchprt.compression import fit_lobes, lobe_coefficients
from torchprt.measure import Table


def random_vectors() -> Table:
    """Figure 2: one random vector of unit length, which is not known; here the range and the median of 24."""
    generator = torch.Generator().manual_seed(0)
    vectors = torch.randn(24, 1, 36, generator=generator, dtype=torch.float64)
    vectors = vectors / vectors.norm(dim=2, keepdim=True)
    table = Table("zonal lobes of random 36-vectors (Sloan, Luna and Snyder 2005, figure 2), RMS error")
    for lobes, published in ((1, 0.751), (2, 0.517), (4, 0.116), (6, 0.00908)):
        error = fit_lobes(vectors, lobes, restarts=48).error.sqrt()
        ours = f"{error.min():.3g} - {error.max():.3g}, median {error.median():.3g}"
        table.add(f"{lobes} lobes", extra={"published": published, "torchprt": ours})
    return table


def membrane(alpha: float = 0.3, order: int = 8) -> Table:
    """Equations 22 and 23: two cosines, by equation 18 from their projection; over pi."""
    nodes, weights = sh.gauss_legendre(2000)
    z = nodes[:, 2]
    function = torch.where(z >= 0, z, -alpha * z) * weights / torch.pi
    found = lobe_coefficients(function @ sh.basis(nodes, order), torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))
    published = (1.3, 0.466667, 0.325, 0, -0.0541667, 0, 0.0203125, 0)
    table = Table(f"thin membrane of translucency {alpha} (equation 23): coefficients g* / pi")
    for l, known in enumerate(published):
        table.add(f"band {l}", extra={"published": known, "torchprt": f"{float(found[l]):.6f}"})
    return table


def rotation_counts() -> Table:
    """Section 3.4: multiplications of the zxzxz rotation."""
    table = Table("multiplications that turn a vector of SH coefficients (section 3.4)")
    for order, published in zip(range(3, 10), (53, 121, 217, 345, 509, 713, 961), strict=True):
        closed = (2 * order**3 + 18 * order**2 + 4 * order - 69) // 3
        table.add(f"order {order}", extra={"published": published, "closed form": closed})
    return table


LOBES = (random_vectors, membrane, rotation_counts)
