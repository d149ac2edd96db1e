"""Do patches lie on surfaces as texture coordinates say, and do lobes come from the right texels?"""

import math

import pytest
import torch
from lobe_maps import random_map
from transfers import replaced

from torchprt import sh
from torchprt.errors import InputError
from torchprt.pose import surface_frames
from torchprt.scene import bend, make_mesh, samples, twist
from torchprt.shade import lay, sample, shader

EPS = torch.finfo(torch.float64).eps


def square(count=5, mirrored=False):
    """The unit square in the plane z = 0, facing +z, with texture coordinates equal to x (or 1 - x) and y."""
    ticks = torch.linspace(0, 1, count, dtype=torch.float64)
    y, x = torch.meshgrid(ticks, ticks, indexing="ij")
    positions = torch.stack([x, y, 0 * x], -1).reshape(-1, 3)
    corner = (torch.arange(count - 1)[:, None] * count + torch.arange(count - 1)).reshape(-1)
    quads = torch.stack([corner, corner + 1, corner + count + 1, corner + count], -1)
    uv = positions[:, :2].clone()
    if mirrored:
        uv[:, 0] = 1 - uv[:, 0]
    return positions, torch.cat([quads[:, :3], quads[:, [0, 2, 3]]]), uv


def light(order=4, seed=3):
    return torch.randn(order * order, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def turn(seed=1):
    return (
        torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64))[0] * 1.0
    )


def test_a_surface_without_texture_coordinates_is_refused():
    positions, faces, uv = square()
    mesh = make_mesh(positions, faces)
    for call in (
        lambda: lay(random_map(), positions, faces, mesh.uv),
        lambda: surface_frames(positions, faces, mesh.uv),
    ):
        with pytest.raises(InputError, match="no texture coordinates: unwrap it"):
            call()
    uv[3, 0] = torch.nan
    with pytest.raises(InputError, match="corners of faces without texture coordinates"):
        lay(random_map(), positions, faces, uv)


def test_shapes_that_do_not_fit_are_refused():
    positions, faces, uv = square()
    with pytest.raises(InputError, match=r"uv have shape \[24, 2\]"):
        lay(random_map(), positions, faces, uv[1:])
    with pytest.raises(InputError, match=r"frames have shape \[1, 3, 3\]"):
        lay(random_map(), positions, faces, uv, frames=torch.eye(3)[None])
    with pytest.raises(InputError, match="uv of 1 points are not finite"):
        sample(random_map(), torch.tensor([[0.5, torch.inf], [0.0, 0.0]]))


def test_no_points_have_no_lobes_and_no_frames():
    none = torch.zeros(0, 3, dtype=torch.int64)
    assert surface_frames(torch.zeros(2, 3), none, torch.zeros(2, 2)).abs().max() == 0
    assert sample(random_map(), torch.zeros(0, 2, dtype=torch.float64))[0].shape[0] == 0


def lobes(patch):
    return patch.layers["diffuse"].signal


def texel(values, row, column):
    """Values of the map of 6 x 8 texels there."""
    return values.unflatten(-1, (6, 8))[..., row, column]


def centres(patch):
    rows, columns = patch.receivers.rows, patch.receivers.columns
    v, u = torch.meshgrid(
        (torch.arange(rows, dtype=torch.float64) + 0.5) / rows,
        (torch.arange(columns, dtype=torch.float64) + 0.5) / columns,
        indexing="ij",
    )
    return torch.stack([u, v], -1).reshape(-1, 2)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("size", [(1, 1), (6, 8), (5, 3)])
def test_at_the_centre_of_a_texel_everything_is_its_own(size, smooth):
    patch = random_map(*size, smooth=smooth)
    found, albedo = sample(patch, centres(patch))
    assert torch.equal(found.squared_error, lobes(patch).squared_error)
    # A coordinate times the size of the map is off by an epsilon of it, and so is each share; values are below 4.
    for name in ("axis", "coefficients", "exact"):
        assert (getattr(found, name) - getattr(lobes(patch), name)).abs().max() <= 64 * EPS
    assert (albedo - patch.albedo).abs().max() <= 64 * EPS


def test_between_texels_low_bands_and_albedo_are_bilinear_and_lobes_the_nearest():
    patch = random_map()
    # A quarter of the way from the centre of texel (2, 3) to that of (3, 4).
    place = torch.tensor([[(3.5 + 0.25) / 8, (2.5 + 0.25) / 6]], dtype=torch.float64)
    found, albedo = sample(patch, place)
    weights = torch.tensor([[0.75], [0.25]], dtype=torch.float64) * torch.tensor([[0.75, 0.25]], dtype=torch.float64)
    for mine, values in ((found.exact[..., 0], lobes(patch).exact), (albedo[0], patch.albedo.mT)):
        wanted = (texel(values, slice(2, 4), slice(3, 5)) * weights).sum((-2, -1))
        assert (mine - wanted).abs().max() <= 64 * EPS
    assert torch.equal(found.axis[..., 0], texel(lobes(patch).axis, 2, 3))
    assert torch.equal(found.coefficients[..., 0], texel(lobes(patch).coefficients, 2, 3))


def test_lobes_of_a_smooth_map_are_interpolated_and_stay_lobes():
    patch = random_map(smooth=True)
    found, _ = sample(patch, torch.tensor([[4.0 / 8, 2.5 / 6]], dtype=torch.float64))
    middle = (texel(lobes(patch).axis, 2, 3) + texel(lobes(patch).axis, 2, 4)) / 2
    assert (found.axis[..., 0] - middle / middle.norm(dim=2, keepdim=True)).abs().max() <= 256 * EPS
    wanted = texel(lobes(patch).coefficients, 2, slice(3, 5)).mean(-1)
    assert (found.coefficients[..., 0] - wanted).abs().max() <= 64 * EPS


@pytest.mark.parametrize("tiles", [(True, True), (False, True), (True, False), (False, False)])
def test_outside_the_unit_square_a_map_repeats_or_goes_on_with_its_border(tiles):
    patch = random_map(tiles_u=tiles[0], tiles_v=tiles[1])
    inside = torch.rand(40, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for axis, repeats in enumerate(tiles):
        for shift in (-3.0, 1.0, 1024.0):
            outside = inside.clone()
            outside[:, axis] += shift
            wanted = inside.clone()
            if not repeats:
                wanted[:, axis] = 0.0 if shift < 0 else 1.0
            (one, _), (other, _) = sample(patch, outside), sample(patch, wanted)
            # 1024 epsilon of place, times 8 texels, times differences of values below 8.
            assert (one.exact - other.exact).abs().max() <= 1024 * 64 * EPS
            assert torch.equal(one.coefficients, other.coefficients)


def test_the_border_of_a_map_that_does_not_tile_has_none_of_the_other_side():
    patch = random_map(tiles_u=False, tiles_v=False, exact=True)
    texel(lobes(patch).exact, slice(None), -1)[:] = 1e9
    edge, _ = sample(patch, torch.tensor([[0.0, 0.5]], dtype=torch.float64))
    assert edge.exact.abs().max() < 10


def test_gradients_flow_to_the_map_and_to_coordinates():
    patch = random_map(2, 3, lobes=1)
    place = torch.tensor([[0.4, 0.3], [0.9, 0.1]], dtype=torch.float64, requires_grad=True)

    def low(exact, place):
        return sample(replaced(patch, exact=exact), place)[0].exact

    assert torch.autograd.gradcheck(low, (lobes(patch).exact.clone().requires_grad_(True), place))


def vectors(signal):
    """SH coefficients, by the definition of lobes."""
    receivers, channels, _, count = signal.shape
    total = torch.zeros(channels, count, receivers, dtype=torch.float64)
    first = signal.exact.shape[2]
    for axis, coefficients in zip(signal.axis[0], signal.coefficients[:, 0].movedim(1, 0), strict=True):
        values = sh.basis(axis.mT, signal.order).mT[first:]
        total[:, first:] += coefficients[:, sh.bands(signal.order)[first:] - (2 if first else 0)] * values
    total[:, :first] = signal.exact[:, 0]
    return total


@pytest.mark.parametrize("exact", [True, False])
def test_on_a_square_as_the_patch_was_baked_nothing_turns(exact):
    patch = random_map(exact=exact)
    laid = lay(patch, *square())
    flat, _ = sample(patch, square()[2])
    assert (vectors(lobes(laid)) - vectors(flat)).abs().max() <= 64 * EPS
    assert torch.equal(laid.normals, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(25, 3))


@pytest.mark.parametrize("exact", [True, False])
def test_on_a_turned_square_the_transfer_is_turned(exact):
    patch, rotation = random_map(exact=exact), turn()
    positions, faces, uv = square()
    flat, laid = lay(patch, positions, faces, uv), lay(patch, positions @ rotation.mT, faces, uv)
    wanted = sh.rotate(vectors(lobes(flat)).movedim(1, 2)[..., None], rotation)[..., 0].movedim(1, 2)
    assert (vectors(lobes(laid)) - wanted).abs().max() <= 2000 * EPS


def test_on_mirrored_coordinates_the_transfer_is_mirrored():
    patch = random_map()
    positions, faces, uv = square(mirrored=True)
    frames = surface_frames(positions, faces, uv)
    assert torch.equal(frames, torch.diag(torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)).expand(25, 3, 3))
    found = vectors(lobes(lay(patch, positions, faces, uv)))
    flat = vectors(sample(patch, uv)[0])
    # f(-x, y, z): functions of odd order in x change sign, which are m > 0 odd and m < 0 even.
    order = torch.tensor([m for l in range(4) for m in range(-l, l + 1)])
    odd = ((order > 0) & (order % 2 == 1)) | ((order < 0) & (order % 2 == 0))
    assert (found - flat * torch.where(odd, -1.0, 1.0)[:, None]).abs().max() <= 64 * EPS


def test_patches_side_by_side_are_the_repeated_map():
    patch = random_map()
    positions, faces, uv = square()
    repeated = lay(patch, positions, faces, uv, repeat=(3, 2))
    wanted = lay(patch, positions, faces, uv * torch.tensor([3.0, 2.0]))
    assert torch.equal(vectors(lobes(repeated)), vectors(lobes(wanted)))


def test_frames_follow_u_v_and_the_normal_of_a_cylinder():
    mesh = samples.cylinder(16).objects[0].mesh
    frames = surface_frames(mesh.positions, mesh.faces, mesh.uv, mesh.normals)
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand_as(mesh.normals)
    assert (frames[..., 2] - mesh.normals).abs().max() <= 16 * EPS
    assert (frames[..., 1] - up).abs().max() <= 256 * EPS
    assert (torch.linalg.det(frames) - 1).abs().max() <= 256 * EPS


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_frames_turn_with_the_surface_and_do_not_see_its_scale(scale):
    mesh = samples.cylinder(8).objects[0].mesh
    rotation = turn(4)
    rest = surface_frames(mesh.positions, mesh.faces, mesh.uv)
    turned = surface_frames(scale * mesh.positions @ rotation.mT, mesh.faces, mesh.uv)
    # Differences of positions of size 3 over edges of .2.
    assert (turned - rotation @ rest).abs().max() <= 5000 * EPS


def test_frames_of_many_poses_are_those_of_each():
    mesh = samples.cylinder(4).objects[0].mesh
    poses = twist(mesh.positions, torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64), 0.0, 3.0)
    frames = surface_frames(poses, mesh.faces, mesh.uv)
    for pose, each in zip(poses, frames, strict=True):
        assert (surface_frames(pose, mesh.faces, mesh.uv) - each).abs().max() <= 256 * EPS


def test_gradients_flow_from_frames_to_positions():
    positions, faces, uv = square(3)
    points = positions + 0.1 * torch.rand(9, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    points.requires_grad_(True)
    assert torch.autograd.gradcheck(lambda p: surface_frames(p, faces, uv), (points,))


def test_where_coordinates_say_no_direction_frames_are_still_frames():
    positions, faces, uv = square()
    frames = surface_frames(positions, faces, torch.zeros_like(uv))
    assert (torch.linalg.det(frames) - 1).abs().max() <= 16 * EPS
    pole = samples.vase(16).objects[0].mesh
    frames = surface_frames(pole.positions, pole.faces, pole.uv)
    assert (torch.linalg.det(frames) - 1).abs().max() <= 64 * EPS


def test_a_vertex_without_a_face_gets_no_light():
    positions, faces, uv = square()
    more = torch.cat([positions, torch.tensor([[5.0, 5.0, 5.0]], dtype=torch.float64)])
    laid = lay(random_map(), more, faces, torch.cat([uv, torch.zeros(1, 2)]))
    laid.check()
    assert vectors(lobes(laid))[..., -1].abs().max() == 0
    assert vectors(lobes(laid))[..., :-1].abs().amax(1).min() > 0


def test_a_laid_patch_follows_a_deformed_surface_like_one_laid_on_it():
    mesh = samples.cylinder(24).objects[0].mesh
    patch = random_map(order=4)
    rest = lay(patch, mesh.positions, mesh.faces, mesh.uv, repeat=4)
    posed = twist(bend(mesh.positions, 0.8, 0.3, 2.7), 0.6, 0.0, 3.0)
    again = lay(patch, posed, mesh.faces, mesh.uv, repeat=4)
    followed = shader(rest)(light(), positions=posed)
    direct = shader(again)(light())
    # Tangents of a sheared surface and its nearest rotation differ by half the shear; it is .6 * .5 / 3 at most, plus
    # what bending adds: .1 of the radiance.
    assert (followed - direct).norm() < 0.1 * direct.norm()
    rotation = turn(2)
    rigid = lay(patch, mesh.positions @ rotation.mT, mesh.faces, mesh.uv, repeat=4)
    moved = shader(rest)(light(), positions=mesh.positions @ rotation.mT)
    assert (moved - shader(rigid)(light())).abs().max() < 1e-10


def test_frames_of_the_pose_on_lobes_in_the_tangent_frame_are_the_same_as_laying_them():
    mesh = samples.cylinder(8).objects[0].mesh
    patch = random_map()
    frames = surface_frames(mesh.positions, mesh.faces, mesh.uv)
    identity = torch.eye(3, dtype=torch.float64).expand_as(frames)
    local = lay(patch, mesh.positions, mesh.faces, mesh.uv, frames=identity)
    laid = lay(patch, mesh.positions, mesh.faces, mesh.uv)
    assert (shader(local)(light(), frames=frames) - shader(laid)(light())).abs().max() < 1e-10 * math.sqrt(16)
