"""Does a skinned mesh follow its joints, and turn as it moves?"""

import math

import pytest
import torch
from zonal_transfers import bumpy, random_zonal, turns

from torchprt.errors import InputError
from torchprt.pose import SkinnedMesh, deformed_frames
from torchprt.sh import check_rotation
from torchprt.shade import shader

EPSILON = torch.finfo(torch.float64).eps


def rigid(*batch, seed=0):
    """Random rigid transforms [*batch, 4, 4]."""
    transforms = torch.eye(4, dtype=torch.float64).repeat(*batch, 1, 1)
    transforms[..., :3, :3] = turns(*batch, dtype=torch.float64, seed=seed)
    generator = torch.Generator().manual_seed(seed)
    transforms[..., :3, 3] = torch.randn(*batch, 3, generator=generator, dtype=torch.float64)
    return transforms


def arm(side=5, joints=3, dtype=torch.float64):
    positions, faces = bumpy(side)
    generator = torch.Generator().manual_seed(0)
    weights = torch.rand(side * side, joints, generator=generator, dtype=torch.float64)
    weights = weights / weights.sum(1, keepdim=True)
    return positions.to(dtype), faces, weights.to(dtype)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": torch.ones(24, 1)}, "weights have 24 rows for 25 positions|weights are for 24"),
        ({"weights": torch.full((25, 2), 0.4)}, "weights of 25 vertices are negative or do not sum to 1"),
        ({"weights": torch.tensor([[1.5, -0.5]]).expand(25, 2)}, "weights of 25 vertices are negative"),
        ({"weights": torch.full((25, 2), math.nan)}, "weights of 25 vertices"),
        ({"weights": torch.zeros(25, 0)}, "weights of 25 vertices"),
        ({"positions": torch.full((25, 3), math.inf)}, "positions hold NaN or infinity"),
        ({"joint_count": 3}, "weights are of 1 joints but joint_count is 3"),
        ({"joints": torch.zeros(25, 2, dtype=torch.int64)}, r"joints have shape \[25, 2\] but weights \[25, 1\]"),
        ({"joints": torch.full((25, 1), 2), "joint_count": 2}, "joints name"),
        ({"joints": torch.full((25, 1), -1)}, "joints name"),
    ],
)
def test_refuses_weights_that_do_not_fit(untyped, change, message):
    arguments = {"positions": torch.zeros(25, 3), "weights": torch.ones(25, 1), **change}
    with pytest.raises(InputError, match=message):
        SkinnedMesh(**arguments)


@pytest.mark.parametrize(
    ("transforms", "message"),
    [
        (torch.eye(4).double().expand(2, 4, 4), r"transforms have shape \[2, 4, 4\]: there are 3 joints"),
        (torch.full((3, 4, 4), math.nan, dtype=torch.float64), "transforms must be finite"),
        (rigid(3).mT, "last row of 0, 0, 0, 1"),
    ],
)
def test_refuses_transforms_that_are_none(untyped, transforms, message):
    positions, _, weights = arm()
    with pytest.raises(InputError, match=message):
        SkinnedMesh(positions, weights)(transforms)


@pytest.mark.parametrize("batch", [(), (1,), (0,), (2, 3)])
@pytest.mark.parametrize("side", [0, 1, 5])
def test_one_transform_for_all_joints_moves_the_mesh_rigidly(batch, side):
    positions, _, weights = arm(side)
    transforms = rigid(*batch)
    moved, frames = SkinnedMesh(positions, weights)(transforms.unsqueeze(-3).expand(*batch, 3, 4, 4))
    assert moved.shape == (*batch, side * side, 3)
    assert frames.shape == (*batch, side * side, 3, 3)
    wanted = positions @ transforms[..., :3, :3].mT + transforms[..., None, :3, 3]
    assert torch.allclose(moved, wanted, atol=16 * EPSILON)
    assert torch.allclose(frames, transforms[..., None, :3, :3].expand_as(frames), atol=64 * EPSILON)


def test_identities_leave_the_mesh_as_it_is():
    positions, _, weights = arm()
    moved, frames = SkinnedMesh(positions, weights)(torch.eye(4).double().expand(3, 4, 4))
    assert torch.allclose(moved, positions, atol=8 * EPSILON)
    assert torch.allclose(frames, torch.eye(3).double().expand(25, 3, 3), atol=64 * EPSILON)


def test_is_the_weighted_mean_that_it_is_defined_as():
    positions, _, weights = arm()
    transforms = rigid(4, 3)
    moved, frames = SkinnedMesh(positions, weights)(transforms)
    for pose in range(4):
        for v in range(25):
            blended = sum(weights[v, j] * transforms[pose, j] for j in range(3))
            place = blended @ torch.cat([positions[v], torch.ones(1).double()])
            assert torch.allclose(moved[pose, v], place[:3], atol=16 * EPSILON)
            u, s, v_t = torch.linalg.svd(blended[:3, :3])
            turn = u @ v_t
            if torch.linalg.det(turn) > 0 and s[1] + s[2] > 0.05:
                assert torch.allclose(frames[pose, v], turn, atol=1e-12)
    check_rotation(frames)


def test_named_joints_are_the_same_as_a_row_of_weights():
    positions, _, weights = arm()
    transforms = rigid(3)
    dense = SkinnedMesh(positions, weights)
    order = torch.tensor([2, 0, 1])
    sparse = SkinnedMesh(positions, weights[:, order], order.expand(25, 3))
    for found, wanted in zip(sparse(transforms), dense(transforms), strict=True):
        assert torch.allclose(found, wanted, atol=64 * EPSILON)
    # A joint that is named twice counts twice, and one that nobody names may be there.
    halves = SkinnedMesh(positions, torch.full((25, 2), 0.5), torch.ones(25, 2, dtype=torch.int32), joint_count=3)
    assert torch.allclose(halves(transforms)[1], transforms[1, :3, :3].expand(25, 3, 3), atol=64 * EPSILON)


def test_joints_that_scale_or_stretch_still_give_rotations():
    positions, _, weights = arm()
    transforms = rigid(3)
    transforms[:, :3, :3] = transforms[:1, :3, :3] * torch.tensor([0.5, 2.0, 3.0]).double()[:, None, None]
    _, frames = SkinnedMesh(positions, weights)(transforms)
    assert torch.allclose(frames, (transforms[0, :3, :3] / 0.5).expand(25, 3, 3), atol=1e-12)


def test_joints_twisted_against_each_other_and_mirrored_ones_give_proper_rotations():
    positions, _, _ = arm()
    ticks = torch.linspace(0, 1, 25, dtype=torch.float64)
    transforms = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    transforms[1] = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]).double())
    mesh = SkinnedMesh(positions, torch.stack([ticks, 1 - ticks], 1))
    check_rotation(mesh(transforms)[1])
    transforms[1] = torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0]).double())
    check_rotation(mesh(transforms)[1])


def test_frames_of_the_skin_are_near_those_of_its_triangles():
    # A gentle bend over a fine grid: both say how the surface has turned.
    positions, faces = bumpy(21)
    ticks = (positions[:, 0].clamp(-1, 1) + 1) / 2
    transforms = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    angle = 0.2
    transforms[1, :2, :2] = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    moved, frames = SkinnedMesh(positions, torch.stack([1 - ticks, ticks], 1))(transforms)
    # Weights that change along the surface shear it too, by the change times what the transforms differ.
    assert (frames - deformed_frames(positions, faces, moved)).abs().max() < angle


def test_an_animation_is_shaded_end_to_end_with_gradients_to_the_joints():
    transfer = random_zonal(5, dtype=torch.float64)
    _, _, weights = arm()
    mesh, module = SkinnedMesh(transfer.positions, weights), shader(transfer)
    light = torch.randn(16, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    base, step = rigid(2, 3), turns(2, 3, dtype=torch.float64, seed=9)
    linear = base[..., :3, :3].clone().requires_grad_()
    transforms = torch.cat([torch.cat([linear, base[..., :3, 3:]], -1), base[..., 3:, :]], -2)
    moved, frames = mesh(transforms)
    radiance = module(light, frames=frames)
    assert radiance.shape == (2, 25, 3)
    (radiance.square().sum() + moved.square().sum()).backward()
    assert linear.grad.isfinite().all()
    assert not torch.equal(linear.grad, torch.zeros_like(step))


def test_gradients_flow_to_the_transforms():
    positions, _, weights = arm(2)
    mesh = SkinnedMesh(positions, weights)
    linear = (
        torch.eye(3, dtype=torch.float64)
        + 0.3 * torch.randn(3, 3, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)[..., :3]
    )
    bottom = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64).expand(3, 1, 4)

    def posed(linear, shift):
        return mesh(torch.cat([torch.cat([linear, shift], -1), bottom], -2))

    shift = torch.zeros(3, 3, 1, dtype=torch.float64)
    assert torch.autograd.gradcheck(posed, (linear.requires_grad_(), shift.requires_grad_()))


def test_compiles_as_one_graph(untyped):
    torch.compiler.reset()
    positions, _, weights = arm()
    mesh, transforms = SkinnedMesh(positions, weights), rigid(2, 3)
    compiled = torch.compile(mesh, fullgraph=True, backend="aot_eager")
    for found, wanted in zip(compiled(transforms), mesh(transforms), strict=True):
        assert torch.allclose(found, wanted, atol=1e-12)
    torch.compiler.reset()
