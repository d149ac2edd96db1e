"""Do layers of any kind and any signal add up, whatever is beside them?"""

import dataclasses

import pytest
import torch
from lobe_maps import random_map
from transfers import KINDS, by_definition, gloss, random_glossy, replaced
from zonal_transfers import random_zonal, random_zonal_factored, turned_by_hand, turns

from torchprt import brdf
from torchprt.compression import compress, decompress
from torchprt.errors import InputError
from torchprt.shade import DenseSignal, Making, SignalModule, at_rest, shader, signal_module
from torchprt.transfer import Clustered, Dense, Diffuse, Exit, Incident, Vertices

EPSILON = torch.finfo(torch.float64).eps
EYE = torch.tensor([0.3, -4.0, 2.0], dtype=torch.float64)
MAKING = Making(random_glossy().receivers, torch.float64)


def lights(*batch, order=4, seed=1):
    return torch.randn(*batch, order**2, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def close(value, wanted, epsilons):
    return (value - wanted).abs().max() <= epsilons * EPSILON * wanted.abs().max()


def in_lobes(kind, glossy=4, channels=1, exact=True, diffuse=True):
    """Transfer whose layers all follow a pose, the last one of a kind that need not be factored."""
    rows = 2 if kind == "factored" else 4
    transfer = random_zonal_factored(
        glossy=glossy, rows=rows, channels=channels, exact=exact, diffuse=diffuse, dtype=torch.float64
    )
    if kind == "factored":
        return transfer
    factored = transfer.layers["factored"]
    common = {name: getattr(factored, name) for name in ("signal", "receivers", "tangents", "specular")}
    layer = Exit(output_order=2, **common) if kind == "exit" else Incident(**common)
    below = {name: layer for name, layer in transfer.layers.items() if name != "factored"}
    return dataclasses.replace(transfer, layers={**below, kind: layer})


def two_coats():
    """A diffuse layer of all vertices, another of some, and two layers of exit matrices of others each."""
    base = random_glossy(dtype=torch.float64, glossy=5)
    coat = gloss(random_glossy(dtype=torch.float64, glossy=4, output_order=2, channels=3, seed=3))
    # Its own frames, about the normals of the base.
    tangents = torch.linalg.cross(base.normals[coat.receivers], torch.eye(3, dtype=torch.float64)[:1].expand(4, 3))
    coat = coat.replace(tangents=torch.nn.functional.normalize(tangents, dim=1))
    some = Diffuse(
        signal=Dense(values=lights(3).permute(2, 1, 0).contiguous()),
        albedo=torch.tensor([[0.2], [0.5], [0.7]], dtype=torch.float64),
        receivers=torch.tensor([0, 3, 6]),
    )
    return base.with_layers(stain=some, coat=coat)


# Misuse


@pytest.mark.parametrize("look", [{"eye": EYE}, {"view": EYE}])
def test_refuses_an_eye_that_nothing_depends_on(make_transfer, look):
    message = "eye or view is given, but what this shader gives does not depend on it: omit it"
    for module in (shader(make_transfer()), shader(random_zonal()), shader(random_glossy()).fix_eye(eye=EYE.float())):
        for call in (module.vectors, module.fix_eye, lambda module=module, **k: module(lights().float(), **k)):
            with pytest.raises(InputError, match=message):
                call(**look)


def test_refuses_a_pose_that_nothing_follows(make_transfer):
    message = "frames or positions are given, but this shader has one pose: omit them"
    transfer = make_transfer()
    mixed = random_zonal_factored().with_layers(diffuse=random_glossy(vertices=9).layers["diffuse"])
    for module, look in (
        (shader(transfer), {}),
        (shader(random_zonal(5)).fix_pose(), {}),
        (shader(mixed), {"view": EYE.float()}),
    ):
        for pose in ({"frames": turns(module.vertices)}, {"positions": torch.zeros(module.vertices, 3)}):
            with pytest.raises(InputError, match=message):
                module(lights().float(), **look, **pose)
            with pytest.raises(InputError, match=message):
                module.vectors(**look, **pose)
        with pytest.raises(InputError, match="fix_pose is for shaders that follow a pose"):
            module.fix_pose()


def test_refuses_to_fix_a_light_that_no_eye_looks_at(make_transfer):
    for module in (shader(make_transfer()), shader(random_zonal())):
        with pytest.raises(InputError, match="fix_light is for shaders that need an eye"):
            module.fix_light(lights().float())


def test_refuses_vectors_of_more_than_one(untyped):
    module = shader(random_zonal_factored(dtype=torch.float64))
    with pytest.raises(InputError, match="eye or view has a batch: fix one at a time"):
        module.vectors(view=EYE.expand(2, 3))
    with pytest.raises(InputError, match="frames or positions have a batch: fix one pose at a time"):
        module.vectors(view=EYE, frames=turns(2, 9, dtype=torch.float64))


def test_refuses_to_write_over_a_result_of_two_layers():
    with pytest.raises(InputError, match="out cannot be used with 2 layers: leave it out"):
        shader(random_glossy())(lights().float(), eye=EYE.float(), out=torch.zeros(7, 3))


@pytest.mark.parametrize(
    ("choice", "kind"), [({"method": "table"}, "exit"), ({"views": len}, "incident"), ({"exponent": 3.0}, "factored")]
)
def test_refuses_a_choice_that_no_layer_leaves_open(choice, kind):
    name = next(iter(choice))
    with pytest.raises(InputError, match=rf"{name} is given, but transfer of kind 'diffuse \+ {kind}' does not leave"):
        shader(random_glossy(kind), **choice)
    assert shader(random_glossy(kind), **{name: None}).order == 4


@pytest.mark.parametrize(
    "name", ["exit.albedo", "nothing.values", "diffuse.exit.values", ".", "exit.", "coat.kernel", ""]
)
def test_refuses_to_learn_what_a_layer_does_not_have(name):
    with pytest.raises(InputError, match=f"learn names '{name}': a shader of transfer of kind"):
        shader(two_coats(), learn=name)


# Layers of any name


@pytest.mark.parametrize("looks", [{"eye": EYE}, {"view": EYE}])
def test_layers_of_any_name_and_of_some_vertices_add_up(looks):
    transfer = two_coats()
    found = shader(transfer)(lights(), **looks)
    one = dataclasses.replace(transfer, layers={name: transfer.layers[name] for name in ("diffuse", "exit")})
    other = dataclasses.replace(transfer, layers={"coat": transfer.layers["coat"]})
    wanted = by_definition(one, lights(), **looks) + by_definition(other, lights(), **looks)
    stain = transfer.layers["stain"]
    for place, vertex in enumerate(stain.receivers):
        vector = stain.signal.values[..., place]
        wanted[vertex] += stain.albedo[place] * (vector * lights().T).sum(1)
    assert close(found, wanted, 1000)


@pytest.mark.parametrize("order", [["coat", "stain", "diffuse", "exit"], ["stain", "exit", "coat", "diffuse"]])
def test_the_order_of_layers_changes_nothing(order):
    transfer = two_coats()
    other = dataclasses.replace(transfer, layers={name: transfer.layers[name] for name in order})
    for light, eye in ((lights(), EYE), (lights(2), EYE), (lights(), EYE.expand(3, 3)), (lights(0), EYE)):
        wanted, found = shader(transfer)(light, eye=eye), shader(other)(light, eye=eye)
        assert found.shape == wanted.shape
        assert wanted.numel() == 0 or close(found, wanted, 64)


def test_a_layer_of_some_vertices_alone_leaves_the_others_dark():
    transfer = two_coats()
    alone = dataclasses.replace(transfer, layers={"stain": transfer.layers["stain"]})
    for light in (lights(), lights(2, 1)):
        radiance = shader(alone)(light)
        assert radiance.shape == (*light.shape[:-2], 7, 3)
        lit = radiance.abs().amax(-1).flatten(0, -2).amax(0) if light.ndim > 2 else radiance.abs().amax(-1)
        assert lit.nonzero().flatten().tolist() == [0, 3, 6]


def test_two_coats_are_fixed_as_one():
    module = shader(two_coats())
    wanted = module(lights(2), eye=EYE)
    assert close(module.fix_eye(eye=EYE)(lights(2)), wanted, 64)
    lit = module.fix_light(lights(2))
    assert close(lit(eye=EYE), wanted, 64)
    assert lit.exit_coefficients.shape == (2, 3, 9, 5)
    assert lit.coat_coefficients.shape == (2, 3, 4, 4)


def test_clustered_layers_beside_each_other_are_what_they_stand_for():
    whole = random_glossy(vertices=40, glossy=30, channels=3, dtype=torch.float64)
    packed = compress(compress(whole, layer="diffuse", clusters=3, components=2), clusters=2, components=3, bits=8)
    assert packed.kind == "clustered diffuse + clustered exit"
    assert all(isinstance(layer.signal, Clustered) for layer in packed.layers.values())
    module, reference = shader(packed, dtype=torch.float64), shader(decompress(packed), dtype=torch.float64)
    wanted = reference(lights(2), eye=EYE)
    # Representatives with weights of bytes are in half precision, and summed to float32 when they are written out.
    near = 64 * torch.finfo(torch.float32).eps * float(wanted.abs().max())
    for found in (
        module(lights(2), eye=EYE),
        module.fix_eye(eye=EYE)(lights(2)),
        module.fix_light(lights(2))(eye=EYE),
        (lights(2).mT.unsqueeze(-2) @ module.vectors(eye=EYE)).squeeze(-2).mT,
    ):
        assert (found - wanted).abs().max() <= near


# Lobes under every layer


@pytest.mark.parametrize("kind", ["exit", "factored", "incident"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("glossy", [0, 4, 9])
def test_rows_in_lobes_turn_with_the_surface(kind, channels, exact, glossy):
    transfer = in_lobes(kind, glossy, channels, exact)
    assert transfer.needs >= {"eye", "pose"}
    module, frames, posed = shader(transfer), turns(9, dtype=torch.float64), transfer.positions.roll(2, 0)
    wanted = turned_by_hand(transfer, frames, posed)
    for look in ({"eye": EYE}, {"view": EYE}):
        found = module(lights(), frames=frames, positions=posed, **look)
        assert close(found, by_definition(wanted, lights(), **look), 4096)
        assert (found - module(lights(), **look)).abs().max() > 0.01


@pytest.mark.parametrize(
    "choice", [{"exponent": 7.0}, {"brdf": brdf.Phong(6)}, {"brdf": brdf.Lambert(), "output_order": 1}]
)
def test_reflectance_is_chosen_for_rows_in_lobes_too(choice):
    transfer, frames = in_lobes("incident", diffuse=False), turns(9, dtype=torch.float64)
    posed = transfer.positions.roll(2, 0)
    found = shader(transfer, **choice)(lights(), eye=EYE, frames=frames, positions=posed)
    wanted = shader(turned_by_hand(transfer, frames, posed), **choice)(lights(), eye=EYE)
    assert close(found, wanted, 4096)
    if "exponent" in choice:
        exponent = torch.tensor(7.0)
        assert close(found, by_definition(turned_by_hand(transfer, frames, posed), lights(), EYE, None, exponent), 4096)


@pytest.mark.parametrize("kind", ["exit", "factored", "incident"])
def test_everything_turned_together_changes_nothing(kind):
    transfer, turn = in_lobes(kind), turns(dtype=torch.float64, seed=4)
    module, frames, posed = shader(transfer), turns(9, dtype=torch.float64), transfer.positions.roll(1, 0)
    still = module(lights(), eye=EYE, frames=frames, positions=posed)
    turned = module(lights(), turn, eye=turn @ EYE, frames=turn @ frames, positions=posed @ turn.mT)
    assert close(turned, still, 2**16)


@pytest.mark.parametrize("kind", ["exit", "factored", "incident"])
def test_an_eye_or_a_light_is_fixed_after_a_pose(kind):
    transfer = in_lobes(kind, channels=3)
    module, frames, posed = shader(transfer), turns(9, dtype=torch.float64), transfer.positions.roll(1, 0)
    fixed = module.fix_pose(frames, positions=posed)
    assert fixed.needs == {"eye"}
    for look in ({"eye": EYE}, {"view": EYE}):
        wanted = module(lights(2), frames=frames, positions=posed, **look)
        assert close(fixed(lights(2), **look), wanted, 1024)
        assert close(fixed.fix_eye(**look)(lights(2)), wanted, 1024)
        assert close(fixed.fix_light(lights(2))(**look), wanted, 1024)
    # Frames alone turn receivers where they are.
    wanted = module(lights(), view=EYE, frames=frames)
    assert close(module.fix_pose(frames).fix_light(lights())(view=EYE), wanted, 1024)
    # Without a pose the one of the bake.
    wanted = module(lights(), eye=EYE)
    assert close(module.fix_light(lights())(eye=EYE), wanted, 1024)
    assert close(module.fix_eye(eye=EYE)(lights()), wanted, 1024)


def test_lobes_beside_a_layer_that_stands_still_are_at_rest():
    transfer = in_lobes("exit")
    still = transfer.with_layers(diffuse=at_rest(transfer).layers["diffuse"])
    assert still.needs == {"eye"}
    assert close(shader(still)(lights(), eye=EYE), shader(transfer)(lights(), eye=EYE), 256)


@pytest.mark.parametrize("kind", ["exit", "factored", "incident"])
def test_rows_in_lobes_are_read_from_the_table_of_a_light_too(kind):
    transfer, frames = in_lobes(kind, glossy=9, diffuse=False), turns(9, dtype=torch.float64)
    wanted = shader(transfer)(lights(2), view=EYE, frames=frames)
    off = shader(transfer, method="table")(lights(2), view=EYE, frames=frames) - wanted
    # What is stated for order 4, of one lobe.
    assert 0 < off.norm() / wanted.norm() < 0.01


# At rest


@pytest.mark.parametrize("kind", ["exit", "factored", "incident"])
def test_at_rest_lobes_are_the_matrices_that_they_stand_for(kind):
    transfer = in_lobes(kind, channels=3)
    dense = at_rest(transfer)
    assert dense.kind == f"diffuse + {kind}"
    assert dense.needs == transfer.needs - {"pose"}
    assert {name: layer.signal.shape for name, layer in dense.layers.items()} == {
        name: layer.signal.shape for name, layer in transfer.layers.items()
    }
    identity = torch.eye(3, dtype=torch.float64).expand(9, 3, 3)
    wanted = turned_by_hand(transfer, identity, transfer.positions)
    for name, layer in dense.layers.items():
        assert close(layer.signal.values, wanted.layers[name].signal.values, 64)
    assert close(shader(dense)(lights(), eye=EYE), shader(transfer)(lights(), eye=EYE), 256)
    dense.check()


def test_at_rest_half_precision_is_widened_and_what_stands_still_is_left_alone():
    packed = compress(random_glossy(vertices=9), clusters=1, components=1)
    mixed = packed.with_layers(diffuse=random_zonal(dtype=torch.float64).to(torch.float16).layers["diffuse"])
    dense = at_rest(mixed)
    assert dense.layers["exit"] is mixed.layers["exit"]
    assert dense.layers["diffuse"].signal.dtype == torch.float32
    assert at_rest(packed).layers == packed.layers


def test_a_patch_at_rest_is_one_still():
    patch = random_map(rows=2, columns=3)
    dense = at_rest(patch)
    assert dense.receivers is patch.receivers
    assert close(shader(dense)(lights()), shader(patch)(lights()), 64)


def test_at_rest_receivers_without_a_normal_have_no_gloss():
    transfer = in_lobes("exit")
    transfer.normals[gloss(transfer).receivers[1]] = 0
    values = gloss(at_rest(transfer)).signal.values
    assert not values[:, 1].any()
    assert values[:, [0, 2, 3]].abs().amax((0, 2, 3)).min() > 0


# Vectors


@pytest.mark.parametrize("make", [random_zonal, random_zonal_factored, lambda dtype: in_lobes("exit", channels=3)])
def test_vectors_are_what_a_light_is_multiplied_with(make):
    transfer = make(dtype=torch.float64)
    module = shader(transfer)
    look = {"eye": EYE} if "eye" in module.needs else {}
    posed = transfer.positions.roll(1, 0)
    for pose in (
        {},
        {"positions": posed},
        {"frames": turns(9, dtype=torch.float64), **({"positions": posed} if look else {})},
    ):
        vectors = module.vectors(**look, **pose)
        assert vectors.shape == (3, 16, 9)
        wanted = module(lights(5), **look, **pose)
        assert close(torch.einsum("cnv,bnc->bvc", vectors, lights(5)), wanted, 1024)


@pytest.mark.parametrize("kind", KINDS)
def test_vectors_hold_the_weights_of_all_layers(kind):
    transfer = random_glossy(kind, glossy=4, albedo=(1, 1), specular=("G", 1), dtype=torch.float64)
    module = shader(transfer)
    vectors = module.vectors(eye=EYE)
    # One channel where no weight has more.
    assert vectors.shape == (1, 16, 7)
    assert close((vectors[0].T @ lights()), module(lights(), eye=EYE), 256)
    dark = replaced(transfer, "diffuse", albedo=torch.zeros(1, 1, dtype=torch.float64))
    dark = replaced(dark, specular=torch.zeros(1, 1, dtype=torch.float64))
    assert not shader(dark).vectors(view=EYE).any()


def test_vectors_carry_gradients_to_eye_and_weights():
    module = shader(random_glossy(dtype=torch.float64, vertices=2, order=2), learn=["specular", "albedo"])
    eye = EYE.clone().requires_grad_()
    module.vectors(eye=eye).square().sum().backward()
    assert eye.grad.abs().max() > 0
    assert all(parameter.grad.abs().max() > 0 for parameter in module.parameters())


# Signals


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3), (0,)])
@pytest.mark.parametrize("rows", [1, 4])
def test_what_rows_send_follows_from_vectors_toward_an_eye(channels, batch, rows):
    """Signals that say nothing but `toward` send what those with a faster way do."""
    values = torch.randn(channels, 9, rows, 16, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    dense = signal_module(Dense(values=values), MAKING)
    wanted = torch.einsum("cgmn,...nc->...cmg", values.expand(3, -1, -1, -1), lights(*batch))
    for found in (DenseSignal.under(dense, lights(*batch)), SignalModule.under(dense, lights(*batch))):
        assert found.shape == (*batch, 3, rows, 9)
        assert wanted.numel() == 0 or close(found, wanted, 64)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("kind", ["clustered", "shared axes", "zonal"])
def test_every_signal_sends_what_its_numbers_do(channels, kind):
    if kind == "zonal":
        transfer = in_lobes("exit", channels=channels)
        signal, wanted = gloss(transfer).signal, gloss(at_rest(transfer)).signal
    else:
        whole = random_glossy(vertices=20, channels=channels, dtype=torch.float64)
        shared = 5 if kind == "shared axes" else None
        signal = gloss(compress(whole, clusters=2, components=2, shared=shared)).signal
        wanted = signal.dense()
    made, dense = (signal_module(each, MAKING) for each in (signal, wanted))
    assert made.shape == dense.shape == signal.shape
    near = 64 * (EPSILON if wanted.dtype == torch.float64 else torch.finfo(torch.float32).eps)
    for one in (made.under, lambda light: SignalModule.under(made, light)):
        found, sent = one(lights(2)), dense.under(lights(2))
        assert (found - sent).abs().max() <= near * sent.abs().max()


def test_a_dense_signal_of_one_row_is_shaded_in_either_layout():
    """As decompressing leaves it."""
    vectors = lights(7).permute(2, 1, 0).contiguous()
    transfer = random_glossy(output_order=1, channels=3, dtype=torch.float64)
    as_rows = transfer.with_layers(
        diffuse=transfer.layers["diffuse"].replace(signal=Dense(values=vectors.mT[:, :, None])),
        exit=gloss(transfer).replace(signal=Dense(values=vectors)),
    )
    assert close(shader(as_rows)(lights(), eye=EYE), by_definition(as_rows, lights(), eye=EYE), 256)
    packed = compress(random_glossy(output_order=1, vertices=20), clusters=1, components=3)
    wanted = shader(packed, dtype=torch.float64)(lights(), eye=EYE)
    found = shader(decompress(packed), dtype=torch.float64)(lights(), eye=EYE)
    assert (found - wanted).abs().max() <= 64 * torch.finfo(torch.float32).eps * wanted.abs().max()


# Learning


@pytest.mark.parametrize(
    ("learn", "wanted"),
    [
        ("exit.values", {"exit.signal.values"}),
        ("values", {"diffuse.signal.values", "stain.signal.values", "coat.signal.values", "exit.signal.values"}),
        (["coat.specular", "stain.albedo"], {"coat.specular", "stain.albedo"}),
        (["specular", "exit.specular"], {"coat.specular", "exit.specular"}),
    ],
)
def test_what_is_learned_is_of_one_layer_or_of_all_that_have_it(learn, wanted):
    module = shader(two_coats(), learn=learn)
    assert {name.removeprefix("layers.") for name, _ in module.named_parameters()} == wanted
    module(lights(), eye=EYE).square().sum().backward()
    for parameter in module.parameters():
        assert parameter.grad.abs().max() > 0


def test_exit_matrices_are_learned_from_pictures_and_the_transfer_is_left_alone():
    transfer = random_glossy(vertices=2, order=2, output_order=1, dtype=torch.float64)
    module = shader(transfer, learn="exit.values")
    parameter = module.layers["exit"].signal.values
    before = gloss(transfer).signal.values.clone()
    truth = shader(replaced(transfer, values=before + 1))
    light = lights(8, order=2)
    pictures = truth(light, eye=EYE).detach()
    optimiser = torch.optim.LBFGS(module.parameters(), max_iter=100, tolerance_grad=1e-14, tolerance_change=0)

    def loss():
        optimiser.zero_grad()
        value = (module(light, eye=EYE) - pictures).square().mean()
        value.backward()
        return value

    optimiser.step(loss)
    # 24 numbers of pictures for the four of a receiver.
    assert (parameter - before - 1).abs().max() < 1e-6
    assert torch.equal(gloss(transfer).signal.values, before)


def test_refuses_to_learn_what_bounces_have_baked_in_of_one_layer():
    transfer = dataclasses.replace(two_coats(), bounces=1)
    with pytest.raises(InputError, match="specular cannot be learned: 1 bounce of"):
        shader(transfer, learn="coat.specular")
    assert len(list(shader(transfer, learn="coat.values").parameters())) == 1


def test_vertices_without_any_layer_of_theirs_are_shaded():
    transfer = two_coats()
    none = Vertices(positions=torch.zeros(0, 3), normals=torch.zeros(0, 3), faces=torch.zeros(0, 3).long())
    empty = dataclasses.replace(
        transfer,
        receivers=none,
        layers={"stain": transfer.layers["stain"].take(torch.zeros(0).long(), torch.zeros(0).long())},
    )
    assert shader(empty)(lights()).shape == (0, 3)
