"""Fixtures for every room. Shapes and dtypes in signatures are checked at run time (jaxtyping + beartype)."""

import os
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import torch
from jaxtyping import config, install_import_hook

if TYPE_CHECKING:
    from torchprt.transfer import Transfer

if os.environ.get("TORCHPRT_TYPECHECK", "1") != "0":
    install_import_hook("torchprt", "beartype.beartype")


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Thousands of tiny operations: more threads only wait for each other, the longer the busier the machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real scans and photographs, which is not part of the project."""
    named = os.environ.get("TORCHPRT_DATA")
    folder = Path(named) if named else Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no real data: set TORCHPRT_DATA to a folder with mesh/bunny.ply and hdri/*.exr")
    return folder


@pytest.fixture
def untyped() -> Iterator[None]:
    """For tests that trace (`torch.compile`, `torch.export`, ONNX): the type checks would break the graph.

    torch's own exporter also uses parts of torch that are going away; that is not ours to mend.
    """
    config.update("jaxtyping_disable", True)
    with warnings.catch_warnings():
        for category in (DeprecationWarning, FutureWarning):
            warnings.filterwarnings("ignore", category=category)
        warnings.filterwarnings("ignore", message=".*axis name.*will not be used")
        # Of torch about that one Python.
        warnings.filterwarnings("ignore", message=r"Guards may run slower on Python 3\.13\.0")
        yield
    config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def make_transfer() -> "Callable[..., Transfer]":
    """Builds random diffuse transfer on a square grid in the plane y = 0: there is no bake in it.

    `albedo` is the shape of the albedo, whose letter V stands for the number of vertices. Other keywords go to
    `Transfer`.
    """

    def make(
        side: int = 5,
        order: int = 4,
        channels: int = 1,
        albedo: tuple[int | str, int] = ("V", 3),
        dtype: torch.dtype = torch.float32,
        seed: int = 0,
        **metadata: Any,
    ) -> "Transfer":
        from torchprt.transfer import diffuse_transfer

        generator = torch.Generator().manual_seed(seed)
        vertices = side * side
        wide = dtype if dtype == torch.float64 else torch.float32
        band = torch.arange(order).repeat_interleave(2 * torch.arange(order) + 1)
        # Bands of a transported cosine fall off about as (l + 1)^-2.
        vectors = torch.randn(channels, order**2, vertices, generator=generator, dtype=wide) / (1 + band[:, None]) ** 2
        rows = vertices if albedo[0] == "V" else int(albedo[0])
        ticks = torch.linspace(-1, 1, side, dtype=wide)
        x, z = torch.meshgrid(ticks, ticks, indexing="ij")
        corner = (torch.arange(max(side - 1, 0))[:, None] * side + torch.arange(max(side - 1, 0))).reshape(-1)
        quads = torch.stack([corner, corner + 1, corner + side + 1, corner + side], -1)
        return diffuse_transfer(
            vectors=vectors.to(dtype),
            albedo=0.1 + 0.8 * torch.rand(rows, albedo[1], generator=generator, dtype=wide),
            positions=torch.stack([x, torch.zeros_like(x), z], -1).reshape(-1, 3),
            normals=torch.tensor([0.0, 1.0, 0.0], dtype=wide).repeat(vertices, 1),
            faces=torch.cat([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
            **metadata,
        )

    return make


@pytest.fixture
def fresh(untyped):
    """A compiler that has seen nothing: it gives up after eight modules of one class."""
    torch.compiler.reset()
    yield
    torch.compiler.reset()
