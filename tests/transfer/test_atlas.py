"""Does a map give back what is on the surface, and is one that is damaged refused?"""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from torchprt.errors import InputError
from torchprt.transfer import Atlas, Dense, Diffuse, Texels, Transfer, bilinear, load, save

CORNERS = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
FACES = torch.tensor([[0, 1, 2], [0, 2, 3]], dtype=torch.int32)


def atlas(size: int = 8) -> Atlas:
    """A unit square on all texels of a map but the outermost, which are gutters."""
    low, high = 1 / size, 1 - 1 / size
    uv = torch.tensor([[low, high], [high, high], [high, low], [low, low]])[FACES.long()]
    number = torch.arange(size * size).view(size, size)
    inner = number[1:-1, 1:-1].flatten()
    u, v = (((each + 0.5) / size - low) / (high - low) for each in (inner % size, inner // size))
    places = torch.stack([u, 1 - v, torch.zeros_like(u)], -1)
    edge = torch.tensor(sorted(set(number.flatten().tolist()) - set(inner.tolist())), dtype=torch.int32)
    row, column = (each.clamp(1, size - 2) - 1 for each in (edge.long() // size, edge.long() % size))
    nearest = (row * (size - 2) + column).to(torch.int32)[:, None].expand(-1, 4).contiguous()
    up = torch.tensor([0.0, 0.0, 1.0])
    return Atlas(
        rows=size,
        columns=size,
        positions=places,
        normals=up.expand(len(places), 3).contiguous(),
        texel=inner.to(torch.int32),
        chart=torch.zeros(len(places), dtype=torch.int32),
        mesh_positions=CORNERS,
        mesh_normals=up.expand(4, 3).contiguous(),
        mesh_faces=FACES,
        mesh_uv=uv,
        gutter=edge,
        gutter_sources=nearest,
        gutter_weights=torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(len(edge), 4).contiguous(),
        objects=[{"name": "square", "role": "receiver", "vertices": [0, 4], "faces": [0, 2], "charts": [0, 1]}],
    )


def test_other_receivers_are_no_map() -> None:
    with pytest.raises(InputError, match="--texels"):
        Texels(rows=2, columns=2).as_atlas()
    assert atlas().as_atlas().rows == 8


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"rows": 0}, "0 x 8 texels"),
        ({"rows": 2}, "texel of the transfer"),
        ({"gutter_sources": torch.full((28, 4), 99, dtype=torch.int32)}, "gutter_sources"),
        ({"mesh_faces": torch.full((2, 3), 4, dtype=torch.int32)}, "mesh_faces"),
        ({"chart": torch.zeros(3, dtype=torch.int32)}, "'chart'"),
    ],
)
def test_what_names_nothing_is_refused(change: dict[str, object], match: str) -> None:
    with pytest.raises(InputError, match=match):
        atlas().replace(**change)


def test_what_is_not_finite_or_out_of_order_is_refused() -> None:
    whole = atlas()
    whole.check()
    with pytest.raises(InputError, match="'mesh_positions'"):
        whole.replace(mesh_positions=CORNERS / 0).check()
    with pytest.raises(InputError, match="ascending"):
        whole.replace(texel=whole.texel.flip(0)).check()
    # A face that is not on the map.
    off = whole.mesh_uv.clone()
    off[0] = torch.nan
    whole.replace(mesh_uv=off).check()


def test_what_is_linear_on_the_surface_is_read_exactly() -> None:
    whole = atlas()
    value = (whole.positions[:, :1] * 2 - whole.positions[:, 1:2]).double()
    weights = torch.rand(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) + 0.5
    weights = weights / weights.sum(1, keepdim=True)
    face = torch.arange(50) % 2
    place = (CORNERS[FACES.long()[face]].double() * weights[..., None]).sum(1)
    found = whole.at(value, face, weights)
    torch.testing.assert_close(found, place[:, :1] * 2 - place[:, 1:2], atol=1e-6, rtol=0)


def test_batches_are_read_alike_and_gutters_show_their_neighbours() -> None:
    whole = atlas()
    values = torch.rand(2, 5, whole.count, 3)
    image = whole.image(values)
    assert image.shape == (2, 5, 8, 8, 3)
    assert torch.equal(image[..., 0, 1:-1, :], image[..., 1, 1:-1, :])
    face, weights = torch.tensor([0, 1]), torch.full((2, 3), 1 / 3)
    assert torch.equal(whole.at(values, face, weights)[1, 2], whole.at(values[1, 2], face, weights))


def test_reading_is_differentiable() -> None:
    whole = atlas(4)
    values = torch.rand(whole.count, 1, dtype=torch.float64, requires_grad=True)
    face, weights = torch.tensor([0]), torch.tensor([[0.2, 0.3, 0.5]], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda given: whole.at(given, face, weights), values)


def test_beyond_the_outermost_texels_a_map_goes_on() -> None:
    image = torch.arange(4.0).view(2, 2, 1)
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5]])
    assert bilinear(image, corners)[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 1.5]
    assert bilinear(torch.ones(1, 1, 1), corners).flatten().tolist() == [1.0] * 5


def test_faces_between_texels_look_as_the_surface_does() -> None:
    whole = atlas()
    a, b, c = (whole.positions[corner.long()] for corner in whole.faces.unbind(1))
    assert len(whole.faces) == 2 * 5 * 5
    assert bool((torch.linalg.cross(b - a, c - a)[:, 2] > 0).all())


def test_a_map_comes_back_from_a_file(tmp_path: Path) -> None:
    whole = atlas()
    layer = Diffuse(albedo=torch.full((1, 1), 0.5), signal=Dense(values=torch.rand(1, 4, whole.count)))
    save(Transfer(receivers=whole, layers={"diffuse": layer}), tmp_path / "map.safetensors")
    found = load(tmp_path / "map.safetensors").receivers
    assert isinstance(found, Atlas)
    for name, tensor in whole.tensors().items():
        assert torch.equal(found.tensors()[name], tensor)
    assert found.metadata() == whole.metadata()
    assert torch.equal(found.faces, whole.faces)
