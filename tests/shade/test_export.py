"""Does `torch.export` take every shader with a free batch, and is the program the same at any size, and read again?"""

import inspect
import io

import pytest
import torch
from every_shader import asked, every_transfer, lights
from zonal_transfers import turns

from torchprt.shade import EnvironmentShader, shader

# The dimension of channels makes two kinds of product of a dense signal.
TRANSFERS = {name: each for name, each in every_transfer().items() if name.endswith("1") or name == "exit dense 3"}
pytestmark = pytest.mark.usefixtures("untyped")


def look_of(module, count):
    look = asked(module.needs, module.vertices, count)
    if "pose" in module.needs:
        look["frames"] = turns(count, module.vertices)
    return look


def whole(transfer):
    module = shader(transfer)
    return module, lambda count: ((lights(count), turns(count)), look_of(module, count))


def from_environment(transfer):
    module = shader(transfer)
    return EnvironmentShader(module, 4), lambda n: ((torch.rand(n, 6, 4, 4, 3), turns(n)), look_of(module, n))


def lit(transfer):
    return shader(transfer).fix_light(lights(1)), lambda count: ((), asked({"eye"}, 0, count))


def seen(transfer):
    module = shader(transfer)
    module = module.fix_pose(turns(module.vertices)) if "pose" in module.needs else module
    module = module.fix_eye(view=torch.ones(3)) if "eye" in module.needs else module
    return module, lambda count: ((lights(count), turns(count)), {})


def exported(module, arguments, strict):
    given, look = arguments(2)
    named = [*inspect.signature(module.forward).parameters][: len(given)] + list(look)
    free = {name: {0: torch.export.Dim.DYNAMIC} for name in named}
    return torch.export.export(module, given, look, dynamic_shapes=free, strict=strict)


def held(program, module, arguments):
    for count in (1, 3, 5):
        given, look = arguments(count)
        # float32, sums of some hundred products, in another order.
        torch.testing.assert_close(program(*given, **look), module(*given, **look), rtol=1e-4, atol=1e-4)


# Lights are fixed at rest: of dense and clustered signals.
CASES = [
    (name, made)
    for name in TRANSFERS
    for made in (whole, from_environment, lit, seen)
    if made is not lit or "zonal" not in name
]


@pytest.mark.parametrize(("name", "made"), CASES)
def test_a_batch_stays_free(name, made):
    module, arguments = made(TRANSFERS[name])
    held(exported(module, arguments, strict=False).module(), module, arguments)


@pytest.mark.parametrize("name", ["visibility clustered 1", "factored dense 1", "incident zonal 1"])
def test_a_batch_stays_free_in_strict_mode(name):
    module, arguments = whole(TRANSFERS[name])
    held(exported(module, arguments, strict=True).module(), module, arguments)


# Said of buffers that are not contiguous, all of whose memory is written all the same.
@pytest.mark.filterwarnings("ignore:No complete tensor found")
@pytest.mark.parametrize("name", ["exit clustered 1", "visibility dense 1", "factored zonal 1"])
def test_a_program_is_the_same_after_it_was_saved_and_read(name):
    module, arguments = whole(TRANSFERS[name])
    file = io.BytesIO()
    torch.export.save(exported(module, arguments, strict=False), file)
    file.seek(0)
    held(torch.export.load(file).module(), module, arguments)
