"""Is a shader the same module whether its tensors are parameters, buffers, or given from outside?"""

import pytest
import torch
from every_shader import asked, every_transfer, lights
from torch.func import functional_call

from torchprt.shade import shader

EPSILON = torch.finfo(torch.float64).eps
TRANSFERS = every_transfer(torch.float64)


def learnable(transfer):
    """Every name that `learn` can have for a transfer, each with its layer."""
    module = shader(transfer)
    return [
        f"{name}.{each}"
        for name, layer in module.layers.items()
        for each in (*layer.learnable, *layer.signal.learnable)
    ]


CASES = [(name, learn) for name, transfer in TRANSFERS.items() for learn in learnable(transfer)]


def moved(module, seed=3):
    """The module, its parameters elsewhere, as a step of an optimiser leaves them: nothing is of unit length."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in module.parameters():
            step = torch.rand(parameter.shape, generator=generator, dtype=torch.float64)
            parameter.mul_(1 + step).add_(0.3 * step)
    return module


def called(module, parts=None):
    look = asked(module.needs, module.vertices, 2, dtype=torch.float64)
    light = lights(2, dtype=torch.float64)
    return module(light, **look) if parts is None else functional_call(module, parts, (light,), look)


def close(value, wanted):
    return (value - wanted).abs().max() <= 64 * EPSILON * wanted.abs().max()


def test_every_buffer_of_a_signal_or_layer_that_can_be_learned_is_tried():
    assert {learn.partition(".")[2] for _, learn in CASES} == {
        "albedo", "specular", "values", "representatives", "axis", "coefficients", "exact", "factors", "kernel",
        "exponent",
    }  # fmt: skip


@pytest.mark.parametrize(("name", "learn"), CASES)
def test_what_was_learned_is_shaded_the_same_from_a_state_dict(name, learn):
    transfer = TRANSFERS[name]
    taught = moved(shader(transfer, learn=[learn]))
    wanted = called(taught).detach()
    plain = shader(transfer)
    before = called(plain)
    plain.load_state_dict(taught.state_dict())
    assert not close(before, wanted), "nothing was learned"
    assert close(called(plain), wanted)
    again = shader(transfer, learn=[learn])
    again.load_state_dict(plain.state_dict())
    assert close(called(again), wanted)


@pytest.mark.parametrize(("name", "learn"), CASES)
def test_a_functional_call_is_a_call(name, learn):
    transfer = TRANSFERS[name]
    taught = moved(shader(transfer, learn=[learn]))
    wanted = called(taught)
    parts = {each: parameter.detach() for each, parameter in taught.named_parameters()}
    assert len(parts) == 1
    for module in (shader(transfer), shader(transfer, learn=[learn])):
        assert close(called(module, parts), wanted)
    wanted.square().sum().backward()
    found = torch.func.grad(lambda each: called(shader(transfer), each).square().sum())(parts)
    for each, parameter in taught.named_parameters():
        assert parameter.grad.abs().max() > 0
        assert close(found[each], parameter.grad)


def test_axes_count_as_unit_vectors_whatever_their_length():
    transfer = TRANSFERS["factored zonal 3"]
    module, longer = shader(transfer), shader(transfer)
    for layer in longer.layers.values():
        layer.signal.axis *= torch.linspace(1e-6, 1e6, layer.signal.axis.shape[-1])
    assert close(called(longer), called(module))


def test_an_axis_of_no_length_gives_finite_gradients():
    module = shader(TRANSFERS["diffuse zonal 1"], learn=["axis"])
    with torch.no_grad():
        module.layers["diffuse"].signal.axis[0, 0, :, 0] = 0
    called(module).sum().backward()
    assert all(parameter.grad.isfinite().all() for parameter in module.parameters())
