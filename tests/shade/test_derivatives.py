"""Has the radiance of every shader all derivatives, of both modes, in all that it is called with and can learn?"""

import pytest
import torch
from every_shader import every_transfer, lights
from torch.autograd import gradcheck, gradgradcheck
from torch.func import functional_call, grad, hessian, jacfwd, jacrev, vmap
from zonal_transfers import random_zonal

from torchprt.sh import yaw_pitch_roll
from torchprt.sh.derivatives import _gathered, _grid_sample
from torchprt.shade import EnvironmentShader, shader

WIDE = torch.float64
TRANSFERS = every_transfer(WIDE)
# Channels do not mix: one and three in turns.
ONE, THREE = ([name for name in TRANSFERS if name.endswith(channels)] for channels in "13")


def random(*shape, seed=3):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=WIDE)


def checked(function, given):
    """First derivatives in reverse and forward mode and second ones against differences, in random directions."""
    given = [value.detach().clone().requires_grad_() for value in given.values()]
    assert gradcheck(function, given, fast_mode=True, check_forward_ad=True)
    assert gradgradcheck(function, given, fast_mode=True)


def arguments(module):
    """By name, degrees for rotations: they stay rotations when they are moved a little."""
    given = {"light": lights(2, dtype=WIDE), "rotation": 40 * random(2, 3)}
    if "eye" in module.needs:
        given["view"] = random(2, 3)
    if "pose" in module.needs:
        given["frames"] = 40 * random(module.vertices, 3)
    return given


def called(module, given, held=None):
    given = dict(given)
    for name in ("rotation", "frames"):
        if name in given:
            given[name] = yaw_pitch_roll(given[name])
    light = given.pop("light")
    if held is not None:
        return functional_call(module, held, (light,), given)
    return module(light, **given)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("name", THREE)
def test_all_derivatives_in_light_rotation_view_and_frames(name):
    module = shader(TRANSFERS[name])
    given = arguments(module)
    checked(lambda *values: called(module, dict(zip(given, values, strict=True))), given)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("name", ONE)
def test_all_derivatives_in_an_eye_and_positions(name):
    transfer = TRANSFERS[name]
    module = shader(transfer)
    given = {}
    if "eye" in module.needs:
        given["eye"] = 5 * random(3)
    if "pose" in module.needs:
        given["positions"] = transfer.positions + 0.1 * random(*transfer.positions.shape)
    light = lights(dtype=WIDE)
    if given:
        checked(lambda *values: module(light, **dict(zip(given, values, strict=True))), given)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("name", ONE)
def test_all_derivatives_in_what_can_be_learned(name):
    module = shader(TRANSFERS[name])
    learned = {
        f"{prefix}.{each}": value
        for prefix, part in module.named_modules()
        for each in getattr(part, "learnable", ())
        if (value := getattr(part, each, None)) is not None and value.numel()
    }
    assert learned
    given = arguments(module)
    checked(lambda *values: called(module, given, dict(zip(learned, values, strict=True))), learned)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("name", THREE)
def test_a_shader_under_torch_func(name):
    module = shader(TRANSFERS[name])
    given = arguments(module)
    single = {key: value[0] if key != "frames" else value for key, value in given.items()}
    frames = {"frames": None} if "frames" in given else {}
    spread = ({**dict.fromkeys(single, 0), **frames},)
    wanted = called(module, given)
    torch.testing.assert_close(vmap(lambda values: called(module, values), spread)(given), wanted)

    def brightness(light):
        return called(module, {**single, "light": light}).square().sum()

    light = single["light"]
    rise, bend = torch.autograd.functional.jacobian(brightness, light), hessian(brightness)(light)
    torch.testing.assert_close(grad(brightness)(light), rise)
    torch.testing.assert_close(bend, torch.autograd.functional.hessian(brightness, light))
    torch.testing.assert_close(vmap(grad(brightness))(torch.stack([light, light])), torch.stack([rise, rise]))
    held = dict(module.named_buffers())
    weight = next(key for key in held if key.endswith((".albedo", ".specular")))

    def by_weight(value):
        return called(module, single, {**held, weight: value})

    torch.testing.assert_close(jacfwd(by_weight)(held[weight]), jacrev(by_weight)(held[weight]))


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("name", ["exit clustered 3", "factored dense 1", "visibility clustered 1", "incident zonal 1"])
def test_all_derivatives_of_shaders_with_something_fixed(name):
    module = shader(TRANSFERS[name])
    light, view = lights(2, dtype=WIDE), random(3)
    checked(lambda light, view: module.fix_light(light)(view=view), {"light": light, "view": view})
    if "pose" in module.needs:
        frames = 40 * random(module.vertices, 3)
        checked(
            lambda frames, light: module.fix_pose(yaw_pitch_roll(frames))(light, view=view),
            {"frames": frames, "light": light},
        )
    else:
        checked(lambda view, light: module.fix_eye(view=view)(light), {"view": view, "light": light})


@pytest.mark.usefixtures("untyped")
def test_all_derivatives_from_an_environment_to_a_picture():
    module = EnvironmentShader(shader(TRANSFERS["exit clustered 1"]), 2, tone="filmic")
    checked(
        lambda environment, view: module(environment, view=view),
        {"environment": 20 + random(6, 2, 2, 3), "view": random(3)},
    )


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("channels", [1, 3])
def test_all_derivatives_through_the_table_of_a_light(channels):
    module = shader(random_zonal(channels=channels, dtype=WIDE), method="table")
    given = {"light": lights(2, dtype=WIDE), "frames": 40 * random(module.vertices, 3)}
    checked(lambda *values: called(module, dict(zip(given, values, strict=True))), given)


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (4, 3)])
def test_plain_and_fast_reading_are_the_same_up_to_and_beyond_the_border(size):
    tables, places = random(2, 3, *size), 1.5 * random(2, 4, 5, 2, seed=4)
    torch.testing.assert_close(_gathered(tables, places), _grid_sample(tables, places))


def test_a_second_backward_without_the_graph_is_refused_as_torch_does():
    module = shader(TRANSFERS["exit clustered 1"])
    light = lights(dtype=WIDE).requires_grad_()
    radiance = module(light, view=random(3)).sum()
    radiance.backward(retain_graph=True)
    radiance.backward()
    with pytest.raises(RuntimeError, match="second time"):
        radiance.backward()
