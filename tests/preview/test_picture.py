"""Does a still show the radiance that was given, where it is and on the side that it is on?"""

import itertools
import math

import numpy as np
import PIL.Image
import pytest
import torch
from shapes import square

from torchprt.errors import InputError
from torchprt.preview import Camera, Still, save_png, sheet
from torchprt.shade import srgb, tone_mapped
from torchprt.shade.display import linear

TRIANGLE = torch.tensor([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.5, 0.0]])
FACE = torch.tensor([[0, 1, 2]])
FRONT = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), field=40.0)
BACK = Camera((0.0, 0.0, -5.0), (0.0, 0.0, 0.0), field=40.0)


def hits_of_plane(camera, width, height):
    """Where the rays of the pixels' middles meet the plane z = 0."""
    rays = camera.directions(width, height)
    eye = torch.tensor(camera.eye, dtype=torch.float64)
    return eye - rays * (eye[2] / rays[..., 2:])


def barycentric(points, corners):
    """Areas of the three triangles under each point of the plane, over the whole: negative outside."""

    def area(a, b, c):
        return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])

    a, b, c = corners.double()
    whole = area(a, b, c)
    return torch.stack([area(points, b, c), area(a, points, c), area(a, b, points)], -1) / whole


def test_refuses_loose_points():
    with pytest.raises(InputError, match=r"needs faces.*\.npy or \.ply"):
        Still(TRIANGLE, torch.zeros(0, 3, dtype=torch.int64))


@pytest.mark.parametrize("options", [{"size": (0, 4)}, {"size": (4, 0)}, {"size": (4, 4), "samples": 0}])
def test_refuses_a_picture_without_pixels(options):
    with pytest.raises(InputError, match="no pixels"):
        Still(TRIANGLE, FACE, **options)


@pytest.mark.parametrize("rows", [0, 2, 4])
def test_refuses_radiance_of_another_model(rows):
    still = Still(TRIANGLE, FACE, size=(4, 4), camera=FRONT)
    with pytest.raises(InputError, match=f"radiance of {rows} vertices for a model of 3"):
        still.radiance(torch.zeros(rows, 3))


def test_a_triangle_shows_the_interpolation_of_its_corners():
    colours = torch.tensor([[1.0, 0.0, 20.0], [0.0, 1.0, 5.0], [-3.0, 0.25, 0.5]])
    picture = Still(TRIANGLE, FACE, size=(60, 44), camera=FRONT, samples=1).radiance(colours, background=7.0)
    weights = barycentric(hits_of_plane(FRONT, 60, 44), TRIANGLE)
    expected = (weights @ colours.double()).float()
    inside, outside = weights.amin(-1) > 1e-4, weights.amin(-1) < -1e-4
    assert inside.sum() > 300
    assert outside.sum() > 300
    # Embree works in float32 on a triangle of size 1 seen from 5: some tens of its epsilon times the largest value.
    torch.testing.assert_close(
        picture[inside], expected[inside], atol=20 * 100 * torch.finfo(torch.float32).eps, rtol=0
    )
    assert (picture[outside] == 7).all()


def test_a_back_face_is_black():
    picture = Still(TRIANGLE, FACE, size=(40, 40), camera=BACK, samples=1).radiance(torch.ones(3, 3), background=0.5)
    assert (picture == 0).any()
    assert set(picture.unique().tolist()) == {0.0, 0.5}


def two_sides(order=0):
    """A square that is there twice, its reverse wound the other way: radiance 1 in front, 2 behind."""
    mesh = square(2.0, 5)
    positions, count = mesh.positions, len(mesh.positions)
    faces = torch.cat([mesh.faces, mesh.faces.flip(1).roll(order, 1) + count])
    return torch.cat([positions, positions]), faces, torch.cat([torch.ones(count, 3), torch.full((count, 3), 2.0)])


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize(("height", "expected"), [(5.0, 1.0), (-5.0, 2.0)])
def test_a_two_sided_surface_shows_the_side_that_faces_the_camera(order, height, expected):
    positions, faces, radiance = two_sides(order)
    camera = Camera((0.4, height, 0.3), (0.0, 0.0, 0.0))
    picture = Still(positions, faces, size=(50, 50), camera=camera, samples=1).radiance(radiance, background=9.0)
    seen = picture[picture != 9.0]
    assert len(seen) > 1000
    torch.testing.assert_close(seen, torch.full_like(seen, expected), rtol=1e-6, atol=0)


def test_the_reverse_side_takes_its_own_corners():
    positions, faces, _ = two_sides(1)
    radiance = positions.float().abs() + torch.tensor([0.0, 1.0, 0.0])
    radiance[: len(radiance) // 2] = 100
    camera = Camera((0.0, -5.0, 0.1), (0.0, 0.0, 0.0))
    picture = Still(positions, faces, size=(60, 60), camera=camera, samples=1).radiance(radiance, background=-1.0)
    rays = camera.directions(60, 60)
    eye = torch.tensor(camera.eye, dtype=torch.float64)
    place = eye - rays * (eye[1] / rays[..., 1:2])
    inside = place[..., [0, 2]].abs().amax(-1) < 0.99
    assert inside.sum() > 500
    # Interpolation of |x| and |z| is exact, for the axes run along the edges of the grid; float32 of Embree.
    torch.testing.assert_close(picture[inside][:, 0], place[inside][:, 0].abs().float(), atol=2e-5, rtol=0)
    torch.testing.assert_close(picture[inside][:, 2], place[inside][:, 2].abs().float(), atol=2e-5, rtol=0)


def test_a_face_that_is_there_twice_in_the_same_sense_has_no_reverse_side():
    positions = torch.cat([TRIANGLE, TRIANGLE])
    for turn in range(3):
        faces = torch.cat([FACE, FACE.roll(turn, 1) + 3])
        behind = Still(positions, faces, size=(20, 20), camera=BACK, samples=1).radiance(torch.ones(6, 3), 0.5)
        assert set(behind.unique().tolist()) == {0.0, 0.5}


def test_two_copies_of_a_two_sided_face_still_show_both_sides():
    for turned in itertools.permutations([FACE, FACE + 3, FACE.flip(1) + 6, FACE.flip(1) + 9]):
        positions, faces = TRIANGLE.repeat(4, 1), torch.cat(turned)
        for camera in (FRONT, BACK):
            seen = Still(positions, faces, size=(12, 12), camera=camera, samples=1).radiance(torch.ones(12, 3), 0.5)
            assert seen.min() == 0.5


@pytest.mark.parametrize("samples", [1, 3, 4, 7])
def test_a_pixel_is_the_mean_of_its_rays(samples):
    colours = torch.rand(3, 3, generator=torch.Generator().manual_seed(1))
    still = Still(TRIANGLE, FACE, size=(24, 16), camera=FRONT, samples=samples)
    rays = still.directions()
    assert rays.shape == (16, 24, samples, 3)
    eye = torch.tensor(FRONT.eye, dtype=torch.float64)
    weights = barycentric(eye - rays * (eye[2] / rays[..., 2:]), TRIANGLE)
    inside = weights.amin(-1) > 0
    expected = torch.where(inside[..., None], weights @ colours.double(), 0.25).mean(2).float()
    clear = (weights.amin(-1).abs() > 1e-4).all(-1)
    assert clear.sum() > 300
    # Embree works in float32 on a triangle of size 1 seen from 5.
    close = {"atol": 20 * 5 * torch.finfo(torch.float32).eps, "rtol": 0}
    torch.testing.assert_close(still.radiance(colours, 0.25)[clear], expected[clear], **close)
    share = inside.double().mean(-1).float()
    torch.testing.assert_close(still.coverage[clear], share[clear], **close)


@pytest.mark.parametrize("samples", [4, 5, 9, 16])
@pytest.mark.parametrize("turned", [False, True])
def test_an_edge_along_the_pixels_has_as_many_steps_as_there_are_samples(samples, turned):
    """A grid of 2 x 2 would know only 0, a half and 1 of a pixel."""
    for place in torch.linspace(-0.4, 0.4, 23).tolist():
        corners = torch.tensor([[place, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [place, 9.0, 0.0]])
        corners = corners[:, [1, 0, 2]] if turned else corners
        faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
        still = Still(corners, faces.flip(1) if turned else faces, size=(8, 8), camera=FRONT, samples=samples)
        across = still.coverage[4] if not turned else still.coverage[:, 4].flip(0)
        # The half width of the picture is 5 tan 20 degrees: what it covers of the row, in pixels.
        exact = 4 - place / (5 * math.tan(math.radians(20))) * 4
        assert abs(float(across.sum()) - exact) <= 0.5 / samples + 1e-3


def test_what_is_half_transparent_shows_half_of_what_is_behind():
    half = torch.full((3,), 0.5)
    still = Still(TRIANGLE, FACE, size=(24, 24), camera=FRONT, samples=1, opacity=half)
    picture = still.picture(torch.full((3, 3), 0.4), tone="none", background=0.2)
    torch.testing.assert_close(picture[12, 12], srgb(torch.full((3,), 0.3)), atol=1e-6, rtol=0)
    assert float(still.coverage[12, 12]) == pytest.approx(0.5, abs=1e-6)


def test_what_is_transparent_adds_nothing_to_its_neighbours():
    still = Still(*(TRIANGLE, FACE), size=(24, 24), camera=FRONT, samples=1, opacity=torch.tensor([1.0, 1.0, 0.0]))
    # However bright the transparent corner is, toward it the picture goes to what is behind.
    picture = still.picture(torch.full((3, 3), 0.4), tone="none", background=0.0)
    rows = picture[:, 12, 0][still.coverage[:, 12] > 0]
    assert (rows.diff() > 0).all()
    assert rows[0] < rows[-1] / 2


def test_an_edge_before_the_dark_of_a_bright_model_is_as_soft_as_any():
    """Mixed before the tone map, a radiance of 1000 would fill every pixel that it touches."""
    still = Still(TRIANGLE, FACE, size=(40, 40), camera=FRONT, samples=16)
    picture = still.picture(torch.full((3, 3), 1000.0), background=0.0)
    edge = (still.coverage > 0) & (still.coverage < 1)
    assert edge.sum() > 20
    white = float(tone_mapped(torch.full((3,), 1000.0)).mean())
    wanted = srgb(white * still.coverage[..., None].expand(-1, -1, 3))
    torch.testing.assert_close(picture, wanted, atol=1e-5, rtol=0)


def test_a_cutout_before_a_colour_is_the_picture_before_it():
    colours = torch.rand(3, 3, generator=torch.Generator().manual_seed(3))
    still = Still(TRIANGLE, FACE, size=(24, 24), camera=FRONT)
    cutout, picture = still.cutout(colours), still.picture(colours, background=0.6)
    assert cutout.shape == (24, 24, 4)
    opaque = cutout[..., 3:]
    mixed = srgb(linear(cutout[..., :3]) * opaque + 0.6 * (1 - opaque))
    torch.testing.assert_close(mixed, picture, atol=1e-5, rtol=0)


def test_a_model_out_of_sight_leaves_the_background():
    away = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 10.0))
    still = Still(TRIANGLE, FACE, size=(6, 4), camera=away)
    assert torch.equal(still.radiance(torch.ones(3, 3), 2.0), torch.full((4, 6, 3), 2.0))
    assert torch.equal(still.cutout(torch.ones(3, 3)), torch.zeros(4, 6, 4))


@pytest.mark.parametrize("size", [(1, 1), (64, 48), (30, 90)])
def test_the_plain_background_is_lightest_behind_the_model_and_has_no_edge(size):
    plain = srgb(Still(TRIANGLE, FACE, size=size, camera=FRONT, samples=1).plain())
    height, width, _ = plain.shape
    assert float(plain[height // 2, width // 2].min()) >= float(plain[0, 0].min())
    if size != (1, 1):
        assert float(plain[0, 0].mean()) < 0.6 * float(plain[height // 2, width // 2].mean())
        assert float(plain.diff(dim=0).abs().max()) < 0.03
        assert float(plain.diff(dim=1).abs().max()) < 0.03


def test_exposure_lights_the_model_and_not_the_background():
    still = Still(TRIANGLE, FACE, size=(24, 24), camera=FRONT, samples=1)
    dark, light = (still.picture(torch.full((3, 3), 0.1), exposure=stops) for stops in (0.0, 2.0))
    assert torch.equal(dark[0, 0], light[0, 0])
    assert (light[12, 12] > dark[12, 12]).all()
    assert torch.equal(light[12, 12], still.picture(torch.full((3, 3), 0.4))[12, 12])


def test_a_model_in_micrometres_far_away_is_seen_as_one_at_home():
    colours = torch.rand(3, 3, generator=torch.Generator().manual_seed(2))
    shift = torch.tensor([4.0, -7.0, 2.0], dtype=torch.float64)
    near = Still(TRIANGLE, FACE, size=(30, 30), samples=1).radiance(colours)
    far = Still((TRIANGLE.double() + shift) * 1e-6, FACE, size=(30, 30), samples=1).radiance(colours)
    # Pixels at the very rim may fall to either side.
    assert ((near - far).abs().amax(-1) > 1e-3).float().mean() < 0.01


def test_png_holds_the_picture_and_replaces_a_former_one_whole(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"former")
    picture = torch.rand(5, 9, 3, generator=torch.Generator().manual_seed(0))
    picture[0, 0] = torch.tensor([-1.0, 2.0, 0.5])
    save_png(picture, path)
    with PIL.Image.open(path) as opened:
        values = np.asarray(opened)
        assert opened.size == (9, 5)
    np.testing.assert_array_equal(values, (picture.clamp(0, 1) * 255).round().numpy().astype(np.uint8))
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.png"]


def test_a_png_keeps_what_is_transparent(tmp_path):
    picture = torch.rand(5, 9, 4, generator=torch.Generator().manual_seed(0))
    save_png(picture, tmp_path / "a.png")
    with PIL.Image.open(tmp_path / "a.png") as opened:
        assert opened.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(opened), (picture * 255).round().numpy().astype(np.uint8))


def test_a_png_that_cannot_be_written_leaves_nothing(tmp_path):
    picture = torch.zeros(2, 2, 3)
    with pytest.raises(InputError, match="cannot be written"):
        save_png(picture, tmp_path / "none" / "a.png")
    with pytest.raises(InputError, match="is a folder"):
        save_png(picture, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_failure_while_writing_keeps_the_former_file(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(b"former")

    def breaks(self, *_, **__):
        raise OSError("disk full")

    monkeypatch.setattr(PIL.Image.Image, "save", breaks)
    with pytest.raises(OSError, match="disk full"):
        save_png(torch.zeros(2, 2, 3), path)
    assert path.read_bytes() == b"former"
    assert len(list(tmp_path.iterdir())) == 1


# Sheets


@pytest.mark.parametrize(
    ("count", "labels", "columns"), [(0, [], 1), (2, ["one"], 2), (1, ["one", "two"], 1), (1, ["one"], 0)]
)
def test_refuses_a_sheet_of_nothing_or_with_other_labels(count, labels, columns):
    with pytest.raises(InputError, match="sheet"):
        sheet([torch.zeros(4, 4, 3)] * count, labels, columns)


def test_refuses_pictures_of_several_sizes():
    with pytest.raises(InputError, match="one size"):
        sheet([torch.zeros(4, 4, 3), torch.zeros(4, 5, 3)], ["a", "b"], 2)


@pytest.mark.parametrize(("count", "columns", "rows"), [(1, 1, 1), (3, 3, 1), (4, 3, 2), (3, 1, 3)])
def test_a_sheet_shows_each_picture_under_its_label(count, columns, rows):
    levels = torch.arange(1, count + 1) * 20
    pictures = [torch.full((30, 50, 3), int(level) / 255) for level in levels]
    page = (sheet(pictures, [f"number {number}" for number in range(count)], columns) * 255).round().to(torch.int64)
    assert page.shape == (rows * (30 + 22 + 6) + 6, columns * (50 + 6) + 6, 3)
    for number, level in enumerate(levels):
        y, x = 6 + number // columns * 58 + 22, 6 + number % columns * 56
        assert (page[y : y + 30, x : x + 50] == level).all()
        label = page[y - 22 : y, x : x + 50]
        assert (label < 128).any()
        assert (label == 255).float().mean() > 0.5
