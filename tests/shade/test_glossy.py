"""Do shaders of layers that depend on the eye follow their definition, take every batch, and refuse the rest?"""

import pytest
import torch
from transfers import KINDS, by_definition, gloss, random_glossy, replaced, stored

from torchprt import sh
from torchprt.errors import InputError
from torchprt.shade import DiffuseLayer, ExitLayer, FactoredLayer, IncidentLayer, Shader, VisibilityLayer, shader

EPSILON = {torch.float32: torch.finfo(torch.float32).eps, torch.float64: torch.finfo(torch.float64).eps}
EYE = torch.tensor([0.3, -4.0, 2.0])
LAYERS = [
    {},
    {"channels": 3},
    {"glossy": 4, "specular": (1, 1)},
    {"glossy": 4, "channels": 3, "specular": (1, 3), "albedo": (1, 3)},
    {"glossy": 1, "specular": ("G", 1), "albedo": ("V", 1)},
    {"diffuse": False},
    {"diffuse": False, "glossy": 4, "channels": 3, "specular": (1, 1), "albedo": (1, 1)},
    {"glossy": 0},
    {"glossy": 0, "diffuse": False, "channels": 3},
]


def lights(*batch, order=4, dtype=torch.float32, seed=1):
    return torch.randn(*batch, order**2, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def eyes(*batch, dtype=torch.float32, seed=2):
    return 3 * torch.randn(*batch, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def close(value, wanted, epsilons):
    """Sums of M N products of numbers near 1: their rounding grows as the root of their count."""
    error = (value.double() - wanted.double()).abs().max()
    return error <= epsilons * EPSILON[value.dtype] * wanted.abs().max()


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "eye and view: neither is given; give one"),
        ({"eye": EYE, "view": EYE}, "eye and view: both are given; give one"),
        ({"view": torch.zeros(3)}, "view is a zero vector: give a direction"),
        ({"view": torch.eye(3).mul(torch.tensor([1.0, 0, 1])[:, None])}, "view is a zero vector"),
        ({"eye": torch.tensor([0.0, torch.nan, 0.0])}, "eye holds NaN or infinity"),
        ({"eye": torch.tensor([0.0, torch.inf, 0.0])}, "eye holds NaN or infinity"),
        ({"view": torch.tensor([torch.nan, 1.0, 0.0])}, "view holds NaN or infinity"),
    ],
)
def test_refuses_an_eye_that_is_nowhere(kind, arguments, message):
    module = shader(random_glossy(kind))
    with pytest.raises(InputError, match=message):
        module(lights(), **arguments)
    with pytest.raises(InputError, match=message):
        module.fix_light(lights())(**arguments)
    if all(value.ndim == 1 for value in arguments.values()):
        with pytest.raises(InputError, match=message):
            module.fix_eye(**arguments)


@pytest.mark.parametrize("shape", [(), (2,), (4,), (3, 2)])
def test_refuses_an_eye_of_another_shape(untyped, kind, shape):
    with pytest.raises(InputError, match="its last dimension must be x, y, z"):
        shader(random_glossy(kind))(lights(), eye=torch.ones(shape))


def test_refuses_a_light_of_another_order(kind):
    message = "light has 9 coefficients but the transfer is of order 4: project the light with order=4"
    module = shader(random_glossy(kind, diffuse=False))
    with pytest.raises(InputError, match=message):
        module(lights(order=3), eye=EYE)
    with pytest.raises(InputError, match=message):
        module.fix_light(lights(order=3))
    with pytest.raises(InputError, match=message):
        module.fix_eye(eye=EYE)(lights(order=3))


def test_refuses_a_rotation_that_is_a_reflection(kind):
    with pytest.raises(InputError, match="reflection"):
        shader(random_glossy(kind))(lights(), -torch.eye(3), eye=EYE)


def test_refuses_a_batch_of_eyes_to_be_fixed(untyped, kind):
    with pytest.raises(InputError, match="eye or view has a batch: fix one at a time"):
        shader(random_glossy(kind)).fix_eye(eye=eyes(2))


def test_refuses_tangents_that_make_no_frame(kind):
    transfer = random_glossy(kind)
    skew = transfer.normals[gloss(transfer).receivers] + 0.1 * gloss(transfer).tangents
    with pytest.raises(InputError, match=r"local frame .* must be orthogonal"):
        shader(replaced(transfer, tangents=skew))


def test_refuses_to_learn_what_it_does_not_have(kind):
    message = rf"learn names 'light': a shader of transfer of kind 'diffuse \+ {kind}' can learn 'albedo', "
    with pytest.raises(InputError, match=message):
        shader(random_glossy(kind), learn=["albedo", "light"])
    with pytest.raises(InputError, match="learn names 'albedo'"):
        shader(random_glossy(kind, diffuse=False), learn="albedo")


@pytest.mark.parametrize("name", ["albedo", "specular"])
def test_refuses_to_learn_what_bounces_have_baked_in(kind, name):
    with pytest.raises(InputError, match=f"{name} cannot be learned: 2 bounces"):
        shader(random_glossy(kind, bounces=2), learn=name)


@pytest.mark.parametrize("name", ["exponent", "brdf"])
def test_refuses_a_reflectance_where_one_is_baked_in(name):
    from torchprt.brdf import Lambert

    value = {"exponent": 10.0, "brdf": Lambert()}[name]
    for kind in ("exit", "factored", "visibility"):
        message = rf"{name} is given, but transfer of kind 'diffuse \+ {kind}' does not leave it open"
        with pytest.raises(InputError, match=message):
            shader(random_glossy(kind), **{name: value})


@pytest.mark.parametrize(
    ("kind", "wanted"),
    list(zip(KINDS, (ExitLayer, FactoredLayer, IncidentLayer, VisibilityLayer), strict=True)),
)
def test_each_kind_has_its_layer(kind, wanted):
    module = shader(random_glossy(kind, glossy=4))
    assert type(module) is Shader
    assert {name: type(layer) for name, layer in module.layers.items()} == {"diffuse": DiffuseLayer, kind: wanted}
    assert len(module.layers[kind].receivers) == 4
    assert "order=4, vertices=7, needs=['eye']" in repr(module)


@pytest.mark.parametrize("layers", LAYERS)
def test_is_the_sum_that_the_paper_writes(kind, layers):
    transfer = random_glossy(kind, **layers)
    radiance = shader(transfer)(lights(), eye=EYE)
    assert radiance.shape == (7, 3)
    assert close(radiance, by_definition(transfer, lights(), eye=EYE), 64)


@pytest.mark.parametrize("projection", ["optimal", "reduced", "zero", "odd", "even"])
def test_takes_every_projection(projection):
    for kind in ("exit", "visibility"):
        transfer = random_glossy(kind, projection=projection)
        assert close(shader(transfer)(lights(), view=EYE), by_definition(transfer, lights(), view=EYE), 64)


@pytest.mark.parametrize(("order", "output_order"), [(1, 1), (1, 8), (10, 2), (12, 12)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_takes_any_order_and_precision(kind, order, output_order, dtype):
    transfer = random_glossy(kind, vertices=3, order=order, output_order=output_order, dtype=dtype)
    light, eye = lights(order=order, dtype=dtype), EYE.to(dtype)
    radiance = shader(transfer)(light, eye=eye)
    assert radiance.dtype == dtype
    # Functions of order n reach n and their rounding a few n epsilons of that.
    assert close(radiance, by_definition(transfer, light, eye=eye), 64 * max(order, output_order))


@pytest.mark.parametrize("vertices", [0, 1])
def test_no_receiver_and_one_receiver(kind, vertices):
    transfer = random_glossy(kind, vertices=vertices)
    module = shader(transfer)
    for found in (
        module(lights(2), eye=eyes(2)),
        module.fix_eye(eye=EYE)(lights(2)),
        module.fix_light(lights(2))(eye=EYE),
    ):
        assert found.shape == (2, vertices, 3)
    if vertices:
        assert close(module(lights(), eye=EYE), by_definition(transfer, lights(), eye=EYE), 64)


@pytest.mark.parametrize(
    ("batch", "turns", "looks"),
    [
        ((), (), ()),
        ((5,), (), ()),
        ((1,), (), (1,)),
        ((), (), (5,)),
        ((5,), (), (5,)),
        ((2, 3), (3,), ()),
        ((2, 3), (), (3,)),
        ((2, 3), (2, 1), (2, 1)),
        ((2, 1), (), (1, 3)),
        ((1, 3), (), (2, 1)),
        ((2, 3), (), (2, 3)),
        ((), (3,), (2, 1)),
        ((0,), (), ()),
        ((), (), (0,)),
        ((2, 0), (), (2, 1)),
    ],
)
def test_lights_rotations_and_eyes_broadcast(kind, batch, turns, looks):
    module = shader(random_glossy(kind, channels=3 if len(batch) == 2 else 1, glossy=4))
    light, eye = lights(*batch), eyes(*looks)
    rotation = sh.yaw_pitch_roll(360 * torch.rand(*turns, 3, generator=torch.Generator().manual_seed(3)))
    whole = torch.broadcast_shapes(batch, turns, looks)
    radiance = module(light, rotation, eye=eye)
    assert radiance.shape == (*whole, 7, 3)
    if radiance.numel():
        each = zip(
            light.expand(*whole, 16, 3).reshape(-1, 16, 3),
            rotation.expand(*whole, 3, 3).reshape(-1, 3, 3),
            eye.expand(*whole, 3).reshape(-1, 3),
            strict=True,
        )
        one_by_one = torch.stack([module(*one[:2], eye=one[2]) for one in each])
        assert close(radiance.reshape(-1, 7, 3), one_by_one, 32)
    assert module.fix_light(light, rotation)(eye=eye).shape == (*whole, 7, 3)


@pytest.mark.parametrize("layers", LAYERS)
def test_fixing_the_eye_or_the_light_changes_nothing(kind, layers):
    module = shader(random_glossy(kind, **layers))
    light, rotation = lights(2), sh.yaw_pitch_roll(torch.tensor([20.0, 40.0, 60.0]))
    for look in ({"eye": EYE}, {"view": EYE}):
        wanted = module(light, rotation, **look)
        assert close(module.fix_eye(**look)(light, rotation), wanted, 32)
        assert close(module.fix_light(light, rotation)(**look), wanted, 32)


def test_a_fixed_light_takes_many_eyes(kind):
    module = shader(random_glossy(kind, glossy=4))
    for batch, looks in [((), (5,)), ((3,), (3,)), ((3,), (2, 1)), ((2, 1), (3,)), ((0,), ())]:
        wanted = module(lights(*batch), eye=eyes(*looks))
        found = module.fix_light(lights(*batch))(eye=eyes(*looks))
        assert found.shape == wanted.shape
        assert found.numel() == 0 or close(found, wanted, 32)


def test_a_fixed_eye_is_a_diffuse_shader(kind):
    module = shader(random_glossy(kind, albedo=(1, 1), specular=("G", 1))).fix_eye(eye=EYE)
    # One channel where no weight has more.
    assert list(module.layers) == ["diffuse"]
    assert module.layers["diffuse"].signal.values.shape == (1, 16, 7)
    assert not module.needs
    first = module(lights(4))
    assert torch.equal(module(lights(4, seed=5), out=first), module(lights(4, seed=5)))
    assert first.stride() == (21, 1, 7)


def test_the_result_is_a_view_with_vertices_contiguous(kind):
    for arguments in ({}, {"glossy": 4}, {"diffuse": False}):
        radiance = shader(random_glossy(kind, **arguments))(lights(4), eye=EYE)
        assert radiance.stride() == (21, 1, 7)


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e6, 1e30])
def test_is_linear_in_the_light(kind, scale):
    module = shader(random_glossy(kind))
    a, b = lights(seed=1), lights(seed=2)
    assert close(module(scale * a + scale * b, eye=EYE) / scale, module(a, eye=EYE) + module(b, eye=EYE), 128)


@pytest.mark.parametrize("channels", [1, 3])
def test_channels_do_not_mix(kind, channels):
    module = shader(random_glossy(kind, channels=channels))
    red = lights()
    red[:, 1:] = 0
    assert torch.equal(module(red, eye=EYE)[:, 0], module(lights(), eye=EYE)[:, 0])
    assert torch.equal(module(red, eye=EYE)[:, 1:], torch.zeros(7, 2))


@pytest.mark.parametrize("degrees", [(0, 0, 0), (180, 0, 0), (0, 180, 0), (0, 0, 180), (30, 200, -70)])
def test_turning_the_light_and_asking_for_a_rotation_are_the_same(kind, degrees):
    module = shader(random_glossy(kind))
    rotation = sh.yaw_pitch_roll(torch.tensor(degrees, dtype=torch.float32))
    assert close(module(lights(2), rotation, eye=EYE), module(sh.rotate(lights(2), rotation), eye=EYE), 16)


def test_a_visible_world_that_turns_with_light_and_eye_looks_the_same():
    """Only visibility is stored in the local frame: turn positions, normals, tangents, light and eye together."""
    transfer = random_glossy("visibility", diffuse=False, dtype=torch.float64)
    turn = sh.yaw_pitch_roll(torch.tensor([30.0, 200.0, -70.0], dtype=torch.float64))
    turned = replaced(
        transfer,
        positions=transfer.positions @ turn.T,
        normals=transfer.normals @ turn.T,
        tangents=gloss(transfer).tangents @ turn.T,
    )
    light, eye = lights(dtype=torch.float64), EYE.double()
    wanted = shader(transfer)(light, eye=eye)
    assert close(shader(turned)(light, turn, eye=turn @ eye), wanted, 1000)


def test_a_far_eye_is_a_view(kind):
    module = shader(random_glossy(kind))
    direction = torch.nn.functional.normalize(EYE, dim=0)
    wanted = module(lights(), view=direction)
    for distance in (1e12, 1e30, 3e38):
        # Positions of size 1 are 1e-12 of the distance, far below rounding.
        assert close(module(lights(), eye=distance * direction), wanted, 64)
    for length in (1e-38, 1e-30, 1e30, 3e38):
        assert close(module(lights(), view=length * direction), wanted, 64)


@pytest.mark.parametrize("scale", [2.0**-20, 2.0**20, 2.0**60])
def test_the_unit_of_the_scene_does_not_matter(kind, scale):
    transfer = random_glossy(kind)
    larger = replaced(transfer, positions=scale * transfer.positions)
    # Powers of two scale without rounding.
    assert torch.equal(shader(larger)(lights(), eye=scale * EYE), shader(transfer)(lights(), eye=EYE))


def test_a_scene_far_from_the_origin_is_exact_with_positions_and_eye_in_float64():
    transfer = random_glossy(dtype=torch.float64, diffuse=False)
    offset = torch.tensor([1e4, -2e4, 3e4], dtype=torch.float64)
    far = replaced(transfer, positions=transfer.positions + offset)
    light, eye = lights(dtype=torch.float64), EYE.double()
    wanted = shader(transfer)(light, eye=eye)
    assert close(shader(far)(light, eye=eye + offset), wanted, 1e4 * 64)
    # Matrices in float32, directions from float64.
    single = shader(far, dtype=torch.float32)
    assert single.layers["exit"].points.dtype == torch.float64
    found = single(light.float(), eye=eye + offset)
    assert found.dtype == torch.float32
    assert close(found, wanted, 64)
    # What the docstring says of float32: an angle of about 6e-8 (|eye| + |position|) / distance, times the slope of
    # functions of order 3. The error must be there, or the float64 path would be for nothing.
    near = replaced(far, positions=far.positions.float())
    coarse = shader(near, dtype=torch.float32)(light.float(), eye=(eye + offset).float())
    error = float((coarse.double() - wanted).abs().max() / wanted.abs().max())
    assert 1e-5 < error < 6e-8 * 2 * 3.8e4 * 10


def test_an_eye_below_the_horizon_is_on_it(kind):
    transfer = random_glossy(kind, vertices=1, diffuse=False)
    transfer = replaced(transfer, normals=torch.tensor([[0.0, 1.0, 0.0]]), tangents=torch.tensor([[1.0, 0.0, 0.0]]))
    module = shader(transfer)
    on = module(lights(), view=torch.tensor([0.6, 0.0, -0.8]))
    for down in (-1e-6, -0.5, -100.0):
        assert close(module(lights(), view=torch.tensor([0.6, down, -0.8])), on, 8)
    # Continuous there: functions of order 3 and tables of 32 random texels change by less than 100 times the angle.
    above = module(lights(), view=torch.tensor([0.6, 1e-5, -0.8]))
    assert (above - on).abs().max() < 1e-3 * on.abs().max()


def test_an_eye_at_a_receiver_or_straight_below_it_looks_along_the_normal(kind):
    transfer = random_glossy(kind)
    transfer = replaced(
        transfer,
        normals=torch.tensor([[0.0, 1.0, 0.0]]).repeat(7, 1),
        tangents=torch.tensor([[1.0, 0, 0]]).repeat(7, 1),
    )
    module, up = shader(transfer), torch.tensor([0.0, 1.0, 0.0])
    wanted = module(lights(), view=up)
    assert close(module(lights(), view=-up), wanted, 1)
    for v in range(7):
        place = transfer.positions[v]
        for eye in (place, place - 3 * up, place + 3 * up):
            assert close(module(lights(), eye=eye)[v], wanted[v], 8)


def test_gradients_are_finite_wherever_the_eye_is(kind):
    transfer = random_glossy(kind, vertices=3)
    transfer.normals[0], gloss(transfer).tangents[0] = torch.tensor([0.0, 1.0, 0.0]), torch.tensor([1.0, 0.0, 0.0])
    module, place = shader(transfer), transfer.positions[0]
    below = torch.tensor([0.0, -2.0, 0.0])
    for eye in (place, place + below, place - below, place + 1e-30, place + 1e-12, 1e30 * below, EYE):
        eye = eye.clone().requires_grad_()
        radiance = module(lights(), eye=eye)
        radiance.sum().backward()
        assert radiance.isfinite().all()
        assert eye.grad.isfinite().all()


def test_a_receiver_without_a_normal_has_no_glossy_layer(kind):
    transfer = random_glossy(kind, channels=1 if kind == "visibility" else 3)
    transfer.normals[2] = 0
    module = shader(transfer)
    below = module.layers["diffuse"](lights()).mT
    for eye in (EYE, transfer.positions[2]):
        radiance = module(lights(), eye=eye)
        assert radiance.isfinite().all()
        assert torch.equal(radiance[2], below[2])
    # The transfer itself was left alone.
    assert (stored(transfer)[0, :, 2] if kind == "visibility" else stored(transfer)[0, 2]).abs().max() > 0


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_storage_alone(kind, dtype):
    stored = random_glossy(kind).to(dtype)
    module = shader(stored)
    assert all(layer.signal.values.dtype == torch.float32 for layer in module.layers.values())
    assert close(module(lights(), eye=EYE), by_definition(stored, lights(), eye=EYE), 64)


def test_float64_transfer_or_a_wish_makes_a_float64_shader(kind):
    light, eye = lights(dtype=torch.float64), EYE.double()
    exact = random_glossy(kind, dtype=torch.float64)
    radiance = shader(exact)(light, eye=eye)
    assert radiance.dtype == torch.float64
    assert close(radiance, by_definition(exact, light, eye=eye), 1000)
    stored = random_glossy(kind)
    radiance = shader(stored, dtype=torch.float64)(light, eye=eye)
    assert radiance.dtype == torch.float64
    # Tangents stored in float32 are orthogonal to float32: ways to use the frame differ by as much.
    assert close(radiance.float(), by_definition(stored, light, eye=eye), 16)


def test_a_transfer_of_lower_order_answers_to_the_first_bands(kind):
    transfer = random_glossy(kind)
    light = lights()
    light[4:] = 0
    assert close(shader(transfer.to_order(2))(light[:4], eye=EYE), shader(transfer)(light, eye=EYE), 32)


def test_a_state_dict_moves_a_shader(kind):
    module, other = shader(random_glossy(kind, seed=1)), shader(random_glossy(kind, seed=2))
    assert not torch.equal(module(lights(), eye=EYE), other(lights(), eye=EYE))
    other.load_state_dict(module.state_dict())
    assert torch.equal(module(lights(), eye=EYE), other(lights(), eye=EYE))


def test_the_given_transfer_is_left_alone_by_learning(kind):
    transfer = random_glossy(kind)
    before = gloss(transfer).specular.clone()
    module = shader(transfer, learn=["specular", "albedo", "diffuse.values"])
    wanted = {f"layers.{kind}.specular", "layers.diffuse.albedo", "layers.diffuse.signal.values"}
    assert {name for name, _ in module.named_parameters()} == wanted
    with torch.no_grad():
        module.layers[kind].specular.zero_()
    assert torch.equal(gloss(transfer).specular, before)


def test_factors_may_come_from_a_function_instead_of_the_table():
    transfer = random_glossy("factored")
    calls = []

    def views(local):
        calls.append(local.shape)
        return local[..., [0, 1, 2, 2]]

    found = shader(transfer, views=views)(lights(), view=EYE)
    table = shader(transfer)
    table.layers["factored"].exit_values = lambda local: local[..., [0, 1, 2, 2]]
    assert torch.equal(found, table(lights(), view=EYE))
    assert calls == [(7, 3)]
