"""Does clustered transfer shade as the transfer that it stands for?"""

import dataclasses

import pytest
import torch
from transfers import KINDS, gloss, random_glossy, replaced

from torchprt.compression import compress, decompress
from torchprt.errors import InputError
from torchprt.sh import yaw_pitch_roll
from torchprt.shade import ClusteredSignal, shader

EPS = torch.finfo(torch.float32).eps
TURN = yaw_pitch_roll(torch.tensor([30.0, 70.0, -20.0], dtype=torch.float64))


def lights(*shape, dtype=torch.float64):
    return torch.randn(*shape, 3, generator=torch.Generator().manual_seed(1), dtype=dtype)


@pytest.fixture(params=["static", "adaptive"])
def method(request):
    return request.param


@pytest.fixture(params=[{}, {"bits": 8, "shared": 6}], ids=str)
def stored(request):
    return request.param


@pytest.fixture
def diffuse(make_transfer, method, stored):
    return compress(make_transfer(side=17, order=3, channels=3), clusters=5, components=3, method=method, **stored)


@pytest.fixture(params=KINDS)
def glossy(request, stored):
    whole = random_glossy(request.param, vertices=40, glossy=30)
    return compress(whole, clusters=3, components=2, method="adaptive", **stored)


def test_refuses_what_it_cannot_learn_or_write_into(diffuse, glossy):
    for transfer in (diffuse, glossy):
        name = list(transfer.layers)[-1]
        with pytest.raises(InputError, match=f"learn names '{name}.values': a shader of transfer of kind .*clustered"):
            shader(transfer, learn=f"{name}.values")
    with pytest.raises(InputError, match="learn names 'values'"):
        shader(diffuse, learn="values")
    with pytest.raises(InputError, match="out"):
        shader(diffuse)(lights(9).float(), out=torch.zeros(289, 3))
    with pytest.raises(InputError, match="order"):
        shader(diffuse)(lights(16).float())


@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3)])
def test_shades_as_what_is_decompressed(diffuse, batch):
    module = shader(diffuse, dtype=torch.float64)
    assert isinstance(module.layers["diffuse"].signal, ClusteredSignal)
    light = lights(*batch, 9)
    wanted = shader(decompress(diffuse), dtype=torch.float64)(light, TURN)
    # The representatives of the decompressed transfer were summed in float32.
    torch.testing.assert_close(module(light, TURN), wanted, atol=64 * EPS * float(wanted.abs().max()), rtol=0)


def test_one_channel_shades_as_what_is_decompressed(make_transfer):
    packed = compress(make_transfer(side=14, order=4), clusters=4, components=2)
    wanted = shader(decompress(packed), dtype=torch.float64)(lights(2, 16))
    found = shader(packed, dtype=torch.float64)(lights(2, 16))
    torch.testing.assert_close(found, wanted, atol=64 * EPS * float(wanted.abs().max()), rtol=0)


@pytest.mark.parametrize("batch", [(), (4,), (2, 1)])
def test_glossy_shades_as_what_is_decompressed(glossy, batch):
    module, reference = shader(glossy, dtype=torch.float64), shader(decompress(glossy), dtype=torch.float64)
    assert type(module.layers[gloss(glossy).kind].signal) is ClusteredSignal
    light = lights(*batch, glossy.order**2)
    for eye in (
        torch.tensor([0.5, 2.0, 1.0]).double(),
        torch.randn(3, 3, generator=torch.Generator().manual_seed(2)).double(),
    ):
        if len(batch) == 1 and eye.ndim == 2:
            continue
        wanted = reference(light, TURN, eye=eye)
        found = module(light, TURN, eye=eye)
        torch.testing.assert_close(found, wanted, atol=64 * EPS * float(wanted.abs().max()), rtol=0)


def test_fixed_eye_and_fixed_light_are_the_same(glossy):
    module = shader(glossy, dtype=torch.float64)
    light, eye = lights(glossy.order**2), torch.tensor([0.3, 1.5, -1.0], dtype=torch.float64)
    wanted = module(light, eye=eye)
    # Frames are stored in float32, so light that is turned by them is not quite what vectors turned by them meet.
    near = 64 * EPS * float(wanted.abs().max()) if "visibility" in glossy.layers else 1e-12
    torch.testing.assert_close(module.fix_eye(eye=eye)(light), wanted, atol=near, rtol=1e-12)
    torch.testing.assert_close(module.fix_light(light)(eye=eye), wanted, atol=near, rtol=1e-12)


def test_a_receiver_without_a_normal_sends_nothing(glossy):
    glossy = dataclasses.replace(glossy, layers={gloss(glossy).kind: gloss(glossy)})
    lost = int(gloss(glossy).receivers[3])
    normals = glossy.normals.clone()
    normals[lost] = 0
    blind = replaced(glossy, normals=normals)
    light, eye = lights(glossy.order**2).float(), torch.tensor([0.3, 1.5, -1.0])
    found = shader(blind)(light, eye=eye)
    wanted = shader(glossy)(light, eye=eye)
    assert not found[lost].any()
    assert wanted[lost].any()
    others = torch.arange(len(found)) != lost
    torch.testing.assert_close(found[others], wanted[others])


def test_gradients_reach_the_light_the_representatives_and_the_albedo(diffuse):
    module = shader(diffuse, learn=("albedo", "representatives"))
    light = lights(9).float().requires_grad_()
    module(light).square().sum().backward()
    for value in (light, module.layers["diffuse"].albedo, module.layers["diffuse"].signal.representatives):
        assert float(value.grad.abs().max()) > 0
        assert value.grad.isfinite().all()


def test_the_gradient_of_the_light_is_that_of_what_is_decompressed(diffuse):
    one, other = (lights(9).requires_grad_() for _ in range(2))
    shader(diffuse, dtype=torch.float64)(one).square().sum().backward()
    shader(decompress(diffuse), dtype=torch.float64)(other).square().sum().backward()
    torch.testing.assert_close(one.grad, other.grad, rtol=1e-4, atol=1e-4 * float(other.grad.abs().max()))
