"""Does a diffuse shader obey the laws of light, take every batch, and refuse the rest?"""

import pytest
import torch
from transfers import replaced, stored

from torchprt.errors import InputError
from torchprt.sh import rotate, yaw_pitch_roll
from torchprt.shade import DiffuseLayer, Shader, shader

EPSILON = {torch.float32: torch.finfo(torch.float32).eps, torch.float64: torch.finfo(torch.float64).eps}
ALBEDOS = [("V", 3), ("V", 1), (1, 3), (1, 1)]


def lights(*batch, order=4, dtype=torch.float32, seed=1):
    return torch.randn(*batch, order**2, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def by_definition(transfer, light):
    """Equation 8 as it is written: a sum over coefficients at every vertex, in float64."""
    vectors = stored(transfer, "diffuse").double().expand(3, -1, -1)
    return transfer.albedo.double() * torch.einsum("cnv,...nc->...vc", vectors, light.double())


def close(value, wanted, epsilons):
    error = (value.double() - wanted.double()).abs().max()
    return error <= epsilons * EPSILON[value.dtype] * wanted.abs().max()


def test_refuses_a_light_of_another_order(make_transfer):
    message = "light has 9 coefficients but the transfer is of order 4: project the light with order=4"
    with pytest.raises(InputError, match=message):
        shader(make_transfer(order=4))(lights(order=3))


@pytest.mark.parametrize("learn", ["light", ["albedo", "normals"]])
def test_refuses_to_learn_what_it_does_not_have(make_transfer, learn):
    with pytest.raises(InputError, match=r"learn names '(light|normals)'"):
        shader(make_transfer(), learn=learn)


def test_refuses_to_learn_an_albedo_that_bounces_have_baked_in(make_transfer):
    with pytest.raises(InputError, match="albedo cannot be learned: 2 bounces"):
        shader(make_transfer(bounces=2), learn="albedo")


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("shape", [(24, 3), (1, 25, 3), (3, 25)])
def test_refuses_an_out_of_another_shape(make_transfer, channels, shape):
    with pytest.raises(InputError, match="out must be a former result for"):
        shader(make_transfer(channels=channels))(lights(), out=torch.zeros(shape))


def test_refuses_an_out_that_is_not_a_former_result(make_transfer):
    with pytest.raises(InputError, match="out must be a former result"):
        shader(make_transfer())(lights(), out=torch.zeros(25, 3))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("albedo", ALBEDOS)
@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3), (0,), (2, 0)])
@pytest.mark.parametrize("side", [0, 1, 5])
def test_is_the_sum_that_the_paper_writes(make_transfer, channels, albedo, batch, side):
    transfer = make_transfer(side=side, channels=channels, albedo=albedo)
    light = lights(*batch)
    radiance = shader(transfer)(light)
    assert radiance.shape == (*batch, side * side, 3)
    if radiance.numel():
        # 16 terms: their rounding errors add up to sqrt(16) epsilons of the largest partial sum.
        assert close(radiance, by_definition(transfer, light), 16)


@pytest.mark.parametrize("order", [1, 2, 8, 32])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_takes_any_order_and_precision(make_transfer, order, dtype):
    transfer = make_transfer(order=order, dtype=dtype)
    light = lights(2, order=order, dtype=dtype)
    radiance = shader(transfer)(light)
    assert radiance.dtype == dtype
    assert close(radiance, by_definition(transfer, light), 16 * order)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e6, 1e30])
def test_is_linear_in_the_light(make_transfer, channels, scale):
    module = shader(make_transfer(channels=channels))
    a, b = lights(seed=1), lights(seed=2)
    assert close(module(scale * a + scale * b) / scale, module(a) + module(b), 64)


@pytest.mark.parametrize("channels", [1, 3])
def test_channels_do_not_mix(make_transfer, channels):
    module = shader(make_transfer(channels=channels))
    light = lights()
    red = light.clone()
    red[:, 1:] = 0
    assert torch.equal(module(red)[:, 0], module(light)[:, 0])
    assert torch.equal(module(red)[:, 1:], torch.zeros(25, 2))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("degrees", [(0, 0, 0), (180, 0, 0), (0, 180, 0), (0, 0, 180), (30, 200, -70)])
def test_turning_the_light_and_asking_for_a_rotation_are_the_same(make_transfer, channels, degrees):
    module = shader(make_transfer(channels=channels))
    light, rotation = lights(2), yaw_pitch_roll(torch.tensor(degrees, dtype=torch.float32))
    assert close(module(light, rotation), module(rotate(light, rotation)), 8)


def test_a_shader_in_float64_turns_in_float64(make_transfer):
    module = shader(make_transfer(order=6), dtype=torch.float64)
    light = lights(order=6, dtype=torch.float64)
    rotation = yaw_pitch_roll(torch.tensor([20.0, 40.0, 60.0], dtype=torch.float64))
    # The norm of the light is kept and the inverse rotation leads back, to float64.
    assert close(module.turn(module.turn(light, rotation), rotation.mT), light, 100)


@pytest.mark.parametrize(
    ("batch", "turns"), [((), ()), ((3,), ()), ((3,), (3,)), ((2, 3), (3,)), ((2, 3), (2, 1)), ((1,), (4,)), ((), (4,))]
)
def test_lights_and_rotations_broadcast(make_transfer, batch, turns):
    module = shader(make_transfer())
    light = lights(*batch)
    rotation = yaw_pitch_roll(360 * torch.rand(*turns, 3, generator=torch.Generator().manual_seed(3)))
    whole = torch.broadcast_shapes(batch, turns)
    radiance = module(light, rotation)
    assert radiance.shape == (*whole, 25, 3)
    one_by_one = [
        module(each, turn)
        for each, turn in zip(
            light.expand(*whole, 16, 3).reshape(-1, 16, 3), rotation.expand(*whole, 3, 3).reshape(-1, 3, 3), strict=True
        )
    ]
    assert close(radiance.reshape(-1, 25, 3), torch.stack(one_by_one), 16)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("albedo", ALBEDOS)
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_out_is_written_over_and_returned(make_transfer, channels, albedo, batch):
    module = shader(make_transfer(channels=channels, albedo=albedo))
    first = module(lights(*batch, seed=1))
    wanted = module(lights(*batch, seed=2))
    memory = first.data_ptr()
    again = module(lights(*batch, seed=2), out=first)
    assert again.data_ptr() == memory
    assert torch.equal(again, wanted)
    assert torch.equal(first, wanted)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("channels", [1, 3])
def test_out_for_no_vertex_and_one_vertex(make_transfer, side, channels):
    module = shader(make_transfer(side=side, channels=channels))
    first = module(lights(2, seed=1))
    assert torch.equal(module(lights(2, seed=2), out=first), module(lights(2, seed=2)))


def test_the_result_is_a_view_with_vertices_contiguous(make_transfer):
    radiance = shader(make_transfer())(lights(4))
    assert radiance.stride() == (75, 1, 25)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_storage_alone(make_transfer, dtype):
    stored = make_transfer(dtype=dtype)
    module = shader(stored)
    assert module.layers["diffuse"].signal.values.dtype == torch.float32
    assert close(module(lights()), by_definition(stored, lights()), 16)


def test_gradients_through_light_rotation_albedo_and_transfer_are_right(make_transfer):
    for channels in (1, 3):
        transfer = make_transfer(side=2, order=2, channels=channels, dtype=torch.float64)
        module = shader(transfer, learn=("albedo", "values"))
        parameters = dict(module.named_parameters())
        assert set(parameters) == {"layers.diffuse.albedo", "layers.diffuse.signal.values"}
        light = lights(2, order=2, dtype=torch.float64).requires_grad_()
        # The identity is where formulas with angles have no gradient.
        turns = torch.stack([torch.eye(3, dtype=torch.float64), yaw_pitch_roll(torch.tensor([9.0, 8.0, 7.0]).double())])

        def shade(light, rotation, *values, module=module, parameters=parameters):
            given = dict(zip(parameters, values, strict=True))
            return torch.func.functional_call(module, given, (light, rotation))

        assert torch.autograd.gradcheck(shade, (light, turns.requires_grad_(), *parameters.values()))


def test_a_light_is_recovered_from_a_picture_by_gradient_descent(make_transfer):
    transfer = make_transfer(side=8, order=3)
    module = shader(transfer)
    truth = lights(order=3)
    picture = module(truth).detach()
    light = torch.zeros_like(truth, requires_grad=True)
    optimiser = torch.optim.LBFGS(
        [light], max_iter=200, tolerance_grad=1e-9, tolerance_change=0, line_search_fn="strong_wolfe"
    )

    def loss():
        optimiser.zero_grad()
        value = (module(light) - picture).square().mean()
        value.backward()
        return value

    optimiser.step(loss)
    # float32 and a condition number of about 10: a thousand epsilons are reached with room to spare.
    assert (light - truth).abs().max() <= 1e4 * EPSILON[torch.float32] * truth.abs().max()


def test_an_albedo_is_recovered_from_pictures_by_gradient_descent(make_transfer):
    transfer = make_transfer(side=4, order=3, albedo=("V", 3))
    light = lights(8, order=3)
    pictures = shader(transfer)(light).detach()
    module = shader(replaced(transfer, albedo=torch.full_like(transfer.albedo, 0.5)), learn="albedo")
    optimiser = torch.optim.LBFGS(module.parameters(), max_iter=200, tolerance_grad=1e-9, tolerance_change=0)

    def loss():
        optimiser.zero_grad()
        value = (module(light) - pictures).square().mean()
        value.backward()
        return value

    optimiser.step(loss)
    assert (module.layers["diffuse"].albedo - transfer.albedo).abs().max() <= 1e4 * EPSILON[torch.float32]


def test_the_given_transfer_is_left_alone_by_learning(make_transfer):
    transfer = make_transfer()
    before = transfer.albedo.clone()
    module = shader(transfer, learn="albedo")
    with torch.no_grad():
        module.layers["diffuse"].albedo.zero_()
    assert torch.equal(transfer.albedo, before)


def test_a_state_dict_moves_a_shader(make_transfer):
    module, other = shader(make_transfer(seed=1)), shader(make_transfer(seed=2))
    assert not torch.equal(module(lights()), other(lights()))
    other.load_state_dict(module.state_dict())
    assert torch.equal(module(lights()), other(lights()))


def test_says_what_it_is(make_transfer):
    module = shader(make_transfer())
    assert "order=4, vertices=25, needs=[]" in repr(module)
    assert type(module) is Shader
    assert {name: type(layer) for name, layer in module.layers.items()} == {"diffuse": DiffuseLayer}


def test_refuses_a_rotation_that_is_a_reflection(make_transfer):
    shade = shader(make_transfer())
    light = torch.ones(shade.order**2, 3)
    with pytest.raises(InputError, match="reflection"):
        shade(light, -torch.eye(3))
