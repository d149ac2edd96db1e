"""Is the folder whole or not there, and are its mesh, graph and lights those of the bake?"""

import dataclasses
import gzip
import importlib
import json
import math
from types import SimpleNamespace

import numpy as np
import onnxruntime
import PIL.Image
import pytest
import torch
import trimesh
from transfers import random_glossy, replaced

from torchprt import onnx, sh
from torchprt.compression import compress, fit
from torchprt.errors import InputError
from torchprt.light import BUILT_IN, dominant, studio
from torchprt.preview.environment import Environment, automatic_exposure
from torchprt.shade import shader
from torchprt.transfer import Zonal
from torchprt.web import export, samples

EXPORT = importlib.import_module("torchprt.web.export")


@pytest.fixture(autouse=True)
def no_npm(tmp_path_factory, monkeypatch):
    """Libraries that are only names: nothing here runs them."""
    folder = tmp_path_factory.mktemp("libraries")
    for name in EXPORT.LOADED:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(name)
    monkeypatch.setattr(EXPORT, "libraries", lambda: folder)


@pytest.fixture
def no_graph(monkeypatch):
    """Graphs that are only files, where the subject is the folder."""

    def export(transfer, path, **_):
        path.write_bytes(b"a graph")
        return onnx.ExportReport(path, 7, 18, {}, {}, {}, None)

    monkeypatch.setattr(EXPORT, "onnx", SimpleNamespace(export=export, compare=lambda *_, **__: None))
    monkeypatch.setattr(EXPORT, "pack", lambda path: None)


@pytest.fixture
def lamps():
    return [Environment("Room", torch.ones(16, 3), studio(16))]


def session_of(path):
    """A graph of a page in ONNX Runtime."""
    return onnxruntime.InferenceSession(gzip.decompress(path.with_name(f"{path.name}.gz").read_bytes()))


def about(folder):
    return json.loads((folder / "scene.json").read_text())


def test_refuses_what_it_cannot_show_and_leaves_nothing(make_transfer, tmp_path, lamps):
    transfer = make_transfer()
    points = replaced(transfer, faces=torch.zeros(0, 3, dtype=torch.int64))
    other = replaced(transfer, positions=transfer.positions + 1)
    infinite = [Environment("Sun", torch.full((16, 3), math.inf), studio(16))]
    for words, bake, options in (
        ("loose points", points, {}),
        ("another bake", transfer, {"compressed": other}),
        ("another bake", transfer, {"compressed": transfer.to_order(2)}),
        ("one environment or more", transfer, {"environments": []}),
        ("has 16 coefficients: project it to order 5", make_transfer(order=5), {"environments": lamps}),
        ("not finite", transfer, {"environments": infinite}),
    ):
        with pytest.raises(InputError, match=words):
            export(bake, tmp_path / "page", **options)
    assert not list(tmp_path.iterdir())


def test_a_page_too_large_for_a_browser_is_refused_before_any_work(make_transfer, tmp_path, lamps, monkeypatch):
    monkeypatch.setattr(EXPORT, "LARGEST", 64)
    monkeypatch.setattr(EXPORT, "libraries", lambda: pytest.fail("work began"))
    with pytest.raises(InputError, match=r"unpacks to .* GB of weights, .*: compress the transfer"):
        export(make_transfer(), tmp_path / "page", environments=lamps)
    assert not (tmp_path / "page").exists()


def test_incident_transfer_needs_its_material_first(tmp_path, untyped):
    incident = random_glossy("incident", order=3, output_order=3)
    with pytest.raises(InputError, match="with_material"):
        export(replaced(incident, faces=torch.tensor([[0, 1, 2]])), tmp_path / "page")
    assert not list(tmp_path.iterdir())


def test_refuses_a_folder_that_holds_something_else(make_transfer, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"no page of torchprt"):
        export(make_transfer(), tmp_path / "mine")
    with pytest.raises(InputError, match="is a file"):
        export(make_transfer(), tmp_path / "file")
    assert [entry.name for entry in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


def test_the_folder_holds_the_bake(make_transfer, tmp_path, untyped, lamps):
    transfer = make_transfer()
    transfer.normals[3] = 0
    report = export(
        transfer, tmp_path / "new" / "page", environments=lamps, title='Quotes " & <tags>', exact=True, check=False
    )
    folder = report.folder
    assert report.bytes == sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    assert report.environments == ("Room",)
    said = about(folder)
    assert said["title"] == 'Quotes " & <tags>'
    assert (said["vertices"], said["order"], said["bytes"], said["glossy"]) == (25, 4, transfer.bytes, False)
    assert not said["closed"]
    (mesh,) = trimesh.load(folder / "mesh.glb", process=False).geometry.values()
    np.testing.assert_array_equal(mesh.vertices, transfer.positions)
    np.testing.assert_array_equal(mesh.faces, transfer.faces)
    colour = mesh.visual.vertex_attributes["color"]
    np.testing.assert_array_equal(colour[4], transfer.albedo[4])
    # Without a normal there is nothing that N.L or irradiance could show.
    np.testing.assert_array_equal(colour[3], [0, 0, 0])
    session = session_of(folder / "model.onnx")
    light = np.float32(said["environments"][0]["coefficients"])
    (radiance,) = session.run(None, {"light": light[None], "rotation": np.eye(3, dtype=np.float32)[None]})
    np.testing.assert_allclose(radiance[0], shader(transfer)(torch.from_numpy(light)), atol=1e-5)
    with PIL.Image.open(folder / said["environments"][0]["picture"]) as picture:
        assert picture.size == (32, 16)
    direction, colour = dominant(torch.ones(16, 3).double())
    assert said["environments"][0]["lamp"] == {"direction": direction.tolist(), "colour": colour.tolist()}
    # As every picture of this light.
    assert said["environments"][0]["exposure"] == pytest.approx(automatic_exposure(torch.from_numpy(light)), abs=0.01)


def test_mirrors_of_the_scene_are_a_mesh_beside(make_transfer, tmp_path, no_graph, lamps):
    transfer = make_transfer(side=4, order=4)
    sheet = {"positions": torch.rand(3, 3), "normals": torch.eye(3), "reflectance": torch.full((3, 3), 0.5)}
    sheet["faces"] = torch.tensor([[0, 1, 2]])
    receivers = transfer.receivers.replace(**{f"mirror_{name}": value for name, value in sheet.items()})
    export(dataclasses.replace(transfer, receivers=receivers), tmp_path / "page", environments=lamps, exact=True)
    scene = json.loads((tmp_path / "page" / "scene.json").read_text())
    assert scene["mirrors"]
    assert scene["download"] > (tmp_path / "page" / "mirrors.glb").stat().st_size
    mesh = next(iter(trimesh.load(tmp_path / "page" / "mirrors.glb", process=False).geometry.values()))
    np.testing.assert_array_equal(np.asarray(mesh.vertices, np.float32), sheet["positions"].numpy())
    export(transfer, tmp_path / "plain", environments=lamps)
    assert not (tmp_path / "plain" / "mirrors.glb").exists()


def test_packing_is_measured_and_said_and_exact_packs_nothing(make_transfer, tmp_path, untyped, lamps):
    transfer = make_transfer(side=40, channels=3)
    whole = export(transfer, tmp_path / "whole", environments=lamps, exact=True)
    small = export(transfer, tmp_path / "small", environments=lamps)
    assert whole.packed is None
    assert (whole.losses(), whole.places) == ("", 0)
    assert 1e-6 < small.packed.relative_rms < 2e-3
    assert f"{small.packed.relative_rms:.1e}" in small.losses()
    assert "--exact" in small.losses()
    assert 0 < small.places < 2 / 65535
    assert small.model_bytes < 0.6 * whole.model_bytes
    assert small.model_bytes < small.bytes
    own = ("model.onnx.gz", "mesh.glb", "scene.json", "environments/0.jpg")
    assert small.model_bytes == sum((tmp_path / "small" / name).stat().st_size for name in own)
    light = torch.randn(1, 16, 3, generator=torch.Generator().manual_seed(4))
    feed = {"light": light.numpy(), "rotation": np.eye(3, dtype=np.float32)[None]}
    expected = shader(transfer)(light)
    for folder, allowed in (("whole", 1e-5), ("small", 2e-3)):
        (found,) = session_of(tmp_path / folder / "model.onnx").run(None, feed)
        error = float((torch.from_numpy(found) - expected).square().mean().sqrt() / expected.square().mean().sqrt())
        assert error < allowed


def test_a_former_page_is_replaced_as_a_whole(make_transfer, tmp_path, no_graph, lamps):
    export(make_transfer(), tmp_path / "page", environments=2 * lamps, check=False)
    (tmp_path / "page" / "leftover.js").write_text("")
    export(make_transfer(side=4), tmp_path / "page", environments=lamps, check=False)
    assert about(tmp_path / "page")["vertices"] == 16
    assert not (tmp_path / "page" / "leftover.js").exists()
    assert [entry.name for entry in (tmp_path / "page" / "environments").iterdir()] == ["0.jpg"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["page"]


def test_a_fault_leaves_the_former_page(make_transfer, tmp_path, no_graph, lamps, monkeypatch):
    export(make_transfer(), tmp_path / "page", environments=lamps, check=False)

    def fail(*_, **__):
        raise RuntimeError("full disk")

    monkeypatch.setattr(EXPORT, "save_small_glb", fail)
    with pytest.raises(RuntimeError, match="full disk"):
        export(make_transfer(side=4), tmp_path / "page", environments=lamps)
    assert about(tmp_path / "page")["vertices"] == 25
    assert [entry.name for entry in tmp_path.iterdir()] == ["page"]


def test_a_compressed_bake_is_shown_beside_the_full_one_or_alone(make_transfer, tmp_path, untyped, lamps):
    transfer = make_transfer(side=12)
    packed = compress(transfer, clusters=2, components=2)
    export(transfer, tmp_path / "both", environments=lamps, compressed=packed, check=False)
    assert about(tmp_path / "both")["compressed"]["bytes"] == packed.bytes
    assert (tmp_path / "both" / "compressed.onnx.gz").is_file()
    export(packed, tmp_path / "alone", environments=lamps, check=False)
    assert about(tmp_path / "alone")["bytes"] == packed.bytes
    light = np.ones((1, 16, 3), np.float32)
    feed = {"light": light, "rotation": np.eye(3, dtype=np.float32)[None]}
    runs = [session_of(tmp_path / name).run(None, feed)[0] for name in ("both/compressed.onnx", "alone/model.onnx")]
    np.testing.assert_array_equal(*runs)


def test_zonal_lobes_are_shown_in_their_rest_pose(make_transfer, tmp_path, untyped, lamps):
    plain = make_transfer()
    generator = torch.Generator().manual_seed(4)
    signal = Zonal(
        axis=torch.nn.functional.normalize(torch.randn(1, 2, 3, 25, generator=generator), dim=2),
        coefficients=torch.randn(3, 1, 2, 4, 25, generator=generator),
        exact=torch.zeros(3, 1, 0, 25),
        squared_error=torch.zeros(25),
    )
    lobes = plain.with_layers(diffuse=plain.layers["diffuse"].replace(signal=signal))
    export(lobes, tmp_path / "page", environments=lamps, check=False)
    assert about(tmp_path / "page")["bytes"] == lobes.bytes
    light = torch.randn(1, 16, 3, generator=generator)
    feed = {"light": light.numpy(), "rotation": np.eye(3, dtype=np.float32)[None]}
    (radiance,) = session_of(tmp_path / "page" / "model.onnx").run(None, feed)
    expected = shader(lobes)(light)
    np.testing.assert_allclose(radiance, expected, atol=1e-5 * float(expected.abs().max()))


def test_exit_rows_in_lobes_are_shown_in_their_rest_pose(make_transfer, tmp_path, untyped, lamps):
    plain = make_transfer()
    baked = random_glossy("exit", vertices=25, glossy=9, output_order=2)
    lobes = fit(replaced(baked, positions=plain.positions, faces=plain.faces), lobes=2)
    export(lobes, tmp_path / "page", environments=lamps, check=False)
    assert about(tmp_path / "page")["glossy"]
    light, eye = torch.randn(1, 16, 3, generator=torch.Generator().manual_seed(4)), torch.tensor([[2.0, 3.0, 1.0]])
    feed = {"light": light.numpy(), "rotation": np.eye(3, dtype=np.float32)[None], "eye": eye.numpy()}
    (radiance,) = session_of(tmp_path / "page" / "model.onnx").run(None, feed)
    expected = shader(lobes)(light, eye=eye)
    np.testing.assert_allclose(radiance, expected, atol=1e-5 * float(expected.abs().max()))


def test_a_closed_surface_is_told_from_an_open_one_across_seams(tmp_path):
    box = trimesh.creation.box()
    # Every face with corners of its own, as a file with texture coordinates has them.
    corners = torch.tensor(box.triangles.reshape(-1, 3))
    faces = torch.arange(36).reshape(-1, 3)
    assert EXPORT._is_closed(corners, faces)
    assert not EXPORT._is_closed(corners, faces[:-1])
    assert not EXPORT._is_closed(corners, torch.cat([faces, faces[:1]]))


@pytest.mark.parametrize("order", [1, 3, 6])
def test_the_sample_lights_are_positive_and_have_pictures(order):
    lights = samples(order)
    assert len({each.name for each in lights}) == len(lights) == len(BUILT_IN)
    directions, _ = sh.fibonacci(2000)
    for each in lights:
        assert each.light.shape == (order**2, 3)
        assert float(each.image.min()) >= 0
        values = sh.evaluate(each.light.double(), directions)
        assert float(values.min()) > -1e-4 * float(values.max())
        shown = EXPORT.shown(each)
        assert shown.shape[1] == 2 * shown.shape[0]
        assert 0.2 < float(shown.mean()) <= 0.9


def test_a_light_without_image_has_the_picture_of_its_coefficients():
    red = torch.zeros(4, 3)
    red[0] = torch.tensor([2.0, 1.0, 1.0])
    red[1] = torch.tensor([-0.5, 0.0, 0.0])
    shown = EXPORT.shown(Environment("red", red))
    # y1,-1 = -.4886 y: more red above.
    assert shown[0, 0, 0] > shown[-1, 0, 0]
    assert torch.allclose(shown[..., 1], shown[0, 0, 1].expand_as(shown[..., 1]), atol=1e-5)


def test_a_black_light_is_no_fault(make_transfer, tmp_path, no_graph):
    night = [Environment("Night", torch.zeros(16, 3))]
    export(make_transfer(), tmp_path / "page", environments=night, check=False)
    assert about(tmp_path / "page")["environments"][0]["exposure"] == 0
