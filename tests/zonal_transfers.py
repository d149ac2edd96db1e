"""Random zonal transfer, and what its shading is by definition."""

import dataclasses
import math

import torch
from torch.nn.functional import normalize

from torchprt import sh
from torchprt.sh import yaw_pitch_roll
from torchprt.transfer import Dense, Diffuse, Factored, Transfer, Vertices, Zonal


def random_zonal(
    side=3, lobes=4, order=4, channels=1, exact=True, albedo=("V", 3), dtype=torch.float32, seed=0, **metadata
):
    """Zonal transfer on a bumpy square grid of `side`^2 vertices, in which every receiver has its own lobes."""
    generator = torch.Generator().manual_seed(seed)
    wide = dtype if dtype == torch.float64 else torch.float32
    vertices = side * side

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    positions, faces = bumpy(side, seed)
    rows = vertices if albedo[0] == "V" else albedo[0]
    bands = order - 2 if exact else order
    signal = Zonal(
        axis=normalize(normal(lobes, 3, vertices), dim=1).to(dtype)[None],
        coefficients=normal(channels, lobes, bands, vertices).to(dtype)[:, None],
        exact=normal(channels, 4 if exact else 0, vertices).to(dtype)[:, None],
        squared_error=torch.rand(vertices, generator=generator, dtype=wide),
        **{name: metadata.pop(name) for name in ("smooth", "fit_error") if name in metadata},
    )
    albedo_ = 0.1 + 0.8 * torch.rand(rows, albedo[1], generator=generator, dtype=wide)
    normals = normalize(normal(vertices, 3), dim=1).to(wide)
    return Transfer(
        receivers=Vertices(positions=positions.to(wide), normals=normals, faces=faces),
        layers={"diffuse": Diffuse(albedo=albedo_, signal=signal)},
        **metadata,
    )


def random_zonal_factored(
    vertices=9,
    glossy=4,
    rows=2,
    lobes=3,
    order=4,
    channels=1,
    exact=True,
    diffuse=True,
    dtype=torch.float32,
    seed=0,
    specular=("G", 3),
    **metadata,
):
    """Rows of a factored BRDF in lobes, and a diffuse layer in two; on the square of `random_zonal`."""
    generator = torch.Generator().manual_seed(seed)
    wide = dtype if dtype == torch.float64 else torch.float32
    plain = random_zonal(math.isqrt(vertices), lobes=2, order=order, channels=channels, dtype=dtype, seed=seed)
    many = [
        random_zonal(math.isqrt(vertices), lobes, order, channels, exact, dtype=dtype, seed=seed + row + 1)
        for row in range(rows)
    ]
    chosen = torch.randperm(vertices, generator=generator)[:glossy].sort().values
    across = torch.randn(glossy, 3, generator=generator, dtype=torch.float64)
    parts = [one.layers["diffuse"].signal for one in many]
    tangents = normalize(torch.linalg.cross(plain.normals[chosen].double(), across), dim=1).to(wide)
    weights = torch.rand(glossy if specular[0] == "G" else 1, specular[1], generator=generator).to(wide)
    signal = Zonal(
        axis=torch.cat([one.axis for one in parts])[..., :glossy].contiguous(),
        coefficients=torch.cat([one.coefficients for one in parts], 1)[..., :glossy].contiguous(),
        exact=torch.cat([one.exact for one in parts], 1)[..., :glossy].contiguous(),
        squared_error=torch.zeros(glossy),
        **{name: metadata.pop(name) for name in ("smooth", "fit_error") if name in metadata},
    )
    layer = Factored(
        signal=signal,
        factors=torch.randn(rows, 32, 32, generator=generator, dtype=torch.float64).to(wide),
        receivers=chosen,
        tangents=tangents,
        specular=0.1 + 0.8 * weights,
        materials=metadata.pop("materials", []),
    )
    layers = {**plain.layers, "factored": layer} if diffuse else {"factored": layer}
    return Transfer(receivers=plain.receivers, layers=layers, **metadata)


def bumpy(side, seed=0):
    """Positions [side^2, 3] in float64 and faces of a square that is neither flat nor regular, facing +y."""
    generator = torch.Generator().manual_seed(seed)
    ticks = torch.linspace(-1, 1, side, dtype=torch.float64)
    x, z = torch.meshgrid(ticks, ticks, indexing="ij")
    flat = torch.stack([x, torch.zeros_like(x), z], -1).reshape(-1, 3)
    bumps = torch.rand(side * side, 3, generator=generator, dtype=torch.float64) - 0.5
    corner = (torch.arange(max(side - 1, 0))[:, None] * side + torch.arange(max(side - 1, 0))).reshape(-1)
    a, b, c, d = corner, corner + 1, corner + side + 1, corner + side
    faces = torch.cat([torch.stack([a, b, c], -1), torch.stack([a, c, d], -1)])
    return flat + bumps * (0.6 / max(side, 1)), faces


def turns(*batch, dtype=torch.float32, seed=0):
    """Random rotations [*batch, 3, 3]."""
    degrees = 360 * torch.rand(*batch, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return yaw_pitch_roll(degrees).to(dtype)


def vectors_by_definition(transfer, frames=None, layer="diffuse", row=0):
    """Transfer vectors [C, N, G] of a row of a layer in float64, a receiver and a lobe after the other; `frames`
    [G, 3, 3]."""
    signal = transfer.layers[layer].signal
    order, first = signal.order, 2 if signal.exact.shape[2] else 0
    receivers, channels, _, _ = signal.shape
    band = sh.bands(order)
    vectors = torch.zeros(channels, order**2, receivers, dtype=torch.float64)
    for v in range(receivers):
        turn = torch.eye(3, dtype=torch.float64) if frames is None else frames[v].double()
        for k in range(signal.lobes):
            values = sh.basis(turn @ signal.axis[row, k, :, v].double(), order)
            weights = torch.zeros(channels, order, dtype=torch.float64)
            weights[:, first:] = signal.coefficients[:, row, k, :, v].double()
            vectors[:, :, v] += values * weights[:, band]
        if first:
            low = sh.rotate(signal.exact[:, row, :, v].double().T, turn).T
            vectors[:, :4, v] += low
    return vectors


def turned_by_hand(transfer, frames, positions):
    """Dense transfer of one pose, `frames` [V, 3, 3]: every receiver turned by its frame, lobe by lobe, in float64."""
    normals = (frames @ transfer.normals.to(frames)[..., None])[..., 0]
    layers = {}
    for name, layer in transfer.layers.items():
        own = frames[layer.index(transfer.vertices)]
        rows = [vectors_by_definition(transfer, own, name, row) for row in range(layer.signal.shape[2])]
        changes = {"signal": Dense(values=torch.stack(rows).permute(1, 3, 0, 2))}
        if "tangents" in layer.layouts:
            changes["tangents"] = (own @ layer.tangents.to(own)[..., None])[..., 0]
        layers[name] = layer.replace(**changes)
    receivers = transfer.receivers.replace(positions=positions, normals=normals)
    return dataclasses.replace(transfer, receivers=receivers, layers=layers)


def by_definition(transfer, light, frames=None):
    """Exit radiance [V, 3] under one light in one pose, in float64."""
    vectors = vectors_by_definition(transfer, frames).expand(3, -1, -1)
    return transfer.albedo.double() * torch.einsum("cnv,nc->vc", vectors, light.double())
