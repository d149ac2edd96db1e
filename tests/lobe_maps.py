"""Random maps of lobes: there is no bake and no fit in them."""

import torch

from torchprt.transfer import ZonalMap


def random_map(rows=6, columns=8, lobes=3, order=4, channels=1, exact=True, dtype=torch.float64, seed=0, **metadata):
    make = torch.Generator().manual_seed(seed)

    def random(*shape):
        return torch.randn(*shape, generator=make, dtype=dtype)

    axis = torch.nn.functional.normalize(random(lobes, 3, rows, columns), dim=1)
    return ZonalMap(
        axis=axis,
        coefficients=random(channels, lobes, order - (2 if exact else 0), rows, columns),
        exact=random(channels, 4 if exact else 0, rows, columns),
        albedo=torch.rand(3, rows, columns, generator=make, dtype=dtype),
        squared_error=random(rows, columns).square(),
        **metadata,
    )
