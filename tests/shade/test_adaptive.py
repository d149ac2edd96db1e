"""Is adaptive shading what it says: all that matters of the full shading, and no more?"""

import functools
import itertools
import math

import pytest
import torch
from adaptive_twin import adapted, neighbours_of
from every_shader import asked, every_transfer
from transfers import random_glossy

from torchprt import sh
from torchprt.errors import InputError
from torchprt.shade import adaptive, shader, white
from torchprt.transfer import Transfer

ORDER = 7
made = functools.cache(every_transfer)
HARD = {"blend": 0, "hysteresis": 1}


def lights(*batch, order=ORDER, dtype=torch.float64, seed=1):
    generator = torch.Generator().manual_seed(seed)
    light = torch.randn(*batch, order**2, 3, generator=generator, dtype=torch.float64)
    light[..., 0, :] = 3
    return light.to(dtype)


def grid(make_transfer, side=9, order=ORDER, dtype=torch.float64, **options):
    """Diffuse transfer on a grid whose high bands are strong in a corner and vanish away from it."""
    transfer = make_transfer(side=side, order=order, dtype=dtype, **options)
    values = transfer.layers["diffuse"].signal.values
    corner = transfer.positions - transfer.positions[:1]
    values[:, 9:] *= 3 * torch.exp(-2 * corner.norm(dim=-1)).to(values)
    return transfer


def glossy_on_grid(make_transfer, kind="visibility", side=6, order=6, glossy=None, dtype=torch.float64):
    """A layer that depends on the eye over the faces of a grid."""
    transfer = random_glossy(kind, vertices=side * side, glossy=glossy, order=order, dtype=dtype)
    return transfer, make_transfer(side=side, dtype=dtype).faces


def truncated(light, order):
    kept = light.clone()
    kept[..., order**2 :, :] = 0
    return kept


# Misuse


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"diffuse": -0.1}, "diffuse is -0.1: a threshold is a part of white, zero or more, or None"),
        ({"specular": math.nan}, "specular is nan: a threshold"),
        ({"hysteresis": 1.5}, "hysteresis is 1.5: give a number from 0 to 1"),
        ({"blend": -1}, "blend is -1: give a number from 0 to 1"),
        ({"against": "first"}, "against 'first' is unknown: use 'last' or 'base'"),
        ({"rings": -1}, "rings is -1: give zero or more"),
        ({"levels": (3, 5)}, r"levels are \[3, 5\]: they must rise from an order of 1 or more to 7"),
        ({"levels": (3, 3, 7)}, "they must rise"),
        ({"levels": ()}, "they must rise"),
    ],
)
def test_refuses_options_that_make_no_sense(make_transfer, options, message):
    with pytest.raises(InputError, match=message):
        adaptive(shader(grid(make_transfer)), **options)


def test_refuses_faces_of_another_mesh(make_transfer):
    module = shader(grid(make_transfer, side=3))
    with pytest.raises(InputError, match="faces name vertices outside 0 to 8"):
        adaptive(module, make_transfer(side=4).faces)
    with pytest.raises(InputError, match="triangles"):
        adaptive(module, torch.zeros(2, 4, dtype=torch.int64))


def test_refuses_transfer_whose_receivers_cost_the_same_at_any_order():
    with pytest.raises(InputError, match="saves nothing with ClusteredSignal"):
        adaptive(shader(made()["exit clustered 1"]))
    # What is shaded whole is not asked.
    module = adaptive(shader(made()["exit clustered 1"]), specular=None)
    assert list(module.adaptive) == []


def test_refuses_regions_of_another_batch(make_transfer):
    module = adaptive(shader(grid(make_transfer)), diffuse=0.1)
    regions = module(lights(2)).regions
    with pytest.raises(InputError, match="regions are of another shader or batch"):
        module(lights(3), regions=regions)
    with pytest.raises(InputError, match="regions are of another shader or batch"):
        adaptive(shader(grid(make_transfer, side=4)), diffuse=0.1)(lights(2), regions=regions)


def test_takes_what_the_shader_takes(make_transfer):
    module = adaptive(shader(grid(make_transfer)), diffuse=0.01)
    with pytest.raises(InputError, match="eye or view is given"):
        module(lights(), eye=torch.ones(3, dtype=torch.float64))
    with pytest.raises(InputError, match="of order 7"):
        module(lights(order=4))


# Extremes


@pytest.mark.parametrize("side", [0, 1, 2])
def test_there_may_be_nothing_one_vertex_or_four(make_transfer, side):
    transfer = grid(make_transfer, side=side) if side else make_transfer(side=0, order=ORDER, dtype=torch.float64)
    module = shader(transfer)
    found, regions = adaptive(module, transfer.faces, diffuse=0)(lights(2))
    torch.testing.assert_close(found, module(lights(2)))
    assert regions.orders["diffuse"].tolist() == [ORDER] * side**2


@pytest.mark.parametrize("order", [1, 2, 3, 4, 14])
def test_works_from_order_1_to_14(make_transfer, order):
    module = shader(make_transfer(order=order, dtype=torch.float64))
    light = lights(order=order)
    torch.testing.assert_close(adaptive(module, diffuse=0)(light).radiance, module(light))
    coarse = adaptive(module, diffuse=math.inf)(light).radiance
    torch.testing.assert_close(coarse, module(truncated(light, 3)))


def test_black_stays_black(make_transfer):
    transfer = grid(make_transfer)
    found, _ = adaptive(shader(transfer), transfer.faces, diffuse=0.01)(torch.zeros(ORDER**2, 3, dtype=torch.float64))
    assert float(found.abs().max()) == 0


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_scale_of_the_light_only_scales_radiance(make_transfer, scale):
    transfer = grid(make_transfer)
    module = adaptive(shader(transfer), transfer.faces, diffuse=0.05)
    one, other = module(lights()), module(scale * lights())
    torch.testing.assert_close(other.radiance / scale, one.radiance, rtol=1e-12, atol=1e-12)
    assert torch.equal(one.regions.orders["diffuse"], other.regions.orders["diffuse"])


# The ends of the scale of thresholds


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", [name for name in made() if "clustered" not in name or "visibility" in name])
def test_threshold_zero_is_the_shader(name, dtype):
    transfer = made(dtype)[name]
    module = shader(transfer)
    light, look = lights(2, order=4, dtype=dtype), asked(module.needs, transfer.vertices, dtype=dtype)
    wanted = module(light, **look)
    whole = {"diffuse": None} if "clustered" in name else {"diffuse": 0}
    found, regions = adaptive(module, specular=0, **whole)(light, **look)
    # The nodes of a product have other rounding than those that the layer stores: its terms are added up to 20 times.
    tolerance = 400 * torch.finfo(dtype).eps * float(wanted.abs().max())
    torch.testing.assert_close(found, wanted, rtol=0, atol=tolerance)
    assert all(bool((orders == 4).all()) for orders in regions.orders.values())


@pytest.mark.parametrize("kind", ["diffuse", "exit", "factored", "incident"])
def test_threshold_infinity_is_order_3(make_transfer, kind):
    if kind == "diffuse":
        transfer, light, look = grid(make_transfer), lights(), {}
    else:
        transfer, _ = glossy_on_grid(make_transfer, kind)
        light, look = lights(order=6), {"view": torch.tensor([1.0, 2, 3], dtype=torch.float64)}
    module = shader(transfer)
    found, regions = adaptive(module, diffuse=math.inf, specular=math.inf)(light, **look)
    torch.testing.assert_close(found, module(truncated(light, 3), **look))
    assert all(bool((orders == 3).all()) for orders in regions.orders.values())


def test_threshold_none_shades_a_layer_whole(make_transfer):
    transfer, faces = glossy_on_grid(make_transfer)
    module = shader(transfer)
    look = {"view": torch.tensor([1.0, 2, 3], dtype=torch.float64)}
    found, regions = adaptive(module, faces, diffuse=None, specular=None)(lights(order=6), **look)
    torch.testing.assert_close(found, module(lights(order=6), **look))
    assert regions.layers == {}


# Against the twin


@pytest.mark.parametrize("against", ["last", "base"])
@pytest.mark.parametrize(
    ("rings", "grow", "with_faces"), [(0, False, True), (0, True, True), (2, True, True), (2, True, False)]
)
@pytest.mark.parametrize("threshold", [0.002, 0.01, 0.05])
def test_agrees_with_the_algorithms_vertex_by_vertex(make_transfer, against, rings, grow, with_faces, threshold):
    transfer = grid(make_transfer, side=12)
    module, faces = shader(transfer), transfer.faces if with_faces else None
    orders = (3, 4, 6, ORDER)
    light = lights()
    radiance = [module(truncated(light, order)) / transfer.albedo for order in orders]
    wanted, reached = adapted(
        radiance, transfer.albedo, orders, threshold * float(white(light)), faces, against, rings, grow
    )
    options = {"against": against, "rings": rings, "grow": grow, "levels": orders}
    found, regions = adaptive(module, faces, diffuse=threshold, **options, **HARD)(light)
    torch.testing.assert_close(found, wanted)
    assert regions.orders["diffuse"].tolist() == reached
    assert len(set(reached)) > 1


@pytest.mark.parametrize(("glossy", "threshold"), [(None, 1.2), (25, 0.6)])
def test_agrees_with_the_algorithms_for_products(make_transfer, glossy, threshold):
    transfer, faces = glossy_on_grid(make_transfer, glossy=glossy)
    look = {"view": torch.tensor([1.0, 2, 3], dtype=torch.float64)}
    light, orders = lights(order=6), (2, 3, 5, 6)
    module = shader(transfer)
    layer = module.layers["visibility"]
    values = layer.signal.values.clone()
    radiance = []
    for order in orders:
        layer.signal.values[:, order**2 :] = 0
        radiance.append(layer(truncated(light, order), layer.values(None, look["view"])).mT / layer.weight)
        layer.signal.values.copy_(values)
    among = transfer.layers["visibility"].receivers.tolist()
    place = {receiver: at for at, receiver in enumerate(among)}
    kept = [[place[v] for v in face] for face in faces.tolist() if all(v in place for v in face)]
    # An edge of which another corner is missing is still an edge.
    edges = [[a, b, b] for a, others in enumerate(neighbours_of(faces, 36)) for b in others]
    edges = [[place[v] for v in edge] for edge in edges if all(v in place for v in edge)]
    wanted, reached = adapted(
        radiance, layer.weight, orders, threshold * float(white(light)), torch.tensor(kept + edges)
    )
    found, regions = adaptive(module, faces, diffuse=None, specular=threshold, levels=orders, **HARD)(light, **look)
    rest = module.layers["diffuse"](light).mT
    torch.testing.assert_close(found[among] - rest[among], wanted, rtol=1e-9, atol=1e-9)
    assert regions.orders["visibility"].tolist() == reached
    assert len(set(reached)) > 1


# What the thresholds bound


def test_the_error_falls_with_the_threshold_and_stays_in_its_size(make_transfer):
    transfer = grid(make_transfer, side=20)
    module, light = shader(transfer), lights()
    errors = []
    for threshold in (0.1, 0.03, 0.01, 0.003):
        found = adaptive(module, transfer.faces, diffuse=threshold)(light).radiance
        errors.append(float((found - module(light)).abs().max() / white(light)) / threshold)
    # What the bands above a level add is not known to be less than what it added: here it is, up to a factor.
    assert max(errors) < 4


def test_lights_add_up_within_the_thresholds(make_transfer):
    transfer = grid(make_transfer, side=20)
    module = adaptive(shader(transfer), transfer.faces, diffuse=0.01)
    one, other = lights(), lights(seed=2)
    parts = module(one).radiance + module(other).radiance
    gap = (module(one + other).radiance - parts).abs().max()
    assert 0 < float(gap) < 0.04 * float(white(one) + white(other) + white(one + other))


def test_a_light_in_a_batch_gets_what_it_gets_alone(make_transfer):
    transfer = grid(make_transfer, side=12)
    module = adaptive(shader(transfer), transfer.faces, diffuse=0.02)
    light = lights(3, 2)
    together = module(light).radiance
    for index in itertools.product(range(3), range(2)):
        # Growing ends where a hundredth of a level is gained, wherever another light leads it.
        torch.testing.assert_close(together[index], module(light[index]).radiance, rtol=0, atol=1e-3)


def test_work_is_the_union_of_the_regions(make_transfer):
    transfer = grid(make_transfer, side=12)
    module = adaptive(shader(transfer), transfer.faces, diffuse=0.02, grow=False)
    light = lights(3)
    alone = torch.stack([module(each).regions.orders["diffuse"] for each in light])
    assert torch.equal(module(light).regions.orders["diffuse"], alone.amax(0))


def test_turning_the_light_is_asking_for_the_rotation(make_transfer):
    transfer = grid(make_transfer)
    module = adaptive(shader(transfer), transfer.faces, diffuse=0.02)
    turn = sh.yaw_pitch_roll(torch.tensor([30.0, 40, 50], dtype=torch.float64))
    bright = white(lights())
    turned = sh.rotate(lights(), turn)
    # White is looked for among some directions, of the light as it is given.
    assert abs(float(white(turned) / bright) - 1) < 0.02
    full = adaptive(shader(transfer), transfer.faces, diffuse=0)
    torch.testing.assert_close(full(lights(), turn).radiance, full(turned).radiance)
    assert float((module(lights(), turn).radiance - module(turned).radiance).abs().max()) < 0.02 * float(bright)


# Regions


def pulse(make_transfer, side=9, hole=(), order=5):
    """Transfer of which bands 0 to 3 are smooth, band 3 marks vertex 0, and band 4 all of the grid but `hole`."""
    transfer = make_transfer(side=side, order=order, dtype=torch.float64, albedo=(1, 1))
    values = transfer.layers["diffuse"].signal.values
    values[:, 1:] = 0
    values[:, 9, 0] = 1
    values[:, 16] = 1
    values[:, 16, list(hole)] = 0
    light = torch.zeros(order**2, 3, dtype=torch.float64)
    light[0], light[9], light[16] = 1, 1, 1
    return transfer, light


def test_a_region_grows_along_edges_over_what_lower_orders_did_not_foretell(make_transfer):
    transfer, light = pulse(make_transfer)
    options = {"diffuse": 0.01, "levels": (3, 4, 5), **HARD}
    alone = adaptive(shader(transfer), transfer.faces, grow=False, **options)(light).regions.orders["diffuse"]
    assert (alone == 5).nonzero().flatten().tolist() == [0]
    grown = adaptive(shader(transfer), transfer.faces, **options)(light).regions.orders["diffuse"]
    assert bool((grown == 5).all())


def test_a_region_does_not_grow_over_a_gap(make_transfer):
    side = 9
    # Two columns wide, so that the ring behind the first is not evaluated.
    gap = [row * side + column for row in range(side) for column in (4, 5)]
    transfer, light = pulse(make_transfer, side, gap)
    found = adaptive(shader(transfer), transfer.faces, diffuse=0.01, levels=(3, 4, 5), **HARD)(light)
    orders = found.regions.orders["diffuse"].reshape(side, side)
    assert bool((orders[:, :5] == 5).all())
    assert bool((orders[:, 5:] == 4).all())
    torn = transfer.faces[~torch.isin(transfer.faces, torch.tensor(gap)).any(-1)]
    torn = adaptive(shader(transfer), torn, diffuse=0.01, levels=(3, 4, 5), **HARD)(light)
    assert bool((torn.regions.orders["diffuse"].reshape(side, side)[:, 4:] == 4).all())


@pytest.mark.parametrize("rings", [0, 1, 2, 3])
def test_rings_fade_outward_from_the_region(make_transfer, rings):
    side = 9
    transfer, light = pulse(make_transfer, side)
    centre = 4 * side + 4
    values = transfer.layers["diffuse"].signal.values
    values[:, 9:] = 0
    values[:, 9, centre] = values[:, 16, centre] = 1
    module = adaptive(shader(transfer), transfer.faces, diffuse=0.01, levels=(3, 4, 5), rings=rings, **HARD)
    added = module(light).radiance[:, 0] - shader(transfer)(truncated(light, 4))[:, 0]
    distance = hops(transfer.faces, centre, side * side)
    assert bool((added[distance > rings] == 0).all())
    means = [float(added[distance == ring].mean()) for ring in range(rings + 1)]
    assert all(high > low > 0 for high, low in itertools.pairwise(means))


def hops(faces, start, count):
    beside, far, edge, step = neighbours_of(faces, count), torch.full((count,), count), {start}, 0
    while edge:
        for g in edge:
            far[g] = step
        edge, step = {h for g in edge for h in beside[g] if far[h] == count}, step + 1
    return far


# From light to light


def strength(make_transfer, amounts, **options):
    """How much of the last level vertex 0 gets as the band before it grows and shrinks, frame after frame."""
    transfer, light = pulse(make_transfer, 1)
    module = adaptive(shader(transfer), diffuse=0.1, levels=(3, 4, 5), **options)
    regions, found = None, []
    for amount in amounts:
        scaled = light.clone()
        scaled[9] = amount * float(white(light)) / float(transfer.albedo[0, 0])
        regions = module(scaled, regions=regions).regions
        found.append(float(regions.layers["diffuse"].weights[0]))
    return found


def test_a_receiver_stays_in_until_the_difference_is_well_below_where_it_came_in(make_transfer):
    amounts = [0.09, 0.11, 0.09, 0.06, 0.04, 0.06, 0.09, 0.11]
    assert strength(make_transfer, amounts, blend=0, hysteresis=0.5) == [0, 1, 1, 1, 0, 0, 0, 1]
    assert strength(make_transfer, amounts, blend=0, hysteresis=1) == [0, 1, 0, 0, 0, 0, 0, 1]


def test_a_flicker_about_the_threshold_changes_nothing(make_transfer):
    amounts = [0.2, *[0.097, 0.103] * 10]
    assert strength(make_transfer, amounts, blend=0.1) == [1] * 21
    assert len(set(strength(make_transfer, amounts, blend=0, hysteresis=1))) == 2


def test_it_comes_in_smoothly(make_transfer):
    found = strength(make_transfer, torch.linspace(0.05, 0.15, 101).tolist(), blend=0.25)
    steps = torch.tensor(found).diff()
    assert found[0] == 0
    assert found[-1] == 1
    assert bool((steps >= 0).all())
    # The steepest slope of a smooth step is 1.5 of its mean; it rises over half of the threshold.
    assert float(steps.max()) < 1.6 * 0.001 / 0.05


def test_nothing_pops_under_a_turning_light(make_transfer):
    transfer = grid(make_transfer, side=14)
    module, light = shader(transfer), lights()
    turns = sh.yaw_pitch_roll(torch.stack([torch.linspace(0, 8, 80), *[torch.zeros(80)] * 2], -1).double())
    full = module(light, turns)

    def largest_change(**options):
        adapting, regions, errors = adaptive(module, transfer.faces, diffuse=0.05, **options), None, []
        for turn, wanted in zip(turns, full, strict=True):
            found, regions = adapting(light, turn, regions=regions)
            errors.append(found - wanted)
        return float(torch.stack(errors).diff(dim=0).abs().max())

    assert largest_change() < 0.25 * largest_change(**HARD)


# Gradients


@pytest.mark.parametrize("kind", ["diffuse", "exit", "visibility"])
def test_gradients_flow_to_light_eye_and_parameters(make_transfer, kind):
    if kind == "diffuse":
        transfer, learn, look = make_transfer(side=3, order=5, dtype=torch.float64), ["albedo", "values"], {}
    else:
        transfer = random_glossy(kind, vertices=4, order=5, dtype=torch.float64)
        learn, look = ["specular"], {"view": torch.tensor([1.0, 2, 3], dtype=torch.float64, requires_grad=True)}
    module = shader(transfer, learn=learn)
    blended = adaptive(module, transfer.faces, diffuse=0.1, specular=0.1, blend=1)
    light = lights(order=5).requires_grad_()
    assert torch.autograd.gradcheck(lambda light: blended(light, **look).radiance, (light,))
    blended(light, **look).radiance.square().sum().backward()
    found = [light.grad, *(each.grad for each in look.values()), *(each.grad for each in module.parameters())]
    assert all(each is not None and bool(each.isfinite().all()) and float(each.abs().max()) > 0 for each in found)


def test_follows_the_shader_to_another_dtype(make_transfer):
    transfer, faces = glossy_on_grid(make_transfer, dtype=torch.float32)
    module = adaptive(shader(transfer), faces, diffuse=0, specular=0).double()
    look = {"view": torch.tensor([1.0, 2, 3], dtype=torch.float64)}
    found = module(lights(order=6), **look).radiance
    assert found.dtype == torch.float64
    # The tables of a rule are made anew in float64; the layer itself keeps those that it had.
    torch.testing.assert_close(found, module.shader(lights(order=6), **look), rtol=0, atol=1e-4)
    assert set(module.state_dict()) == {f"shader.{name}" for name in module.shader.state_dict()}


def test_a_pose_is_followed():
    transfer: Transfer = made()["factored zonal 1"]
    module = shader(transfer)
    look = asked(module.needs, transfer.vertices)
    found = adaptive(module, diffuse=0, specular=0)(lights(2, order=4, dtype=torch.float32), **look).radiance
    torch.testing.assert_close(found, module(lights(2, order=4, dtype=torch.float32), **look), rtol=1e-4, atol=1e-4)
