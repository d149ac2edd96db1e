"""Do the scripts, what they install and what the package declares belong together?"""

import ast
import importlib.util
import os
import re
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = [
    *(ROOT / "scripts" / name for name in ("bench", "demo", "environment", "minima", "reproduce", "test")),
    ROOT / ".ci/run",
]


def canonical(name):
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.fixture(scope="module")
def requirements():
    """scripts/declared.py, which is no part of a package."""
    spec = importlib.util.spec_from_file_location("declared", ROOT / "scripts/declared.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def declared(requirements):
    """Canonical names of what pyproject.toml asks for: one set of the base, one of the extras."""
    project = requirements.project()

    def names(lines):
        return {canonical(re.match(r"[\w.-]+", line)[0]) for line in lines} - {"torchprt"}

    extras = names(line for lines in project["optional-dependencies"].values() for line in lines)
    return names(project["dependencies"]), extras


def constraints():
    lines = (line.split("#")[0].strip() for line in (ROOT / "constraints.txt").read_text().splitlines())
    return {canonical(line.split("==")[0]) for line in lines if line}


def imported():
    """Top-level modules from elsewhere that the package imports, in functions too, and whether it runs without."""
    found = set()
    for path in (ROOT / "torchprt").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(node.module)
    return {name for name in found if name.split(".")[0] not in {*sys.stdlib_module_names, "torchprt"}}


def test_every_dependency_has_a_tested_version_and_nothing_else_does(declared):
    base, extras = declared
    assert constraints() == base | extras


def test_what_the_package_imports_it_declares(declared):
    base, extras = declared
    # What may not be installed here is not told by what is.
    owners = {"warp": ["warp-lang"]} | packages_distributions()
    for module in imported():
        top = module.split(".")[0]
        # google is a namespace that many packages share.
        names = {"protobuf"} if module.startswith("google.protobuf") else {canonical(n) for n in owners.get(top, [top])}
        assert names & (base | extras), f"{module} is imported but not declared"


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_can_be_run(path):
    assert os.access(path, os.X_OK)
    subprocess.run(["bash", "-n", path], check=True)


@pytest.mark.parametrize("path", sorted((ROOT / "scripts" / "benchmarks").glob("*.py")), ids=lambda path: path.stem)
def test_every_benchmark_has_a_run(path):
    functions = {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}
    assert "run" in functions


def failure(*command, **environment):
    done = subprocess.run(
        command, env=os.environ | environment, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
    )
    assert done.returncode
    (sentence,) = done.stderr.splitlines()
    return sentence


def test_an_interpreter_that_is_none_is_named():
    sentence = failure(ROOT / "scripts/environment", "all", PYTHON="/no/such/python")
    assert (
        sentence == "error: PYTHON=/no/such/python is not Python 3.10 or newer with the venv module: name another one"
    )


def test_a_benchmark_that_is_none_is_named_beside_those_that_are():
    sentence = failure(ROOT / "scripts/bench", "nonesuch")
    assert "no benchmark nonesuch" in sentence
    assert " ".join(sorted(path.stem for path in (ROOT / "scripts/benchmarks").glob("*.py"))) in sentence
    assert "bake" in sentence


def test_every_requirement_has_a_lower_bound_that_the_tested_version_meets(requirements):
    project = requirements.project()
    tested = dict(
        line.split("#")[0].split(";")[0].strip().split("==")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line.split("#")[0].split(";")[0]
    )
    tested = {canonical(name): version for name, version in tested.items()}
    found = list(requirements.declared(project["optional-dependencies"], project))
    assert len(found) > 20
    for requirement in found:
        assert requirements.oldest(requirement).startswith(f"{requirement.name}==")
        assert tested[canonical(requirement.name)] in requirement.specifier


def test_the_oldest_is_the_lower_bound_and_the_newest_has_none(requirements):
    table = {
        "name": "thing",
        "dependencies": ["a>=1.5", "b>=2,<3; python_version >= '3'", "gone>=1; python_version < '3'"],
        "optional-dependencies": {"c": ["c[d]>=4"], "all": ["thing[c]", "e>=5"], "other": ["f>=6"]},
    }
    found = list(requirements.declared(["all"], table))
    assert [requirements.oldest(one) for one in found] == ["a==1.5", "b==2", "c[d]==4", "e==5"]
    assert [requirements.newest(one) for one in found] == ["a", "b<3", "c[d]", "e"]
    loose = list(requirements.declared([], table | {"dependencies": ["g"]}))
    with pytest.raises(ValueError, match="g has no lower bound"):
        requirements.oldest(loose[0])


def test_an_interpreter_of_the_minima_that_is_none_is_named():
    assert "none of /no/such/python is Python 3.10" in failure(ROOT / "scripts/minima", PYTHON="/no/such/python")
