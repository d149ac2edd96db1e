"""Is every receiver lit by its own blend of the lights, for every layer and signal?"""

import pytest
import torch
from every_shader import ORDER, asked, every_transfer, lights
from zonal_transfers import turns

from torchprt.errors import InputError
from torchprt.light import with_sample_points
from torchprt.shade import LocalLightShader, local_light_shader, shader

COUNT = 3
WIDE = every_transfer(torch.float64)


def blends(vertices, count=COUNT, dtype=torch.float64):
    generator = torch.Generator().manual_seed(3)
    return torch.rand(vertices, count, generator=generator, dtype=torch.float64).softmax(1).to(dtype)


def close(found, wanted):
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-12 * float(wanted.abs().max()))


def test_says_how_to_get_sample_points(make_transfer):
    transfer = make_transfer()
    with pytest.raises(InputError, match="has no sample points: bake it with --sample-points"):
        local_light_shader(shader(transfer), transfer)


@pytest.mark.parametrize("shape", [(24, 3), (25, 0), (3, 25)])
def test_refuses_a_blend_of_other_receivers(make_transfer, shape):
    with pytest.raises(InputError, match=r"blend has shape .* at the 25 receivers"):
        LocalLightShader(shader(make_transfer()), torch.ones(shape))


@pytest.mark.parametrize("shape", [(2, 16, 3), (5, 4, 16, 3)])
def test_refuses_other_than_a_light_a_column(make_transfer, shape):
    module = LocalLightShader(shader(make_transfer()), blends(25))
    with pytest.raises(InputError, match=r"the blend is of 3 lights, give \[\.\.\., 3, 16, 3\]"):
        module(torch.zeros(shape))


@pytest.mark.parametrize("name", WIDE)
@pytest.mark.parametrize("batch", [(), (2,)])
def test_every_receiver_has_its_own_light(name, batch):
    """The twin: the light of one receiver on all of them, of which that one is kept."""
    transfer = WIDE[name]
    module = shader(transfer, dtype=torch.float64)
    local = LocalLightShader(module, blends(transfer.vertices))
    given = lights(*batch, COUNT, dtype=torch.float64)
    look = asked(module.needs, transfer.vertices, *batch, dtype=torch.float64)
    rotation = turns(*batch, dtype=torch.float64) if batch else turns(1, dtype=torch.float64)[0]
    found = local(given, rotation, **look)
    assert found.shape == (*batch, transfer.vertices, 3)
    for vertex in (0, 5, transfer.vertices - 1):
        own = (local.blend[vertex][:, None, None] * given).sum(-3)
        close(found[..., vertex, :], module(own, rotation, **look)[..., vertex, :])


def test_equal_lights_are_one_light(make_transfer):
    transfer = with_sample_points(make_transfer(dtype=torch.float64), 7)
    module = shader(transfer)
    light = lights(dtype=torch.float64)
    close(local_light_shader(module, transfer)(light.expand(7, -1, -1)), module(light))


def test_of_derivatives_only_those_of_the_place_count(make_transfer):
    transfer = with_sample_points(make_transfer(dtype=torch.float64), 4, gradients=True)
    local = local_light_shader(shader(transfer), transfer)
    assert local.lights == 16
    given = torch.zeros(4, 4, ORDER**2, 3, dtype=torch.float64)
    given[:, 0] = lights(dtype=torch.float64)
    close(local(given.flatten(0, 1)), local.shader(given[0, 0]))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_narrow_lights_are_blended_in_float32(make_transfer, dtype):
    local = LocalLightShader(shader(make_transfer()), blends(25))
    given = lights(COUNT)
    found, wanted = local(given.to(dtype)), local(given)
    assert found.dtype == dtype
    assert (found - wanted).abs().max() <= 4 * torch.finfo(dtype).eps * wanted.abs().max()
    assert local.half().blend.dtype == torch.float32


@pytest.mark.parametrize("name", ["diffuse dense 1" if "diffuse dense 1" in WIDE else next(iter(WIDE)), "exit zonal 3"])
def test_gradients_flow_to_lights_and_blend(name):
    transfer = WIDE[name]
    module = LocalLightShader(shader(transfer, dtype=torch.float64), blends(transfer.vertices), learn=True)
    look = asked(module.needs, transfer.vertices, dtype=torch.float64)
    given = lights(COUNT, dtype=torch.float64).requires_grad_()

    def call(light, blend):
        return torch.func.functional_call(module, {"blend": blend}, (light,), look)

    assert torch.autograd.gradcheck(call, (given, module.blend), fast_mode=True)


def test_can_be_compiled_and_exported(make_transfer, fresh):
    module = LocalLightShader(shader(make_transfer()), blends(25))
    given = lights(2, COUNT)
    wanted = module(given)
    for made in (
        torch.compile(module, fullgraph=True, backend="eager", dynamic=True),
        torch.export.export(module, (given,), dynamic_shapes={"light": {0: torch.export.Dim("B")}}).module(),
    ):
        for batch in (given, given[:1].expand(5, -1, -1, -1)):
            torch.testing.assert_close(made(batch), module(batch))
    assert wanted.shape == (2, 25, 3)


def test_works_on_no_light(make_transfer):
    assert LocalLightShader(shader(make_transfer()), blends(25))(lights(0, COUNT)).shape == (0, 25, 3)
