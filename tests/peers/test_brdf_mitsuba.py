"""Does a renderer that no one here wrote evaluate the same microfacets? (It has no Phong and no Ward.)"""

import numpy as np
import pytest
import torch
from path_tracer import variant

from torchprt.brdf import GGX, Lambert

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")


@pytest.fixture(scope="module")
def mitsuba():
    if fault := variant(mi):
        pytest.skip(fault)
    return mi


def pairs(count=2000):
    directions = torch.randn(2, count, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    directions[..., 2] = directions[..., 2].abs() + 0.02
    # Half of the lights near the mirror direction, where narrow lobes are.
    view, light = torch.nn.functional.normalize(directions, dim=-1)
    near = view * torch.tensor([-1.0, -1.0, 1.0]) + 0.1 * directions[1]
    light[::2] = torch.nn.functional.normalize(near, dim=-1)[::2]
    return view.float(), torch.nn.functional.normalize(light, dim=-1).float()


def evaluated(mi, description, view, light):
    """f times the cosine, from Mitsuba."""
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = mi.Vector3f(*(mi.Float(np.ascontiguousarray(part)) for part in view.numpy().T))
    interaction.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    outward = mi.Vector3f(*(mi.Float(np.ascontiguousarray(part)) for part in light.numpy().T))
    value = mi.load_dict(description).eval(mi.BSDFContext(), interaction, outward)
    return torch.from_numpy(np.array(value))[0]


@pytest.mark.parametrize("roughness", [0.05, 0.1, 0.3, 0.5, 1.0])
def test_ggx_is_a_rough_conductor_without_absorption(mitsuba, roughness):
    view, light = pairs()
    description = {
        "type": "roughconductor", "distribution": "ggx", "alpha": roughness, "material": "none", "sample_visible": True,
    }  # fmt: skip
    theirs = evaluated(mitsuba, description, view, light).double()
    ours = (GGX(roughness)(view.double(), light.double()) * light[:, 2].double()).double()
    # Theirs is float32; at roughness .05 the slope of a facet is divided by it and squared twice.
    tolerance = 32 / roughness**2 * torch.finfo(torch.float32).eps
    torch.testing.assert_close(theirs, ours, rtol=tolerance, atol=1e-6)


def test_lambert_is_their_white_diffuse(mitsuba):
    view, light = pairs()
    theirs = evaluated(mitsuba, {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}, view, light)
    torch.testing.assert_close(theirs, Lambert()(view, light) * light[:, 2], rtol=1e-6, atol=0)
