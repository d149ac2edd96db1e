"""Does docs/onnx.md say of files what is in them?"""

import re
from pathlib import Path

import onnx
import pytest
from transfers import random_glossy

from torchprt.onnx import describe, export
from torchprt.onnx.describe import KEYS

PAGE = (Path(__file__).parents[2] / "docs" / "onnx.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.usefixtures("untyped")


def section(name):
    return re.search(rf"^## {name}\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)[1]


@pytest.fixture(scope="module")
def files(make_transfer, tmp_path_factory):
    """A diffuse and a glossy file of order 5."""
    from jaxtyping import config

    config.update("jaxtyping_disable", True)
    folder = tmp_path_factory.mktemp("promises")
    export(make_transfer(side=2, order=5), folder / "diffuse.onnx", check=False)
    export(random_glossy(order=5, output_order=5, glossy=4), folder / "glossy.onnx", check=False)
    config.update("jaxtyping_disable", False)
    return folder / "diffuse.onnx", folder / "glossy.onnx"


def test_the_page_counts_the_nodes_and_names_the_operators(files):
    text = " ".join(section("Operators").split())
    counts = [int(number) for number in re.findall(r"(?:of|has) (\d+)(?: nodes|,)", text)]
    operators = [describe(path)["operators"] for path in files]
    assert counts == [sum(each.values()) for each in operators]
    first, second = (set(names.split()) for names in re.findall(r"`([A-Z]\w+(?: [A-Z]\w+)+)`", text))
    assert (first, first | second) == (set(operators[0]), set(operators[1]))


def test_files_have_the_metadata_of_the_page_and_no_other(files):
    named = set(re.findall(r"`(\w+)`", section("Metadata")))
    read = {"inputs", "outputs", "opset", "operators", "bytes"}
    entries = [set(describe(path)) - read for path in files]
    assert entries[0] == {*KEYS, "layers"}
    assert entries[1] <= named
    # Of clustered and zonal transfer, and of what is said of the layers, the page names more.
    assert entries[0] <= named


def test_one_opset_of_the_default_domain(files):
    for path in files:
        assert [(entry.domain, entry.version) for entry in onnx.load(path).opset_import] == [("", 18)]
