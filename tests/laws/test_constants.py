"""Can a table that is kept between calls be spoiled by what torch was doing when it was first made?"""

import ast
import functools
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.fx.experimental.proxy_tensor import make_fx
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

import torchprt
from torchprt import brdf, light, sh
from torchprt.sh.constant import REMEMBERED

FOLDER = Path(torchprt.__file__).parent
CPU = torch.device("cpu")
# Caches whose results hold no tensor: arrays, numbers, handles of the system. Whoever adds one puts it here, or makes
# it with `sh.constant.remembered`.
WITHOUT_TENSORS = {
    "brdf/half.py": {"_nodes"},
    "scene/volume_nanovdb.py": {"_look"},
    "scene/energy.py": {"_remembered"},
    "scene/footprint.py": {"_pattern"},
    "scene/texture.py": {"_table"},
    "sh/constant.py": {"kept"},
    "sh/hemisphere_basis.py": {"_recurrence"},
    "sh/quadrature.py": {"_gauss_legendre"},
    "preview/window.py": {"_connection"},
    "trace/embree.py": {"library"},
    "trace/engines.py": {"_fastest"},
    "trace/packets.py": {"_kernels"},
    "transport/cluster_worker.py": {"_allocate_as_at_home"},
}
# Of every remembered function the plain values that one call is made with.
F32 = torch.float32
KEYS = {
    "torchprt.sh.basis._recurrence": (4, F32),
    "torchprt.sh.euler._constants": (4, F32),
    "torchprt.sh.hemisphere_basis._tables": (4, F32),
    "torchprt.sh.hemisphere_nodes._nodes": (3,),
    "torchprt.sh.matrices._coupling": (2, F32),
    "torchprt.sh.product._gaunt": (2, 2, 2, F32),
    "torchprt.sh.product._tables": (2, 2, 2, F32),
    "torchprt.sh.rotate._constants": (3, F32),
    "torchprt.sh.texels._cube_table": (2, 3, "normalised", F32),
    "torchprt.sh.texels._latlong_tables": (2, 3, 6, F32),
    "torchprt.sh.turned_product._folds": (3, F32),
    "torchprt.sh.window._search_set": (2,),
    "torchprt.shade.lobes._table_basis": (3, F32),
    "torchprt.shade.white._facing": (3, F32),
    "torchprt.sh.basis.band_of": (3,),
    "torchprt.light.arguments.clamped_cosine": (3, F32),
    "torchprt.light.sky._about_z": (3, F32),
    "torchprt.light.triangles._rule": (1, F32),
    "torchprt.light.environment._neighbours": (3,),
    "torchprt.light.sun._tables": (),
    "torchprt.light.windowed._narrowest_lobe": (3,),
    "torchprt.compression.lobe_axes._derivatives": (2,),
    "torchprt.compression.single_lobe.hemicube": (),
    "torchprt.brdf.integrals._table": (brdf.Lambert(), sh.basis, 2, "views"),
    "torchprt.brdf.table_integrals._entries": (
        brdf.Tabulated(torch.rand(6, 6, 9, generator=torch.Generator().manual_seed(0)) + 0.1),
        sh.basis,
        2,
        False,
    ),
}


class Passing(TorchDispatchMode):
    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        return func(*args, **(kwargs or {}))


class PassingFunctions(TorchFunctionMode):
    def __torch_function__(self, func, types, args=(), kwargs=None):
        return func(*args, **(kwargs or {}))


def within(context):
    def run(call):
        with context():
            call()

    return run


def traced(mode):
    return lambda call: make_fx(lambda x: (call(), x + 1)[1], tracing_mode=mode)(torch.ones(2))


def functional(transform):
    def run(call):
        transform(lambda x: (call(), x.sum())[1])(torch.ones(3))

    return run


def exported(call):
    class Calls(torch.nn.Module):
        def forward(self, x):
            call()
            return x + 1

    torch.export.export(Calls(), (torch.ones(2),), strict=False)


# What torch may be doing to the first caller.
AT_WORK = {
    "fake tensors": within(FakeTensorMode),
    "a default device": within(lambda: torch.device("meta")),
    "inference mode": within(torch.inference_mode),
    "a dispatch mode": within(Passing),
    "a function mode": within(PassingFunctions),
    "autocast": within(lambda: torch.autocast("cpu", torch.bfloat16)),
    "vmap": functional(lambda f: torch.vmap(f)),
    "grad": functional(torch.func.grad),
    "jacfwd": functional(torch.func.jacfwd),
    "hessian": functional(torch.func.hessian),
    "functionalize": functional(torch.func.functionalize),
    "make_fx": traced("real"),
    "make_fx, fake": traced("fake"),
    "make_fx, symbolic": traced("symbolic"),
    "export": exported,
}


def named(function):
    return f"{function.__module__}.{function.__qualname__}"


def tensors(made):
    if isinstance(made, torch.Tensor):
        return [made]
    parts = made if isinstance(made, tuple) else getattr(made, "__dict__", {}).values()
    return [tensor for part in parts for tensor in tensors(part)]


@pytest.fixture(scope="module", autouse=True)
def all_rooms():
    for path in (*FOLDER.glob("sh/*.py"), *FOLDER.glob("light/*.py"), *FOLDER.glob("[bcs]*/*.py")):
        if "lru_cache" in path.read_text() or "remembered(" in path.read_text():
            import_module(".".join(path.relative_to(FOLDER.parent).with_suffix("").parts))


def caches(path: Path) -> Iterator[str]:
    """Names of functions with, or variables of, a cache of functools."""

    def is_cache(node: ast.AST) -> bool:
        return any(getattr(each, "id", getattr(each, "attr", "")) in ("lru_cache", "cache") for each in ast.walk(node))

    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef) and any(is_cache(each) for each in node.decorator_list):
            yield node.name
        elif isinstance(node, ast.Assign) and is_cache(node.value):
            yield ast.unparse(node.targets[0])


def test_no_other_cache_can_hold_tensors():
    found = {str(path.relative_to(FOLDER)): set(caches(path)) for path in FOLDER.rglob("*.py")}
    assert {path: names for path, names in found.items() if names} == WITHOUT_TENSORS


def test_every_remembered_function_is_tried():
    assert {named(function) for function in REMEMBERED} == KEYS.keys()


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("work", AT_WORK)
@pytest.mark.parametrize("name", KEYS)
def test_a_table_first_made_there_serves_everyone_afterwards(name, work):
    (table,) = (function for function in REMEMBERED if named(function) == name)
    call = functools.partial(table, CPU, *KEYS[name])
    table.forget()
    wanted = [tensor.clone() for tensor in tensors(call())]
    assert wanted
    table.forget()
    AT_WORK[work](call)
    found = tensors(call())
    for one, other in zip(found, wanted, strict=True):
        assert type(one) is torch.Tensor
        assert one.device == CPU
        assert not one.is_inference()
        assert not torch._C._functorch.is_functorch_wrapped_tensor(one)
        # Up to rounding: where derivatives are asked for the basis is made in another order.
        torch.testing.assert_close(one, other, rtol=0, atol=1e-5 if one.dtype == F32 else 1e-13)
        if one.is_floating_point():
            # It can be saved for a gradient.
            (one * torch.ones_like(one, requires_grad=True)).sum().backward()


@pytest.mark.usefixtures("untyped")
def test_what_was_kept_before_can_be_used_by_fake_tensors():
    sh.basis(torch.ones(4, 3), 5)
    with FakeTensorMode():
        assert sh.basis(torch.randn(4, 3), 5).shape == (4, 25)
        assert sh.rotate(torch.randn(2, 16, 3), torch.randn(2, 3, 3)).shape == (2, 16, 3)
        assert light.project(torch.rand(4, 8, 3), 3).shape == (9, 3)
        # Of a device that has no values, and that may not be here.
        assert sh.basis(torch.empty(4, 3, device="meta"), 5).device.type == "meta"
    torch.testing.assert_close(sh.basis(torch.eye(3), 5)[0, 0], torch.tensor(0.28209479))


@pytest.mark.usefixtures("untyped")
def test_a_traced_function_holds_the_numbers_and_not_the_fakes():
    sh.basis(torch.ones(4, 3), 5)
    directions, _ = sh.fibonacci(7, torch.float32)
    for mode in ("real", "fake", "symbolic"):
        graph = make_fx(lambda d: sh.basis(d, 5), tracing_mode=mode)(directions)
        torch.testing.assert_close(graph(directions), sh.basis(directions, 5))
