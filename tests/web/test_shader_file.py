"""Does the file for shaders say what it holds, lose what it says, and refuse what shaders cannot draw?"""

import dataclasses
import json

import numpy as np
import pytest
import torch
from safetensors.numpy import load
from transfers import random_glossy, replaced

from torchprt import light, web
from torchprt.compression import compress, fit
from torchprt.errors import InputError
from torchprt.preview.environment import Environment
from torchprt.shade import shader
from torchprt.transfer import Vertices
from torchprt.web.three import apart

TRIANGLE = torch.tensor([[0, 1, 2]])
LAMPS = [Environment("Lamp", torch.randn(25, 3, generator=torch.Generator().manual_seed(2)) + 2)]


def drawn(transfer):
    return replaced(transfer, faces=TRIANGLE) if not len(transfer.faces) else transfer


@pytest.fixture
def no_npm(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("libraries")
    for name in web.three.THREE:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(name)
    monkeypatch.setattr(web.three, "libraries", lambda: folder)


def test_refuses_what_shaders_cannot_draw_and_leaves_nothing(make_transfer, tmp_path, no_npm):
    plain = make_transfer()
    lobes = fit(plain, lobes=1)
    mixed = lobes.with_layers(more=plain.layers["diffuse"])
    other = make_transfer(order=3)
    sun = [Environment("Sun", torch.ones(4, 3))]
    for words, transfer, options in (
        ("loose points", replaced(plain, faces=TRIANGLE[:0]), {}),
        ("one of factored", drawn(random_glossy("factored")), {}),
        ("one of visibility", drawn(random_glossy("visibility")), {}),
        ("one diffuse layer alone", mixed, {}),
        ("one environment or more", plain, {"environments": []}),
        ("project it to order 3", other, {"environments": sun}),
        ("does not fit attributes", drawn(random_glossy()), {"order": 3}),
    ):
        with pytest.raises(InputError, match=words):
            web.export_three(transfer, tmp_path / "scene", **{"environments": LAMPS, **options})
        assert not list(tmp_path.iterdir())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="no --three wrote"):
        web.export_three(plain, tmp_path / "mine", environments=LAMPS)
    assert (tmp_path / "mine" / "letter.txt").read_text() == "dear"


def test_it_is_a_safetensors_file_whose_header_says_what_it_holds(make_transfer):
    transfer = make_transfer(channels=3, order=5)
    file = web.shader_file(transfer)
    size = int.from_bytes(file.content[:8], "little")
    about = json.loads(json.loads(file.content[8 : 8 + size])["__metadata__"]["torchprt_gpu"])
    assert about == file.about
    assert (about["order"], about["count"], about["receivers"]) == (5, 25, "vertices")
    tensors = load(file.content)
    values = tensors["0.values"].reshape(25, 3, 28)
    vectors = transfer.layers["diffuse"].signal.values
    np.testing.assert_array_equal(values[..., :25], vectors.permute(2, 0, 1).half().numpy())
    assert not values[..., 25:].any()
    exact = load(web.shader_file(transfer, exact=True).content)["0.values"]
    np.testing.assert_array_equal(exact.reshape(25, 3, 28)[..., :25], vectors.permute(2, 0, 1).numpy())


def test_what_is_read_is_what_was_stored_to_half_precision(make_transfer):
    plain = make_transfer(side=6, order=4)
    eye = torch.tensor([2.0, 3.0, 5.0])
    lamps = light.project(light.built_in("sky", 16), 4).float()
    for transfer in (
        plain,
        compress(plain, clusters=3, components=4),
        fit(plain, lobes=2),
        random_glossy(glossy=4),
        random_glossy(projection="reduced", channels=3),
        random_glossy(projection="even"),
    ):
        transfer = drawn(transfer)
        read, whole = web.shader_file(transfer).transfer, web.shader_file(transfer, exact=True).transfer
        seen = {"eye": eye} if "eye" in transfer.needs else {}
        expected, near, same = (shader(each)(lamps, **seen) for each in (transfer, read, whole))
        size = float(expected.abs().max())
        assert float((same - expected).abs().max()) < 1e-5 * size
        assert 0 < float((near - expected).abs().max()) < 5e-3 * size


def test_a_receiver_without_a_normal_has_no_gloss():
    transfer = drawn(random_glossy(vertices=5))
    normals = transfer.normals.clone()
    normals[2] = 0
    transfer = replaced(transfer, normals=normals)
    eye, lamps = torch.tensor([2.0, 3.0, 5.0]), torch.ones(16, 3)
    read = web.shader_file(transfer, exact=True)
    weight = read.tensors["1.weight"].reshape(-1, 4)
    assert not weight[2].any()
    assert weight[3].any()
    torch.testing.assert_close(shader(read.transfer)(lamps, eye=eye), shader(transfer)(lamps, eye=eye))


def test_what_bands_cost_is_told_of_attributes(make_transfer, tmp_path, no_npm):
    transfer = make_transfer(order=5)
    lamps = torch.randn(2, 25, 3, generator=torch.Generator().manual_seed(1))
    lost = apart(transfer, transfer.to_order(3), lamps)
    one, other = shader(transfer)(lamps), shader(transfer.to_order(3))(lamps[:, :9])
    worst = max(float((a - b).norm() / a.norm()) for a, b in zip(one, other, strict=True))
    assert lost == pytest.approx(worst, rel=1e-4)
    report = web.export_three(transfer, tmp_path / "scene", order=3, environments=LAMPS)
    assert report.error > 1e-3
    assert report.transfer_bytes == 0
    assert not (tmp_path / "scene" / "transfer.bin").exists()
    whole = web.export_three(transfer, tmp_path / "scene", environments=LAMPS, title="<b>@about & so</b>")
    page = (tmp_path / "scene" / "index.html").read_text()
    assert "<title>&lt;b&gt;@about &amp; so&lt;/b&gt;</title>" in page
    assert whole.transfer_bytes == (tmp_path / "scene" / "transfer.bin").stat().st_size
    assert whole.bytes == sum(path.stat().st_size for path in (tmp_path / "scene").rglob("*") if path.is_file())
    assert "off by" in str(whole)


def test_the_module_imports_three_and_nothing_else():
    text = web.module()
    lines = [line for line in text.splitlines() if line.startswith(("import", "} from"))]
    assert lines == ["import {", '} from "three";']
    for name in ("loadPRT", "PRTModel", "PRTLight", "loadLights", "Shading", "lightmapMaterial", "rotate", "project"):
        assert f"export class {name}" in text or f"function {name}" in text
    assert "@prt" not in text


def test_a_page_for_shaders_has_no_onnx_and_refuses_what_they_cannot(make_transfer, tmp_path, monkeypatch):
    import importlib

    module = importlib.import_module("torchprt.web.export")
    folder = tmp_path / "libraries"
    for name in (*module.LOADED, "onnxruntime-LICENSE.txt", "three-LICENSE.txt"):
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_text(name)
    monkeypatch.setattr(module, "libraries", lambda: folder)
    transfer = make_transfer()
    packed, picture = compress(transfer, clusters=2, components=2), torch.ones(8, 16, 3)
    lamps = [Environment("Lamp", torch.ones(16, 3), picture)]
    report = module.export(transfer, tmp_path / "page", compressed=packed, environments=lamps, gpu=True)
    names = {
        path.relative_to(tmp_path / "page").as_posix() for path in (tmp_path / "page").rglob("*") if path.is_file()
    }
    assert {"transfer.bin.gz", "compressed.bin.gz", "torchprt.js", "libraries/three-LICENSE.txt"} <= names
    assert not [name for name in names if "onnx" in name or "ort." in name]
    for name in ("index.html", "NOTICE.txt"):
        assert "ort." not in (tmp_path / "page" / name).read_text()
    assert report.parity is None
    assert 0 < report.half < 5e-3
    assert "half precision" in report.losses()
    with pytest.raises(InputError, match="one of incident"):
        module.export(drawn(random_glossy("incident")), tmp_path / "other", environments=lamps, gpu=True)


def test_a_vertex_of_the_mesh_says_which_receiver_it_is(make_transfer, tmp_path, no_npm):
    import trimesh

    transfer = make_transfer()
    mixed = torch.randperm(25, generator=torch.Generator().manual_seed(3))
    receivers = transfer.receivers
    assert isinstance(receivers, Vertices)
    transfer = dataclasses.replace(transfer, receivers=receivers.replace(original=mixed))
    web.export_three(transfer, tmp_path / "scene", environments=LAMPS, check=False)
    (mesh,) = trimesh.load(tmp_path / "scene" / "model.glb", process=False).geometry.values()
    number = mesh.vertex_attributes["_PRT_ID"].reshape(-1).astype(int)
    np.testing.assert_allclose(mesh.vertices, transfer.positions[number], atol=1e-6)
