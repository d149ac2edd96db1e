"""Random maps of lobes: there is no bake and no fit in them."""

import torch

from torchprt.transfer import Diffuse, Exit, Factored, Incident, Texels, Transfer, Zonal


def random_map(rows=6, columns=8, lobes=3, order=4, channels=1, exact=True, dtype=torch.float64, seed=0, **metadata):
    """A patch of `rows` x `columns` texels; `metadata` of its texels, of its lobes, or of the transfer."""
    make = torch.Generator().manual_seed(seed)

    def random(*shape):
        return torch.randn(*shape, rows, columns, generator=make, dtype=dtype).flatten(-2)

    signal = Zonal(
        axis=torch.nn.functional.normalize(random(1, lobes, 3), dim=2),
        coefficients=random(channels, 1, lobes, order - (2 if exact else 0)),
        exact=random(channels, 1, 4 if exact else 0),
        squared_error=random().square(),
        **{name: metadata.pop(name) for name in ("smooth", "fit_error") if name in metadata},
    )
    tiles = {name: metadata.pop(name) for name in ("tiles_u", "tiles_v") if name in metadata}
    albedo = torch.rand(3, rows, columns, generator=make, dtype=dtype).flatten(1).T.contiguous()
    return Transfer(
        receivers=Texels(rows=rows, columns=columns, **tiles),
        layers={"diffuse": Diffuse(albedo=albedo, signal=signal)},
        **metadata,
    )


def random_glossy_map(kind="exit", rows=6, columns=8, order=4, seed=0, **metadata):
    """The same with a glossy layer of `kind` besides, about the normals of a random relief."""
    make = torch.Generator().manual_seed(seed + 1)
    plain = random_map(rows, columns, order=order, seed=seed, **metadata)
    texels, count = plain.receivers, rows * columns
    tilt = 0.5 * torch.randn(count, 2, generator=make, dtype=torch.float64)
    normals = torch.nn.functional.normalize(torch.cat([tilt, torch.ones(count, 1)], 1), dim=1)
    along = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand(count, 3)
    tangents = torch.nn.functional.normalize(along - (along * normals).sum(1, keepdim=True) * normals, dim=1)
    each = [random_map(rows, columns, order=order, seed=seed + 10 * row + 2) for row in range(4)]
    signals = [one.layers["diffuse"].signal for one in each]
    signal = Zonal(
        axis=torch.cat([one.axis for one in signals]),
        coefficients=torch.cat([one.coefficients for one in signals], 1),
        exact=torch.cat([one.exact for one in signals], 1),
        squared_error=torch.zeros(count),
        smooth=signals[0].smooth if "smooth" not in metadata else metadata["smooth"],
    )
    common = {"signal": signal, "tangents": tangents, "specular": torch.tensor([[0.5]], dtype=torch.float64)}
    layers = {
        "exit": lambda: Exit(output_order=2, **common),
        "incident": lambda: Incident(**common),
        # Neither even nor odd.
        "factored": lambda: Factored(factors=torch.randn(4, 16, 16, generator=make, dtype=torch.float64), **common),
    }
    receivers = texels.replace(relief=normals)
    return Transfer(receivers=receivers, layers={**plain.layers, kind: layers[kind]()})
