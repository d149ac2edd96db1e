"""Does a Dask cluster bake the same bits as threads, whatever happens to its workers and its store?"""

import dataclasses
import os
import pickle
import time

import pytest
import torch
from transfers import stored

from torchprt.errors import InputError
from torchprt.scene import samples
from torchprt.transport import Cluster, bake, cluster_worker
from torchprt.transport.checkpoint import place_of
from torchprt.transport.cluster import connected
from torchprt.transport.object_store import ObjectCheckpoint, Objects
from torchprt.transport.task import Task

distributed = pytest.importorskip("distributed")
fsspec = pytest.importorskip("fsspec")

OPTIONS = {"order": 2, "rays": 8, "bounces": 1, "progress": False}


@pytest.fixture(scope="module")
def scene():
    return samples.organic(8000)


@pytest.fixture(scope="module")
def alone(scene):
    return bake(scene, threads=1, **OPTIONS)


@pytest.fixture(scope="module")
def processes():
    with connected("local:2") as cluster:
        yield cluster


@pytest.fixture(scope="module")
def inside():
    """Two workers that are threads of this process, and see what it has in memory."""
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture
def memory():
    yield "memory://bakes/one"
    files = fsspec.filesystem("memory")
    if files.exists("/bakes"):
        files.rm("/bakes", recursive=True)


class Kills:
    """A report that kills a worker after some chunks."""

    def __init__(self, cluster, after):
        self.cluster, self.left = cluster, after

    def start(self, stage, total, done=0): ...

    def advance(self, count):
        self.left -= 1
        if self.left == 0:
            os.kill(min(self.cluster.client.run(os.getpid).values()), 9)


class Stops:
    """A report that behaves like Ctrl-C after some chunks."""

    def __init__(self, after):
        self.left, self.done_before = after, []

    def start(self, stage, total, done=0):
        self.done_before.append(done)

    def advance(self, count):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("on", "said"),
    [("nonsense", "no address"), ("local:0", "local:4"), ("local:x", "local:4"), (3, "on is a int")],
)
def test_refuses_what_is_no_cluster(scene, on, said):
    with pytest.raises(InputError, match=said):
        bake(scene, on=on, **OPTIONS)


def test_refuses_a_cluster_that_is_not_there(scene, monkeypatch):
    monkeypatch.setattr("torchprt.transport.cluster.ANSWER", 0.2)
    with pytest.raises(InputError, match=r"no cluster at tcp://127\.0\.0\.1:9"):
        bake(scene, on="tcp://127.0.0.1:9", **OPTIONS)


def test_refuses_threads_beside_a_cluster(scene):
    with pytest.raises(InputError, match="on and threads"):
        bake(scene, on="local:2", threads=2, **OPTIONS)


def test_names_a_worker_of_another_version(inside, monkeypatch):
    wanted = {**cluster_worker.versions(), "numpy": "1.0"}
    monkeypatch.setattr(Cluster, "check", lambda self: None)
    cluster = Cluster(inside)
    monkeypatch.undo()
    cluster._wanted = wanted
    with pytest.raises(InputError, match=r"worker inproc\S* has numpy \S+ where 1\.0"):
        cluster.check()
    # And one that comes later.
    with pytest.raises(InputError, match=r"has numpy \S+ where 1\.0"):
        list(cluster.map([Fails(slice(0, 1))]))


@dataclasses.dataclass(frozen=True)
class Fails(Task):
    """A store that is full, found by a worker."""

    def compute(self):
        from torchprt.files import CannotWrite

        raise CannotWrite("/shared/bake", "No space left on device", "free some space")


def test_a_fault_in_a_worker_is_its_sentence_here(inside):
    with pytest.raises(InputError, match=r"/shared/bake cannot be written \(No space left"):
        list(Cluster(inside).map([Fails(slice(0, 1))]))


def test_refuses_a_store_that_workers_do_not_see(scene, processes, memory):
    # What is in the memory of this process.
    with pytest.raises(InputError, match=r"does not see memory://bakes/one.*all workers reach"):
        bake(scene, on=processes, checkpoint=memory, **OPTIONS)


def test_processes_of_a_cluster_give_the_same_bits_although_one_is_killed(scene, alone, processes, tmp_path):
    kills = Kills(processes, after=3)
    found = bake(scene, on=processes, checkpoint=tmp_path / "kept", **{**OPTIONS, "progress": kills})
    assert kills.left <= 0
    assert torch.equal(stored(found), stored(alone))
    assert found.error == alone.error
    assert not (tmp_path / "kept").exists()


def test_a_bake_on_a_cluster_goes_on_elsewhere_from_any_store(scene, alone, inside, memory):
    with pytest.raises(KeyboardInterrupt):
        bake(scene, on=inside, checkpoint=memory, **{**OPTIONS, "progress": Stops(2)})
    report = Stops(1000)
    found = bake(scene, threads=1, checkpoint=memory, **{**OPTIONS, "progress": report})
    assert torch.equal(stored(found), stored(alone))
    assert report.done_before[0] >= 2 * 512 * 8
    assert not fsspec.filesystem("memory").exists("/bakes/one")


def test_a_store_is_of_one_bake_and_of_nothing_else(memory):
    store = ObjectCheckpoint(memory, "a")
    store.save(3, {"x": torch.arange(4.0)})
    sent = pickle.loads(pickle.dumps(ObjectCheckpoint(memory, "a")))
    assert type(sent) is Objects
    assert torch.equal(sent.read(3)["x"], torch.arange(4.0))
    files = fsspec.filesystem("memory")
    files.pipe_file(store.path(3), files.cat_file(store.path(3))[:-3])
    assert store.load(3) is None
    with pytest.raises(InputError, match="chunk 3 in memory://bakes/one vanished"):
        sent.read(3)
    with pytest.warns(UserWarning, match="is emptied"):
        assert ObjectCheckpoint(memory, "b").load(3) is None
    files.pipe_file("/bakes/one/thesis.tex", b"do not delete")
    with pytest.raises(InputError, match=r"thesis\.tex"):
        ObjectCheckpoint(memory, "b")


def test_a_store_without_rights_is_named(memory, monkeypatch):
    store = ObjectCheckpoint(memory, "a")

    def refuses(*_):
        raise PermissionError("Access Denied")

    monkeypatch.setattr(type(store._files), "pipe_file", refuses)
    with pytest.raises(InputError, match=r"memory://bakes/one cannot be written \(Access Denied\)"):
        store.save(0, {"x": torch.zeros(1)})
    with pytest.raises(InputError, match="nowhere://a cannot be opened"):
        ObjectCheckpoint("nowhere://a", "a")


def test_files_of_this_machine_are_a_folder_by_any_name(tmp_path):
    assert place_of(f"file://{tmp_path}/a%20b") == tmp_path / "a b"
    assert place_of("s3://bucket/a") == "s3://bucket/a"
    assert place_of(None) is None


@dataclasses.dataclass(frozen=True)
class Doubles(Task):
    """Twice a number that is shared, and which."""

    number: int = 0

    def compute(self, shared):
        return {"twice": 2 * shared.values, "number": torch.tensor([self.number])}


class Numbers:
    """Something to share."""

    def __init__(self, values):
        self.values = values


def test_short_tasks_go_out_many_at_a_time_and_all_come_back_once(inside, monkeypatch):
    batches = []
    submit = inside.submit
    monkeypatch.setattr(inside, "submit", lambda *given, **named: batches.append(given) or submit(*given, **named))
    shared = Numbers(torch.arange(3.0))
    found = list(Cluster(inside).map([Doubles(slice(0, 1), number) for number in range(300)], shared))
    assert sorted(int(tensors["number"]) for _, tensors in found) == list(range(300))
    assert all(task.number == int(tensors["number"]) for task, tensors in found)
    assert all(torch.equal(tensors["twice"], 2 * shared.values) for _, tensors in found)
    # A first one each and one more, then a quarter of what is left for each of two threads.
    assert len(batches) < 60


def test_workers_hold_what_lives_here_and_no_more(inside):
    cluster = Cluster(inside)
    first, second = Numbers(torch.ones(1)), Numbers(torch.zeros(1))
    (sent,) = cluster.send((first,))
    assert cluster.send((second, first))[1] is sent
    key = sent.key
    assert key in {key for each in inside.has_what().values() for key in each}
    del first, sent
    cluster.send((second,))
    end = time.monotonic() + 20
    while key in {key for each in inside.has_what().values() for key in each}:
        assert time.monotonic() < end
        time.sleep(0.05)
    assert len(cluster._held.all) == 1
