"""Is transfer at vertices what the texels around them say, and the other way?"""

import dataclasses

import pytest
import torch
from atlases import cube, lit_cube
from transfers import random_glossy
from zonal_transfers import random_zonal

from torchprt.compression import compress, decompress
from torchprt.errors import InputError
from torchprt.shade import shader
from torchprt.transfer import Dense, Vertices, bilinear, diffuse_transfer, places, to_texels, to_vertices, with_channels

NO_FACES = torch.zeros(0, 3, dtype=torch.int32)
LIGHT = torch.rand(9, 3, generator=torch.Generator().manual_seed(1))


def with_values(transfer, values):
    layer = transfer.layers["diffuse"]
    return transfer.with_layers(diffuse=layer.replace(signal=Dense(values=values)))


def linear(places_):
    """Vectors that are linear in the places."""
    return (places_ @ torch.tensor([0.3, -0.2, 0.5]) + 0.1).expand(1, 9, -1).contiguous()


def test_refuses_what_is_not_at_the_right_place():
    with pytest.raises(InputError, match="not recorded at the texels of a map"):
        to_vertices(random_glossy())
    with pytest.raises(InputError, match="not recorded at vertices"):
        to_texels(lit_cube(), cube())
    with pytest.raises(InputError, match="at 7 vertices, and the map lies on meshes of 24"):
        to_texels(diffuse_transfer(torch.zeros(1, 9, 7), torch.ones(1, 1), *torch.rand(2, 7, 3), NO_FACES), cube())


def test_refuses_frames_and_compressed_signals():
    whole = lit_cube()
    place = cube()
    glossy = random_glossy(vertices=place.count, diffuse=False)
    with pytest.raises(InputError, match=r"layer 'exit' .* in the frame of each of its receivers"):
        to_vertices(dataclasses.replace(glossy, receivers=place))
    with pytest.raises(InputError, match=r"stored as clustered.*compression\.decompress"):
        to_vertices(compress(whole, clusters=4, components=2))
    with pytest.raises(InputError, match="stored as zonal"):
        with_channels(random_zonal(), 3)
    with pytest.raises(InputError, match="2 channels are asked for"):
        with_channels(whole, 2)


def test_vertices_of_a_side_have_what_its_corner_has():
    found = to_vertices(lit_cube())
    assert isinstance(found.receivers, Vertices)
    found.check()
    assert found.receivers.objects == [{"name": "cube.ply", "role": "receiver", "side": "front", "rows": [0, 24]}]
    # Every side of the cube has vertices, albedo and light of its own.
    side = torch.arange(24) // 4
    wanted = lit_cube()
    first = torch.stack([(wanted.receivers.chart == number).nonzero()[0, 0] for number in range(6)])
    values, expected = (each.layers["diffuse"] for each in (found, wanted))
    torch.testing.assert_close(values.signal.values, expected.signal.values[..., first][..., side])
    torch.testing.assert_close(values.albedo, expected.albedo[first][side])


def test_a_vertex_of_no_face_has_what_the_nearest_texel_has():
    whole = lit_cube()
    place = whole.receivers
    more = place.replace(
        mesh_positions=torch.cat([place.mesh_positions, torch.tensor([[0.2, 3.0, 0.1]])]),
        mesh_normals=torch.cat([place.mesh_normals, torch.zeros(1, 3)]),
    )
    found = to_vertices(dataclasses.replace(whole, receivers=more))
    up = (place.normals[:, 1] > 0).nonzero()[0, 0]
    torch.testing.assert_close(
        found.layers["diffuse"].signal.values[..., -1], whole.layers["diffuse"].signal.values[..., up]
    )


def test_without_gutters_borders_are_not_dark():
    whole = lit_cube()
    none = {name: getattr(whole.receivers, name)[:0] for name in ("gutter", "gutter_sources", "gutter_weights")}
    whole = dataclasses.replace(whole, receivers=whole.receivers.replace(**none))
    torch.testing.assert_close(
        to_vertices(whole).layers["diffuse"].signal.values, to_vertices(lit_cube()).layers["diffuse"].signal.values
    )


def test_what_is_linear_on_the_surface_goes_to_texels_and_back():
    place = cube(texels=8, gutter=2)
    flat = to_vertices(with_values(lit_cube(texels=8), linear(place.positions)))
    exact = with_values(flat, linear(flat.positions))
    there = to_texels(exact, place)
    assert there.receivers is place
    torch.testing.assert_close(there.layers["diffuse"].signal.values, linear(place.positions))
    # Back at a corner half a texel is missing, beyond which the gutters repeat the last.
    back = to_vertices(there).layers["diffuse"].signal.values
    assert (back - exact.layers["diffuse"].signal.values).abs().max() <= 1.0 / 8 + 1e-5


def test_texels_lie_where_they_recorded():
    place = cube(texels=9, gutter=1)
    face, weights = places(place)
    found = (place.mesh_positions[place.mesh_faces.long()[face]] * weights[..., None]).sum(1)
    torch.testing.assert_close(found, place.positions)
    assert torch.equal(face // 2, place.chart.long())


def test_one_channel_is_the_mean_of_three_and_three_are_one_repeated():
    one = lit_cube()
    three = with_channels(one, 3)
    assert three.channels == 3
    torch.testing.assert_close(shader(three)(LIGHT), shader(one)(LIGHT))
    spread = with_values(three, three.layers["diffuse"].signal.values * torch.tensor([0.5, 1.0, 1.5])[:, None, None])
    torch.testing.assert_close(
        with_channels(spread, 1).layers["diffuse"].signal.values, one.layers["diffuse"].signal.values
    )
    glossy = with_channels(random_glossy(channels=3), 1)
    assert {layer.signal.shape[1] for layer in glossy.layers.values()} == {1}


def test_no_weight_of_a_cluster_is_filtered_only_what_is_shaded():
    """Clusters of a map differ from texel to texel: they are blended after shading, as linear radiance."""
    whole = lit_cube()
    noisy = with_values(whole, whole.layers["diffuse"].signal.values + 0.1 * torch.rand(1, 9, whole.vertices))
    packed = compress(noisy, clusters=6, components=3)
    place = packed.receivers
    face, weights = torch.arange(12), torch.rand(12, 3).softmax(-1)
    with torch.no_grad():
        shaded, plain = shader(packed)(LIGHT), shader(decompress(packed))(LIGHT)
    read = place.at(shaded, face, weights)
    torch.testing.assert_close(read, bilinear(place.image(plain), place.uv_at(face, weights)))
