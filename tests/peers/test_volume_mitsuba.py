"""Is a volume seen as Mitsuba's volumetric path tracer sees it?"""

import math

import pytest
import torch

from tests import path_tracer
from torchprt import samples, sh
from torchprt.shade import VolumeShader
from torchprt.shade.rays import pinhole
from torchprt.transport import bake_volume

mi = pytest.importorskip("mitsuba", reason="compared with Mitsuba 3: install it")
EYE = torch.tensor([3.0, 1.2, 3.4], dtype=torch.float64)
SIZE, FIELD, PATHS = (16, 16), 22.0, 1024


@pytest.mark.parametrize("phase", [0.0, 0.85])
def test_a_cloud_under_a_positive_light(phase):
    missing = path_tracer.variant(mi)
    if missing:
        pytest.skip(missing)
    cloud, light = samples.cloud(24, phase=phase), path_tracer.positive_light()
    transfer = bake_volume(cloud, rays=1024, bounces=math.inf, progress=False)
    shader = VolumeShader(transfer, size=SIZE, field=FIELD, dtype=torch.float64)
    picture = shader(light, eye=EYE)
    directions = torch.nn.functional.normalize(pinhole(EYE, shader.target.double(), SIZE, FIELD), dim=-1)
    ours = picture[..., :3] + (1 - picture[..., 3:]) * (sh.basis(directions, 5) @ light)
    theirs, noise = path_tracer.through_volume(mi, cloud, light, EYE, directions.flatten(0, 1), PATHS)
    seen = picture[..., 3].flatten() > 0.01
    assert seen.sum() > 50
    difference = (ours.flatten(0, 1) - theirs)[seen]
    whole, off, chance = (each.square().mean().sqrt().item() for each in (theirs[seen], difference, noise[seen]))
    # The paths make 2 %, as they say of themselves; what is left is ours.
    assert off / whole < 0.03
    assert math.sqrt(max(off**2 - chance**2, 0)) / whole < 0.015
    assert abs(difference.mean().item()) / whole < 0.01
