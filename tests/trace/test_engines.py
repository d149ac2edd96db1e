"""Which engine traces, and is that ever another than was asked for?"""

import importlib.util
import pickle

import pytest
import torch

from torchprt.errors import InputError
from torchprt.trace import ENGINE, EngineWarning, Tracer, engines
from torchprt.transport.progress import Bar

pytest.importorskip("numba", reason="packets need `pip install 'torchprt[fast]'`")
from torchprt.trace import embree as embree_module
from torchprt.trace import packets as packets_module
from torchprt.trace.embree import Embree, library

SIDE = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 0, -1]], dtype=torch.float64)
FACE = torch.tensor([[0, 1, 2]])


@pytest.fixture(autouse=True)
def asked_anew(monkeypatch):
    monkeypatch.delenv(ENGINE, raising=False)
    forget = engines._fastest.cache_clear, library.cache_clear
    for each in forget:
        each()
    yield
    for each in forget:
        each()


def test_refuses_an_engine_that_is_not_there(monkeypatch):
    with pytest.raises(InputError, match="no engine 'optix' for rays: choose from embreex, packets"):
        Tracer(SIDE, FACE, "optix")
    monkeypatch.setenv(ENGINE, "cuda")
    with pytest.raises(InputError, match="no engine 'cuda'"):
        Tracer(SIDE, FACE)


def unfit(monkeypatch, change):
    """As if another library lay beside embreex."""
    monkeypatch.setattr(embree_module, "library", change)
    monkeypatch.setattr(packets_module, "library", change)


def without_a_function():
    embree = library.__wrapped__()
    raise engines.CannotRun(f"{embree.path} has no function rtcOccluded16")


@pytest.mark.parametrize("asked", [False, True])
def test_a_library_that_does_not_fit_is_refused_out_loud(monkeypatch, asked):
    unfit(monkeypatch, without_a_function)
    if asked:
        monkeypatch.setenv(ENGINE, "packets")
        with pytest.raises(InputError, match=r"'packets' for rays cannot run here: .*has no function rtcOccluded16"):
            Tracer(SIDE, FACE)
        return
    with pytest.warns(EngineWarning, match="one at a time.*rtcOccluded16.*TORCHPRT_ENGINE=embreex"):
        assert Tracer(SIDE, FACE).engine == "embreex"
    # Said once a process.
    assert Tracer(SIDE, FACE).engine == "embreex"


@pytest.mark.parametrize(
    ("number", "value", "fault"),
    [
        (embree_module.VERSION, 50000, "is Embree 5.0.0, packets are made for Embree 4"),
        (embree_module.CULLING, 1, "cull back faces"),
    ],
)
def test_another_embree_is_refused(monkeypatch, number, value, fault):
    true = Embree.property
    monkeypatch.setattr(Embree, "property", lambda self, asked: value if asked == number else true(self, asked))
    with pytest.raises(engines.CannotRun, match=fault):
        library()


def test_a_library_of_something_else_is_refused(tmp_path):
    import _ctypes

    with pytest.raises(engines.CannotRun, match="has no function rtcNewDevice"):
        Embree(_ctypes.__file__)
    foreign = tmp_path / "libembree4.so"
    foreign.write_text("not a library")
    with pytest.raises(engines.CannotRun, match=r"libembree4\.so cannot be loaded"):
        Embree(str(foreign))


def test_an_embree_that_answers_otherwise_is_refused(monkeypatch):
    """Another layout of packets would give nonsense and no error."""
    monkeypatch.setattr(packets_module.Packets, "_tracing", lambda self, embree, what: (blind(), 0))
    with pytest.raises(engines.CannotRun, match="where a triangle is hit twice"):
        packets_module.try_on_a_triangle(library())


def blind():
    """The address of a function that traces nothing."""
    import ctypes

    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)
    if not hasattr(blind, "kept"):
        blind.kept = kind(lambda *_: None)
    return ctypes.cast(blind.kept, ctypes.c_void_p).value


def test_without_numba_embreex_traces(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "numba" else find(name))
    assert Tracer(SIDE, FACE).engine == "embreex"
    with pytest.raises(InputError, match=r"numba is not installed: `pip install 'torchprt\[fast\]'`"):
        Tracer(SIDE, FACE, "packets")


def test_packets_are_taken_where_they_run_and_go_with_a_tracer():
    tracer = Tracer(SIDE, FACE)
    assert tracer.engine == "packets"
    assert pickle.loads(pickle.dumps(Tracer(SIDE, FACE, "embreex"))).engine == "embreex"
    assert pickle.loads(pickle.dumps(tracer)).engine == "packets"


def test_a_tracer_does_not_change_its_engine_on_the_way(monkeypatch):
    sent = pickle.dumps(Tracer(SIDE, FACE, "packets"))
    unfit(monkeypatch, without_a_function)
    with pytest.raises(InputError, match="'packets' for rays cannot run here"):
        pickle.loads(sent)


def test_compiled_code_that_cannot_be_kept_is_said(monkeypatch):
    from torchprt.trace import packet_kernels

    made = packet_kernels.kernels

    def without_a_place(lanes, kept=True):
        if kept:
            raise RuntimeError("cannot cache function: no locator available")
        return made(lanes, kept=False)

    monkeypatch.setattr(packet_kernels, "kernels", without_a_place)
    packets_module._kernels.cache_clear()
    try:
        with pytest.warns(EngineWarning, match="NUMBA_CACHE_DIR"):
            assert Tracer(SIDE, FACE, "packets").engine == "packets"
    finally:
        packets_module._kernels.cache_clear()


def test_the_bar_says_who_traces(monkeypatch, capfd):
    monkeypatch.delenv("TORCHPRT_QUIET", raising=False)
    with Bar(engine="packets") as bar:
        bar.start("trace", 10)
        bar.advance(10)
        bar.start("bounce 1", 10)
        bar.advance(10)
    told = capfd.readouterr().err
    assert "trace by packets" in told
    assert "bounce 1 by" not in told
