"""Does the demo write everything that it announces?"""

import re
import warnings

import PIL.Image
import pytest
import torch

from torchprt import demo
from torchprt.errors import InputError
from torchprt.light import read
from torchprt.scene import samples
from torchprt.transfer import load
from torchprt.transport import GridWarning, bake, bake_neighbourhood, bake_volume


@pytest.fixture
def small(monkeypatch):
    """The same demo at a fraction of the size."""

    def few(scene, **options):
        return bake(scene, **{**options, "rays": 16, "bounces": min(options.get("bounces", 0), 2), "progress": False})

    def few_nodes(scene, **options):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GridWarning)
            return bake_neighbourhood(scene, **{**options, "rays": 32, "progress": False})

    def few_passes(volume, **options):
        return bake_volume(volume, **{**options, "rays": 32, "bounces": 1})

    terrain = samples.terrain
    organic, square, box, teapot = samples.organic, samples.plane_and_blocker, samples.coloured_box, samples.teapot
    monkeypatch.setattr(demo, "bake", few)
    monkeypatch.setattr(demo, "SIZE", (180, 120))
    monkeypatch.setattr(demo.samples, "organic", lambda _, **options: organic(8000, **options))
    monkeypatch.setattr(demo.samples, "plane_and_blocker", lambda _: square(16))
    monkeypatch.setattr(demo.samples, "coloured_box", lambda _: box(8))
    monkeypatch.setattr(demo.samples, "teapot", lambda _, material: teapot(8000, material))
    monkeypatch.setattr(demo, "GLOSS", 3)
    monkeypatch.setattr(demo, "RING", 24)
    monkeypatch.setattr(demo, "NODES", 512)
    monkeypatch.setattr(demo, "bake_neighbourhood", few_nodes)
    monkeypatch.setattr(demo.samples, "terrain", lambda *_, **options: terrain(24, **options))
    monkeypatch.setattr(demo, "bake_volume", few_passes)
    monkeypatch.setattr(demo, "CLOUD", 16)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def test_refuses_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "a").write_text("mine")
    for folder in (tmp_path / "a", tmp_path / "a" / "b"):
        with pytest.raises(InputError, match="cannot be made"):
            demo.run(folder)


def test_writes_every_file_that_it_names_and_no_other(small, untyped, tmp_path):
    said = []
    demo.run(tmp_path / "new" / "demo", said.append)
    written = {path.name for path in (tmp_path / "new" / "demo").iterdir()}
    assert written == set(re.findall(r"[a-z]+\.(?:exr|safetensors|png|ply|onnx)", " ".join(said)))
    assert len(written) == 21
    for path in (tmp_path / "new" / "demo").glob("*.png"):
        with PIL.Image.open(path) as picture:
            # More than a white sheet with black words.
            assert len(picture.convert("RGB").getcolors(1 << 24)) > 200
    transfer = load(tmp_path / "new" / "demo" / "sculpture.safetensors")
    assert (transfer.kind, transfer.bounces) == ("diffuse", 2)
    transfer = load(tmp_path / "new" / "demo" / "teapot.safetensors")
    assert (transfer.kind, transfer.order, transfer.bounces) == ("diffuse + exit", 3, 1)
    assert read(tmp_path / "new" / "demo" / "studio.exr").shape == (256, 512, 3)


def test_an_environment_is_written_as_half_floats_of_what_it_was(tmp_path):
    image = torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(0)) * 100
    demo.write_environment(image, tmp_path / "a.exr")
    assert torch.equal(read(tmp_path / "a.exr"), image.half().float())
    with pytest.raises(InputError, match="cannot be written"):
        demo.write_environment(image, tmp_path / "none" / "a.exr")
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]
