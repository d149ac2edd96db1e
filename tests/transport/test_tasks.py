"""Is a chunk of a bake a plain value that anyone can run, to the same bits?"""

import dataclasses
import math
import pickle
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from torchprt.brdf import Measured, parse
from torchprt.errors import InputError
from torchprt.scene import Glosses, Material, Object, Points, Scene, make_mesh, samples
from torchprt.trace import Tracer
from torchprt.transport import Processes, Threads, bake
from torchprt.transport.checkpoint import Checkpoint
from torchprt.transport.diffuse_tasks import Bounce, Job, Record, Trace
from torchprt.transport.glossy_tasks import GlossyBounce, GlossyRecord, GlossyTrace
from torchprt.transport.solve import surfaces, vertex_receivers
from torchprt.transport.stages import Kept
from torchprt.transport.task import Once, Task, chunks


class Pickling:
    """Runs tasks one by one after sending them and what they share through pickle, and notes how large they were."""

    def __init__(self):
        self.tasks, self.grown = [], []

    def map(self, tasks, *shared):
        sizes = [len(pickle.dumps(thing)) for thing in shared]
        sent = [pickle.loads(pickle.dumps(thing)) for thing in shared]
        for task in tasks:
            self.tasks.append((task, len(pickle.dumps(task))))
            yield task, pickle.loads(pickle.dumps(task))(*sent)
        self.grown += [len(pickle.dumps(thing)) - size for thing, size in zip(sent, sizes, strict=True)]


class Stops:
    """A report that behaves like Ctrl-C after some chunks."""

    def __init__(self, after):
        self.left = after

    def start(self, stage, total, done=0):
        self.stage, self.done_before = stage, done

    def advance(self, count):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


def sheet(side=30):
    """A bent sheet, coloured, through which light shines."""
    x, z = torch.meshgrid(torch.linspace(-1, 1, side), torch.linspace(-1, 1, side), indexing="ij")
    corner = (torch.arange(side - 1)[:, None] * side + torch.arange(side - 1)).flatten()
    faces = torch.cat(
        [corner[:, None] + torch.tensor([0, 1, side + 1]), corner[:, None] + torch.tensor([0, side + 1, side])]
    )
    mesh = make_mesh(torch.stack([x, x * x, z], -1).view(-1, 3), faces)
    return Object(mesh, Material((0.6, 0.4, 0.2), two_sided=True, translucency=0.5))


def shiny_box():
    box = samples.coloured_box(6)
    gloss = Material(0.1, gloss=parse("ggx:0.4"))
    return [Object(each.mesh, gloss if number % 2 else each.material) for number, each in enumerate(box.objects)]


SCENES = {
    "diffuse": samples.coloured_box(12),
    "membrane": Scene([sheet()]),
    "glossy": Scene([*shiny_box(), sheet()]),
}
# More than a chunk of them.
POINTS = Points(
    0.8 * torch.rand(700, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64),
    torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand(700, 3),
)
SHINING = Points(
    POINTS.positions, POINTS.normals, 0.2, Glosses((parse("ggx:0.4"), parse("phong:4")), torch.arange(700) % 3 - 1), 0.3
)
BAKES = [
    ("diffuse", {}),
    ("diffuse", {"bounces": 2}),
    ("diffuse", {"receivers": POINTS}),
    ("diffuse", {"receivers": POINTS, "bounces": 2}),
    ("membrane", {"bounces": math.inf}),
    ("membrane", {"shadows": False}),
    ("glossy", {}),
    ("glossy", {"bounces": 2}),
    ("glossy", {"bounces": 2, "frame": "incident"}),
    ("glossy", {"factors": 3, "bounces": 1}),
    ("glossy", {"frame": "visibility"}),
    ("glossy", {"receivers": POINTS, "bounces": 2}),
    ("glossy", {"receivers": SHINING, "bounces": 2}),
    ("membrane", {"receivers": SHINING, "bounces": 1, "frame": "incident"}),
]


def contents(value):
    """All tensors and numbers of a transfer."""
    if dataclasses.is_dataclass(value):
        return {field.name: contents(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {name: contents(each) for name, each in value.items()}
    return value.numpy().tobytes() if isinstance(value, torch.Tensor) else value


def baked(name, options, **others):
    return contents(bake(SCENES[name], order=3, rays=32, progress=False, **options, **others))


@pytest.fixture(scope="module")
def processes():
    with Processes(2) as running:
        yield running


def test_refuses_threads_beside_a_runner():
    with Threads(2) as running, pytest.raises(InputError, match="leave one"):
        bake(SCENES["diffuse"], threads=2, runner=running, progress=False)


def test_refuses_to_send_what_does_not_pickle(processes):
    brdf = Measured(lambda view, light: 0 * (view * light).sum(-1) + 0.1, isotropic=True)
    scene = Scene([Object(samples.coloured_box(4).objects[0].mesh, Material(0.1, gloss=brdf))])
    with pytest.raises(InputError, match="bake with threads"):
        bake(scene, order=2, rays=8, runner=processes, progress=False)


@pytest.mark.parametrize(("name", "options"), BAKES)
def test_processes_give_the_same_bits_as_threads(name, options, processes):
    assert baked(name, options, runner=processes) == baked(name, options, threads=2)


@pytest.mark.parametrize(("name", "options"), BAKES)
def test_tasks_that_were_sent_give_the_same_bits_and_are_small(name, options):
    runner = Pickling()
    assert baked(name, options, runner=runner) == baked(name, options)
    assert bool(runner.tasks) == options.get("shadows", True)
    # Names of classes, a path, a dozen numbers.
    assert all(size < 600 for _, size in runner.tasks)
    # What a worker makes for itself is not sent: a table of 9 coefficients along 32 directions has 1152 bytes.
    assert max(runner.grown, default=0) < 100


def test_every_kind_of_task_was_among_them():
    runner = Pickling()
    for name, options in BAKES:
        baked(name, options, runner=runner)
    kinds = {type(task.task if isinstance(task, Kept) else task) for task, _ in runner.tasks}
    assert kinds == {Trace, Record, Bounce, GlossyTrace, GlossyRecord, GlossyBounce}


def test_what_is_shared_is_the_scene_and_its_receivers_and_little_more():
    geometry = SCENES["diffuse"].geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    job = Job(tracer, surfaces(geometry), vertex_receivers(geometry, tracer), 5, 1 << 16, 0, 3)
    # Float64 positions and int32 faces, two int64 a corner; points and normals in float64, origins in float32.
    tensors = 24 * len(geometry.positions) + (12 + 48) * len(geometry.faces) + 60 * geometry.receivers
    assert tensors < len(pickle.dumps(job)) < tensors + 8192


def test_a_bake_stopped_in_processes_goes_on_in_threads(processes, tmp_path):
    scene, folder = samples.organic(8000), tmp_path / "kept"
    options = {"order": 3, "rays": 16, "bounces": 2, "checkpoint": folder}
    with pytest.raises(KeyboardInterrupt):
        bake(scene, runner=processes, progress=Stops(3), **options)
    kept = len(list(folder.glob("chunk-*")))
    # Those that were running are finished, the rest is dropped.
    assert 3 <= kept <= 3 + processes.count + 1 < len(chunks(scene.geometry().receivers))
    report = Stops(math.inf)
    found = bake(scene, progress=report, **options)
    assert contents(found) == contents(bake(scene, progress=False, **{**options, "checkpoint": None}))
    # The processes are as good as new.
    assert contents(bake(scene, runner=processes, progress=False, **{**options, "checkpoint": None})) == contents(found)


def test_hits_stay_in_the_store_and_are_not_handed_back(tmp_path):
    geometry = SCENES["diffuse"].geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    job = Job(tracer, surfaces(geometry), vertex_receivers(geometry, tracer), 3, 16, 0, 1)
    store = Checkpoint(tmp_path / "kept", "a")
    task = Trace(slice(0, 20), 16, 0, keep_hits=True)
    handed = Kept(task.rows, task, 7, store)(job)
    assert set(handed) == {"transfer"}
    assert set(store.read(7)) == {"transfer", "offsets", "sources", "weights"}
    exitant = torch.ones(geometry.receivers, 2)
    sent = pickle.loads(pickle.dumps(store))
    arriving = Bounce(task.rows, 7)(sent, exitant)["arriving"]
    both = Record(task.rows, 16, 0)(dataclasses.replace(job, order=1, channels=2), exitant)["transfer"]
    direct = Trace(task.rows, 16, 0)(dataclasses.replace(job, order=1))["transfer"]
    # One more addition.
    torch.testing.assert_close(both[:, 0] - direct[0], arriving.T, atol=2 * torch.finfo(torch.float32).eps, rtol=0)


def test_a_store_that_was_sent_is_the_same_folder_and_does_not_end_with_it():
    store = Checkpoint(None, "a")
    store.save(0, {"x": torch.ones(2)})
    sent = pickle.loads(pickle.dumps(store))
    assert torch.equal(sent.read(0)["x"], torch.ones(2))
    with pytest.raises(InputError, match="vanished"):
        sent.read(1)
    del sent
    assert store.load(0) is not None
    store.close()


def test_what_is_made_once_is_made_once_by_many_threads_and_not_sent():
    once, made = Once(), []
    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(lambda _: once("key", lambda: made.append(0) or 5), range(100))) == {5}
    assert len(made) == 1
    assert pickle.loads(pickle.dumps(once))("key", lambda: 6) == 6
    assert once("other", lambda: 7) == 7
    once.forget()
    assert once("other", lambda: 8) == 8


@dataclasses.dataclass(frozen=True)
class Counts(Task):
    """How many threads torch would use where it runs."""

    def compute(self):
        return {"threads": torch.tensor(torch.get_num_threads())}


def test_torch_is_on_one_thread_in_every_thread():
    # The number is one of each thread, and a product that is split rounds otherwise.
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        with Threads(2) as running:
            found = [int(made["threads"]) for _, made in running.map([Counts(slice(0, 1))] * 6)]
    finally:
        torch.set_num_threads(before)
    assert found == [1] * 6
