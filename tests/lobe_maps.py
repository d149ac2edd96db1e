"""Random maps of lobes: there is no bake and no fit in them."""

import torch

from torchprt.transfer import Diffuse, Texels, Transfer, Zonal


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
