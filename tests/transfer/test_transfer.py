"""Does transfer refuse layers that do not fit together, and say what it holds?"""

import dataclasses

import pytest
import torch
from transfers import KINDS, gloss, random_glossy, same, stored
from zonal_transfers import random_zonal, random_zonal_factored

from torchprt.compression import compress
from torchprt.errors import InputError
from torchprt.transfer import Transfer, Vertices


def with_layers(transfer, **layers):
    return dataclasses.replace(transfer, layers=layers)


def test_refuses_no_layer(make_transfer):
    with pytest.raises(InputError, match="the transfer has no layer: give one or more"):
        with_layers(make_transfer())


@pytest.mark.parametrize("name", ["", "two words", "a.b", "1st", "a/b"])
def test_refuses_a_name_that_is_none(make_transfer, name):
    transfer = make_transfer()
    with pytest.raises(InputError, match=f"layer '{name}' of the transfer: give it a name of letters"):
        with_layers(transfer, **{name: transfer.layers["diffuse"]})


@pytest.mark.parametrize("name", ["values", "keys", "forward", "type", "training"])
def test_refuses_a_name_that_modules_have(make_transfer, name):
    transfer = make_transfer()
    with pytest.raises(InputError, match=f"layer '{name}' of the transfer: modules of torch use that name"):
        with_layers(transfer, **{name: transfer.layers["diffuse"]})


def test_refuses_layers_of_other_orders():
    transfer = random_glossy()
    with pytest.raises(InputError, match=r"layers of the transfer are of orders \[3, 4\]: all must be of that"):
        transfer.with_layers(exit=gloss(transfer).to_order(3))


@pytest.mark.parametrize("chosen", [[0, 1, 2, 7], [-1, 1, 2, 3]])
def test_refuses_receivers_that_it_does_not_have(chosen):
    transfer = random_glossy(glossy=4)
    with pytest.raises(InputError, match="receivers of the transfer name vertices that it does not have"):
        transfer.with_layers(exit=gloss(transfer).replace(receivers=torch.tensor(chosen)))


def test_refuses_a_layer_about_some_vertices_that_does_not_say_which():
    transfer = random_glossy(glossy=4)
    with pytest.raises(InputError, match="the exit layer of the transfer holds 4 receivers of 7: say which"):
        transfer.with_layers(exit=gloss(transfer).replace(receivers=None))


@pytest.mark.parametrize("chosen", [[0, 2, 1, 3], [0, 1, 1, 3]])
def test_check_finds_receivers_in_another_order_or_twice(chosen):
    transfer = random_glossy(glossy=4)
    named = transfer.with_layers(exit=gloss(transfer).replace(receivers=torch.tensor(chosen)))
    with pytest.raises(InputError, match="ascending order, each once"):
        named.check()


def test_check_looks_at_receivers_and_at_every_layer():
    for spoil, message in (
        (lambda transfer: transfer.positions, "'positions'"),
        (lambda transfer: stored(transfer, "diffuse"), r"'diffuse\.signal\.values'"),
        (lambda transfer: gloss(transfer).tangents, r"'exit\.tangents'"),
        (lambda transfer: stored(transfer, "exit"), r"'exit\.signal\.values'"),
    ):
        transfer = random_glossy()
        transfer.check()
        spoil(transfer)[0, 0] = torch.nan
        with pytest.raises(InputError, match=f"tensor {message} of the transfer holds .* NaN"):
            transfer.check()


@pytest.mark.parametrize(
    ("make", "kind", "needs", "approximates"),
    [
        (lambda: random_glossy(diffuse=False), "exit", {"eye"}, False),
        (lambda: random_glossy("incident"), "diffuse + incident", {"eye", "reflectance"}, False),
        (lambda: compress(random_glossy(), clusters=1, components=1), "diffuse + clustered exit", {"eye"}, True),
        (
            lambda: compress(random_glossy(), layer="diffuse", clusters=1, components=1),
            "clustered diffuse + exit",
            {"eye"},
            True,
        ),
        (random_zonal, "zonal diffuse", {"pose"}, True),
        (random_zonal_factored, "zonal diffuse + zonal factored", {"eye", "pose"}, True),
        # One layer that stands still is enough.
        (
            lambda: random_zonal_factored().with_layers(diffuse=random_diffuse(9)),
            "diffuse + zonal factored",
            {"eye"},
            True,
        ),
    ],
)
def test_says_what_it_holds_and_needs(make, kind, needs, approximates):
    transfer = make()
    assert (transfer.kind, transfer.needs, transfer.approximates) == (kind, needs, approximates)
    assert set(transfer.eye_layers) == {name for name in transfer.layers if name != "diffuse"}


def random_diffuse(vertices):
    return random_glossy(vertices=vertices).layers["diffuse"]


def test_channels_and_bytes_are_those_of_all_layers():
    transfer = random_glossy(channels=1)
    coloured = transfer.with_layers(diffuse=random_glossy(channels=3).layers["diffuse"])
    assert (transfer.channels, coloured.channels) == (1, 3)
    assert coloured.bytes == sum(layer.bytes for layer in coloured.layers.values())
    assert coloured.bytes - transfer.bytes == 2 * 16 * 7 * 4


def test_albedo_is_that_of_the_diffuse_layer_of_all_vertices():
    transfer = random_glossy()
    assert transfer.albedo is transfer.layers["diffuse"].albedo
    assert random_glossy(diffuse=False).albedo.tolist() == [[0.0]]


def test_provenance_is_all_but_receivers_and_layers():
    given = {"transport": "interreflected", "bounces": 2, "rays": 512, "seed": 7, "error": 1e-3, "signal": 0.25}
    transfer = dataclasses.replace(random_glossy(), **given, version="0.1.0")
    assert transfer.provenance == given | {"version": "0.1.0", "cut": None}
    assert same(Transfer(receivers=transfer.receivers, layers=transfer.layers, **transfer.provenance), transfer)


def test_a_layer_is_replaced_or_added_after_the_others():
    transfer = random_glossy()
    more = transfer.with_layers(coat=gloss(transfer), diffuse=random_diffuse(7))
    assert list(more.layers) == ["diffuse", "exit", "coat"]
    assert list(transfer.layers) == ["diffuse", "exit"]


def test_no_vertices_is_a_transfer(make_transfer):
    empty = make_transfer(side=0)
    empty.check()
    assert (empty.vertices, empty.bytes) == (0, 0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("arguments", [{"vertices": 0}, {"glossy": 0}, {"diffuse": False}, {"vertices": 1}])
def test_no_receiver_no_layer_and_one_receiver_are_transfer(kind, arguments):
    transfer = random_glossy(kind, **arguments)
    transfer.check()
    assert transfer.vertices == arguments.get("vertices", 7)
    assert transfer.order == 4


def test_a_lower_order_keeps_the_first_bands(make_transfer):
    transfer = make_transfer(order=5)
    lower = transfer.to_order(3)
    assert lower.order == 3
    assert torch.equal(stored(lower), stored(transfer)[:, :9])
    assert stored(lower).is_contiguous()


@pytest.mark.parametrize("kind", KINDS)
def test_a_lower_order_keeps_the_first_bands_of_every_layer(kind):
    transfer = random_glossy(kind, channels=3)
    lower = transfer.to_order(2)
    assert lower.order == 2
    assert torch.equal(stored(lower, "diffuse"), stored(transfer, "diffuse")[:, :4])
    if kind == "visibility":
        assert torch.equal(stored(lower), stored(transfer))
    else:
        assert torch.equal(stored(lower), stored(transfer)[..., :4])
        assert stored(lower).is_contiguous()


@pytest.mark.parametrize("order", [0, 5, -1])
@pytest.mark.parametrize("kind", ["diffuse", *KINDS])
def test_refuses_an_order_that_it_does_not_have(make_transfer, kind, order):
    transfer = make_transfer(order=4) if kind == "diffuse" else random_glossy(kind)
    with pytest.raises(InputError, match=f"order {order} is not between 1 and the 4"):
        transfer.to_order(order)


@pytest.mark.parametrize(("dtype", "size"), [(torch.float16, 2), (torch.float32, 4), (torch.float64, 8)])
def test_bytes_count_the_vectors_alone(make_transfer, dtype, size):
    assert make_transfer(channels=3).to(dtype).bytes == 3 * 16 * 25 * size


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("dtype", "size"), [(torch.float16, 2), (torch.bfloat16, 2), (torch.float64, 8)])
def test_another_storage_changes_the_bytes_and_little_else(kind, dtype, size):
    transfer = random_glossy(kind)
    half = transfer.to(dtype)
    assert stored(half).dtype == stored(half, "diffuse").dtype == dtype
    assert torch.equal(half.positions, transfer.positions)
    assert torch.equal(gloss(half).specular, gloss(transfer).specular)
    # Tables that all receivers share stay as they are.
    shared = {"factored": 4 * 32 * 32 * 4, "visibility": 9 * 45 * 4}.get(kind, 0)
    assert half.bytes == size * (stored(transfer).numel() + stored(transfer, "diffuse").numel()) + shared


def test_diffuse_transfer_is_made_of_its_vectors(make_transfer):
    transfer = make_transfer()
    assert isinstance(transfer.receivers, Vertices)
    assert list(transfer.layers) == ["diffuse"]
    assert transfer.layers["diffuse"].receivers is None
