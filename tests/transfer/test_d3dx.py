"""Is what D3DX saved read as its documentation says it is laid out?

The files are written here number by number, from the structures and sizes in the Direct3D 9 reference.
"""

import math
import struct

import pytest
import torch
from transfers import stored

from torchprt import sh
from torchprt.errors import InputError
from torchprt.shade import shader
from torchprt.transfer import Vertices, load, load_d3dx, save


def numbers(count, seed=0):
    return torch.randn(count, generator=torch.Generator().manual_seed(seed)).tolist()


def write_prt(path, samples=5, order=3, channels=3, texture=(0, 0), values=None):
    """PRTHeader, then a float for every sample, channel and coefficient, the last fastest."""
    values = numbers(samples * channels * order * order) if values is None else values
    header = struct.pack("<6I", samples, order * order, channels, *texture, int(texture != (0, 0)))
    path.write_bytes(header + struct.pack(f"<{len(values)}f", *values))
    return values


def write_pca(path, samples=7, order=2, channels=3, clusters=2, vectors=3, texture=(0, 0)):
    """PRTCompressHeader; a mean and PCA vectors a cluster; weights; clusters of samples, if there are several."""
    coefficients = order * order
    basis = numbers(clusters * (vectors + 1) * channels * coefficients)
    weights = numbers(samples * vectors, 1)
    labels = [sample % clusters for sample in range(samples)] if clusters > 1 else []
    header = struct.pack("<8I", samples, coefficients, channels, *texture, int(texture != (0, 0)), clusters, vectors)
    path.write_bytes(
        header
        + struct.pack(f"<{len(basis)}f", *basis)
        + struct.pack(f"<{len(weights)}f", *weights)
        + struct.pack(f"<{len(labels)}I", *labels)
    )
    return basis, weights, labels or [0] * samples


def a_mesh(count):
    return Vertices(positions=torch.rand(count, 3), normals=torch.rand(count, 3), faces=torch.zeros(0, 3).int())


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"cut": 4}, "has 560 bytes, but its header says 564"),
        ({"cut": 550}, "has 14 bytes, less than the 24"),
        ({"more": 4}, "has 568 bytes, but its header says 564"),
        ({"header": (5, 8, 3, 0, 0, 0)}, "5 samples of 8 coefficients in 3 channels, which is no transfer"),
        ({"header": (5, 9, 2, 0, 0, 0)}, "in 2 channels"),
        ({"header": (0, 9, 3, 0, 0, 0)}, "0 samples"),
        ({"header": (5, 9, 3, 4, 2, 1)}, "5 samples of a texture of 4 x 2"),
        ({"header": (2**32 - 1, 9, 3, 0, 0, 0)}, "but its header says"),
    ],
)
def test_refuses_what_is_not_whole(tmp_path, change, match):
    path = tmp_path / "x.prt"
    write_prt(path)
    contents = path.read_bytes()
    if "header" in change:
        contents = struct.pack("<6I", *change["header"]) + contents[24:]
    contents = contents[: len(contents) - change.get("cut", 0)] + b"\0" * change.get("more", 0)
    path.write_bytes(contents)
    with pytest.raises(InputError, match=match) as fault:
        load(path)
    assert str(path) in str(fault.value)


def test_refuses_values_that_are_no_numbers_and_clusters_that_are_not_there(tmp_path):
    path = tmp_path / "x.prt"
    values = numbers(45)
    values[7] = math.nan
    write_prt(path, order=3, channels=1, values=values)
    with pytest.raises(InputError, match=r"x\.prt: .*NaN"):
        load(path)
    path = tmp_path / "x.pca"
    write_pca(path)
    contents = bytearray(path.read_bytes())
    contents[-4:] = struct.pack("<I", 2)
    path.write_bytes(contents)
    with pytest.raises(InputError, match="names clusters that it does not have"):
        load(path)
    contents[24:28] = struct.pack("<I", 0)
    path.write_bytes(contents)
    with pytest.raises(InputError, match="no cluster"):
        load(path)


def test_refuses_another_mesh_and_another_suffix(tmp_path):
    write_prt(tmp_path / "x.prt")
    with pytest.raises(InputError, match="holds 5 samples, but 4 receivers are given"):
        load_d3dx(tmp_path / "x.prt", a_mesh(4))
    with pytest.raises(InputError, match=r"does not exist: give a \.prt or \.pca"):
        load_d3dx(tmp_path / "y.prt")
    (tmp_path / "x.bin").write_bytes(b"")
    with pytest.raises(InputError, match="must end in"):
        load_d3dx(tmp_path / "x.bin")


@pytest.mark.parametrize("channels", [1, 3])
def test_vectors_are_those_of_each_sample_and_channel(tmp_path, channels):
    values = write_prt(tmp_path / "x.prt", channels=channels)
    found = load(tmp_path / "x.prt")
    assert (found.kind, found.order, found.channels, found.vertices) == ("diffuse", 3, channels, 5)
    for sample, channel, i in ((0, 0, 0), (0, 0, 1), (2, channels - 1, 4), (4, 0, 8)):
        wanted = values[(sample * channels + channel) * 9 + i]
        assert float(stored(found)[channel, i, sample]) == pytest.approx(wanted)


@pytest.mark.parametrize(("clusters", "vectors"), [(2, 3), (1, 3), (3, 0)])
def test_clusters_are_means_and_weighted_vectors(tmp_path, clusters, vectors):
    basis, weights, labels = write_pca(tmp_path / "x.pca", clusters=clusters, vectors=vectors)
    found = load(tmp_path / "x.pca")
    assert (found.kind, found.order, found.channels, found.vertices) == ("clustered diffuse", 2, 3, 7)
    dense = found.layers["diffuse"].signal.dense().values
    for sample, channel, i in ((0, 0, 0), (3, 1, 2), (6, 2, 3)):
        start = labels[sample] * (vectors + 1) * 12
        wanted = basis[start + channel * 4 + i] + sum(
            weights[sample * vectors + j] * basis[start + (j + 1) * 12 + channel * 4 + i] for j in range(vectors)
        )
        assert float(dense[channel, i, sample]) == pytest.approx(wanted, rel=1e-5)


def test_it_is_lit_as_d3dx_lights_it_a_product_of_each_channel(tmp_path):
    """L . T: D3DXSHDot of each channel; signs and order of the basis are the same."""
    values = torch.tensor(write_prt(tmp_path / "x.prt")).view(5, 3, 9)
    light = torch.randn(9, 3, generator=torch.Generator().manual_seed(2))
    wanted = torch.einsum("vcn,nc->vc", values, light)
    torch.testing.assert_close(shader(load(tmp_path / "x.prt"))(light), wanted)
    half = load_d3dx(tmp_path / "x.prt", albedo=torch.tensor([[0.5]]))
    torch.testing.assert_close(shader(half)(light), 0.5 * wanted)


def test_an_unshadowed_plane_of_d3dx_is_that_of_a_bake(tmp_path):
    """T = (1 / pi) int y max(n . s, 0) ds, as "PRT Equations" has it."""
    normal = torch.tensor([[0.0, 0.6, 0.8]])
    plane = (sh.zonal(sh.clamped_cosine(3), normal.double()) / math.pi).flatten().tolist()
    write_prt(tmp_path / "x.prt", samples=1, channels=1, values=plane)
    constant = torch.zeros(9, 3)
    constant[0] = math.sqrt(4 * math.pi)
    torch.testing.assert_close(shader(load(tmp_path / "x.prt"))(constant), torch.ones(1, 3))


def test_a_texture_is_texels_and_a_mesh_may_be_given(tmp_path):
    write_prt(tmp_path / "x.prt", samples=6, texture=(3, 2))
    found = load(tmp_path / "x.prt")
    assert (found.receivers.rows, found.receivers.columns) == (2, 3)
    mesh = a_mesh(7)
    write_pca(tmp_path / "x.pca")
    placed = load_d3dx(tmp_path / "x.pca", mesh)
    assert torch.equal(placed.positions, mesh.positions)
    save(placed, tmp_path / "x.safetensors")
    again = load(tmp_path / "x.safetensors")
    assert torch.equal(again.layers["diffuse"].signal.dense().values, placed.layers["diffuse"].signal.dense().values)
