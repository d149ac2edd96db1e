"""Does a page composite a volume in the browser as torch does?"""

import json

import numpy as np
import pytest
import torch
from jaxtyping import config
from volumes import puff, seeing_all
from web.conftest import at
from web.test_page import pixels

from torchprt import web
from torchprt.errors import InputError
from torchprt.preview import Camera, Environment, VolumeStudio
from torchprt.preview.environment import built_in_environment
from torchprt.transfer import Dense, Phase
from torchprt.web.volume import box, save_volume

GROUND = np.array([0x0D, 0x0E, 0x11])


@pytest.fixture(scope="module")
def cloud():
    """A phase function, cells of colours of their own."""
    cells = puff(14)
    even = seeing_all(cells, order=4).layers["diffuse"]
    values = torch.zeros(1, cells.count, 4, 16)
    values[0, :, 0] = even.signal.values[0].T * (4 * torch.pi) ** 0.5
    values[0, :, 1:, 1:4] = 0.8 * torch.eye(3)
    albedo = 0.3 + 0.6 * torch.rand(cells.count, 3, generator=torch.Generator().manual_seed(4))
    layer = Phase(signal=Dense(values=values), albedo=albedo, moments=[1.0, 0.4])
    made = seeing_all(cells, order=4)
    return made.__class__(receivers=cells, layers={"phase": layer})


@pytest.fixture(scope="module")
def folder(libraries, cloud, tmp_path_factory):
    made = tmp_path_factory.mktemp("site") / "cloud"
    lights = [built_in_environment("studio", 4), Environment("dark", torch.zeros(16, 3), torch.zeros(8, 16, 3))]
    config.update("jaxtyping_disable", True)
    web.export(cloud, made, environments=lights, title="A cloud", check=False)
    config.update("jaxtyping_disable", False)
    return made


@pytest.mark.usefixtures("untyped")
def test_nothing_flies_over_a_volume(cloud, tmp_path):
    with pytest.raises(InputError, match="nothing flies"):
        web.export(cloud, tmp_path / "page", flight=object())


def test_the_file_holds_every_cell_at_its_place(cloud, tmp_path):
    import gzip

    about = save_volume(cloud.receivers, tmp_path)
    content = gzip.decompress((tmp_path / "volume.bin.gz").read_bytes())
    count = cloud.vertices
    number, extinction = np.frombuffer(content, "<i4", count), np.frombuffer(content, "<f4", count, 4 * count)
    places = np.stack(np.unravel_index(number, about["shape"]), -1)
    middles = np.array(about["corner"]) + (places + 0.5) * about["spacing"]
    np.testing.assert_allclose(middles, cloud.positions, atol=1e-6)
    np.testing.assert_array_equal(extinction, cloud.receivers.extinction)
    # An empty cell all around, in whose middle the box ends.
    assert places.min() == 1
    assert (places.max(0) == np.array(about["shape"]) - 2).all()
    corners, normals, faces = box(cloud.receivers)
    np.testing.assert_allclose(corners[0], np.array(about["corner"]) + np.array(about["spacing"]) / 2, atol=1e-6)
    a, b, c = corners[faces.long()].unbind(1)
    assert bool(((torch.linalg.cross(b - a, c - a) * normals[faces.long()].sum(1)).sum(-1) > 0).all())


def test_the_picture_is_that_of_torch_and_follows_light_and_eye(visit, folder, cloud):
    with at(folder.parent) as root:
        tab = visit().open(f"{root}/cloud/")
        assert tab.complaints == []
        assert tab.page.locator("#modes input").count() == 1
        tab.page.click("#background")
        studio = built_in_environment("studio", 4)
        light = torch.tensor(json.loads((folder / "scene.json").read_text())["environments"][0]["coefficients"])
        pictures = []
        for drag in (None, (90, 40)):
            if drag is not None:
                tab.drag(*drag)
                tab.drag(-50, 0, button="right")
            tab.settled()
            told = tab.ask(
                "return {eye: it.view.eye.toArray(), target: it.view.target.toArray(), fov: it.view.camera.fov,"
                " exposure: it.exposure, rotation: it.rotation};"
            )
            shown = pixels(tab)
            height, width, _ = shown.shape
            environment = Environment("studio", light, studio.image)
            options = {
                "size": (width, height),
                "samples": 1,
                "background": "transparent",
                "exposure": float(told["exposure"]),
            }
            made = VolumeStudio(cloud, environment, **options)
            eye, target = (tuple(map(float, told[name])) for name in ("eye", "target"))
            camera = Camera(eye, target, field=float(told["fov"]))
            cut = made.picture(camera, torch.tensor(told["rotation"], dtype=torch.float32).view(3, 3)).numpy()
            wanted = 255 * cut[..., :3] * cut[..., 3:] + GROUND * (1 - cut[..., 3:])
            apart = shown - wanted
            assert (cut[..., 3] > 0.5).sum() > 5000
            assert np.sqrt((apart**2).mean()) < 1.0
            assert np.abs(apart).max() < 8
            pictures.append(shown.astype(float))
        assert np.abs(pictures[0] - pictures[1]).max() > 10
        # Inside of it nothing breaks.
        tab.ask("it.view.distance = 0.05; await it.change();")
        assert tab.complaints == []
