"""Is a bake that writes its result part by part the bake in memory, without ever holding the whole?"""

import dataclasses
import math
import os
import pickle

import pytest
import torch
from faults import everything, room_for
from shapes import grid
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from torchprt.brdf import parse
from torchprt.errors import InputError
from torchprt.files import CannotWrite
from torchprt.scene import Glosses, Lightmap, Material, Object, Points, Scene, make_mesh, samples
from torchprt.transfer import load, save
from torchprt.transport import Output, bake
from torchprt.transport.tables import InMemory, Mapped, any_of, in_channels


def sheet(side=24):
    """A bent sheet, coloured, through which light shines."""
    x, z = torch.meshgrid(torch.linspace(-1, 1, side), torch.linspace(-1, 1, side), indexing="ij")
    mesh = make_mesh(torch.stack([x, x * x, z], -1).view(-1, 3), grid(side, side))
    return Object(mesh, Material((0.6, 0.4, 0.2), two_sided=True, translucency=0.5))


def shiny(side=8):
    gloss = Material(0.1, gloss=parse("ggx:0.4"))
    objects = samples.coloured_box(side).objects
    return [Object(each.mesh, gloss if number % 2 else each.material) for number, each in enumerate(objects)]


SCENES = {
    "diffuse": samples.coloured_box(12),
    "membrane": Scene([sheet()]),
    "glossy": Scene([*shiny(), sheet(12)]),
}
SHINING = Points(
    0.8 * torch.rand(600, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64),
    torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand(600, 3),
    0.2,
    Glosses((parse("ggx:0.4"), parse("phong:4")), torch.arange(600) % 3 - 1),
    0.3,
)
# Of each path through the solve one.
BAKES = [
    ("diffuse", {}),
    ("diffuse", {"bounces": math.inf}),
    ("diffuse", {"lightmap": Lightmap(64, uv="unwrap"), "bounces": 1}),
    ("membrane", {"bounces": 2}),
    ("membrane", {"shadows": False}),
    ("glossy", {"bounces": 2}),
    ("glossy", {"bounces": 1, "frame": "incident"}),
    ("glossy", {"frame": "visibility"}),
    ("glossy", {"shadows": False}),
    ("glossy", {"receivers": SHINING, "bounces": 2}),
]


class Pickling:
    """Runs tasks after sending them and what they share through pickle."""

    def map(self, tasks, *shared):
        sent = pickle.loads(pickle.dumps(shared))
        for task in tasks:
            yield task, task(*sent)


class Stops:
    """A report that behaves like Ctrl-C after some chunks, and notes what was done before each stage."""

    def __init__(self, after):
        self.left, self.before = after, []

    def start(self, stage, total, done=0):
        self.before.append((stage, done))

    def advance(self, count):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


def contents(value):
    """All tensors and numbers of a transfer."""
    if dataclasses.is_dataclass(value):
        return {field.name: contents(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {name: contents(each) for name, each in value.items()}
    return value.numpy().tobytes() if isinstance(value, torch.Tensor) else value


@pytest.fixture
def small(monkeypatch):
    """So few numbers at a time that every table takes several."""
    for name in ("torchprt.transfer.pieces", "torchprt.transport.validity"):
        monkeypatch.setattr(f"{name}.NUMBERS", 5000)


def baked(name, options, **others):
    return bake(SCENES[name], order=3, rays=16, progress=False, threads=1, **options, **others)


def test_a_place_that_is_no_file_is_refused_before_anything(tmp_path):
    for out, words in ((tmp_path / "a.onnx", "must end in .safetensors"), (tmp_path / "no" / "a.safetensors", "first")):
        with pytest.raises(InputError, match=words):
            baked("diffuse", {}, out=out)
    assert not list(tmp_path.iterdir())


def test_bodies_are_refused(tmp_path):
    corners = torch.tensor([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    mesh = make_mesh(corners, torch.tensor([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))
    scene = Scene([Object(mesh, Material(0.5, subsurface="marble", millimetres=0.5))])
    with pytest.raises(InputError, match="diffuses in a body comes from all of it"):
        bake(scene, out=tmp_path / "a.safetensors", progress=False)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "options"), BAKES)
def test_the_same_bits_as_in_memory(name, options, tmp_path, small):
    out = tmp_path / "a.safetensors"
    parts = baked(name, options, out=out)
    # Neither chunks nor tables are left.
    assert list(tmp_path.iterdir()) == [out]
    save(baked(name, options), tmp_path / "whole.safetensors")
    assert out.read_bytes() == (tmp_path / "whole.safetensors").read_bytes()
    assert contents(load(out)) == contents(parts)


def test_a_narrow_type_is_that_of_the_bake_in_memory(tmp_path):
    baked("diffuse", {"bounces": 1}, out=Output(tmp_path / "a.safetensors", dtype=torch.float16))
    save(baked("diffuse", {"bounces": 1}), tmp_path / "b.safetensors", dtype=torch.float16)
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


def test_workers_elsewhere_get_what_is_mapped(tmp_path):
    parts = bake(
        SCENES["diffuse"],
        order=3,
        rays=16,
        bounces=2,
        progress=False,
        runner=Pickling(),
        out=tmp_path / "a.safetensors",
    )
    assert contents(parts) == contents(baked("diffuse", {"bounces": 2}))


def test_a_stopped_bake_goes_on(tmp_path):
    out = tmp_path / "a.safetensors"
    whole = baked("diffuse", {"bounces": 2})
    with pytest.raises(KeyboardInterrupt):
        bake(SCENES["diffuse"], order=3, rays=16, bounces=2, threads=1, progress=Stops(2), out=out)
    assert not out.exists()
    report = Stops(math.inf)
    parts = bake(SCENES["diffuse"], order=3, rays=16, bounces=2, threads=1, progress=report, out=out)
    assert contents(parts) == contents(whole)
    stage, done = report.before[0]
    assert stage == "trace"
    assert done > 0
    assert list(tmp_path.iterdir()) == [out]


def test_what_is_made_of_it_is_written(tmp_path):
    seen = []

    def then(transfer):
        seen.append(transfer)
        return transfer.with_layers(diffuse=transfer.layers["diffuse"].replace(albedo=torch.full((1, 1), 0.25)))

    found = baked("diffuse", {}, out=Output(tmp_path / "a.safetensors", then=then))
    assert len(seen) == 1
    assert float(found.albedo) == 0.25


def test_tables_take_their_room_when_they_are_made(tmp_path):
    table = Mapped(tmp_path / "a.safetensors").empty(100, 7)
    table.zero_()
    assert table.is_contiguous()
    assert not any_of(table)
    table[99, 6] = 1
    assert any_of(table)
    assert torch.equal(in_channels(table, 3, Mapped(tmp_path / "a.safetensors")), table.repeat(1, 3))
    assert in_channels(table, 1, InMemory()) is table
    assert Mapped(tmp_path / "a.safetensors").empty(0, 7).shape == (0, 7)
    assert everything(tmp_path) == {}
    with room_for(1000), pytest.raises(CannotWrite, match=r"a\.safetensors cannot be written .*: free some space"):
        Mapped(tmp_path / "a.safetensors").empty(100, 7)


def test_tables_without_a_call_of_the_system_are_filled_with_zeros(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "posix_fallocate", raising=False)
    assert not any_of(Mapped(tmp_path / "a.safetensors").empty(1000, 7))


class Allocations(TorchDispatchMode):
    """The largest tensor that this thread makes anew once rays are traced: tasks are other threads', and the scene is
    no result."""

    def __init__(self):
        super().__init__()
        self.largest, self.traced = 0, False

    def start(self, stage, total, done=0):
        self.traced = True

    def advance(self, count):
        pass

    def __torch_dispatch__(self, function, types, arguments=(), options=None):
        made = function(*arguments, **(options or {}))
        given = [each for each in tree_leaves((arguments, options)) if isinstance(each, torch.Tensor)]
        known = {each.untyped_storage().data_ptr() for each in given}
        for each in tree_leaves(made):
            if self.traced and isinstance(each, torch.Tensor) and each.untyped_storage().data_ptr() not in known:
                self.largest = max(self.largest, each.untyped_storage().nbytes())
        return made


@pytest.mark.parametrize(
    ("name", "options"),
    [("membrane", {"bounces": 2})],
)
def test_nothing_as_large_as_a_part_of_the_result_is_in_memory(name, options, tmp_path, monkeypatch, small):
    monkeypatch.setattr("torchprt.transport.task.CHUNK", 32)

    def largest(**others):
        with Allocations() as seen:
            bake(SCENES[name], order=4, rays=4, progress=seen, threads=1, **options, **others)
        return seen.largest

    out = tmp_path / "a.safetensors"
    held, size = largest(out=out), load(out).bytes
    assert held < size / 4, (held, size)
    # It can fail.
    assert largest() > size / 2
