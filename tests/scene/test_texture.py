"""Are pictures decoded, looked up and averaged over the surface of a vertex as the formats say?"""

import numpy as np
import pytest
import torch
from textured_files import flat, noise, png, save_sheet, sheet, textured

from torchprt.errors import InputError
from torchprt.scene import read_surface
from torchprt.scene.footprint import surface_means
from torchprt.scene.texture import Map, Picture, Texture, bordered, linear_planes, srgb_to_linear

CLAMP, MIRROR, NEAREST = 33071, 33648, 9728
LINEAR_188 = 0.502886
"""((188 / 255 + .055) / 1.055)^2.4"""


def texture(texels, wrap="repeat", nearest=False) -> Texture:
    planes = linear_planes(np.asarray(texels, np.uint8), srgb=False)
    return Texture(bordered(planes, (wrap, wrap)), (wrap, wrap), nearest)


def row(*values) -> np.ndarray:
    """A picture of one row of greys."""
    return np.stack([np.array(values)] * 3 + [np.full(len(values), 255)], axis=-1)[None]


def hat_means(look, positions, faces, uv, rows=240):
    """Integrals against hat functions by brute force: a fine, even lattice of points in every face."""
    i, j = np.meshgrid(np.arange(rows), np.arange(rows), indexing="ij")
    low = np.stack([(i + 1 / 3), (j + 1 / 3)], -1)[i + j < rows] / rows
    high = np.stack([(i + 2 / 3), (j + 2 / 3)], -1)[i + j < rows - 1] / rows
    points = np.concatenate([low, high])
    points = np.column_stack([1 - points.sum(1), points])
    sums, weights = np.zeros((len(positions), 3)), np.zeros(len(positions))
    for face in faces:
        a, b, c = positions[face]
        area = np.linalg.norm(np.cross(b - a, c - a))
        values = look(points @ uv[face])
        for corner in range(3):
            sums[face[corner]] += area * (values * points[:, corner, None]).mean(0)
            weights[face[corner]] += area * points[:, corner].mean()
    return sums / weights[:, None]


def bilinear(texels, uv):
    """Linear colours between the middles of repeated texels, in double precision."""
    rows, columns = texels.shape[:2]
    x, y = uv[:, 0] * columns - 0.5, uv[:, 1] * rows - 0.5
    column, line = np.floor(x).astype(int), np.floor(y).astype(int)
    across, down = (x - column)[:, None], (y - line)[:, None]
    at = lambda dy, dx: texels[(line + dy) % rows, (column + dx) % columns]  # noqa: E731
    upper = at(0, 0) * (1 - across) + at(0, 1) * across
    return upper * (1 - down) + (at(1, 0) * (1 - across) + at(1, 1) * across) * down


# Misuse


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"no picture", "of no kind that is read"),
        (b"\xabKTX 20\xbb\r\n\x1a\n", "is KTX2"),
        (png(noise(64))[:400], "is damaged"),
    ],
)
def test_a_picture_that_cannot_be_read_is_named(content, words):
    with pytest.raises(InputError, match=r"wall\.png") as fault:
        Picture("wall.png", lambda: content).texels()
    assert words in str(fault.value)


# Colour


def test_colours_are_decoded_before_they_are_averaged():
    half = png(np.stack([noise(2)[0] * 0, noise(2)[0] * 0 + 255], axis=1)[:1].astype(np.uint8))
    found = Map(Picture("", lambda: half), srgb=True).texture().at(torch.tensor([[0.5, 0.5]]))
    # Half way between black and white is half the light, which a screen encodes as 188.
    assert found[:, 0] == pytest.approx(0.5)
    assert srgb_to_linear(np.array([188, 10]) / 255) == pytest.approx([LINEAR_188, 10 / 255 / 12.92], rel=1e-5)


def test_sixteen_bits_of_grey_are_all_read():
    fine = Picture("", lambda: png(np.full((2, 2), 33000, np.uint16)))
    found = Map(fine, srgb=False).texture().at(torch.tensor([[0.3, 0.3]]))
    assert found[:, 0].numpy() == pytest.approx(33000 / 65535, rel=1e-6)


def test_alpha_is_kept_only_where_it_says_something():
    assert len(linear_planes(np.full((2, 2, 4), 255, np.uint8), srgb=True)) == 3
    clear = linear_planes(np.full((2, 2, 4), 128, np.uint8), srgb=True)
    assert clear[3].numpy() == pytest.approx(128 / 255)


# Looking up


@pytest.mark.parametrize(
    ("wrap", "expected"),
    [("repeat", [10, 40, 10, 40]), ("mirror", [10, 40, 40, 10]), ("clamp", [10, 40, 40, 40])],
)
def test_outside_of_the_picture_it_goes_on_as_the_file_says(wrap, expected):
    looked = texture(row(10, 20, 30, 40), wrap).at(torch.tensor([[u, 0.5] for u in (0.125, 0.875, 1.125, 1.875)]))
    assert (255 * looked[0]).numpy() == pytest.approx(expected, abs=1e-3)


def test_between_the_last_texel_and_the_first_a_repeated_picture_has_both():
    ends = torch.tensor([[0.0, 0.5], [1.0, 0.5]])
    assert (255 * texture(row(10, 20, 30, 40)).at(ends)[0]).numpy() == pytest.approx([25, 25], abs=1e-3)
    assert (255 * texture(row(10, 20, 30, 40), "clamp").at(ends)[0]).numpy() == pytest.approx([10, 40], abs=1e-3)


def test_the_nearest_texel_is_not_mixed_with_its_neighbours():
    looked = texture(row(10, 20, 30, 40), nearest=True).at(torch.tensor([[0.26, 0.5], [0.49, 0.5], [0.51, 0.5]]))
    assert (255 * looked[0]).numpy() == pytest.approx([20, 20, 30], abs=1e-3)


@pytest.mark.parametrize("size", [(8, 8), (7, 5), (1, 6)])
def test_a_smaller_picture_has_the_same_mean(size):
    texels = np.random.default_rng(0).integers(0, 256, (*size, 4))
    whole = texture(texels)
    smaller = whole._level(3)[:, 1:-1, 1:-1]
    rows = 2 ** np.ceil(np.log2(size))
    tolerance = 1e-6 if tuple(rows) == size else 0.15
    assert smaller.mean((1, 2)).numpy() == pytest.approx(texels.mean((0, 1)) / 255, abs=tolerance)


@pytest.mark.parametrize("far", [0, 1000, -37])
def test_far_texture_coordinates_lose_no_digits(far):
    corners = np.array([[[0.1, 0.2], [0.4, 0.2], [0.1, 0.9]]])
    for mode in ("repeat", "mirror"):
        moved = texture(row(10, 20), mode).near_origin(corners + 2 * far)
        period = 2 if mode == "mirror" else 1
        assert np.mod(moved - corners + 0.5, period) == pytest.approx(0.5, abs=1e-6)


# Averages


@pytest.mark.parametrize("size", [2, 16, 61, 200])
def test_a_vertex_has_the_hat_weighted_mean_of_the_texture_around_it(tmp_path, size):
    texels = noise(size)
    path = save_sheet(tmp_path / "sheet.glb", [textured()], [png(texels)])
    positions, faces, uv = sheet()
    wanted = hat_means(lambda at: bilinear(srgb_to_linear(texels / 255), at), positions, faces, uv)
    # The lattice has 58 000 points in a face, of up to 800 texels.
    # Beside 1 / 255, which is asked for.
    assert np.abs(read_surface(path).look(False).diffuse - wanted).max() < 0.5 / 255


def test_a_texture_that_is_repeated_many_times_is_its_mean(tmp_path):
    texels = noise(256)
    _, _, uv = sheet()
    path = save_sheet(tmp_path / "sheet.glb", [textured()], [png(texels)], TEXCOORD_0=300 * uv)
    mean = srgb_to_linear(texels / 255).mean((0, 1))
    assert np.abs(read_surface(path).look(False).diffuse - mean).max() < 1 / 255


def test_the_average_is_linear_and_of_one_is_one():
    positions, faces, _ = sheet()
    texels = [positions[faces][..., :2] * 40]
    ones = surface_means(faces, np.ones(len(faces)), len(positions), texels, lambda f, p, _: ones_of(f, p), 2)
    assert ones[:, 0] == pytest.approx(np.bincount(faces.ravel()) / 3, rel=2e-3)
    assert ones[:, 1] == pytest.approx(2 * ones[:, 0], rel=1e-6)


def ones_of(faces, points):
    return torch.ones(2, len(faces) * len(points)) * torch.tensor([[1.0], [2.0]])


def test_the_same_file_gives_the_same_bits(tmp_path):
    path = save_sheet(tmp_path / "sheet.glb", [textured()], [png(noise(64))])
    assert np.array_equal(read_surface(path).look(False).diffuse, read_surface(path).look(False).diffuse)


def test_a_thin_triangle_that_crosses_a_whole_picture_is_averaged_along_it(tmp_path):
    texels = np.zeros((512, 512, 3), np.uint8)
    texels[:, 256:] = 255
    positions = sheet(1)[0]
    path = save_sheet(
        tmp_path / "sheet.glb",
        [textured()],
        [png(texels)],
        [{"wrapS": CLAMP, "wrapT": CLAMP}],
        squares=1,
        TEXCOORD_0=np.column_stack([positions[:, 0], np.full(4, 0.5)]),
    )
    found = read_surface(path).look(False).diffuse[:, 0]
    # The corner (1, 0) is of one triangle, its hat x - y: of its integral 1/6, 7/48 lie where x > 1/2.
    assert found[1] == pytest.approx(7 / 8, abs=0.5 / 255)


def test_flat_textures_are_exact(tmp_path):
    path = save_sheet(tmp_path / "sheet.glb", [textured()], [flat(188, 188, 10)])
    assert read_surface(path).look(False).diffuse == pytest.approx(
        np.tile([LINEAR_188, LINEAR_188, 10 / 255 / 12.92], (36, 1)), rel=1e-5
    )
