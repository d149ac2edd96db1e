"""Are vertices and texels of a patch refused when they are wrong, and read as they were written?"""

import dataclasses

import pytest
import torch
from lobe_maps import random_map
from transfers import replaced, same
from zonal_transfers import random_zonal

from torchprt.errors import InputError
from torchprt.transfer import Texels, Vertices, load, save


def vertices(**changes):
    parts = {
        "positions": torch.zeros(25, 3),
        "normals": torch.zeros(25, 3),
        "faces": torch.zeros(2, 3, dtype=torch.int64),
    }
    return Vertices(**{**parts, **changes})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("positions", torch.zeros(24, 3), r"'normals' .* shape \[25, 3\]: it must be \[V, 3\] with V = 24"),
        ("positions", torch.zeros(25, 3, dtype=torch.float16), "'positions' of the transfer is float16"),
        ("normals", torch.zeros(25, 2), "'normals'"),
        ("faces", torch.zeros(2, 4, dtype=torch.int64), "'faces'"),
        ("faces", torch.zeros(2, 3), "'faces' of the transfer is float32: it must be int32 or int64"),
        ("original", torch.zeros(24, dtype=torch.int64), r"'original' .* must be \[V\] with V = 25"),
        ("original", torch.zeros(25), "'original' of the transfer is float32"),
    ],
)
def test_refuses_tensors_that_make_no_vertices(field, value, message):
    with pytest.raises(InputError, match=message):
        vertices(**{field: value})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("normals", torch.full((25, 3), torch.inf), "'normals' .* infinite"),
        ("positions", torch.full((25, 3), torch.nan), "'positions' of the transfer holds 75 NaN"),
        ("faces", torch.tensor([[0, 1, 25]]), "faces of the transfer name vertices"),
        ("faces", torch.tensor([[0, 1, -1]]), "faces of the transfer name vertices"),
        ("original", torch.zeros(25, dtype=torch.int64), "original of the transfer does not name every vertex once"),
        ("original", torch.arange(1, 26), "original of the transfer does not name every vertex once"),
    ],
)
def test_check_names_the_values_at_fault(field, value, message):
    with pytest.raises(InputError, match=message):
        vertices(**{field: value}).check()


def test_values_go_back_to_the_order_of_the_mesh():
    values = torch.randn(2, 25, 3, generator=torch.Generator().manual_seed(0))
    order = torch.randperm(25, generator=torch.Generator().manual_seed(1))
    assert torch.equal(vertices(original=order.int()).in_mesh_order(values[:, order]), values)
    assert vertices().in_mesh_order(values) is values
    assert Texels(rows=5, columns=5).in_mesh_order(values) is values


def test_vertices_are_no_texels_of_a_patch():
    with pytest.raises(InputError, match="recorded at vertices, not at the texels of a patch"):
        vertices().as_texels()
    texels = Texels(rows=2, columns=3)
    assert texels.as_texels() is texels


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"axis": torch.zeros(3, 3, 48)}, "tensor 'axis' of the transfer has shape"),
        ({"exact": torch.zeros(1, 1, 4, 42)}, "tensor 'exact' of the transfer has shape"),
        ({"exact": torch.zeros(1, 1, 3, 48)}, "must be 0, or 4"),
        ({"albedo": torch.zeros(48, 2)}, "tensor 'albedo' of the transfer has shape"),
        ({"albedo": torch.zeros(12, 3)}, "about 12 receivers, but its signal holds 48"),
        (
            {"coefficients": torch.zeros(2, 1, 3, 2, 48), "exact": torch.zeros(2, 1, 4, 48)},
            "has 2 channels",
        ),
        ({"columns": 7}, "the diffuse layer of the transfer holds 48 receivers of 42: say which"),
    ],
)
def test_refuses_tensors_that_make_no_map(change, message):
    with pytest.raises(InputError, match=message):
        replaced(random_map(), **change)


@pytest.mark.parametrize(("rows", "columns"), [(0, 8), (8, 0), (-1, 8)])
def test_refuses_a_map_without_texels(rows, columns):
    with pytest.raises(InputError, match=f"{rows} x {columns} texels"):
        Texels(rows=rows, columns=columns)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [("axis", 2.0, "unit length"), ("exact", torch.nan, "NaN"), ("albedo", 1.5, r"outside \[0, 1\]")],
)
def test_refuses_to_write_values_that_cannot_be(tmp_path, name, value, message):
    patch = random_map()
    layer = patch.layers["diffuse"]
    getattr(layer if name == "albedo" else layer.signal, name)[0, 0] = value
    with pytest.raises(InputError, match=message):
        save(patch, tmp_path / "map.safetensors")


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_a_map_is_read_as_it_was_written(tmp_path, dtype):
    patch = random_map(dtype=dtype, tiles_v=False, smooth=True, fit_error=0.01, rays=77, version="1")
    save(patch, tmp_path / "map.safetensors")
    found = load(tmp_path / "map.safetensors")
    assert same(found, patch)
    assert (found.receivers.tiles_u, found.receivers.tiles_v) == (True, False)
    assert torch.equal(found.positions, patch.positions)


@pytest.mark.parametrize("original", [None, torch.arange(24, -1, -1)])
def test_vertices_are_read_as_they_were_written(tmp_path, make_transfer, original):
    transfer = replaced(make_transfer(), original=original)
    save(transfer, tmp_path / "a.safetensors")
    found = load(tmp_path / "a.safetensors")
    assert same(found, transfer)
    assert (found.receivers.original is None) == (original is None)


def test_texels_stand_row_after_row():
    texels = Texels(rows=2, columns=3)
    v, u = torch.meshgrid(torch.tensor([0.25, 0.75]), torch.tensor([1 / 6, 3 / 6, 5 / 6]), indexing="ij")
    assert torch.allclose(texels.positions, torch.stack([u, v, 0 * u], -1).reshape(6, 3))
    assert torch.equal(texels.normals, torch.tensor([0.0, 0.0, 1.0]).expand(6, 3))
    assert texels.count == 6
    # Two triangles between four texels, all facing along the normal.
    corners = texels.positions[texels.faces.long()]
    across = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert torch.allclose(across, torch.tensor([0.0, 0.0, 1 / 6]).expand(4, 3))


def test_transfer_of_as_many_vertices_becomes_a_map():
    transfer = random_zonal(3, rays=5, fit_error=0.1)
    found = dataclasses.replace(transfer, receivers=Texels(rows=3, columns=3))
    assert found.layers["diffuse"] is transfer.layers["diffuse"]
    assert (found.rays, found.receivers.tiles_u, found.receivers.tiles_v) == (5, True, True)
    one = replaced(transfer, albedo=torch.tensor([[0.2, 0.4, 0.6]]))
    found = dataclasses.replace(one, receivers=Texels(rows=1, columns=9))
    assert found.albedo.flatten().tolist() == pytest.approx([0.2, 0.4, 0.6])
    with pytest.raises(InputError, match="9 receivers of 8"):
        dataclasses.replace(transfer, receivers=Texels(rows=2, columns=4))


def test_fewer_bands_of_a_map_are_the_first_ones():
    patch = random_map(order=5)
    lower = patch.to_order(3)
    assert lower.order == 3
    coefficients = patch.layers["diffuse"].signal.coefficients
    assert torch.equal(lower.layers["diffuse"].signal.coefficients, coefficients[..., :1, :])
    for order in (1, 6):
        with pytest.raises(InputError, match="is not between 2 and the 5"):
            patch.to_order(order)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_halves_the_bytes_of_a_map_and_is_accepted(tmp_path, dtype):
    patch = random_map(dtype=torch.float32)
    half = patch.to(dtype)
    assert half.bytes * 2 == patch.bytes
    save(half, tmp_path / "map.safetensors")
    assert load(tmp_path / "map.safetensors").layers["diffuse"].signal.axis.dtype == dtype


# Of which objects they are


def of_objects(*ranges, **changes):
    objects = [{"name": name, "role": role, "side": "front", "rows": list(rows)} for name, role, rows in ranges]
    return vertices(objects=objects, **changes)


@pytest.mark.parametrize(
    "objects",
    [
        [{"name": "a", "role": "receiver", "side": "front"}],
        [{"name": "a", "role": "receiver", "side": "front", "rows": [3, 2]}],
        [{"name": "a", "role": "receiver", "side": "front", "rows": [-1, 2]}],
        [{"name": "a", "role": "receiver", "side": "front", "rows": [0, 26]}],
    ],
)
def test_refuses_objects_of_rows_that_there_are_not(objects):
    with pytest.raises(InputError, match="objects of the transfer"):
        vertices(objects=objects).check()


def test_vertices_of_unknown_objects_are_no_ground():
    assert not vertices().ground().any()
    assert "objects" not in vertices().metadata()
    assert torch.equal(vertices().subject, vertices().positions)


def test_ground_is_found_in_the_order_of_the_mesh_and_in_any_other():
    positions = torch.arange(75.0).view(25, 3)
    plain = of_objects(("a", "receiver", (0, 9)), ("ground", "ground", (9, 25)), positions=positions)
    assert torch.equal(plain.ground(), torch.arange(25) >= 9)
    order = torch.randperm(25, generator=torch.Generator().manual_seed(1))
    mixed = plain.replace(positions=positions[order], original=order)
    assert torch.equal(mixed.ground(), order >= 9)
    assert torch.equal(mixed.subject.sort(0).values, positions[:9])


def test_some_are_taken_with_the_faces_between_them_in_the_order_that_they_have():
    positions = torch.arange(75.0).view(25, 3)
    faces = torch.tensor([[0, 1, 2], [7, 8, 9], [10, 11, 12]])
    plain = of_objects(("a", "receiver", (0, 9)), ("g", "ground", (9, 20)), ("b", "receiver", (20, 25)), faces=faces)
    plain = plain.replace(positions=positions)
    left = plain.take((~plain.ground()).nonzero()[:, 0])
    left.check()
    assert torch.equal(left.positions, positions[[*range(9), *range(20, 25)]])
    assert left.faces.tolist() == [[0, 1, 2]]
    assert [(each["name"], each["rows"]) for each in left.objects] == [("a", [0, 9]), ("b", [9, 14])]
    order = torch.randperm(25, generator=torch.Generator().manual_seed(1))
    place = order.argsort()
    mixed = plain.replace(positions=positions[order], faces=place[faces], original=order)
    again = mixed.take((~mixed.ground()).nonzero()[:, 0])
    again.check()
    assert again.objects == left.objects
    values = again.in_mesh_order(again.positions)
    assert torch.equal(values, left.positions)


def test_objects_are_read_as_they_were_written(make_transfer, tmp_path):
    transfer = make_transfer(side=5)
    known = of_objects(("a", "receiver", (0, 20)), ("ground", "ground", (20, 25)))
    known = transfer.receivers.replace(objects=known.objects)
    save(dataclasses.replace(transfer, receivers=known), tmp_path / "a.safetensors")
    assert load(tmp_path / "a.safetensors").receivers.objects == known.objects
