"""Random transfer with a layer that depends on the eye, of every kind, and what its shading is by definition."""

import dataclasses
import math

import torch

from torchprt import sh
from torchprt.brdf import sample_hemisphere_map
from torchprt.transfer import Dense, Diffuse, Exit, Factored, Incident, Transfer, Vertices, Visibility

KINDS = ("exit", "factored", "incident", "visibility")
TEXELS, FACTORS, DEGREE, VISIBILITY_ORDER = 32, 4, 8, 3


def random_glossy(
    kind="exit",
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
    """Transfer of a layer of `kind`, over a diffuse one, in which every receiver has its own place, frame and values;
    `glossy` of them are glossy. `metadata`: `materials` of the layer, all else of the transfer."""
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
    vertices_ = Vertices(
        positions=normal(vertices, 3), normals=normals.to(wide), faces=torch.zeros(0, 3, dtype=torch.int64)
    )
    colour = weight(*albedo, "V", vertices)
    common = {
        "receivers": chosen,
        "tangents": torch.nn.functional.normalize(tangents, dim=-1).to(wide),
        "specular": weight(*specular, "G", count),
        "materials": metadata.pop("materials", []),
    }
    layers = {}
    vectors = normal(channels, order**2, vertices if diffuse else 0).to(dtype)
    if diffuse:
        layers["diffuse"] = Diffuse(albedo=colour, signal=Dense(values=vectors))
    exits = {"output_order": output_order, "projection": projection}

    def matrices(rows):
        return Dense(values=normal(channels, count, rows, order**2).to(dtype))

    if kind == "visibility":
        nodes = (DEGREE // 2 + 1) * (DEGREE + 1)
        seen = Dense(values=normal(VISIBILITY_ORDER**2, count).to(dtype)[None])
        kernel = normal(sh.exit_count(output_order, projection), nodes) / math.sqrt(nodes)
        layers[kind] = Visibility(signal=seen, kernel=kernel, degree=DEGREE, light_order=order, **exits, **common)
    elif kind == "exit":
        layers[kind] = Exit(signal=matrices(sh.exit_count(output_order, projection)), **exits, **common)
    elif kind == "incident":
        layers[kind] = Incident(signal=matrices(output_order**2), **common)
    else:
        layers[kind] = Factored(signal=matrices(FACTORS), factors=normal(FACTORS, TEXELS, TEXELS), **common)
    return Transfer(receivers=vertices_, layers=layers, **metadata)


def gloss(transfer):
    """The layer that depends on the eye."""
    return list(transfer.layers.values())[-1]


def stored(transfer, layer=None):
    """What a dense layer stores, the last one unless another is named."""
    return (gloss(transfer) if layer is None else transfer.layers[layer]).signal.values


def replaced(transfer, layer=None, **changes):
    """The transfer with other fields: its own, those of its receivers, or those of a layer (the last one unless another
    is named) and of its signal."""
    name = list(transfer.layers)[-1] if layer is None else layer
    found = transfer.layers[name]
    own = {key: changes.pop(key) for key in list(changes) if key in transfer.provenance}
    place = {key: changes.pop(key) for key in list(changes) if key in vars(transfer.receivers)}
    # At once: receivers, layers and signals must fit each other whenever they are made.
    seen = {key: changes.pop(key) for key in list(changes) if key not in vars(found.signal)}
    layers = {**transfer.layers, name: found.replace(signal=found.signal.replace(**changes), **seen)}
    return dataclasses.replace(transfer, receivers=transfer.receivers.replace(**place), layers=layers, **own)


def same(one, other):
    """Whether two transfers have the same tensors, bit for bit, and the same in all other fields."""

    def parts(transfer):
        yield "", transfer.receivers
        for name, layer in transfer.layers.items():
            yield name, layer
            yield f"{name}.signal", layer.signal

    def equal(a, b):
        return a.dtype == b.dtype and torch.equal(a, b)

    return one.provenance == other.provenance and all(
        name == again
        and type(a) is type(b)
        and a.metadata() == b.metadata()
        and a.tensors().keys() == b.tensors().keys()
        and all(equal(value, b.tensors()[each]) for each, value in a.tensors().items())
        for (name, a), (again, b) in zip(parts(one), parts(other), strict=True)
    )


def frame_of(transfer, g):
    """Rows tangent, normal x tangent, normal of the glossy receiver g, float64."""
    normal, tangent = transfer.normals[gloss(transfer).receivers[g]].double(), gloss(transfer).tangents[g].double()
    return torch.stack([tangent, torch.linalg.cross(normal, tangent), normal])


def looks_along(transfer, g, eye=None, view=None):
    """The local direction toward the eye, as it is defined, with the cases one after another."""
    toward = view.double() if eye is None else eye.double() - transfer.positions[gloss(transfer).receivers[g]].double()
    x, y, z = (frame_of(transfer, g) @ toward).tolist()
    z = max(z, 0.0)
    length = math.sqrt(x * x + y * y + z * z)
    return torch.tensor([x, y, z] if length > 0 else [0, 0, 1], dtype=torch.float64) / (length or 1)


def exit_row(transfer, direction, exponent=None):
    """What the rows of the matrix are weighted with for one direction, float64."""
    layer = gloss(transfer)
    if layer.kind == "incident":
        order = layer.output_order
        mirrored = direction * torch.tensor([-1.0, -1.0, 1.0])
        return sh.zonal(sh.phong(40.0 if exponent is None else float(exponent), order), mirrored)
    if layer.kind == "factored":
        return sample_hemisphere_map(layer.factors.double(), direction)
    return sh.exit_functions(direction, layer.output_order, layer.projection)


def matrix_of(transfer, g):
    """M_ij of the glossy receiver g, [C, M, N], float64."""
    layer = gloss(transfer)
    if layer.kind != "visibility":
        return layer.signal.values[:, g].double()
    nodes, _ = sh.gauss_legendre_hemisphere(layer.degree)
    seen = sh.hemisphere_basis(nodes, layer.visibility_order) @ layer.signal.values[0, :, g].double()
    world = nodes @ frame_of(transfer, g)
    return ((layer.kernel.double() * seen) @ sh.basis(world, transfer.order))[None]


def by_definition(transfer, light, eye=None, view=None, exponent=None):
    """Exit radiance [V, 3] under one light toward one eye, a receiver after the other, in float64."""
    light = light.double()
    radiance = torch.zeros(transfer.vertices, 3, dtype=torch.float64)
    if "diffuse" in transfer.layers:
        vectors = stored(transfer, "diffuse").double().expand(3, -1, -1)
        radiance += transfer.albedo.double() * torch.einsum("cnv,nc->vc", vectors, light)
    layer = gloss(transfer)
    specular = layer.specular.double().expand(len(layer.receivers), 3)
    for g in range(len(layer.receivers)):
        one = exponent if exponent is None or exponent.ndim == 0 else exponent[g]
        row = exit_row(transfer, looks_along(transfer, g, eye, view), one)
        sums = row @ (matrix_of(transfer, g) @ light.T[:, :, None]).expand(3, -1, 1)[..., 0].T
        radiance[layer.receivers[g]] += specular[g] * sums
    return radiance
