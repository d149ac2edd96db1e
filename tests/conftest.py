"""Fixtures for every room. Shapes and dtypes in signatures are checked at run time (jaxtyping + beartype)."""

import os
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from jaxtyping import config, install_import_hook

if os.environ.get("TORCHPRT_TYPECHECK", "1") != "0":
    install_import_hook("torchprt", "beartype.beartype")


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
        yield
    config.update("jaxtyping_disable", False)
