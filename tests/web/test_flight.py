"""Does an object that flies over the model of a page cast the shadow that Python computes?"""

import numpy as np
import pytest
import torch
from jaxtyping import config
from neighbourhoods import ORDER, posed, slab, slab_around
from web.conftest import at

from torchprt import InputError, bake, sh, web
from torchprt.scene import Material, Object, Scene, samples
from torchprt.shade import NeighbourhoodShader, by_ratio, shader
from torchprt.web.flight import Flight

POSES = torch.stack([posed(at=(-0.6, 0.9, 0.0)), posed(at=(0.6, 0.8, 0.2), turn=(40.0, 0.0, 0.0))])


@pytest.fixture(scope="module")
def land():
    mesh = samples.terrain(12, 3.0).objects[0].mesh
    return bake(Scene([Object(mesh, Material((0.6, 0.5, 0.3)))]), order=ORDER, rays=32, progress=False)


@pytest.fixture(scope="module")
def model():
    return bake(slab(), order=ORDER, rays=32, progress=False)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"order": 3}, "of order 4, the page of 3"),
        ({"poses": POSES[:0]}, "finite ones"),
        ({"neighbourhood": "land"}, "not around an object"),
    ],
)
def test_refuses_what_cannot_fly(wrong, words, land, model):
    given = {"neighbourhood": slab_around(), "model": model, "poses": POSES} | wrong
    order = given.pop("order", ORDER)
    given["neighbourhood"] = land if given["neighbourhood"] == "land" else given["neighbourhood"]
    with pytest.raises(InputError, match=words):
        Flight(**given).check(order)


def test_its_shadow_is_that_of_python_and_it_flies_when_asked_to(visit, libraries, land, model, tmp_path):
    config.update("jaxtyping_disable", True)
    try:
        flight = Flight(slab_around(), model, POSES, seconds=2.0)
        web.export(land, tmp_path / "site" / "page", flight=flight, exact=True, check=False)
    finally:
        config.update("jaxtyping_disable", False)
    with at(tmp_path / "site") as root:
        tab = visit().open(f"{root}/page/")
        assert not tab.page.is_checked("#flying")
        tab.ask("await it.flyTo(1);")
        radiance = torch.tensor(tab.radiance()).view(-1, 3)
        light, turn = (
            torch.tensor(tab.ask(f"return Array.from(it.{name});"), dtype=torch.float32)
            for name in ("shining", "rotation")
        )
        lit = sh.rotate(light.view(-1, 3), turn.view(3, 3))
        given = {"positions": land.positions.float(), "normals": land.normals, "pose": POSES[1]}
        plain, change = NeighbourhoodShader(slab_around()).parts(lit, **given)
        wanted = shader(land)(lit) * by_ratio([(plain, change)]) / plain
        np.testing.assert_allclose(radiance, wanted, rtol=0, atol=2e-4 * float(wanted.abs().max()))
        assert float((radiance - shader(land)(lit)).abs().max()) > 0.02 * float(wanted.max())
        tab.page.check("#flying")
        tab.page.wait_for_function("() => window.torchprt.flight.moment > 0.05 && window.torchprt.flight.moment < 0.95")
        tab.page.uncheck("#flying")
        assert tab.complaints == []
        tab.page.click("#modes label:nth-child(2)")
        tab.settled()
        assert tab.ask("return it.view.objectShown;") is False
