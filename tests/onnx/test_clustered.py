"""Does ONNX Runtime shade clustered transfer as torch does, without decompressing it?"""

import numpy as np
import onnxruntime
import pytest
import torch
from transfers import KINDS, random_glossy

from torchprt.compression import compress
from torchprt.onnx import describe, export
from torchprt.shade import shader

pytestmark = pytest.mark.usefixtures("untyped")


def exported(transfer, path, **options):
    report = export(transfer, path / "a.onnx", **options)
    assert report.parity.passed
    return report, onnxruntime.InferenceSession(report.path)


ADAPTIVE, SMALL = {"method": "adaptive"}, {"bits": 8, "shared": 6}


@pytest.mark.parametrize(
    ("channels", "source", "stored"), [(1, "light", ADAPTIVE), (3, "light", SMALL), (3, "environment", ADAPTIVE)]
)
def test_diffuse_is_the_same(make_transfer, tmp_path, stored, channels, source):
    # Clusters of more and of fewer than a block.
    packed = compress(make_transfer(side=23, order=3, channels=channels), clusters=6, components=3, **stored)
    report, _ = exported(packed, tmp_path, source=source, size=8)
    assert report.inputs[source] == (("B", 9, 3) if source == "light" else ("B", 6, 8, 8, 3))
    assert describe(report.path)["kind"] == "clustered diffuse"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("eye", "stored"), [("point", ADAPTIVE), ("direction", SMALL)])
def test_glossy_is_the_same(kind, eye, stored, tmp_path):
    packed = compress(random_glossy(kind, vertices=90, glossy=80), clusters=3, components=2, **stored)
    exponent = {"exponent": 5.0} if kind == "incident" else {}
    report, _ = exported(packed, tmp_path, eye=eye, **exponent)
    assert report.inputs["eye" if eye == "point" else "view"] == ("B", 3)


@pytest.mark.parametrize("kind", KINDS)
def test_glossy_under_one_light_is_the_same(kind, tmp_path):
    packed = compress(random_glossy(kind, vertices=90, glossy=80, channels=3), clusters=3, components=2, **SMALL)
    light = torch.randn(packed.order**2, 3, generator=torch.Generator().manual_seed(1))
    exported(packed, tmp_path, fix_light=light, **({"exponent": 5.0} if kind == "incident" else {}))


@pytest.mark.parametrize("kind", ["exit", "visibility"])
def test_glossy_for_one_eye_is_the_same(kind, tmp_path):
    packed = compress(random_glossy(kind, vertices=90, glossy=80, channels=3), clusters=3, components=2)
    exported(packed, tmp_path, fix_eye=[1.0, 2.0, 0.5])


def test_an_exponent_for_every_receiver_stays_with_it(tmp_path):
    packed = compress(random_glossy("incident", vertices=90, glossy=80), clusters=5, components=2)
    exported(packed, tmp_path, exponent=torch.linspace(1, 20, 80))


def test_the_weights_stay_compressed(make_transfer, tmp_path):
    whole = random_glossy("exit", vertices=600, order=5, output_order=4, diffuse=False)
    packed = compress(whole, clusters=4, components=3)
    sizes = [export(transfer, tmp_path / "a.onnx", check=False).bytes for transfer in (packed, whole)]
    assert sizes[0] < sizes[1] / 8


def test_a_light_in_a_runtime_without_torch(make_transfer, tmp_path):
    packed = compress(make_transfer(side=23, order=3), clusters=6, components=3)
    _, session = exported(packed, tmp_path)
    light = np.random.default_rng(0).normal(size=(2, 9, 3)).astype(np.float32)
    (found,) = session.run(["radiance"], {"light": light, "rotation": np.tile(np.eye(3, dtype=np.float32), (2, 1, 1))})
    wanted = shader(packed)(torch.from_numpy(light)).numpy()
    # 16 roundings of sums of 9 and of 4 terms.
    np.testing.assert_allclose(found, wanted, atol=16 * np.finfo(np.float32).eps * np.abs(wanted).max())
