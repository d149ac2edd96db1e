"""Does light come through thin membranes?"""

import torch
from glossy_scenes import quiet
from shapes import square
from transfers import stored

from torchprt import brdf, sh
from torchprt.scene import Material, Object, Scene, load
from torchprt.transport import unshadowed

EPS = torch.finfo(torch.float32).eps


def test_membranes_let_the_light_behind_them_through():
    scene = load(square(1.0, 4), material=Material(0.5, translucency=0.3))
    transfer = quiet(scene, order=5, rays=512)
    normals = transfer.normals.double()
    vectors = sh.zonal(brdf.membrane(0.3, 5), normals).T
    assert transfer.vertices == 32
    # Nothing blocks either side: the sum of two closed forms.
    torch.testing.assert_close(stored(transfer)[0].double(), vectors, atol=512 * EPS, rtol=0)
    torch.testing.assert_close(stored(quiet(scene, order=5, shadows=False))[0].double(), vectors, atol=16 * EPS, rtol=0)
    assert float((vectors - unshadowed(normals, 5)).abs().max()) > 0.05


def test_light_bounces_through_membranes():
    """A membrane over a floor: what the floor gets of a light above comes through the sheet alone."""

    def reading(translucency):
        sheet = square(8.0, 9, height=0.2)
        objects = [
            Object(square(1.0, 3), Material(0.5)),
            Object(sheet, Material(0.5, two_sided=True, translucency=translucency)),
        ]
        transfer = quiet(Scene(objects), order=3, rays=512, bounces=4)
        above = sh.zonal(sh.phong(2.0, 3), torch.tensor([[0.0, 1, 0]], dtype=torch.float64))[0].float()
        return float((above @ stored(transfer)[0])[:9].mean())

    assert reading(0.6) > 3 * abs(reading(0.0))
