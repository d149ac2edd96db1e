"""Does a patch that is read at every pixel look as it does on a mesh fine enough to show it?"""

import math

import pytest
import torch
from lobe_maps import random_glossy_map, random_map

from torchprt.errors import InputError
from torchprt.preview import Camera, Environment, PatchStudio, Studio
from torchprt.scene import make_mesh
from torchprt.sh import yaw_pitch_roll
from torchprt.shade import lay, shader

ABOVE = Camera(eye=(0.4, 0.3, 2.0), target=(0.5, 0.5, 0.0), up=(0.0, 1.0, 0.0), field=35.0)


def square(count):
    """The unit square in the plane z = 0 as 2 count^2 faces, texture coordinates as x and y."""
    ticks = torch.linspace(0, 1, count + 1)
    y, x = torch.meshgrid(ticks, ticks, indexing="ij")
    corner = (torch.arange(count)[:, None] * (count + 1) + torch.arange(count)).flatten()
    quads = torch.stack([corner, corner + 1, corner + count + 2, corner + count + 1], -1)
    positions = torch.stack([x, y, 0 * x], -1).view(-1, 3)
    return positions, torch.cat([quads[:, :3], quads[:, [0, 2, 3]]]).int(), positions[:, :2].clone()


def a_light(order=4):
    light = 0.1 * torch.randn(order**2, 3, generator=torch.Generator().manual_seed(1))
    light[0] += 3
    return Environment("a light", light, None)


def pixels(kind, count, camera=ABOVE, **options):
    """Linear radiance of a picture."""
    patch = random_map(dtype=torch.float32) if kind == "diffuse" else random_glossy_map(kind)
    studio = PatchStudio(patch, *square(count), a_light(), size=(60, 60), exposure=0.0, **options)
    still, radiance = studio.shaded(camera, studio.environment.light)
    return still.radiance(radiance)


def test_refuses_what_is_no_patch_or_has_no_coordinates():
    positions, faces, uv = square(2)
    with pytest.raises(InputError, match="no texture coordinates: unwrap it"):
        PatchStudio(random_map(), positions, faces, None, a_light())
    with pytest.raises(InputError, match="recorded at vertices"):
        PatchStudio(lay(random_map(), positions, faces, uv), positions, faces, uv, a_light())
    with pytest.raises(InputError, match="order 4"):
        PatchStudio(random_map(), positions, faces, uv, a_light(3)).picture(ABOVE, torch.eye(3))


@pytest.mark.parametrize("kind", ["diffuse", "exit"])
def test_two_faces_show_what_many_faces_do(kind):
    wanted, coarse = pixels(kind, 40), pixels(kind, 1)
    # Barycentrics of Embree in float32, and places that cross from one texel to the next by its rounding.
    differs = (wanted - coarse).abs().amax(-1) > 1e-4 * wanted.abs().max()
    assert float(differs.float().mean()) < 0.01


def test_at_vertices_coarse_faces_lose_it_and_fine_ones_come_near():
    patch, light = random_map(dtype=torch.float32, smooth=True), a_light()

    def at_vertices(count):
        laid = lay(patch, *square(count))
        studio = Studio(laid, shader(laid), light, size=(60, 60))
        still, radiance = studio.shaded(ABOVE, light.light)
        return still.radiance(radiance)

    exact = PatchStudio(patch, *square(1), light, size=(60, 60))
    still, radiance = exact.shaded(ABOVE, light.light)
    wanted = still.radiance(radiance)
    errors = [float((at_vertices(count) - wanted).norm() / wanted.norm()) for count in (1, 40, 160)]
    assert errors[0] > 0.2
    assert errors[2] < 0.03
    assert errors[2] < 0.5 * errors[1]


def test_many_samples_in_pieces_are_the_same_picture(monkeypatch):
    whole = pixels("exit", 2)
    monkeypatch.setattr("torchprt.preview.per_pixel._NUMBERS", 1600)
    assert torch.equal(pixels("exit", 2), whole)


def test_a_gloss_follows_the_camera_and_the_patch_its_repeat():
    aside = Camera(eye=(2.0, 1.5, 1.0), target=(0.5, 0.5, 0.0), up=(0.0, 1.0, 0.0), field=35.0)
    patch, light = random_glossy_map("exit"), a_light()
    studio = PatchStudio(patch, *square(1), light, size=(40, 40))
    first = studio.picture(ABOVE, torch.eye(3))
    other = studio.picture(aside, torch.eye(3))
    assert float((studio.picture(ABOVE, torch.eye(3)) - first).abs().max()) == 0
    assert float((other - first).abs().mean()) > 0.01
    assert float((pixels("exit", 1, repeat=(3.0, 2.0)) - pixels("exit", 1)).abs().mean()) > 0.01


def test_a_surface_that_is_turned_with_light_and_camera_looks_the_same():
    turn = yaw_pitch_roll(torch.tensor([90.0, 0.0, 0.0]))
    positions, faces, uv = square(1)
    patch, light = random_glossy_map("exit"), a_light()
    wanted = PatchStudio(patch, positions, faces, uv, light, size=(40, 40)).picture(ABOVE, torch.eye(3))
    moved = Camera(
        eye=tuple((turn @ torch.tensor(ABOVE.eye)).tolist()),
        target=tuple((turn @ torch.tensor(ABOVE.target)).tolist()),
        up=ABOVE.up,
        field=ABOVE.field,
    )
    found = PatchStudio(patch, positions @ turn.mT, faces, uv, light, size=(40, 40)).picture(moved, turn)
    # At the edges of texels and of the square rays fall to either side.
    assert float(((found - wanted).abs().amax(-1) > 0.01).float().mean()) < 0.02


def test_the_back_of_a_surface_is_black_and_what_is_behind_it_shows_around():
    patch = random_map(dtype=torch.float32)
    below = Camera(eye=(0.5, 0.5, -2.0), target=(0.5, 0.5, 0.0), up=(0.0, 1.0, 0.0), field=35.0)
    studio = PatchStudio(patch, *square(1), a_light(), size=(40, 40), background=(1.0, 1.0, 1.0))
    picture = studio.picture(below, torch.eye(3))
    assert float(picture[20, 20].max()) == 0
    assert float(picture[0, 0].min()) == pytest.approx(1.0)


def test_a_patch_read_at_pixels_keeps_the_seam_of_a_chart():
    """Coordinates that begin anew at an edge: a vertex there has one pair, a corner of a face its own."""
    positions, faces, uv = square(1)
    mesh = make_mesh(positions, faces.long())
    corners = uv[faces.long()].clone()
    # The second face is another chart, a whole number of patches away: it shows the same.
    corners[1] += torch.tensor([5.0, -2.0])
    patch = random_map(dtype=torch.float32)
    one, other = (
        PatchStudio(patch, mesh.positions, faces, each, a_light(), size=(40, 40)).picture(ABOVE, torch.eye(3))
        for each in (uv, corners)
    )
    assert float(((one - other).abs().amax(-1) > 1e-3).float().mean()) < 0.01
    assert not math.isclose(float(one[20, 20].max()), 0.0)
