"""Does compression stay on the device of what it is given?

Nothing that it makes may lie on the default device: under another one, of which no value can be read, the result is the
same to the bit. A device that computes is not needed for that.
"""

import pytest
import torch
from lobe_maps import random_map
from transfers import random_glossy, same
from zonal_transfers import bumpy, random_zonal

from torchprt.compression import (
    clustered_pca,
    compress,
    decompress,
    fit,
    fit_bilinear,
    fit_lobes,
    make_coherent,
    quantise,
    reorder,
    vector_quantise,
)
from torchprt.shade import at_rest, lay, sample

GLOSSY = random_glossy("exit", vertices=40, glossy=30)
DATA = torch.randn(200, 9, generator=torch.Generator().manual_seed(1))
PACKED = clustered_pca(DATA, 3, 2)
COMPRESSED = compress(GLOSSY, clusters=3, components=2)
ON_A_MESH = compress(at_rest(random_zonal(side=4)), clusters=2, components=1)
POSITIONS, FACES = (part.clone() for part in bumpy(4, 0))
MAP = random_map()

CALLS = {
    "clustered_pca": lambda: clustered_pca(DATA, 3, 2),
    "vector_quantise": lambda: vector_quantise(DATA, 3),
    "quantise": lambda: quantise(DATA, PACKED),
    "make_coherent": lambda: make_coherent(DATA[:16], clustered_pca(DATA[:16], 2, 2), FACES),
    "fit_lobes": lambda: fit_lobes(DATA[:30, None, :9], lobes=2, restarts=2),
    "fit_lobes, smooth": lambda: fit_lobes(DATA[:16, None, :9], lobes=2, faces=FACES, smooth=True),
    "compress": lambda: compress(GLOSSY, clusters=3, components=2),
    "compress, bytes": lambda: compress(GLOSSY, clusters=3, components=2, bits=8),
    "compress, error": lambda: compress(GLOSSY, error=0.5),
    "decompress": lambda: decompress(COMPRESSED),
    "reorder": lambda: reorder(ON_A_MESH, 2),
    "fit": lambda: fit(GLOSSY, lobes=2),
    "at_rest": lambda: at_rest(fit(GLOSSY, lobes=1)),
    "fit_bilinear": lambda: fit_bilinear(DATA[:36].T.reshape(1, 9, 6, 6).double(), (3, 3), lobes=1, iterations=5),
    "lay": lambda: lay(MAP, POSITIONS.float(), FACES, POSITIONS[:, :2].float()),
    "sample": lambda: sample(MAP, POSITIONS[:, :2].float()),
}


@pytest.mark.parametrize("name", CALLS)
def test_nothing_is_made_on_another_device(name):
    here = CALLS[name]()
    with torch.device("meta"):
        there = CALLS[name]()
    assert equal(there, here)


def equal(value, wanted):
    if hasattr(wanted, "layers"):
        return same(value, wanted)
    if isinstance(wanted, torch.Tensor):
        return torch.equal(value, wanted)
    if isinstance(wanted, tuple):
        return all(equal(one, other) for one, other in zip(value, wanted, strict=True))
    fields = vars(wanted)
    assert fields
    return all(
        equal(getattr(value, name), field) if isinstance(field, torch.Tensor) else True
        for name, field in fields.items()
    )
