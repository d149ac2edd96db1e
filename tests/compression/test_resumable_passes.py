"""What is told of the passes of clustered PCA, and what is lost when they stop?"""

import math

import pytest
import torch
from safetensors.torch import load_file, save_file
from transfers import gloss

from torchprt.checkpoint import CheckpointWarning
from torchprt.compression import clustered_pca, compress
from torchprt.compression.checkpoint import Checkpoint
from torchprt.compression.resumable_passes import Passes
from torchprt.errors import InputError

METHODS = {
    "iterative": {"clusters": 9, "components": 2, "iterations": 2},
    "adaptive": {"clusters": 9, "components": 2},
    "static": {"clusters": 9, "components": 2},
    "vq": {"clusters": 9, "components": 0},
    "pca": {"clusters": 1, "components": 2},
}
PARTS = ("label", "mean", "basis", "offsets", "weights", "error")


class Listener:
    """A report that keeps what it is told, and behaves like Ctrl-C after some of it."""

    def __init__(self, after=math.inf):
        self.after, self.told = after, 0
        self.stages = []

    def start(self, stage, total, done=0):
        self.stages.append([stage, total, done, 0])

    def advance(self, count):
        self.told += 1
        self.stages[-1][3] += count
        if self.told > self.after:
            raise KeyboardInterrupt


def surface(side=20, width=9):
    ticks = torch.linspace(-1, 1, side)
    place = torch.stack(torch.meshgrid(ticks, ticks, indexing="ij"), -1).view(-1, 2)
    generator = torch.Generator().manual_seed(0)
    waves, phases = 3 * torch.randn(2, width, generator=generator), 6 * torch.rand(width, generator=generator)
    return torch.sin(place**3 @ waves + phases)


def same(one, other, parts=PARTS):
    return all(torch.equal(getattr(one, part), getattr(other, part)) for part in parts)


def stopped(data, path, after, method="iterative", **changed):
    with pytest.raises(KeyboardInterrupt):
        clustered_pca(data, method=method, checkpoint=path, report=Listener(after), **{**METHODS[method], **changed})


def test_a_file_that_is_something_else_is_refused_and_left_as_it_is(tmp_path):
    data = surface()
    text, foreign, torn = tmp_path / "thesis.tex", tmp_path / "a.safetensors", tmp_path / "torn"
    text.write_text("do not delete")
    save_file({"positions": torch.ones(3)}, foreign)
    stopped(data, torn, 9)
    torn.write_bytes(torn.read_bytes()[:-7])
    for path in (text, foreign, torn):
        before = path.read_bytes()
        with pytest.raises(InputError, match=f"{path.name} is not a checkpoint of a compression"):
            clustered_pca(data, 4, 1, checkpoint=path)
        assert path.read_bytes() == before


def test_a_place_that_cannot_be_written_is_refused_before_any_pass(tmp_path):
    for path, fault in ((tmp_path, "is a folder"), (tmp_path / "no" / "kept", "does not exist")):
        listener = Listener()
        with pytest.raises(InputError, match=fault):
            clustered_pca(surface(), 4, 1, checkpoint=path, report=listener)
        assert not listener.stages


@pytest.mark.parametrize("method", METHODS)
def test_every_stage_ends_with_all_that_it_announced(method):
    data, listener = surface(), Listener()
    clustered_pca(data, method=method, report=listener, **METHODS[method])
    for _, total, done, told in listener.stages:
        assert done + told == total
        assert total % len(data) == 0
    growth = ["growing", "dropping", "refining"] if method in ("iterative", "adaptive") else []
    expected = ["clusters", *growth, *(["adapting"] if method == "adaptive" else []), "weights"]
    assert [stage for stage, *_ in listener.stages] == (expected if method != "pca" else ["weights"])


def test_more_passes_than_were_foreseen_are_announced_as_they_come():
    """Of clusters that all have the same heir one is dropped at a time."""
    listener = Listener()
    with Passes(listener).stage("dropping", 1, 10) as stage:
        for _ in range(3):
            stage.advance(4)
            stage.advance(6)
            stage.keep({})
    assert listener.stages == [["dropping", 10, 0, 10]] * 3


def test_as_many_clusters_as_points_have_no_surplus_to_drop():
    listener = Listener()
    packed = clustered_pca(surface(side=4), 16, 1, report=listener)
    assert float(packed.error.max()) == 0
    assert "dropping" not in [stage for stage, *_ in listener.stages]


@pytest.mark.parametrize("method", METHODS)
def test_stopped_after_any_pass_it_goes_on_to_the_same_bits(method, tmp_path):
    data = surface()
    whole = Listener()
    expected = clustered_pca(data, method=method, report=whole, **METHODS[method])
    for after in range(0, whole.told, max(1, whole.told // 9)):
        torch.set_num_threads(1 + after % 2)
        path = tmp_path / f"{after}"
        stopped(data, path, after, method)
        rest = Listener()
        found = clustered_pca(data, method=method, checkpoint=path, report=rest, **METHODS[method])
        assert same(found, expected)
        # What was done before the pass that was stopped is not done again.
        assert rest.told <= whole.told - after + 1 or rest.stages[0][0] == "weights"
        assert all(done + told == total for _, total, done, told in rest.stages)
        assert not path.exists()


def test_stopped_after_every_pass_it_still_comes_to_an_end(tmp_path):
    """Each start does three passes, and is stopped in the fourth."""

    class Impatient(Listener):
        def advance(self, count):
            if self.stages[-1][0] != "weights":
                super().advance(count)

    data, path = surface(), tmp_path / "kept"
    expected = clustered_pca(data, method="adaptive", **METHODS["adaptive"])
    for _ in range(1000):
        try:
            found = clustered_pca(data, method="adaptive", checkpoint=path, report=Impatient(3), **METHODS["adaptive"])
            break
        except KeyboardInterrupt:
            assert path.exists()
    assert same(found, expected)
    assert not path.exists()


def test_a_stop_before_the_first_pass_leaves_nothing(tmp_path):
    stopped(surface(), tmp_path / "kept", 0)
    assert not list(tmp_path.iterdir())


def test_the_file_is_written_as_passes_go_by_and_holds_labels_alone(tmp_path, monkeypatch):
    """What a kill leaves: no interrupt is needed for the file to be there."""
    monkeypatch.setattr("torchprt.compression.checkpoint._EVERY", 0.0)
    data, path, sizes = surface(side=60, width=30), tmp_path / "kept", []

    class Looks(Listener):
        def advance(self, count):
            super().advance(count)
            sizes.append(path.stat().st_size if path.exists() else 0)
            if path.exists() and self.stages[-1][0] == "refining":
                (tmp_path / "copy").write_bytes(path.read_bytes())

    expected = clustered_pca(data, 9, 2, checkpoint=path, report=Looks())
    assert not path.exists()
    # Five labels of four bytes a point, and some numbers.
    assert 0 < max(sizes) < 5 * 4 * len(data) + 5000
    assert "refining/best" in load_file(tmp_path / "copy")
    assert same(clustered_pca(data, 9, 2, checkpoint=tmp_path / "copy"), expected)


def test_seldom_written_means_seldom(tmp_path):
    listener = Listener()
    path = tmp_path / "kept"

    class Looks(Listener):
        def advance(self, count):
            super().advance(count)
            assert not path.exists()

    # Faster than ten seconds.
    clustered_pca(surface(), 9, 2, checkpoint=path, report=Looks())
    assert not listener.stages


@pytest.mark.parametrize(
    "change",
    [{"clusters": 8}, {"components": 3}, {"iterations": 3}, {"seed": 1}, {"importance": torch.ones(9)}, "data"],
)
def test_a_file_of_other_data_or_parameters_is_not_used_and_that_is_said(change, tmp_path):
    data, path = surface(), tmp_path / "kept"
    stopped(data, path, 9)
    options, other = METHODS["iterative"], data
    if change == "data":
        other = data.clone()
        other[7, 3] += 1e-6
    else:
        options = options | change
    with pytest.warns(CheckpointWarning, match="kept is of a compression of other data or with other parameters"):
        found = clustered_pca(other, checkpoint=path, **options)
    assert same(found, clustered_pca(other, **options))
    assert not path.exists()


def test_what_is_refused_leaves_the_file_of_an_earlier_call(tmp_path):
    data, path = surface(), tmp_path / "kept"
    stopped(data, path, 9)
    before = path.read_bytes()
    with pytest.warns(CheckpointWarning), pytest.raises(InputError, match="components is 10"):
        clustered_pca(data, 9, 10, checkpoint=path)
    assert path.read_bytes() == before


def test_the_number_of_torch_threads_is_left_as_it_was_after_a_stop(tmp_path):
    torch.set_num_threads(3)
    stopped(surface(), tmp_path / "kept", 5)
    assert torch.get_num_threads() == 3


def test_entries_are_found_as_they_were_kept(tmp_path):
    label, energy = torch.arange(5), torch.tensor([1e-300, math.pi], dtype=torch.float64)
    with Checkpoint(tmp_path / "kept", [energy], {"a": 1}, keep=True) as store:
        store.put("one/two", {"label": label, "again": label, "energy": energy})
        store.put("other", {"label": label})
        store.drop("oth")
    found = Checkpoint(tmp_path / "kept", [energy], {"a": 1})
    assert found.get("other") == {}
    entry = found.get("one/two")
    assert entry.keys() == {"label", "again", "energy"}
    for name, tensor in (("label", label), ("again", label), ("energy", energy)):
        assert torch.equal(entry[name], tensor)
        assert entry[name].dtype == tensor.dtype


PACKED = ("label", "mean", "basis", "offsets", "weights", "squared_error")
SOUGHT = [
    {"clusters": 12, "components": 3, "bits": 8, "coherence": 0.1},
    {"clusters": 12, "components": 3, "shared": 9, "importance": torch.linspace(1, 2, 16)},
    {"error": 0.2},
    {"bytes": 4000, "method": "adaptive"},
]


@pytest.mark.parametrize("options", SOUGHT, ids=" ".join)
def test_a_stopped_search_goes_on_to_the_same_bits(options, make_transfer, tmp_path):
    transfer, whole = make_transfer(side=15), Listener()
    expected = compress(transfer, report=whole, **options)
    assert all(done + told == total for _, total, done, told in whole.stages)
    assert ("sampling" in [stage for stage, *_ in whole.stages]) == ("error" in options or "bytes" in options)
    for after in range(1, whole.told, max(1, whole.told // 5)):
        path = tmp_path / f"{after}"
        with pytest.raises(KeyboardInterrupt):
            compress(transfer, report=Listener(after), checkpoint=path, **options)
        rest = Listener()
        found = compress(transfer, report=rest, checkpoint=path, **options)
        assert same(gloss(found).signal, gloss(expected).signal, PACKED)
        assert rest.told < whole.told
        assert not path.exists()


def test_a_file_is_kept_until_the_result_is_safe_if_that_is_asked(make_transfer, tmp_path):
    transfer, path = make_transfer(side=15), tmp_path / "kept"
    first = compress(transfer, error=0.2, checkpoint=path, keep=True)
    listener = Listener()
    again = compress(transfer, error=0.2, checkpoint=path, report=listener)
    assert same(gloss(first).signal, gloss(again).signal, PACKED)
    # Weights are not kept: they follow from the clusters.
    assert {stage for stage, total, done, _ in listener.stages if done < total} == {"weights"}
    assert not path.exists()


def test_an_error_that_cannot_be_met_leaves_no_file(make_transfer, tmp_path, monkeypatch):
    monkeypatch.setattr("torchprt.compression.checkpoint._EVERY", 0.0)
    with pytest.raises(InputError, match="cannot be met"):
        compress(make_transfer(side=15), error=1e-9, checkpoint=tmp_path / "kept")
    assert not list(tmp_path.iterdir())
