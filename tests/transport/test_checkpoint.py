"""What is lost when a bake stops, and does it go on to the same bits?"""

import math
import pickle

import pytest
import torch
from transfers import stored

from torchprt.errors import InputError
from torchprt.scene import Material, Points, load, samples
from torchprt.trace import Tracer
from torchprt.transport import CheckpointWarning, bake, hemisphere
from torchprt.transport.checkpoint import Checkpoint
from torchprt.transport.diffuse import projection, shadowed
from torchprt.transport.solve import vertex_receivers


class Stops:
    """A report that behaves like Ctrl-C after some chunks, and counts rays."""

    def __init__(self, after=math.inf):
        self.left = after
        self.done_before, self.traced = 0, 0

    def start(self, stage, total, done=0):
        if stage in ("trace", "points"):
            self.done_before = done
        self.stage = stage

    def advance(self, count):
        if self.stage in ("trace", "points"):
            self.traced += count
            self.left -= 1
            if self.left <= 0:
                raise KeyboardInterrupt


@pytest.fixture(scope="module")
def scene():
    return samples.organic(8000)


@pytest.mark.parametrize("options", [{}, {"bounces": 2}, {"bounces": math.inf, "order": 3}])
def test_any_number_of_threads_gives_the_same_bits(scene, options):
    one, two, five = (bake(scene, rays=48, threads=count, progress=False, **options) for count in (1, 2, 5))
    assert torch.equal(stored(one), stored(two))
    assert torch.equal(stored(one), stored(five))
    assert one.error == two.error == five.error


@pytest.mark.parametrize("options", [{}, {"bounces": 2}])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_stopped_bake_goes_on_where_it_was_to_the_same_bits(scene, tmp_path, options, threads):
    folder = tmp_path / "kept"
    whole = bake(scene, rays=48, progress=False, **options)
    with pytest.raises(KeyboardInterrupt):
        bake(scene, rays=48, checkpoint=folder, threads=threads, progress=Stops(after=3), **options)
    counter = Stops()
    resumed = bake(scene, rays=48, checkpoint=folder, threads=threads, progress=counter, **options)
    assert torch.equal(stored(resumed), stored(whole))
    assert resumed.error == whole.error
    # Three chunks were handed over; those that were running then are kept as well.
    assert counter.done_before >= 3 * 512 * 48
    assert counter.done_before + counter.traced == 48 * whole.vertices
    assert not folder.exists()


@pytest.mark.parametrize("gloss", [None, "ggx:0.5,0.4"])
def test_bounces_to_points_go_on_too(scene, tmp_path, gloss):
    mesh = scene.objects[0].mesh
    points = Points(mesh.positions[:3000], mesh.normals[:3000], 0.1, gloss)
    options = {"rays": 16, "bounces": 2, "receivers": points}
    whole = bake(scene, progress=False, **options)
    with pytest.raises(KeyboardInterrupt):
        bake(scene, checkpoint=tmp_path / "kept", progress=Stops(after=9), **options)
    resumed = bake(scene, checkpoint=tmp_path / "kept", progress=False, **options)
    assert torch.equal(stored(resumed), stored(whole))


def test_what_points_gather_is_of_one_gloss_and_one_specular(scene, tmp_path):
    """Chunks of points hold what others reflected toward them: another paint is another bake."""
    mesh, folder = scene.objects[0].mesh, tmp_path / "kept"
    points = Points(mesh.positions[:600], mesh.normals[:600], 0.1, "ggx:0.5,0.4", 0.5)
    options = {
        "rays": 8,
        "order": 2,
        "output_order": 4,
        "bounces": 1,
        "checkpoint": folder,
        "keep": True,
        "progress": False,
    }
    bake(load(mesh, material=Material(0.1, gloss="ggx:0.5,0.4", specular=0.5)), receivers=points, **options)
    for specular, gloss in ((0.4, "ggx:0.5,0.4"), (0.4, "ggx:0.6,0.4")):
        paint = load(mesh, material=Material(0.1, gloss="ggx:0.5,0.4", specular=specular))
        with pytest.warns(CheckpointWarning, match="another scene"):
            bake(paint, receivers=Points(mesh.positions[:600], mesh.normals[:600], 0.1, gloss, 0.5), **options)


def test_a_chunk_that_a_crash_left_half_written_is_traced_again(scene, tmp_path):
    folder = tmp_path / "kept"
    whole = bake(scene, rays=16, progress=False)
    with pytest.raises(KeyboardInterrupt):
        bake(scene, rays=16, checkpoint=folder, progress=Stops(after=4))
    chunk = min(folder.glob("chunk-*"))
    chunk.write_bytes(chunk.read_bytes()[:100])
    (folder / ".chunk-0000001.abc.safetensors").write_bytes(b"torn")
    assert torch.equal(stored(bake(scene, rays=16, checkpoint=folder, progress=False)), stored(whole))


@pytest.mark.parametrize("change", [{"rays": 17}, {"order": 4}, {"seed": 1}, {"bounces": 1}])
def test_chunks_of_another_bake_are_not_used_and_that_is_said(scene, tmp_path, change):
    folder = tmp_path / "kept"
    with pytest.raises(KeyboardInterrupt):
        bake(scene, rays=16, checkpoint=folder, progress=Stops(after=2))
    options = {"rays": 16, **change}
    with pytest.warns(CheckpointWarning, match="from the beginning"):
        other = bake(scene, checkpoint=folder, progress=False, **options)
    assert torch.equal(stored(other), stored(bake(scene, progress=False, **options)))


def test_albedo_and_number_of_bounces_may_change_between_a_stop_and_its_resumption(scene, tmp_path):
    mesh = scene.objects[0].mesh
    folder = tmp_path / "kept"
    with pytest.raises(KeyboardInterrupt):
        bake(load(mesh, albedo=0.9), rays=16, bounces=1, checkpoint=folder, progress=Stops(after=2))
    resumed = bake(load(mesh, albedo=0.2), rays=16, bounces=3, checkpoint=folder, progress=False)
    assert torch.equal(stored(resumed), stored(bake(load(mesh, albedo=0.2), rays=16, bounces=3, progress=False)))


def test_refuses_a_folder_that_holds_other_files(scene, tmp_path):
    (tmp_path / "thesis.tex").write_text("do not delete")
    with pytest.raises(InputError, match=r"thesis\.tex"):
        bake(scene, rays=16, checkpoint=tmp_path, progress=False)
    assert (tmp_path / "thesis.tex").exists()


def test_refuses_a_folder_that_cannot_be_made(scene, tmp_path):
    with pytest.raises(InputError, match="checkpoint"):
        bake(scene, rays=16, checkpoint=tmp_path / "no" / "such" / "parent", progress=False)


def test_a_checkpoint_without_its_manifest_starts_over(tmp_path):
    store = Checkpoint(tmp_path / "kept", "a")
    store.save(0, {"x": torch.ones(2)})
    assert torch.equal(Checkpoint(tmp_path / "kept", "a").load(0)["x"], torch.ones(2))
    (tmp_path / "kept" / "manifest.json").write_text("{")
    with pytest.warns(CheckpointWarning):
        assert Checkpoint(tmp_path / "kept", "a").load(0) is None


def test_a_chunk_is_a_pure_function_that_another_process_could_run(scene):
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    receivers = vertex_receivers(geometry, tracer)[:100]
    directions = hemisphere(32)
    here = shadowed(tracer, receivers, directions, projection(directions, 3))
    arguments = pickle.loads(pickle.dumps((tracer, receivers, directions, projection(directions, 3))))
    assert torch.equal(shadowed(*arguments), here)
    # A product of other sizes rounds otherwise: 32 additions.
    whole = stored(bake(scene, rays=32, order=3, progress=False))[0]
    torch.testing.assert_close(here, whole[:, :100], atol=32 * torch.finfo(torch.float32).eps, rtol=0)


def test_the_number_of_torch_threads_is_left_as_it_was(scene):
    torch.set_num_threads(3)
    bake(scene, rays=4, order=1, threads=2, progress=False)
    assert torch.get_num_threads() == 3


def test_a_checkpoint_is_kept_until_the_result_is_safe_if_that_is_asked(scene, tmp_path):
    folder = tmp_path / "kept"
    first = bake(scene, rays=8, checkpoint=folder, keep=True, progress=False)
    counter = Stops()
    again = bake(scene, rays=8, checkpoint=folder, progress=counter)
    assert torch.equal(stored(first), stored(again))
    assert counter.traced == 0
    assert not folder.exists()


def test_a_bad_argument_leaves_no_folder(scene, tmp_path):
    with pytest.raises(InputError, match="seed"):
        bake(scene, seed=-1, checkpoint=tmp_path / "kept", progress=False)
    assert not (tmp_path / "kept").exists()
