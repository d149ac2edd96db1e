"""Transfer of every layer with every signal that it can have, small, and what its shader is called with."""

import torch
from transfers import KINDS, random_glossy
from volumes import random_volume
from zonal_transfers import random_zonal, random_zonal_factored, turns

from torchprt.compression import compress
from torchprt.transfer import Exit, Incident

ORDER = 4


def every_transfer(dtype=torch.float32):
    """By name: each layer, dense, clustered and in lobes, in one channel and in three, over a diffuse one."""
    made = {}
    for channels in (1, 3):
        for kind in KINDS:
            dense = random_glossy(kind, vertices=12, glossy=9, channels=channels, dtype=dtype)
            made[f"{kind} dense {channels}"] = dense
            made[f"{kind} clustered {channels}"] = compress(dense, clusters=2, components=2)
        made[f"diffuse zonal {channels}"] = random_zonal(channels=channels, dtype=dtype)
        made[f"factored zonal {channels}"] = random_zonal_factored(channels=channels, dtype=dtype)
        made[f"exit zonal {channels}"] = _in_lobes(Exit, channels, dtype, output_order=2)
        made[f"incident zonal {channels}"] = _in_lobes(Incident, channels, dtype)
    made["phase dense 1"] = random_volume("phase", dtype=dtype)
    made["phase clustered 3"] = compress(random_volume("phase", channels=3, dtype=dtype), clusters=2, components=2)
    return made


def _in_lobes(kind, channels, dtype, **fields):
    transfer = random_zonal_factored(rows=4, channels=channels, dtype=dtype)
    factored = transfer.layers["factored"]
    common = {name: getattr(factored, name) for name in ("signal", "receivers", "tangents", "specular")}
    below = {name: layer for name, layer in transfer.layers.items() if name != "factored"}
    return transfer.__class__(receivers=transfer.receivers, layers={**below, kind.kind: kind(**common, **fields)})


def asked(needs, vertices, *batch, dtype=torch.float32, seed=5):
    """What a shader that `needs` it is called with beside the light: views, and frames of one pose."""
    look = {}
    if "eye" in needs:
        generator = torch.Generator().manual_seed(seed)
        look["view"] = torch.randn(*batch, 3, generator=generator, dtype=torch.float64).to(dtype)
    if "pose" in needs:
        look["frames"] = turns(vertices, dtype=dtype)
    return look


def lights(*batch, dtype=torch.float32, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*batch, ORDER**2, 3, generator=generator, dtype=torch.float64).to(dtype)
