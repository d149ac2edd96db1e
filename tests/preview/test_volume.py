"""Is a volume in pictures and on the sheet of the window what compositing says, alone and before a surface?"""

import dataclasses
import math

import pytest
import torch
from shapes import square
from volumes import cells_of, puff, random_volume, seeing_all

from torchprt import light
from torchprt.compression import compress, reorder
from torchprt.errors import InputError
from torchprt.preview import (
    Camera,
    Environment,
    Orbit,
    Session,
    Studio,
    VolumeSession,
    VolumeStudio,
    frame,
    look,
    save_lit_glb,
    save_transfer_glb,
    session_of,
    studio_of,
)
from torchprt.shade import Composite, VolumeShader, shader, srgb, tone_mapped
from torchprt.shade.display import linear
from torchprt.transfer import Dense, Diffuse, Transfer, Vertices

ORDER = 3
WHITE = light.constant(1.0, ORDER).float()
EYE = torch.eye(3)


def environment(image=False):
    picture = light.studio(16)
    return Environment("studio", light.project(picture, ORDER), picture) if image else Environment("white", WHITE)


def wall(distance, bright=0.5):
    """A square at z = -distance that faces +z, as bright as `bright` of the light."""
    flat = square(6.0, 2)
    x, _, z = flat.positions.unbind(-1)
    places = torch.stack([x, -z, torch.full_like(x, -distance)], -1).float()
    values = torch.zeros(1, ORDER**2, len(places))
    values[0, 0] = bright / math.sqrt(4 * math.pi)
    receivers = Vertices(
        positions=places, normals=torch.tensor([0.0, 0.0, 1.0]).expand(len(places), 3), faces=flat.faces.int()
    )
    layer = Diffuse(signal=Dense(values=values), albedo=torch.ones(1, 1))
    return Transfer(receivers=receivers, layers={"diffuse": layer})


@pytest.fixture(scope="module")
def cloud():
    return seeing_all(puff(10), 0.8, ORDER)


def test_refuses_what_has_no_meaning(cloud):
    with pytest.raises(InputError, match="not recorded in a volume"):
        VolumeStudio(wall(2.0), environment())
    with pytest.raises(InputError, match="a volume itself"):
        studio_of(cloud, shader(cloud), environment(), volume=cloud)
    with pytest.raises(InputError, match="order 2, the surface of order 3"):
        VolumeStudio(cloud.to_order(2), environment(), surface=wall(2.0))
    with pytest.raises(InputError, match="no vertices"):
        VolumeStudio(cloud, environment(), colours=torch.zeros(cloud.vertices, 3))
    with pytest.raises(InputError, match="no pixels"):
        VolumeStudio(cloud, environment(), size=(0, 4)).picture(frame(cloud.receivers.subject), EYE)
    silvered = wall(2.0)
    place = silvered.receivers
    parts = {"mirror_positions": place.positions, "mirror_normals": place.normals, "mirror_faces": place.faces}
    mirrors = place.replace(**parts, mirror_reflectance=torch.ones(len(place.positions), 3))
    with pytest.raises(InputError, match="in mirrors"):
        VolumeStudio(cloud, environment(), surface=dataclasses.replace(silvered, receivers=mirrors))


def test_what_is_for_meshes_says_so(cloud, tmp_path):
    with pytest.raises(InputError, match="VolumeStudio"):
        Studio(cloud, shader(cloud), environment()).picture(frame(cloud.positions), EYE)
    with pytest.raises(InputError, match="VolumeSession"):
        Session({"cloud": cloud}, [environment()])
    with pytest.raises(InputError, match="no surface"):
        save_lit_glb(cloud, torch.zeros(cloud.vertices, 3), tmp_path / "a.glb")
    with pytest.raises(InputError, match="no vertices"):
        save_transfer_glb(cloud, tmp_path / "a.glb")
    with pytest.raises(InputError, match="no triangles"):
        reorder(compress(cloud, clusters=2, components=1))
    assert not list(tmp_path.iterdir())


def test_a_still_is_the_picture_of_the_shader(cloud):
    camera = Camera((1.0, 1.2, 4.0), (0.0, 0.0, 0.0), field=30.0)
    options = {"size": (20, 16), "exposure": 0.0}
    made = VolumeStudio(cloud, environment(), samples=1, background=(0.2, 0.4, 0.6), **options)
    shade = VolumeShader(cloud, size=(20, 16), field=30.0, target=camera.target, reading="trilinear")
    image = shade(WHITE, eye=torch.tensor(camera.eye))
    colour, hidden = image.split([3, 1], -1)
    shown = tone_mapped(colour / hidden.clamp(min=1e-6)) * hidden + linear(torch.tensor([0.2, 0.4, 0.6])) * (1 - hidden)
    torch.testing.assert_close(made.picture(camera, EYE), srgb(shown), rtol=0, atol=2e-4)
    # As a cutout it has the opacity.
    cut = VolumeStudio(cloud, environment(), samples=1, background="transparent", **options).picture(camera, EYE)
    torch.testing.assert_close(cut[..., 3], hidden[..., 0], rtol=0, atol=1e-4)
    # More rays are their mean.
    many = VolumeStudio(cloud, environment(), samples=9, background="transparent", **options).picture(camera, EYE)
    assert 0 < (many[..., 3] - cut[..., 3]).abs().max() < 0.1


def test_a_surface_behind_is_dimmed_and_one_in_front_is_not():
    cells = cells_of(torch.full((2, 2, 2), 1.0), (-1.0, -1.0, -1.0))
    slab = seeing_all(cells, 0.8, ORDER)
    camera = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    options = {"size": (3, 3), "reading": "exact", "exposure": 0.0, "tone": "none"}

    def middle(distance):
        made = VolumeStudio(slab, environment(), surface=wall(distance), samples=1, **options)
        return float(linear(made.picture(camera, EYE))[1, 1, 0])

    for distance, depth in ((2.0, 2.0), (0.0, 1.0), (-2.0, 0.0)):
        left = math.exp(-depth)
        assert middle(distance) == pytest.approx(left * 0.5 + (1 - left) * 0.8, abs=2e-3)


def test_turntables_frame_the_volume_whole(cloud):
    made = VolumeStudio(cloud, environment(image=True), size=(16, 12), samples=1, background="environment")
    orbit = Orbit.around(cloud.receivers.subject, aspect=16 / 12, sides=3)
    pictures = list(made.turntable(3, orbit, EYE))
    assert (pictures[0] - pictures[1]).abs().max() > 0.01
    for side in range(3):
        cut = VolumeStudio(cloud, environment(), size=(16, 12), samples=1, background="transparent")
        alpha = cut.picture(orbit.turned(-2 * math.pi * side / 3, 0.0).camera(), EYE)[..., 3]
        assert alpha[6, 8] > 0.5
        assert max(alpha[0].max(), alpha[-1].max(), alpha[:, 0].max(), alpha[:, -1].max()) < 0.05


def test_a_notebook_and_what_is_made_by_kind(cloud):
    assert look(cloud, WHITE, size=(8, 6)).values.shape == (6, 8, 3)
    assert isinstance(studio_of(cloud, shader(cloud), environment()), VolumeStudio)
    flat = wall(2.0)
    assert type(studio_of(flat, shader(flat), environment())) is Studio
    assert isinstance(studio_of(flat, shader(flat), environment(), volume=cloud), VolumeStudio)


# The window


def test_a_window_refuses_other_volumes_surfaces_and_poses(cloud):
    lights = [environment()]
    with pytest.raises(InputError, match="a surface or a volume"):
        session_of({"cloud": cloud, "wall": wall(2.0)}, lights)
    with pytest.raises(InputError, match="one volume"):
        session_of({"one": cloud, "other": seeing_all(puff(8), order=ORDER)}, lights)
    with pytest.raises(InputError, match="does not move"):
        session_of({"cloud": cloud}, lights, poses=torch.zeros(1, cloud.vertices, 3))


def test_the_sheet_shows_what_its_rays_see(cloud):
    session = session_of({"cloud": cloud}, [environment(image=True)])
    assert isinstance(session, VolumeSession)
    colours, places = session.colours(), session.positions
    assert colours is session.colours()
    eye = session.eye
    seen, through = Composite(cloud.receivers, reading="trilinear")(session.source(), eye[None], places - eye)
    hidden = (1 - through)[:, None]
    behind = linear(torch.full((3,), 0.27))
    tones = tone_mapped(seen / hidden.clamp(min=1e-6), exposure=session.stops, tone=session.tone)
    torch.testing.assert_close(colours, srgb(tones * hidden + behind * through[:, None]), rtol=0, atol=1e-3)
    # It covers all of the cloud: at its edge nothing is left of it.
    side = round(len(places) ** 0.5)
    border = through.view(side, side)[[0, -1]]
    assert float(border.min()) > 0.95
    assert float(through.min()) < 0.2


def test_the_sheet_follows_the_camera_and_the_light(cloud):
    session = session_of({"cloud": cloud}, [environment(image=True)])
    before, places = session.colours(), session.positions
    session.turn_camera(0.5, 0.1)
    session.advance(0.1)
    after = session.colours()
    assert not torch.equal(session.positions, places)
    # It faces the camera: its rows are along the right of the picture.
    row = session.positions[1] - session.positions[0]
    assert abs(float(row @ session.camera.axes()[0])) < 1e-9
    assert (after - before).abs().max() > 0.01
    session.next_backdrop()
    assert (session.colours() - after).abs().max() > 0.01
    session.zoom(40)
    assert bool(session.colours().isfinite().all())


def test_modes_that_a_volume_has_not_are_told_and_compression_is_there():
    cloud = random_volume("phase", puff(6), order=ORDER)
    session = session_of({"cloud": cloud, "small": compress(cloud, clusters=2, components=1)}, [environment()])
    assert "for surfaces" in session.set_mode("one lamp")
    before = session.colours()
    assert session.next_mode() == "mode: compressed, small"
    assert (session.colours() - before).abs().max() > 1e-3
    assert "no cell" in session.pick(3, 3, 10, 10)
    assert "pass" not in session.play()
