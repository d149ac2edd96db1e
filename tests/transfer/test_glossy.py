"""Does glossy transfer of every kind refuse what does not fit together, and come back from its file as it went?"""

import dataclasses

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from transfers import KINDS, random_glossy

from torchprt.errors import InputError
from torchprt.transfer import load, save
from torchprt.transfer.layout import FLOATS, tensors


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


def main_tensor(transfer):
    return "visibility" if transfer.kind == "visibility" else "matrix"


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("positions", torch.zeros(6, 3), r"'(positions|normals)'"),
        ("positions", torch.zeros(7, 3, dtype=torch.float16), "'positions' of the transfer is float16"),
        ("normals", torch.zeros(7, 2), "'normals'"),
        ("faces", torch.zeros(2, 4, dtype=torch.int64), "'faces'"),
        ("albedo", torch.zeros(6, 3), r"'albedo' .* must be \[V\|1, 3\|1\] with .*V = 7"),
        ("glossy", torch.zeros(4), "'glossy' of the transfer is float32: it must be int32 or int64"),
        ("glossy", torch.zeros(4, 1, dtype=torch.int64), "'glossy'"),
        ("tangents", torch.zeros(3, 3), r"'tangents' .* must be \[G, 3\] with .*G = 4"),
        ("specular", torch.zeros(3, 3), r"'specular' .* must be \[G\|1, 3\|1\] with .*G = 4"),
        ("specular", torch.zeros(4, 2), "'specular'"),
        ("diffuse", torch.zeros(1, 16, 6), r"'diffuse' .* must be \[C, N, V\|0\]"),
    ],
)
def test_refuses_tensors_that_do_not_fit(kind, field, value, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(random_glossy(kind, glossy=4), **{field: value})


@pytest.mark.parametrize("kind", ["glossy", "factored", "incident"])
@pytest.mark.parametrize("shape", [(4, 9, 16), (1, 3, 9, 16), (3, 4, 9, 16), (1, 4, 9, 9)])
def test_refuses_matrices_that_do_not_fit(kind, shape):
    with pytest.raises(InputError, match="'matrix' of the transfer has shape"):
        dataclasses.replace(random_glossy(kind, glossy=4), matrix=torch.zeros(shape))


@pytest.mark.parametrize("count", [2, 0])
def test_refuses_channels_that_are_no_colour(kind, count):
    transfer = random_glossy(kind)
    values = {"diffuse": torch.zeros(count, 16, 7)}
    if kind != "visibility":
        values["matrix"] = torch.zeros(count, *transfer.matrix.shape[1:])
    with pytest.raises(InputError, match=f"{count} channels: it must have 1 or 3"):
        dataclasses.replace(transfer, **values)


@pytest.mark.parametrize("count", [15, 0])
def test_refuses_coefficients_that_are_no_order(kind, count):
    transfer = random_glossy(kind)
    values = {"diffuse": torch.zeros(1, count, 7)}
    if kind != "visibility":
        values["matrix"] = torch.zeros(*transfer.matrix.shape[:3], count)
    with pytest.raises(InputError, match=f"{count} coefficients a vertex"):
        dataclasses.replace(transfer, **values)


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        ("glossy", {"output_order": 2}, "matrix of the transfer has 9 rows: output order 2 with the .* has 4"),
        ("glossy", {"output_order": 0}, "matrix of the transfer has 9 rows"),
        ("glossy", {"projection": "reduced"}, "has 9 rows: output order 3 with the projection 'reduced' has 8"),
        ("factored", {"factors": torch.zeros(3, 32, 32)}, "'factors'"),
        ("factored", {"factors": torch.zeros(4, 32, 16)}, r"'factors' .* must be \[M, H, H\]"),
        ("factored", {"factors": torch.zeros(4, 32, 32, dtype=torch.float16)}, "'factors' of the transfer is float16"),
        ("incident", {"matrix": torch.zeros(1, 7, 8, 16)}, "matrix of the transfer has 8 rows: .* square"),
        ("incident", {"matrix": torch.zeros(1, 7, 0, 16)}, "matrix of the transfer has 0 rows"),
        ("visibility", {"visibility": torch.zeros(8, 7)}, "visibility of the transfer has 8 coefficients"),
        ("visibility", {"visibility": torch.zeros(0, 7)}, "visibility of the transfer has 0 coefficients"),
        ("visibility", {"degree": 9}, "kernel of the transfer has 45 nodes: the rule of degree 9 has 50"),
        ("visibility", {"kernel": torch.zeros(9, 44)}, "kernel of the transfer has 44 nodes"),
        ("visibility", {"kernel": torch.zeros(8, 45)}, "kernel of the transfer has 8 rows: output order 3 .* has 9"),
        ("visibility", {"output_order": 4}, "kernel of the transfer has 9 rows: output order 4 .* has 16"),
    ],
)
def test_refuses_what_the_kind_cannot_be(kind, values, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(random_glossy(kind), **values)


@pytest.mark.parametrize("kind", ["glossy", "visibility"])
def test_refuses_a_projection_of_a_newer_torchprt(untyped, kind):
    with pytest.raises(InputError, match="projection 'best' of the transfer is unknown: update torchprt"):
        dataclasses.replace(random_glossy(kind), projection="best")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("specular", torch.full((4, 3), 1.5), r"specular of the transfer is outside \[0, 1\]"),
        ("albedo", torch.full((7, 3), -0.1), r"albedo of the transfer is outside \[0, 1\]"),
        ("glossy", torch.tensor([0, 1, 2, 7]), "glossy of the transfer name vertices that it does not have"),
        ("glossy", torch.tensor([-1, 1, 2, 3]), "glossy of the transfer name vertices that it does not have"),
        ("glossy", torch.tensor([0, 2, 1, 3]), "ascending order, each once"),
        ("glossy", torch.tensor([0, 1, 1, 3]), "ascending order, each once"),
        ("faces", torch.tensor([[0, 1, 7]]), "faces of the transfer name vertices"),
        ("tangents", torch.full((4, 3), torch.nan), "'tangents' of the transfer holds 12 NaN"),
        ("diffuse", torch.full((1, 16, 7), torch.inf), "'diffuse' of the transfer holds 112 NaN or infinite"),
    ],
)
def test_check_names_the_values_at_fault(kind, field, value, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(random_glossy(kind, glossy=4), **{field: value}).check()


def test_check_finds_a_matrix_that_is_not_finite(kind):
    transfer = random_glossy(kind)
    name = main_tensor(transfer)
    getattr(transfer, name)[0, 1] = torch.nan
    with pytest.raises(InputError, match=f"'{name}' of the transfer holds .* NaN"):
        transfer.check()


@pytest.mark.parametrize("arguments", [{"vertices": 0}, {"glossy": 0}, {"diffuse": False}, {"vertices": 1}])
def test_no_receiver_no_layer_and_one_receiver_are_transfer(kind, arguments):
    transfer = random_glossy(kind, **arguments)
    transfer.check()
    assert transfer.vertices == arguments.get("vertices", 7)
    assert transfer.order == 4


def test_a_lower_order_keeps_the_first_bands_of_the_light(kind):
    transfer = random_glossy(kind, channels=3)
    lower = transfer.to_order(2)
    assert lower.order == 2
    assert torch.equal(lower.diffuse, transfer.diffuse[:, :4])
    if kind == "visibility":
        assert torch.equal(lower.visibility, transfer.visibility)
    else:
        assert torch.equal(lower.matrix, transfer.matrix[..., :4])
        assert lower.matrix.is_contiguous()


@pytest.mark.parametrize("order", [0, 5, -1])
def test_refuses_an_order_that_it_does_not_have(kind, order):
    with pytest.raises(InputError, match=f"order {order} is not between 1 and the 4"):
        random_glossy(kind).to_order(order)


@pytest.mark.parametrize(("dtype", "size"), [(torch.float16, 2), (torch.bfloat16, 2), (torch.float64, 8)])
def test_another_storage_changes_the_bytes_and_little_else(kind, dtype, size):
    transfer = random_glossy(kind)
    stored = transfer.to(dtype)
    name = main_tensor(transfer)
    assert getattr(stored, name).dtype == stored.diffuse.dtype == dtype
    assert torch.equal(stored.positions, transfer.positions)
    assert torch.equal(stored.specular, transfer.specular)
    # Tables that all receivers share stay as they are.
    shared = {"factored": 4 * 32 * 32 * 4, "visibility": 9 * 45 * 4}.get(kind, 0)
    assert stored.bytes == size * (getattr(transfer, name).numel() + transfer.diffuse.numel()) + shared


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("channels", [1, 3])
def test_comes_back_bit_for_bit(kind, tmp_path, dtype, channels):
    metadata = {"exit_error": 0.01} if kind in ("glossy", "visibility") else {}
    metadata |= {"product_error": 0.02} if kind == "visibility" else {}
    metadata |= {"factor_error": 0.03} if kind == "factored" else {}
    transfer = random_glossy(
        kind, channels=channels, dtype=dtype, glossy=4, transport="interreflected", bounces=2, rays=512, seed=0,
        error=1e-3, signal=0.25, version="0.1.0", materials=["phong:40", "ggx:0.3"], **metadata,
    )  # fmt: skip
    save(transfer, tmp_path / "a.safetensors")
    back = load(tmp_path / "a.safetensors")
    assert type(back) is type(transfer)
    for name, value in tensors(transfer).items():
        assert getattr(back, name).dtype == value.dtype
        assert torch.equal(getattr(back, name), value)
    for field in dataclasses.fields(transfer):
        if field.name not in transfer.layouts:
            assert getattr(back, field.name) == getattr(transfer, field.name)


@pytest.mark.parametrize("arguments", [{"vertices": 0}, {"glossy": 0}, {"diffuse": False}])
def test_nothing_comes_back_as_nothing(kind, tmp_path, arguments):
    transfer = random_glossy(kind, **arguments)
    save(transfer, tmp_path / "a.safetensors")
    back = load(tmp_path / "a.safetensors")
    assert {name: value.shape for name, value in tensors(back).items()} == {
        name: value.shape for name, value in tensors(transfer).items()
    }


def test_names_what_is_missing_or_at_fault_in_a_file(kind, tmp_path):
    path = tmp_path / "scene.safetensors"
    save(random_glossy(kind), path)
    with safe_open(path, framework="pt") as file:
        values, metadata = {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata())  # noqa: SIM118
    for name in values:
        save_file({other: value for other, value in values.items() if other != name}, path, metadata=metadata)
        with pytest.raises(InputError, match=f"lacks the tensor '{name}'"):
            load(path)
    for name in set(metadata) - {"kind", "format", "conventions"}:
        save_file(values, path, metadata={other: value for other, value in metadata.items() if other != name})
        with pytest.raises(InputError, match=f"lacks the metadata '{name}'"):
            load(path)
    save_file(values | {"glossy": values["glossy"] + 1}, path, metadata=metadata)
    with pytest.raises(InputError, match=r"scene\.safetensors: glossy of the transfer name vertices"):
        load(path)
