"""Is the transfer of a patch periodic, in its tangent frame, and free of what lies beside it?"""

import math

import pytest
import torch
from transfers import gloss, stored

from torchprt import light
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, height_field, make_mesh, samples, tiled
from torchprt.sh import yaw_pitch_roll
from torchprt.shade import PatchShader, lay, sample, shader
from torchprt.shade.lobes import lobe_vectors
from torchprt.transport import bake, bake_patch, patch_transfer
from torchprt.transport.diffuse import unshadowed
from torchprt.transport.patch import _floor, texel_centres

EPS = torch.finfo(torch.float32).eps


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": 1}, "size is 1 x 1"),
        ({"size": (4, 0)}, "size is 4 x 0"),
        ({"around": -1}, "around is -1"),
        ({"order": 0}, "order is 0"),
        ({"albedo": torch.rand(81, 3)}, "differs from vertex to vertex"),
    ],
)
def test_refuses_what_makes_no_patch(options, message):
    with pytest.raises(InputError, match=message):
        patch_transfer(samples.bumps(8), **{"size": 4, "rays": 16, **options})


def test_refuses_a_mesh_that_is_no_patch():
    far = make_mesh(torch.tensor([[5.0, 5, 0], [6, 5, 0], [5, 6, 0]]), torch.tensor([[0, 1, 2]]), name="far")
    with pytest.raises(InputError, match="must fill the unit square"):
        patch_transfer(far, size=4, rays=16)
    with pytest.raises(InputError, match="far is beside the unit square"):
        patch_transfer(far, size=4, rays=16, tiles=False)


def test_a_flat_patch_is_lit_as_a_plane():
    baked = patch_transfer(height_field(torch.zeros(4, 4)), size=(3, 5), order=5, rays=64)
    assert baked.vertices == 15
    plane = unshadowed(torch.tensor([[0.0, 0.0, 1.0]]), 5)
    # Nothing blocks, so the bake gives the closed form to the rounding of a sum over 64 rays.
    assert (stored(baked)[0] - plane).abs().max() <= 64 * EPS
    assert baked.positions[:, 0].view(3, 5)[0].tolist() == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9])
    assert baked.positions[:, 1].view(3, 5)[:, 0].tolist() == pytest.approx([1 / 6, 0.5, 5 / 6])


@pytest.mark.parametrize("patch", [samples.bumps, samples.waffle, samples.wrinkles])
def test_a_patch_shifted_by_half_is_its_map_shifted_by_half(patch):
    mesh = patch(24)
    heights = mesh.positions[:, 2].view(25, 25)[:24, :24]
    moved = height_field(heights.roll((12, 6), (0, 1)))
    one = stored(patch_transfer(mesh, size=12, rays=256)).view(36, 12, 12).roll((6, 3), (1, 2))
    other = stored(patch_transfer(moved, size=12, rays=256)).view(36, 12, 12)
    # The tiles around end at another place; near the horizon that is seen: .4 % at the depth of the bumps, and a ray
    # of 256 that grazes an edge may fall on either side of it.
    assert (one - other).norm() < 0.01 * one.norm()


def test_more_copies_around_change_little():
    one, more = (patch_transfer(samples.wrinkles(24), size=8, rays=256, around=count) for count in (1, 2))
    assert (stored(one) - stored(more)).norm() < 0.004 * stored(more).norm()
    alone = patch_transfer(samples.wrinkles(24), size=8, rays=256, around=0)
    # Without any the creases at the border are open.
    assert (stored(alone) - stored(more)).norm() > 0.02 * stored(more).norm()


def test_texels_record_what_the_vertices_at_their_places_do():
    mesh = samples.bumps(16)
    texels = patch_transfer(mesh, size=8, rays=1024, order=4)
    whole = bake(Scene([Object(tiled(mesh, 1), Material(0.5))]), order=4, rays=1024, progress=False)
    # The centre of texel (i, j) is vertex (2 i + 1, 2 j + 1) of 17 x 17.
    vertices = torch.arange(289).view(17, 17)[1::2, 1::2].flatten()
    wanted = stored(whole)[..., vertices]
    assert (texels.positions - whole.positions[vertices]).abs().max() < 1e-6
    # Rays of a vertex start a little farther off, and nothing lies beneath it: what comes from under the horizon.
    assert (stored(texels) - wanted).norm() < 0.02 * wanted.norm()


def dome(radius=0.3, height=0.15, count=24):
    """A cap of a sphere on the middle of the square, and nothing around it."""
    ball = (radius**2 + height**2) / (2 * height)
    ring = torch.linspace(0, 1, count, dtype=torch.float64)[1:] * radius
    angle = torch.arange(4 * count, dtype=torch.float64) * (2 * math.pi / (4 * count))
    x, y = ring[:, None] * angle.cos(), ring[:, None] * angle.sin()
    z = (ball**2 - x * x - y * y).sqrt() - (ball - height)
    top = torch.tensor([[0.0, 0.0, height]], dtype=torch.float64)
    points = torch.cat([top, torch.stack([x, y, z], -1).reshape(-1, 3)])
    around = torch.arange(4 * count)
    after = (around + 1) % (4 * count)
    inner = torch.arange(count - 2)[:, None] * 4 * count + 1
    a, b, c, d = (inner + around, inner + 4 * count + around, inner + 4 * count + after, inner + after)
    faces = [torch.stack([0 * around, around + 1, after + 1], -1)]
    faces += [torch.stack(part, -1).reshape(-1, 3) for part in ((a, b, c), (a, c, d))]
    normals = points - torch.tensor([0.0, 0.0, height - ball])
    return make_mesh(points + torch.tensor([0.5, 0.5, 0.0]), torch.cat(faces), normals=normals, name="dome")


def test_nothing_comes_from_under_the_horizon():
    baked = patch_transfer(dome(), size=16, order=1, rays=4096, tiles=False)
    # A convex body on a plane loses what lies below it: of a cosine tilted by t, (1 - cos t) / 2.
    wanted = (1 + baked.normals[:, 2]) / 2 * float(unshadowed(torch.tensor([[0.0, 0.0, 1.0]]), 1))
    assert baked.normals[:, 2].min() < 0.8
    # 4096 rays, and facets of the dome that stand out of their tangent planes.
    assert (stored(baked)[0, 0] / wanted - 1).abs().max() < 0.02


def test_texels_beside_the_surface_repeat_the_nearest_on_it():
    baked = patch_transfer(dome(), size=16, order=4, rays=256, tiles=False)
    picture = stored(baked)[0].view(16, 16, 16)
    centre = (torch.arange(16) + 0.5) / 16 - 0.5
    inside = (centre[:, None].square() + centre.square()).sqrt() < 0.3
    # Left of the dome in its middle row.
    first = int(inside[8].nonzero()[0])
    assert first > 2
    assert torch.equal(picture[:, 8, :first], picture[:, 8, first : first + 1].expand(-1, first))
    # No texel is dark: every one is a copy of one on the dome.
    on_it = picture[:, inside].mT
    for texel in picture[:, ~inside].mT[::7]:
        assert (on_it == texel).all(1).any()


def test_a_patch_that_does_not_tile_does_not_see_its_copies():
    relief = samples.wrinkles(24)
    tiling, single = (patch_transfer(relief, size=8, rays=256, tiles=each) for each in (True, False))
    more = stored(single)[0, 0] - stored(tiling)[0, 0]
    assert more.min() > -1e-3
    assert more.max() > 0.01
    assert len(tiling.faces) == 2 * 64
    assert len(single.faces) == 2 * 49


def test_light_bounces_between_copies():
    direct = patch_transfer(samples.waffle(16), size=8, rays=256, albedo=0.8)
    bounced = patch_transfer(samples.waffle(16), size=8, rays=256, albedo=(0.8, 0.4, 0.1), bounces=2)
    assert bounced.channels == 3
    more = stored(bounced)[:, 0] - stored(direct)[:, 0]
    assert (more >= 0).all()
    assert more[0].mean() > more[1].mean() > more[2].mean() > 0
    assert torch.allclose(bounced.albedo, torch.tensor([[0.8, 0.4, 0.1]]))


def test_unshadowed_patches_follow_their_normals_alone():
    baked = patch_transfer(samples.bumps(16), size=8, shadows=False, order=5)
    assert baked.transport == "unshadowed"
    assert (stored(baked)[0] - unshadowed(baked.normals.double(), 5)).abs().max() < 1e-6


def test_the_same_for_any_number_of_threads():
    one, two = (patch_transfer(samples.bumps(8), size=30, rays=64, threads=count) for count in (1, 2))
    assert torch.equal(stored(one), stored(two))


@pytest.fixture(scope="module")
def small():
    options = {"size": (8, 12), "rays": 256, "order": 4, "albedo": (0.5, 0.4, 0.3)}
    return patch_transfer(samples.bumps(16), **options), bake_patch(samples.bumps(16), **options)


def test_a_baked_patch_is_a_map_of_what_was_recorded(small):
    texels, patch = small
    patch.check()
    place, lobes = patch.receivers, gloss(patch).signal
    assert (place.rows, place.columns) == (8, 12)
    assert (lobes.lobes, patch.order, patch.rays, patch.transport) == (4, 4, 256, "shadowed")
    assert (place.tiles_u, place.tiles_v, lobes.smooth) == (True, True, False)
    found, albedo = sample(patch, texel_centres(8, 12))
    vectors = lobe_vectors(found.axis[0].movedim(1, 0), found.coefficients[:, 0], found.exact[:, 0])
    assert (vectors - stored(texels)).norm() <= 1.001 * lobes.fit_error * stored(texels).norm()
    assert lobes.fit_error < 0.01
    assert torch.equal(albedo, texels.albedo)


def test_a_patch_on_a_plane_of_its_size_is_the_relief_itself(small):
    """Laid on the unit square, at texels, radiance is that of the bake of the relief."""
    texels, patch = small
    places = texel_centres(8, 12)
    plane = torch.cat([places, torch.zeros(96, 1)], 1)
    frames = torch.eye(3, dtype=torch.float64).expand(96, 3, 3)
    laid = lay(patch, plane, torch.zeros(0, 3, dtype=torch.int64), places, frames=frames)
    lamps = light.project(light.studio(64), 4)
    found, wanted = shader(laid)(lamps), shader(texels)(lamps.float())
    assert (found - wanted).norm() < 0.01 * wanted.norm()


def test_a_patch_that_does_not_tile_is_a_map_that_does_not():
    patch = bake_patch(dome(), size=8, rays=64, order=3, lobes=1, tiles=False)
    assert (patch.receivers.tiles_u, patch.receivers.tiles_v) == (False, False)


def test_a_smooth_patch_is_read_smoothly():
    assert gloss(bake_patch(samples.bumps(8), size=6, rays=64, order=3, lobes=2, smooth=True)).signal.smooth


@pytest.mark.filterwarnings("ignore::torchprt.transport.OrderWarning")
def test_a_glossy_patch_looks_from_an_eye_as_the_turned_relief_does():
    """Bumps of glossy paint as texels in lobes on a turned square, against points baked on the turned relief itself."""
    paint, mesh, size = {"albedo": 0.2, "gloss": "ggx:0.4,0.4"}, samples.bumps(16), 3
    patch = bake_patch(mesh, size=size, order=4, rays=256, lobes=3, around=0, factors=3, **paint)
    assert patch.receivers.relief is not None
    rotation = yaw_pitch_roll(torch.tensor([40.0, -30.0, 70.0], dtype=torch.float64))
    frames, uv = rotation.expand(size * size, 3, 3), texel_centres(size, size)

    def turned(mesh):
        return make_mesh(mesh.positions @ rotation.mT, mesh.faces)

    texels = patch_transfer(mesh, size=size, order=2, rays=8)
    places = texels.positions.double()
    baked = bake(
        Scene(
            [
                Object(turned(mesh), Material(**paint)),
                Object(turned(_floor(mesh)), Material(0.0), "blocker"),
            ]
        ),
        receivers=Points(
            places @ rotation.mT,
            texels.normals.double() @ rotation.mT,
            paint["albedo"],
            paint["gloss"],
            tangents=rotation[:, 0].expand(size * size, 3),
        ),
        order=4,
        rays=256,
        progress=False,
        factors=3,
    )
    generator = torch.Generator().manual_seed(0)
    environment = torch.randn(3, 16, 3, generator=generator)
    eye = (rotation @ torch.tensor([1.5, 0.2, 2.0], dtype=torch.float64)).float()
    wanted = shader(baked)(environment, eye=eye)
    found = PatchShader(patch)(environment, uv, frames, eye=eye, positions=places @ rotation.mT)
    # What three lobes leave of each row, and a ray of 256 here and there at an edge.
    assert float((found - wanted).norm() / wanted.norm()) < 0.02


def test_a_glossy_patch_refuses_what_lobes_cannot_hold():
    with pytest.raises(InputError, match="frame 'visibility' cannot be held in lobes"):
        patch_transfer(samples.bumps(8), size=4, gloss="lambert", frame="visibility")
    with pytest.raises(InputError, match="for glossy materials"):
        patch_transfer(samples.bumps(8), size=4, rays=8, factors=3)


def test_texels_beside_a_glossy_patch_are_those_of_its_border():
    half = make_mesh(
        torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [0.5, 1, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2], [0, 2, 3]])
    )
    found = patch_transfer(half, size=4, rays=32, order=3, tiles=False, gloss="lambert", output_order=2)
    assert found.kind == "exit"
    values, tangents = stored(found)[0].view(4, 4, -1), gloss(found).tangents.view(4, 4, 3)
    for column in (2, 3):
        assert torch.equal(values[:, column], values[:, 1])
        assert torch.equal(tangents[:, column], tangents[:, 1])
