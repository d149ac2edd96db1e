"""Do gradients of layers that depend on the eye flow to light, rotation, eye and every weight, and are they right?"""

import pytest
import torch
from transfers import KINDS, gloss, random_glossy

from torchprt import sh
from torchprt.shade import shader

WHAT = {
    "exit": [],
    "factored": ["factors"],
    "incident": ["exponent"],
    "visibility": ["kernel"],
}


def small(kind, **arguments):
    return random_glossy(kind, vertices=2, order=2, output_order=2, dtype=torch.float64, **arguments)


def inputs():
    generator = torch.Generator().manual_seed(1)
    light = torch.randn(2, 4, 3, generator=generator, dtype=torch.float64).requires_grad_()
    # The identity is where formulas with angles have no gradient.
    turns = torch.stack([torch.eye(3, dtype=torch.float64), sh.yaw_pitch_roll(torch.tensor([9.0, 8.0, 7.0]).double())])
    eye = 3 * torch.randn(2, 3, generator=generator, dtype=torch.float64)
    return light, turns.requires_grad_(), eye.requires_grad_()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("channels", [1, 3])
def test_gradients_through_everything_are_right(kind, channels):
    names = [*WHAT[kind], f"{kind}.values", "specular", "albedo", "diffuse.values"]
    module = shader(small(kind, channels=channels, glossy=1), learn=names)
    parameters = dict(module.named_parameters())
    assert len(parameters) == len(names)

    def shade(light, rotation, eye, *values):
        given = dict(zip(parameters, values, strict=True))
        return torch.func.functional_call(module, given, (light, rotation), {"eye": eye})

    # Random directions instead of every entry: the tables alone have thousands.
    assert torch.autograd.gradcheck(shade, (*inputs(), *parameters.values()), fast_mode=True)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_reach_the_eye_and_the_weights_through_a_fixed_eye(kind):
    module = shader(small(kind), learn="specular")
    light, rotation, eye = inputs()

    def shade(light, eye, specular):
        with torch.nn.utils.stateless._reparametrize_module(module, {f"layers.{kind}.specular": specular}):
            return module.fix_eye(eye=eye[0])(light, rotation.detach())

    assert torch.autograd.gradcheck(shade, (light, eye, module.layers[kind].specular), fast_mode=True)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_reach_the_light_and_the_eye_through_a_fixed_light(kind):
    module = shader(small(kind))

    def shade(light, rotation, eye):
        return module.fix_light(light, rotation)(eye=eye)

    def along(light, rotation, eye):
        return module.fix_light(light, rotation)(view=eye)

    assert torch.autograd.gradcheck(shade, inputs(), fast_mode=True)
    assert torch.autograd.gradcheck(along, inputs(), fast_mode=True)


def recovered(module, pictures, parameter, make):
    optimiser = torch.optim.LBFGS(
        [parameter], max_iter=100, tolerance_grad=1e-14, tolerance_change=0, line_search_fn="strong_wolfe"
    )

    def loss():
        optimiser.zero_grad()
        value = (make(module) - pictures).square().mean()
        value.backward()
        return value

    optimiser.step(loss)


def test_a_specular_weight_is_recovered_from_pictures():
    transfer = small("exit")
    light, _, eye = (value.detach() for value in inputs())
    pictures = shader(transfer)(light, eye=eye)
    module = shader(transfer, learn="specular")
    learned = module.layers["exit"].specular
    with torch.no_grad():
        learned.fill_(0.5)
    recovered(module, pictures, learned, lambda module: module(light, eye=eye))
    assert (learned - gloss(transfer).specular).abs().max() < 1e-9


@pytest.mark.parametrize("count", [(), (2,)])
def test_an_exponent_is_recovered_from_pictures(count):
    transfer = small("incident")
    light, _, eye = (value.detach() for value in inputs())
    truth = torch.tensor([5.0, 9.0], dtype=torch.float64)[: max(sum(count), 1)].reshape(count)
    pictures = shader(transfer, exponent=truth)(light, eye=eye)
    module = shader(transfer, exponent=torch.full(count, 7.0), learn=["exponent"])
    learned = module.layers["incident"].exponent
    assert learned.shape == count
    recovered(module, pictures, learned, lambda module: module(light, eye=eye))
    assert (learned - truth).abs().max() < 1e-5
