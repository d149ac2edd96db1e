"""Does a shader with receivers at fixed orders give what their orders give?"""

import functools

import pytest
import torch
from every_shader import asked, every_transfer
from transfers import random_glossy

from torchprt.errors import InputError
from torchprt.shade import adaptive, fixed_orders, shader

ORDER = 4
made = functools.cache(every_transfer)
NAMES = [name for name in made() if "clustered" not in name]


def lights(*batch, order=ORDER, dtype=torch.float64, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*batch, order**2, 3, generator=generator, dtype=torch.float64).to(dtype)


def mixed(module, seed=0):
    """Orders 2, 3 and 4 at random for the last layer."""
    name, layer = list(module.layers.items())[-1]
    generator = torch.Generator().manual_seed(seed)
    return {name: torch.tensor([2, 3, 4])[torch.randint(0, 3, (layer.signal.shape[0],), generator=generator)]}


# Misuse


@pytest.mark.parametrize(
    ("orders", "message"),
    [
        ({"gloss": torch.ones(9, dtype=torch.int64)}, "orders name a layer 'gloss': the shader has 'diffuse', 'exit'"),
        (
            {"exit": torch.ones(8, dtype=torch.int64)},
            r"orders of layer 'exit' have shape \[8\].* each of its 9 receivers",
        ),
        ({"exit": torch.ones(9)}, "dtype torch.float32: give a whole number"),
        ({"exit": torch.zeros(9, dtype=torch.int64)}, "are 0 to 0: they must be 1 to 4, the shader's"),
        ({"exit": torch.full((9,), 5)}, "are 5 to 5: they must be 1 to 4"),
    ],
)
def test_refuses_orders_that_do_not_fit(untyped, orders, message):
    with pytest.raises(InputError, match=message):
        fixed_orders(shader(made()["exit dense 1"]), orders)


def test_refuses_a_layer_whose_receivers_cost_the_same_at_any_order():
    module = shader(made()["exit clustered 1"])
    with pytest.raises(InputError, match="saves nothing with ClusteredSignal"):
        fixed_orders(module, mixed(module))


def test_refuses_half_of_what_lobes_hold_as_one():
    module = shader(made()["diffuse zonal 1"])
    with pytest.raises(InputError, match="bands 0 and 1 of zonal lobes are held as one: give orders of 2 or more"):
        fixed_orders(module, {"diffuse": torch.ones(module.layers["diffuse"].signal.shape[0], dtype=torch.int64)})


def test_nothing_named_is_the_shader():
    module = shader(made()["exit dense 1"])
    assert list(fixed_orders(module, {}).layers) == list(module.layers)


# What they give


@pytest.mark.parametrize("name", NAMES)
def test_all_at_the_order_of_the_light_is_the_shader(name):
    transfer = made(torch.float64)[name]
    module = shader(transfer)
    whole = {each: torch.full((layer.signal.shape[0],), ORDER) for each, layer in module.layers.items()}
    look = asked(module.needs, transfer.vertices, dtype=torch.float64)
    found = fixed_orders(module, whole)(lights(2), **look)
    torch.testing.assert_close(found, module(lights(2), **look), rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("name", [name for name in NAMES if "visibility" not in name])
def test_each_receiver_gets_the_bands_of_its_order(name):
    transfer = made(torch.float64)[name]
    module = shader(transfer)
    ((layer, orders),) = mixed(module).items()
    look = asked(module.needs, transfer.vertices, dtype=torch.float64)
    found = fixed_orders(module, {layer: orders})(lights(2), **look)
    receivers = module.layers[layer].receivers
    receivers = torch.arange(transfer.vertices) if receivers is None else receivers
    for order in (2, 3, 4):
        cut = lights(2)
        cut[..., order**2 :, :] = 0
        # Only that layer is cut.
        rest = module(lights(2), **look) - alone(module, layer, lights(2), look)
        wanted = rest + alone(module, layer, cut, look)
        chosen = receivers[orders == order]
        torch.testing.assert_close(found[..., chosen, :], wanted[..., chosen, :], rtol=1e-10, atol=1e-11)


def alone(module, name, light, look):
    """The radiance of one layer."""
    layer = module.layers[name]
    pose = module.pose(look.get("frames"), None) if "frames" in look else None
    posed = None if pose is None else layer.among(pose, -3)
    values = layer.values(None, look.get("view"), posed, None)
    return layer.spread(layer(light, values, posed), None, module.vertices).mT


def test_receivers_of_visibility_get_the_product_of_their_order():
    transfer = random_glossy("visibility", vertices=12, order=6, dtype=torch.float64)
    module, look = shader(transfer), {"view": torch.tensor([1.0, 2, 3], dtype=torch.float64)}
    coarse, fine = (torch.full((12,), order) for order in (3, 6))
    some = torch.where(torch.arange(12) % 3 == 0, 3, 6)
    light = lights(order=6)
    low, high, found = (fixed_orders(module, {"visibility": each})(light, **look) for each in (coarse, fine, some))
    torch.testing.assert_close(found, torch.where((some == 3)[:, None], low, high))
    infinite = adaptive(module, diffuse=None, specular=float("inf"))
    torch.testing.assert_close(low, infinite(light, **look).radiance)


@pytest.mark.parametrize("name", ["diffuse zonal 1", "exit dense 3", "visibility dense 1"])
def test_eye_light_and_pose_can_be_fixed_then(name):
    transfer = made(torch.float64)[name]
    whole = shader(transfer)
    module = fixed_orders(whole, mixed(whole))
    look = asked(module.needs, transfer.vertices, dtype=torch.float64)
    wanted = module(lights(), **look)
    if "pose" in module.needs:
        module = module.fix_pose(look.pop("frames"))
        torch.testing.assert_close(module(lights(), **look), wanted)
    if "eye" in module.needs:
        torch.testing.assert_close(module.fix_light(lights())(**look), wanted)
        torch.testing.assert_close(module.fix_eye(**look)(lights()), wanted)


def test_the_regions_of_a_set_of_lights_are_such_orders(make_transfer):
    transfer = make_transfer(side=12, order=7, dtype=torch.float64)
    module, light = shader(transfer), lights(5, order=7)
    light[:, 0] = 3
    found, regions = adaptive(module, transfer.faces, diffuse=0.2)(light)
    orders = regions.orders
    assert len(set(orders["diffuse"].tolist())) > 1
    fixed = fixed_orders(module, orders)
    # A receiver stands at the highest order that it has under any of the lights.
    error = (fixed(light) - module(light)).square().mean()
    assert float(error) < 1.2 * float((found - module(light)).square().mean())
