"""Do the examples work?"""

import importlib.util
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_light_and_albedo_are_found_from_the_radiance(tmp_path):
    picture = tmp_path / "fit.png"
    example = load("fit_light_and_albedo")
    arguments = ["--resolution", "8", "--rays", "64", "--output", str(picture)]
    few = example.main([*arguments, "--steps", "10"])
    more = example.main([*arguments, "--steps", "100"])
    # Exact data and a convex problem in either factor: the error falls for as long as it is run. A start of one grey
    # and one constant light is wrong by 80 % in the radiance.
    assert more["radiance"] < 0.01
    assert more["light"] < 0.1
    assert more["albedo"] < 0.2
    assert all(more[name] < 0.5 * few[name] for name in more)
    assert picture.read_bytes().startswith(b"\x89PNG")
