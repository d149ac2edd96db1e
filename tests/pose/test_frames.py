"""Are the frames of a deformed mesh the rotations that took it there, whatever was done to it?"""

import math

import pytest
import torch
from torch.nn.functional import normalize
from zonal_transfers import bumpy, turns

from torchprt.errors import InputError
from torchprt.pose import DeformedFrames, deformed_frames, nearest_rotation
from torchprt.sh import check_rotation

EPSILON = {torch.float32: torch.finfo(torch.float32).eps, torch.float64: torch.finfo(torch.float64).eps}
IDENTITY = torch.eye(3, dtype=torch.float64)
NO_FACES = torch.zeros(0, 3, dtype=torch.int64)


def by_svd(rest, faces, posed):
    """A vertex after the other: the nearest rotation to the deformation gradient, by singular values (float64).

    The gradient takes the tangent plane by the area-weighted gradients of the triangles, normal to normal.
    """
    frames = []
    for v in range(len(rest)):
        gradient, before, after = torch.zeros(3, 3).double(), torch.zeros(3).double(), torch.zeros(3).double()
        for a, b, c in faces[(faces == v).any(1)].tolist():
            old = torch.stack([rest[b] - rest[a], rest[c] - rest[a]], 1)
            new = torch.stack([posed[b] - posed[a], posed[c] - posed[a]], 1)
            normal = torch.linalg.cross(old[:, 0], old[:, 1])
            gradient += normal.norm() / 2 * new @ torch.linalg.pinv(old)
            before += normal / 2
            after += torch.linalg.cross(new[:, 0], new[:, 1]) / 2
        before, after = normalize(before, dim=0), normalize(after, dim=0)
        plane, image = IDENTITY - torch.outer(before, before), IDENTITY - torch.outer(after, after)
        inside = image @ gradient @ plane
        u, s, v_t = torch.linalg.svd(inside)
        # The plane alone, then the normals: signs make the whole proper.
        turned = u[:, :2] @ v_t[:2] + torch.outer(after, before)
        assert s[1] > 1e-6 * s[0], "the twin is for planes that stay planes"
        frames.append(turned)
    return torch.stack(frames)


def bent(positions):
    x, y, z = positions.unbind(-1)
    angle = 0.7 * x
    return torch.stack([(1 + y) * angle.sin() / 0.7, (1 + y) * angle.cos(), 1.3 * z + 0.2 * x * x], -1)


# Misuse and what is empty


def test_refuses_faces_that_name_no_vertex():
    positions, faces = bumpy(3)
    for wrong in (faces + 1, faces - 1):
        with pytest.raises(InputError, match="faces name vertices that the 9 of the rest pose do not have"):
            deformed_frames(positions, wrong, positions)


def test_refuses_another_number_of_positions():
    positions, faces = bumpy(3)
    with pytest.raises(InputError, match=r"positions have shape \[8, 3\]: the rest pose has 9 vertices"):
        DeformedFrames(positions, faces)(positions[:8])


def test_refuses_a_rest_pose_that_is_not_finite():
    positions, faces = bumpy(3)
    positions[4, 1] = math.nan
    with pytest.raises(InputError, match="rest positions hold NaN"):
        DeformedFrames(positions, faces)


@pytest.mark.parametrize("batch", [(), (2,), (0,), (2, 3)])
@pytest.mark.parametrize("vertices", [0, 1, 4])
def test_points_without_faces_do_not_turn(batch, vertices):
    posed = torch.randn(*batch, vertices, 3, generator=torch.Generator().manual_seed(0))
    frames = deformed_frames(torch.zeros(vertices, 3), NO_FACES, posed)
    assert torch.equal(frames, torch.eye(3).expand(*batch, vertices, 3, 3))


def test_a_batch_of_no_poses_has_no_frames():
    positions, faces = bumpy(3)
    assert deformed_frames(positions, faces, positions.new_zeros(0, 9, 3)).shape == (0, 9, 3, 3)


# Laws


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("side", [2, 3, 9])
def test_rigid_motion_is_found_exactly(dtype, side):
    positions, faces = bumpy(side)
    turn = turns(6, dtype=torch.float64)
    turn[0], turn[1] = IDENTITY, torch.diag(torch.tensor([-1.0, 1.0, -1.0]).double())
    posed = positions @ turn.mT + torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
    frames = deformed_frames(positions.to(dtype), faces, posed.to(dtype))
    # Positions are rounded, edges are down to a tenth of them, and up to 12 are summed: 64 epsilons.
    assert (frames - turn[:, None]).abs().max() <= 64 * EPSILON[dtype]


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e6, 1e30])
def test_size_does_not_matter(scale):
    positions, faces = bumpy(4)
    turn = turns(dtype=torch.float64)
    rest = (positions * scale).float()
    posed = ((positions @ turn.mT) * scale).float()
    wanted = turn.expand(16, 3, 3)
    assert (deformed_frames(rest, faces, posed) - wanted).abs().max() <= 64 * EPSILON[torch.float32]
    # Grown in the pose alone.
    grown = (positions @ turn.mT * 1e4).float()
    assert (deformed_frames(positions.float(), faces, grown) - wanted).abs().max() <= 64 * EPSILON[torch.float32]


@pytest.mark.parametrize("side", [2, 3, 8])
def test_is_the_polar_factor_of_the_deformation_gradient(side):
    positions, faces = bumpy(side)
    posed = torch.stack(
        [bent(positions), positions * torch.tensor([0.3, 1.0, 2.0]), bent(positions) @ turns().double()]
    )
    frames = deformed_frames(positions, faces, posed)
    for found, pose in zip(frames, posed, strict=True):
        wanted = by_svd(positions, faces, pose)
        assert (found - wanted).abs().max() <= 1e4 * EPSILON[torch.float64]


def test_normals_go_to_normals():
    positions, faces = bumpy(7)
    posed = bent(positions)

    def normals(places):
        a, b, c = places[faces].unbind(1)
        across = torch.linalg.cross(b - a, c - a)
        return normalize(torch.zeros_like(places).index_add_(0, faces.reshape(-1), across.repeat_interleave(3, 0)))

    frames = deformed_frames(positions, faces, posed)
    assert torch.allclose((frames @ normals(positions)[..., None])[..., 0], normals(posed), atol=1e-14)


def test_turning_the_pose_turns_the_frames():
    positions, faces = bumpy(6)
    posed, turn = bent(positions), turns(4, dtype=torch.float64)
    once = deformed_frames(positions, faces, posed)
    turned = deformed_frames(positions, faces, posed @ turn.mT)
    assert (turned - turn[:, None] @ once).abs().max() <= 64 * EPSILON[torch.float64]


def test_a_gentle_bend_turns_each_vertex_by_the_angle_there():
    ticks = torch.linspace(-1, 1, 81, dtype=torch.float64)
    x, z = torch.meshgrid(ticks, ticks[:5], indexing="ij")
    positions = torch.stack([x, torch.zeros_like(x), z], -1).reshape(-1, 3)
    corner = (torch.arange(80)[:, None] * 5 + torch.arange(4)).reshape(-1)
    faces = torch.cat([
        torch.stack([corner, corner + 1, corner + 6], -1),
        torch.stack([corner, corner + 6, corner + 5], -1),
    ])  # fmt: skip
    angle = 0.5 * positions[:, 0]
    posed = torch.stack([angle.sin() / 0.5, (angle.cos() - 1) / 0.5, positions[:, 2]], -1)
    frames = deformed_frames(positions, faces, posed)
    c, s, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    wanted = torch.stack([c, s, zero, -s, c, zero, zero, zero, one], -1).view(-1, 3, 3)
    inside = (positions[:, 0].abs() < 0.99) & (positions[:, 2] > -0.99) & (positions[:, 2] < ticks[4])
    # Of second order in the size of a triangle inside; at the border the faces are on one side: first order.
    assert (frames - wanted)[inside].abs().max() < 1e-4
    assert (frames - wanted).abs().max() < 0.5 * 2 / 80


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_always_proper_rotations_whatever_the_pose(dtype):
    positions, faces = bumpy(5)
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(20, 25, 3, generator=generator, dtype=torch.float64)
    check_rotation(deformed_frames(positions.to(dtype), faces, noise.to(dtype)))


# What is degenerate


def test_a_mirrored_pose_is_inside_out():
    positions, faces = bumpy(5)
    mirror = torch.diag(torch.tensor([-1.0, 1.0, 1.0]).double())
    frames = deformed_frames(positions, faces, positions @ mirror)
    check_rotation(frames)
    # Tangents are mirrored, normals follow the winding.
    flipped = deformed_frames(positions, faces.flip(1), positions @ mirror)
    assert torch.allclose(frames, flipped, atol=1e-12)
    flat = positions * torch.tensor([1.0, 0.0, 1.0])
    wanted = torch.diag(torch.tensor([-1.0, -1.0, 1.0]).double())
    assert torch.allclose(deformed_frames(flat, faces, flat @ mirror), wanted.expand(25, 3, 3), atol=1e-14)


def test_a_pose_in_one_point_or_on_one_line_has_identity_frames():
    positions, faces = bumpy(4)
    for posed in (torch.zeros_like(positions), positions[:1].expand(16, 3), positions * torch.tensor([1.0, 0.0, 0.0])):
        assert torch.equal(deformed_frames(positions, faces, posed), IDENTITY.expand(16, 3, 3))


def test_neighbours_decide_where_one_triangle_collapses():
    positions, faces = bumpy(5)
    turn = turns(dtype=torch.float64)
    posed = positions @ turn.mT
    # An inner vertex onto its neighbour: the two triangles at that edge have no area.
    posed[12] = posed[13]
    frames = deformed_frames(positions, faces, posed)
    check_rotation(frames)
    far = [v for v in range(25) if not ((faces == 12).any(1)[:, None] & (faces == v)).any()]
    assert (frames[far] - turn).abs().max() <= 64 * EPSILON[torch.float64]


def test_triangles_that_are_collapsed_at_rest_do_not_count():
    positions, faces = bumpy(4)
    turn = turns(dtype=torch.float64)
    more = torch.cat([faces, torch.tensor([[3, 3, 7], [5, 5, 5]])])
    posed = positions @ turn.mT
    assert (deformed_frames(positions, more, posed) - turn).abs().max() <= 64 * EPSILON[torch.float64]


def test_a_fold_over_itself_keeps_the_tangent_nearest():
    # Two triangles of a square; the pose folds one over the other: in the plane nothing is left but a reflection.
    rest = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=torch.float64)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    posed = rest.clone()
    posed[3] = posed[1]
    frames = deformed_frames(rest, faces, posed)
    check_rotation(frames)
    assert torch.allclose(frames[1], IDENTITY)


def test_a_sheet_with_both_windings_turns_as_a_whole():
    positions, faces = bumpy(4)
    turn = turns(dtype=torch.float64)
    both = torch.cat([faces, faces.flip(1)])
    assert (deformed_frames(positions, both, positions @ turn.mT) - turn).abs().max() <= 64 * EPSILON[torch.float64]


def test_a_fan_of_a_thousand_triangles():
    count = 1000
    angle = torch.arange(count, dtype=torch.float64) * (2 * math.pi / count)
    rim = torch.stack([angle.cos(), angle.sin(), torch.zeros_like(angle)], -1)
    positions = torch.cat([torch.zeros(1, 3).double(), rim])
    around = torch.arange(count)
    faces = torch.stack([torch.zeros_like(around), around + 1, (around + 1) % count + 1], -1)
    turn = turns(dtype=torch.float64)
    assert (deformed_frames(positions, faces, positions @ turn.mT) - turn).abs().max() <= 1e-12


def test_copies_at_a_seam_share_their_faces():
    positions, faces = bumpy(5)
    posed = bent(positions)
    whole = deformed_frames(positions, faces, posed)
    # Every triangle gets its own corners, as along texture seams.
    corners = faces.reshape(-1)
    normals = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand(len(corners), 3)
    apart = torch.arange(len(corners)).view(-1, 3)
    welded = deformed_frames(positions[corners], apart, posed[corners], normals=normals)
    assert torch.allclose(welded, whole[corners], atol=1e-13)
    alone = deformed_frames(positions[corners], apart, posed[corners])
    assert not torch.allclose(alone, whole[corners], atol=1e-2)


def test_the_two_sides_of_a_sheet_do_not_share_faces():
    positions, faces = bumpy(4)
    posed = bent(positions)
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand(16, 3)
    both = deformed_frames(
        torch.cat([positions, positions]),
        torch.cat([faces, faces.flip(1) + 16]),
        torch.cat([posed, posed]),
        normals=torch.cat([up, -up]),
    )
    assert torch.allclose(both[:16], both[16:], atol=1e-13)


# Gradients and graphs


def test_gradients_flow_to_the_pose():
    positions, faces = bumpy(3)
    module = DeformedFrames(positions, faces)
    posed = torch.stack([bent(positions), positions]).requires_grad_()
    assert torch.autograd.gradcheck(module, (posed,))


def test_gradients_are_finite_where_the_pose_is_degenerate():
    positions, faces = bumpy(3)
    for posed in (torch.zeros_like(positions), positions * torch.tensor([1.0, 0.0, 0.0])):
        leaf = posed.clone().requires_grad_()
        deformed_frames(positions, faces, leaf).square().sum().backward()
        assert leaf.grad.isfinite().all()


def test_compiles_as_one_graph(untyped):
    torch.compiler.reset()
    positions, faces = bumpy(4)
    module = DeformedFrames(positions, faces)
    posed = torch.stack([bent(positions), positions])
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(posed), module(posed), atol=1e-13)
    torch.compiler.reset()


# The rotation nearest to a matrix


def nearest_by_svd(matrix):
    u, s, v_t = torch.linalg.svd(matrix)
    side = torch.linalg.det(u @ v_t)
    signs = torch.stack([torch.ones_like(side), torch.ones_like(side), side], -1)
    return u @ torch.diag_embed(signs) @ v_t, (s[..., 1] + side * s[..., 2]) / s[..., 0]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_nearest_rotation_agrees_with_singular_values(dtype, scale):
    matrix = torch.randn(4, 500, 3, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    wanted, gap = nearest_by_svd(matrix)
    found = nearest_rotation((matrix * scale).to(dtype))
    check_rotation(found)
    # Rounding turns the result by its size over the gap between the nearest rotation and the next.
    clear = gap > 0.02
    error = (found.double() - wanted).abs().amax((-2, -1)) * gap
    assert error[clear].max() <= 64 * EPSILON[dtype]


def test_a_rotation_is_nearest_to_itself_and_a_reflection_gets_a_proper_one():
    turn = turns(50, dtype=torch.float64)
    assert (nearest_rotation(turn) - turn).abs().max() <= 16 * EPSILON[torch.float64]
    stretch = torch.diag(torch.tensor([3.0, 2.0, 1.0]).double())
    assert (nearest_rotation(turn @ stretch @ turn.mT) - IDENTITY).abs().max() <= 64 * EPSILON[torch.float64]
    check_rotation(nearest_rotation(turn @ torch.diag(torch.tensor([3.0, 2.0, -1.0]).double())))


def test_what_has_no_nearest_rotation_still_gets_one():
    singular = torch.stack([torch.zeros(3, 3), torch.ones(3, 3), -torch.eye(3), torch.diag(torch.tensor([1.0, 0, 0]))])
    found = nearest_rotation(singular)
    check_rotation(found)
    assert torch.equal(found[0], torch.eye(3))
    assert nearest_rotation(torch.zeros(0, 3, 3)).shape == (0, 3, 3)


def test_gradients_flow_to_the_matrix():
    matrix = torch.randn(6, 3, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    matrix = matrix[nearest_by_svd(matrix)[1] > 0.2].requires_grad_()
    assert len(matrix) >= 2
    assert torch.autograd.gradcheck(nearest_rotation, (matrix,))
