"""Is the room closed but for its window, and do its charts lie on the map without meeting?"""

import numpy as np
import pytest
import torch

from torchprt.errors import InputError
from torchprt.scene import samples
from torchprt.scene.rasterise import rasterise
from torchprt.trace import Tracer


@pytest.mark.parametrize("options", [{"texels": 127}, {"gutter": -1}])
def test_refuses_maps_without_room(options):
    with pytest.raises(InputError, match="give at least 128, and 0"):
        samples.room(**options)


@pytest.mark.parametrize("gutter", [0, 2])
def test_charts_lie_apart_within_the_square(gutter):
    meshes = [each.mesh for each in samples.room(256, gutter).objects]
    uv = np.concatenate([mesh.uv.numpy() for mesh in meshes])
    assert uv.min() >= gutter / 256 - 1e-9
    assert uv.max() <= 1 - gutter / 256 + 1e-9
    found = rasterise(uv, np.zeros(len(uv), np.int64), 256, 256)
    assert found.twice == 0
    # Most of the map is used.
    assert len(found.texel) > 256**2 / 4


def test_light_comes_in_at_the_window_alone():
    room = samples.room(128)
    geometry = room.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    eye = torch.tensor([0.5, 1.5, 1.0], dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    toward = torch.nn.functional.normalize(torch.randn(20_000, 3, generator=generator, dtype=torch.float64), dim=-1)
    hits = tracer.camera(eye, toward[None])
    out = hits.triangle[0] < 0
    assert 0.02 < out.float().mean() < 0.1
    # Where those that leave cross the wall.
    place = eye + toward[out] * ((-2.3 - eye[0]) / toward[out][:, :1])
    assert bool((toward[out][:, 0] < 0).all())
    assert bool(((place[:, 2] > -1.7) & (place[:, 2] < 1.1) & (place[:, 1] > 0.75) & (place[:, 1] < 2.35)).all())
    # Nothing is seen from behind but through the opening of the vase.
    behind = geometry.face_object[hits.triangle[0][~out & ~hits.front[0]].long()].unique()
    assert {room.objects[int(each)].mesh.name for each in behind} <= {"vase"}
