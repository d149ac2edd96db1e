"""Does a loop that folds in what stays show what the shader itself gives?"""

import itertools

import pytest
import torch
from transfers import KINDS, random_glossy
from zonal_transfers import random_zonal, random_zonal_factored

from torchprt import compress, sh
from torchprt.preview import Relight
from torchprt.shade import shader

ORDER = 4


def lights(count, seed=0):
    return torch.randn(count, ORDER**2, 3, generator=torch.Generator().manual_seed(seed)).unbind()


def eyes(count):
    return [torch.tensor([3.0 + step, 1.0, 4.0 - step], dtype=torch.float64) for step in range(count)]


def close(found, wanted):
    # Sums of some tens of products, in another order; values of about 10.
    scale = float(wanted.abs().max())
    torch.testing.assert_close(found, wanted, rtol=0, atol=200 * torch.finfo(torch.float32).eps * scale)


# Which of two lights and which of two eyes: all pairs of steps occur, each of both staying and changing.
WALK = [(0, 0), (0, 0), (1, 0), (1, 0), (0, 0), (0, 1), (0, 1), (0, 0), (1, 1), (0, 1), (1, 1), (1, 0), (1, 1)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("glossy", [0, 3, 7])
def test_glossy_radiance_is_that_of_the_shader_at_every_step(kind, glossy):
    module = shader(random_glossy(kind, glossy=glossy, order=ORDER))
    relight, light, eye = Relight(module), lights(2), eyes(2)
    assert relight.follows_eye
    for one, two in WALK:
        close(relight(light[one], eye[two]), module(light[one], eye=eye[two]))


def test_diffuse_radiance_is_that_of_the_shader(make_transfer):
    module = shader(make_transfer(order=ORDER))
    relight = Relight(module)
    assert not relight.follows_eye
    assert not relight.follows_pose
    for light, eye in itertools.product(lights(2), eyes(2)):
        assert torch.equal(relight(light, eye), module(light))


@pytest.mark.parametrize("factored", [False, True])
def test_deformed_radiance_is_that_of_the_shader_at_every_step(factored):
    transfer = random_zonal_factored(order=ORDER) if factored else random_zonal(order=ORDER)
    module = shader(transfer)
    relight, light, eye = Relight(module), lights(2), eyes(2)
    assert relight.follows_pose
    assert relight.follows_eye == factored
    turn = sh.yaw_pitch_roll(torch.tensor([30.0, 10.0, 5.0])).to(transfer.positions)
    poses = [None, transfer.positions @ turn.T, transfer.positions * transfer.positions.new_tensor([1.0, 1.5, 0.8])]
    for pose, (one, two) in [(pose, step) for pose in (0, 1, 1, 2, 0) for step in WALK[:6]]:
        more = {} if poses[pose] is None else {"positions": poses[pose]}
        close(
            relight(light[one], eye[two], poses[pose]),
            module(light[one], **more, **({"eye": eye[two]} if factored else {})),
        )


# The transfer function of a vertex


def by_definition(call, vertex):
    """What one coefficient of the light at a time gives at a vertex."""
    rows = []
    for index in range(ORDER**2):
        one = torch.zeros(ORDER**2, 3)
        one[index] = 1
        rows.append(call(one)[vertex])
    return torch.stack(rows)


# Visibility has one channel.
@pytest.mark.parametrize(("kind", "channels"), [*((kind, 1) for kind in KINDS), *((kind, 3) for kind in KINDS[:3])])
def test_the_transfer_function_of_a_glossy_vertex_is_what_each_coefficient_gives(kind, channels):
    module = shader(random_glossy(kind, glossy=4, order=ORDER, channels=channels))
    (eye,) = eyes(1)
    for vertex in range(7):
        close(Relight(module).transfer_of(vertex, eye), by_definition(lambda one: module(one, eye=eye), vertex))


@pytest.mark.parametrize("albedo", [("V", 3), (1, 1)])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("packed", [False, True])
def test_the_transfer_function_of_a_diffuse_vertex_is_what_each_coefficient_gives(
    make_transfer, albedo, channels, packed
):
    transfer = make_transfer(order=ORDER, albedo=albedo, channels=channels)
    module = shader(compress(transfer, clusters=2, components=2) if packed else transfer)
    (eye,) = eyes(1)
    for vertex in (0, 11, 24):
        close(Relight(module).transfer_of(vertex, eye), by_definition(module, vertex))


def test_the_transfer_function_of_a_moved_vertex_is_that_of_the_pose():
    transfer = random_zonal(order=ORDER)
    module = shader(transfer)
    (eye,) = eyes(1)
    turn = sh.yaw_pitch_roll(torch.tensor([30.0, 10.0, 5.0])).to(transfer.positions)
    pose = transfer.positions @ turn.T
    found = Relight(module).transfer_of(2, eye, pose)
    close(found, by_definition(lambda one: module(one, positions=pose), 2))
    # Rigidly turned, a transfer function turns along.
    close(found, sh.rotate(Relight(module).transfer_of(2, eye), turn))
