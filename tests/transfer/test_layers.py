"""Do layers refuse what does not fit together, say what is wrong in one sentence, and come back from a file?"""

import dataclasses

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from transfers import KINDS, gloss, random_glossy, replaced, same, stored

from torchprt.errors import InputError
from torchprt.transfer import Dense, load, save
from torchprt.transfer.layout import FLOATS


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


# What does not fit


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("values", torch.zeros(16, 25), r"values of the transfer are torch.float32 \[16, 25\]: they must be floats"),
        ("values", torch.zeros(1, 16, 24), "about 25 receivers, but its signal holds 24"),
        ("values", torch.zeros(1, 25, 9, 16), "takes transfer vectors, but its signal has matrices of 9 rows"),
        ("albedo", torch.zeros(24, 3), "the diffuse layer of the transfer is about 24 receivers, but its signal holds"),
        ("albedo", torch.zeros(25, 2), r"'albedo' .* shape \[25, 2\]: it must be \[G\|1, 3\|1\]"),
        ("albedo", torch.zeros(1, 2), r"'albedo' .* shape \[1, 2\]: it must be \[G\|1, 3\|1\]$"),
        ("albedo", torch.zeros(25, 3, dtype=torch.int32), "'albedo' of the transfer is int32"),
        ("receivers", torch.arange(24), r"'receivers' .* must be \[G\] with G = 25"),
    ],
)
def test_diffuse_refuses_tensors_that_do_not_fit(make_transfer, field, value, message):
    with pytest.raises(InputError, match=message):
        replaced(make_transfer(), **{field: value})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("receivers", torch.zeros(4), "'receivers' of the transfer is float32: it must be int32 or int64"),
        ("receivers", torch.zeros(4, 1, dtype=torch.int64), "'receivers'"),
        ("receivers", torch.arange(5), r"'receivers' .* must be \[G\] with .*G = 4"),
        ("tangents", torch.zeros(3, 3), r"must be \[G\|1, 3\|1\] with .*G = 3"),
        ("tangents", torch.zeros(4, 2), r"'tangents' .* must be \[G, 3\]"),
        ("tangents", torch.zeros(4, 3, dtype=torch.float16), "'tangents' of the transfer is float16"),
        ("specular", torch.zeros(3, 3), r"'specular' .* must be \[G\|1, 3\|1\] with .*G = 4"),
        ("specular", torch.zeros(4, 2), "'specular'"),
    ],
)
def test_refuses_tensors_that_do_not_fit(kind, field, value, message):
    with pytest.raises(InputError, match=message):
        replaced(random_glossy(kind, glossy=4), **{field: value})


@pytest.mark.parametrize("kind", ["exit", "factored", "incident"])
@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((4, 9, 16), "transfer has 4 channels"),
        ((1, 3, 9, 16), "about 4 receivers, but its signal holds 3|rows"),
        ((1, 4, 9, 9), r"layers of the transfer are of orders \[3, 4\]|rows"),
        ((1, 4, 7, 16), "7 rows"),
    ],
)
def test_refuses_matrices_that_do_not_fit(kind, shape, message):
    with pytest.raises(InputError, match=message):
        replaced(random_glossy(kind, glossy=4), values=torch.zeros(shape))


@pytest.mark.parametrize("count", [2, 0])
def test_refuses_channels_that_are_no_colour(kind, count):
    transfer = random_glossy(kind)
    for layer in transfer.layers:
        values = stored(transfer, layer)
        with pytest.raises(InputError, match=f"{count} channels: it must have 1 or 3"):
            replaced(transfer, layer, values=torch.zeros(count, *values.shape[1:]))


@pytest.mark.parametrize("count", [15, 0])
def test_refuses_coefficients_that_are_no_order(kind, count):
    transfer = random_glossy(kind)
    layers = ["diffuse"] if kind == "visibility" else list(transfer.layers)
    for layer in layers:
        shape = list(stored(transfer, layer).shape)
        shape[1 if layer == "diffuse" else 3] = count
        with pytest.raises(InputError, match=f"{count} coefficients a vertex"):
            replaced(transfer, layer, values=torch.zeros(shape))


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        ("exit", {"output_order": 2}, "signal of the transfer has 9 rows: output order 2 with the .* has 4"),
        ("exit", {"output_order": 0}, "signal of the transfer has 9 rows"),
        ("exit", {"projection": "reduced"}, "has 9 rows: output order 3 with the projection 'reduced' has 8"),
        ("factored", {"factors": torch.zeros(3, 32, 32)}, "'factors' .* holds 3 factors: the signal has 4 rows"),
        ("factored", {"factors": torch.zeros(4, 32, 16)}, r"'factors' .* must be \[M, H, H\]"),
        ("factored", {"factors": torch.zeros(4, 32, 32, dtype=torch.float16)}, "'factors' of the transfer is float16"),
        ("incident", {"values": torch.zeros(1, 7, 8, 16)}, "signal of the transfer has 8 rows: .* square"),
        ("incident", {"values": torch.zeros(1, 7, 0, 16)}, "signal of the transfer has 0 rows"),
        ("visibility", {"values": torch.zeros(1, 8, 7)}, "transfer has 8 coefficients"),
        ("visibility", {"values": torch.zeros(1, 0, 7)}, "transfer has 0 coefficients"),
        ("visibility", {"values": torch.zeros(3, 9, 7)}, "must be one vector a receiver, of one channel"),
        ("visibility", {"values": torch.zeros(1, 7, 2, 9)}, "must be one vector a receiver, of one channel"),
        ("visibility", {"degree": 9}, "kernel of the transfer has 45 nodes: the rule of degree 9 has 50"),
        ("visibility", {"kernel": torch.zeros(9, 44)}, "kernel of the transfer has 44 nodes"),
        ("visibility", {"kernel": torch.zeros(8, 45)}, "kernel of the transfer has 8 rows: output order 3 .* has 9"),
        ("visibility", {"output_order": 4}, "kernel of the transfer has 9 rows: output order 4 .* has 16"),
    ],
)
def test_refuses_what_the_kind_cannot_be(kind, values, message):
    with pytest.raises(InputError, match=message):
        replaced(random_glossy(kind), **values)


def test_visibility_refuses_lobes():
    from zonal_transfers import random_zonal

    lobes = random_zonal(3, order=3).layers["diffuse"].signal
    layer = gloss(random_glossy("visibility", vertices=9))
    with pytest.raises(InputError, match="it cannot be in lobes"):
        layer.replace(signal=lobes)


@pytest.mark.parametrize("kind", ["exit", "visibility"])
def test_refuses_a_projection_of_a_newer_torchprt(untyped, kind):
    with pytest.raises(InputError, match="projection 'best' of the transfer is unknown: update torchprt"):
        replaced(random_glossy(kind), projection="best")


# What check finds


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("values", torch.full((1, 16, 25), torch.nan), "'signal.values' of the transfer holds 400 NaN"),
        ("albedo", torch.full((25, 3), 1.5), r"albedo of the transfer is outside \[0, 1\]"),
        ("albedo", torch.full((25, 3), -0.1), "albedo"),
    ],
)
def test_check_names_the_values_at_fault_in_diffuse(make_transfer, field, value, message):
    with pytest.raises(InputError, match=message):
        replaced(make_transfer(), **{field: value}).layers["diffuse"].check()


@pytest.mark.parametrize(
    ("layer", "field", "value", "message"),
    [
        (None, "specular", torch.full((4, 3), 1.5), r"specular of the transfer is outside \[0, 1\]"),
        ("diffuse", "albedo", torch.full((7, 3), -0.1), r"albedo of the transfer is outside \[0, 1\]"),
        (None, "receivers", torch.tensor([0, 2, 1, 3]), "ascending order, each once"),
        (None, "receivers", torch.tensor([0, 1, 1, 3]), "ascending order, each once"),
        (None, "tangents", torch.full((4, 3), torch.nan), r"\.tangents' of the transfer holds 12 NaN"),
        ("diffuse", "values", torch.full((1, 16, 7), torch.inf), r"'diffuse\.signal\.values' .* 112 NaN or infinite"),
    ],
)
def test_check_names_the_values_at_fault(kind, layer, field, value, message):
    with pytest.raises(InputError, match=message):
        replaced(random_glossy(kind, glossy=4), layer, **{field: value}).check()


def test_check_finds_a_matrix_that_is_not_finite(kind):
    transfer = random_glossy(kind)
    stored(transfer)[0, 1] = torch.nan
    with pytest.raises(InputError, match=rf"'{kind}\.signal\.values' of the transfer holds .* NaN"):
        transfer.check()


# What they say


def test_a_dense_signal_of_one_row_takes_the_layout_of_its_layer(make_transfer):
    vectors = torch.randn(1, 16, 7, generator=torch.Generator().manual_seed(0))
    rows = Dense(values=vectors.mT[:, :, None])
    assert rows.shape == Dense(values=vectors).shape == (7, 1, 1, 16)
    diffuse = random_glossy().layers["diffuse"]
    layer = gloss(random_glossy(output_order=1))
    assert torch.equal(diffuse.replace(signal=rows).signal.values, vectors)
    assert torch.equal(layer.replace(signal=Dense(values=vectors)).signal.values, rows.values)
    # As it is, without a copy, in the layout that a bake leaves.
    signal = Dense(values=vectors)
    assert diffuse.replace(signal=signal).signal is signal


def test_a_layer_is_cut_to_some_of_its_receivers(kind):
    for specular in (("G", 3), (1, 1)):
        layer = gloss(random_glossy(kind, glossy=5, channels=3 if kind != "visibility" else 1, specular=specular))
        index = torch.tensor([3, 1])
        few = layer.take(index, torch.tensor([2, 6]))
        assert few.receivers.tolist() == [2, 6]
        assert torch.equal(few.tangents, layer.tangents[index])
        assert torch.equal(few.specular, layer.specular[index] if specular[0] == "G" else layer.specular)
        wanted = layer.signal.take(index)
        assert torch.equal(few.signal.values, wanted.values)
        kept = {name for name in layer.layouts if name not in ("receivers", "tangents", "specular")}
        assert all(getattr(few, name) is getattr(layer, name) for name in kept)
    one = gloss(random_glossy(kind, glossy=1)).take(torch.tensor([], dtype=torch.int64), torch.zeros(0).long())
    assert one.signal.shape[0] == 0


# Files


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("channels", [1, 3])
def test_comes_back_bit_for_bit(kind, tmp_path, dtype, channels):
    losses = {"exit_error": 0.01} if kind in ("exit", "visibility") else {}
    losses |= {"product_error": 0.02} if kind == "visibility" else {}
    losses |= {"factor_error": 0.03} if kind == "factored" else {}
    transfer = random_glossy(
        kind, channels=channels, dtype=dtype, glossy=4, transport="interreflected", bounces=2, rays=512,
        error=1e-3, signal=0.25, version="0.1.0", materials=["phong:40", "ggx:0.3"],
    )  # fmt: skip
    transfer = replaced(transfer, **losses)
    save(transfer, tmp_path / "a.safetensors")
    back = load(tmp_path / "a.safetensors")
    assert same(back, transfer)
    assert gloss(back).materials == ["phong:40", "ggx:0.3"]


@pytest.mark.parametrize("arguments", [{"vertices": 0}, {"glossy": 0}, {"diffuse": False}])
def test_nothing_comes_back_as_nothing(kind, tmp_path, arguments):
    transfer = random_glossy(kind, **arguments)
    save(transfer, tmp_path / "a.safetensors")
    assert same(load(tmp_path / "a.safetensors"), transfer)


def test_layers_come_back_in_their_order_and_under_their_names(tmp_path):
    transfer = random_glossy(glossy=4)
    turned = dataclasses.replace(
        transfer, layers={"coat": gloss(transfer), "base": transfer.layers["diffuse"], "exit": gloss(transfer)}
    )
    save(turned, tmp_path / "a.safetensors")
    back = load(tmp_path / "a.safetensors")
    assert list(back.layers) == ["coat", "base", "exit"]
    assert same(back, turned)


def test_names_what_is_missing_or_at_fault_in_a_file(kind, tmp_path):
    path = tmp_path / "scene.safetensors"
    save(random_glossy(kind, glossy=4), path)
    with safe_open(path, framework="pt") as file:
        # Copies: safetensors before 0.5 maps the file that is written over here.
        values = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
        metadata = dict(file.metadata())
    for name in values:
        save_file({other: value for other, value in values.items() if other != name}, path, metadata=metadata)
        wanted = f"lacks the tensor '{name}'"
        with pytest.raises(InputError, match=wanted):
            load(path)
    for name in set(metadata) - {"kind", "format", "conventions"}:
        save_file(values, path, metadata={other: value for other, value in metadata.items() if other != name})
        with pytest.raises(InputError, match=f"lacks the metadata '{name}'"):
            load(path)
    index = f"{kind}.receivers"
    save_file(values | {index: values[index] + 7}, path, metadata=metadata)
    with pytest.raises(InputError, match=r"scene\.safetensors: receivers of the transfer name vertices"):
        load(path)
