"""Random glossy transfer of every kind, and what its shading is by definition."""

import math

import torch

from torchprt import sh
from torchprt.brdf import sample_hemisphere_map
from torchprt.transfer import FactoredTransfer, GlossyTransfer, IncidentTransfer, VisibilityTransfer

KINDS = ("glossy", "factored", "incident", "visibility")
TEXELS, FACTORS, DEGREE, VISIBILITY_ORDER = 32, 4, 8, 3


def random_glossy(
    kind="glossy",
    vertices=7,
    glossy=None,
    order=4,
    output_order=3,
    channels=1,
    albedo=("V", 3),
    specular=("G", 3),
    projection="optimal",
    diffuse=True,
    dtype=torch.float32,
    seed=0,
    **metadata,
):
    """Transfer of `kind` in which every receiver has its own place, frame and values; `glossy` of them are glossy."""
    generator = torch.Generator().manual_seed(seed)
    wide = dtype if dtype == torch.float64 else torch.float32
    count = vertices if glossy is None else glossy

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(wide)

    def weight(rows, columns, letter, size):
        return 0.1 + 0.8 * torch.rand(size if rows == letter else rows, columns, generator=generator, dtype=wide)

    normals = torch.nn.functional.normalize(normal(vertices, 3).double(), dim=-1)
    chosen = torch.randperm(vertices, generator=generator)[:count].sort().values
    tangents = torch.linalg.cross(normals[chosen], normal(count, 3).double())
    common = {
        "positions": normal(vertices, 3),
        "normals": normals.to(wide),
        "faces": torch.zeros(0, 3, dtype=torch.int64),
        "albedo": weight(*albedo, "V", vertices),
        "glossy": chosen,
        "tangents": torch.nn.functional.normalize(tangents, dim=-1).to(wide),
        "specular": weight(*specular, "G", count),
        "diffuse": normal(channels, order**2, vertices if diffuse else 0).to(dtype),
        **metadata,
    }
    if kind == "visibility":
        nodes = (DEGREE // 2 + 1) * (DEGREE + 1)
        return VisibilityTransfer(
            **common,
            visibility=normal(VISIBILITY_ORDER**2, count).to(dtype),
            kernel=normal(sh.exit_count(output_order, projection), nodes) / math.sqrt(nodes),
            degree=DEGREE,
            output_order=output_order,
            projection=projection,
        )
    if kind == "glossy":
        matrix = normal(channels, count, sh.exit_count(output_order, projection), order**2).to(dtype)
        return GlossyTransfer(**common, matrix=matrix, output_order=output_order, projection=projection)
    if kind == "incident":
        return IncidentTransfer(**common, matrix=normal(channels, count, output_order**2, order**2).to(dtype))
    return FactoredTransfer(
        **common,
        matrix=normal(channels, count, FACTORS, order**2).to(dtype),
        factors=normal(FACTORS, TEXELS, TEXELS),
    )


def frame_of(transfer, g):
    """Rows tangent, normal x tangent, normal of the glossy receiver g, float64."""
    normal, tangent = transfer.normals[transfer.glossy[g]].double(), transfer.tangents[g].double()
    return torch.stack([tangent, torch.linalg.cross(normal, tangent), normal])


def looks_along(transfer, g, eye=None, view=None):
    """The local direction toward the eye, as it is defined, with the cases one after another."""
    toward = view.double() if eye is None else eye.double() - transfer.positions[transfer.glossy[g]].double()
    x, y, z = (frame_of(transfer, g) @ toward).tolist()
    z = max(z, 0.0)
    length = math.sqrt(x * x + y * y + z * z)
    return torch.tensor([x, y, z] if length > 0 else [0, 0, 1], dtype=torch.float64) / (length or 1)


def exit_row(transfer, direction, exponent=None):
    """What the rows of the matrix are weighted with for one direction, float64."""
    if transfer.kind == "incident":
        order = transfer.output_order
        mirrored = direction * torch.tensor([-1.0, -1.0, 1.0])
        return sh.zonal(sh.phong(40.0 if exponent is None else float(exponent), order), mirrored)
    if transfer.kind == "factored":
        return sample_hemisphere_map(transfer.factors.double(), direction)
    return sh.exit_functions(direction, transfer.output_order, transfer.projection)


def matrix_of(transfer, g):
    """M_ij of the glossy receiver g, [C, M, N], float64."""
    if transfer.kind != "visibility":
        return transfer.matrix[:, g].double()
    nodes, _ = sh.gauss_legendre_hemisphere(transfer.degree)
    seen = sh.hemisphere_basis(nodes, transfer.visibility_order) @ transfer.visibility[:, g].double()
    world = nodes @ frame_of(transfer, g)
    return ((transfer.kernel.double() * seen) @ sh.basis(world, transfer.order))[None]


def by_definition(transfer, light, eye=None, view=None, exponent=None):
    """Exit radiance [V, 3] under one light toward one eye, a receiver after the other, in float64."""
    light = light.double()
    radiance = torch.zeros(transfer.vertices, 3, dtype=torch.float64)
    if transfer.diffuse.shape[2]:
        vectors = transfer.diffuse.double().expand(3, -1, -1)
        radiance += transfer.albedo.double() * torch.einsum("cnv,nc->vc", vectors, light)
    specular = transfer.specular.double().expand(len(transfer.glossy), 3)
    for g in range(len(transfer.glossy)):
        one = exponent if exponent is None or exponent.ndim == 0 else exponent[g]
        row = exit_row(transfer, looks_along(transfer, g, eye, view), one)
        sums = row @ (matrix_of(transfer, g) @ light.T[:, :, None]).expand(3, -1, 1)[..., 0].T
        radiance[transfer.glossy[g]] += specular[g] * sums
    return radiance
