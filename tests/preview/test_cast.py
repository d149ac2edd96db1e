"""Is what casts shown over what it casts on, where its path says?"""

import pytest
import torch
from neighbourhoods import ORDER, posed, slab, slab_around

from torchprt import InputError
from torchprt.preview import Cast, along, built_in_environment, frame, motions
from torchprt.scene import Material, Object, Scene, make_mesh
from torchprt.scene.samples import terrain
from torchprt.transport import bake

LAND = terrain(16, 3.0).objects[0].mesh
FLOOR = make_mesh(
    LAND.positions * torch.tensor([1.0, 0.2, 1.0]) - torch.tensor([0.0, 0.9, 0.0]), LAND.faces, name="floor"
)


@pytest.fixture(scope="module")
def environment():
    return built_in_environment("studio", ORDER)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize(("keys", "count"), [(torch.zeros(2, 5), 3), (torch.zeros(0, 6), 3), (torch.zeros(2, 6), 0)])
def test_refuses_a_path_that_is_none(keys, count):
    with pytest.raises(InputError, match="poses along keys"):
        along(keys, count)


def test_a_path_goes_through_its_keys_evenly():
    keys = torch.tensor([[0.0, 0, 0, 0, 0, 0], [1, 2, 0, 350, 0, 10], [2, 0, 1, 370, 20, 0]]).double()
    way = along(keys, 5)
    torch.testing.assert_close(way[::2], motions(keys))
    torch.testing.assert_close(along(keys[:1], 2), motions(keys[:1]).expand(2, 4, 4))
    straight = along(keys[:2], 3)
    torch.testing.assert_close(straight[1, :3, 3], torch.tensor([0.5, 1.0, 0.0]).double())


def test_orders_must_be_of_one_light(environment):
    other = bake(slab(), order=3, shadows=False)
    with pytest.raises(InputError, match="different orders"):
        Cast(slab_around(), FLOOR, environment, model=other)


def test_the_object_darkens_what_is_below_it_and_is_drawn(environment):
    camera = frame(FLOOR.positions, (0.0, 1.0, 0.01), aspect=1.0)
    options = {"camera": camera, "size": (40, 40), "albedo": 0.6}
    model = bake(slab(), order=ORDER, rays=32, progress=False)
    bare, drawn = (Cast(slab_around(), FLOOR, environment, model=each, **options) for each in (None, model))
    there, away = posed(at=(0.4, -0.3, 0.0))[None], posed(at=(50.0, 0.0, 0.0))[None]
    lit = bare.picture(away)
    shadow = lit - bare.picture(there)
    assert float(shadow.max()) > 0.05
    # To the right of the middle, where it is.
    assert float(shadow[:, 20:].mean()) > 1.5 * float(shadow[:, :20].mean())
    assert float((drawn.picture(there) - bare.picture(there)).abs().max()) > 0.05
    two = bare.picture(torch.cat([there, posed(at=(-0.4, -0.3, 0.0))[None]]))
    assert float((lit - two)[:, :20].mean()) > 2 * float(shadow[:, :20].mean())


def test_a_bake_shadows_itself_too(environment):
    scene = Scene([Object(LAND, Material(0.6))])
    land = bake(scene, order=ORDER, rays=64, progress=False)
    shown = Cast(slab_around(), land, environment, size=(24, 24))
    plain, under = (shown.radiance(posed(at=at)[None], shown.light) for at in ((50.0, 0.0, 0.0), (0.0, 0.9, 0.0)))
    torch.testing.assert_close(plain, shown.own(shown.light), rtol=0, atol=1e-5)
    assert float((plain - under).max()) > 0.05 * float(plain.mean())
    assert shown.picture(posed(at=(0.0, 0.9, 0.0))[None]).shape == (24, 24, 3)
