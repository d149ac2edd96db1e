"""Do glossy surfaces that deform show what their frames, the light and the eye ask for?"""

import math

import pytest
import torch
from transfers import by_definition, gloss
from zonal_transfers import random_zonal_factored, turned_by_hand, turns

from torchprt import sh
from torchprt.errors import InputError
from torchprt.shade import EnvironmentShader, shader

EPSILON = torch.finfo(torch.float64).eps


def lights(*batch, order=4, seed=1, dtype=torch.float64):
    return torch.randn(*batch, order**2, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def points(*batch, seed=2):
    return 3 * torch.randn(*batch, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def close(value, wanted, epsilons):
    return (value - wanted).abs().max() <= epsilons * EPSILON * wanted.abs().max()


def test_refuses_a_point_that_is_seen_from_nowhere():
    with pytest.raises(InputError, match="eye is a point and frames are given without positions"):
        shader(random_zonal_factored(dtype=torch.float64))(lights(), eye=points(), frames=turns(9, dtype=torch.float64))


def test_refuses_no_eye_and_two():
    module = shader(random_zonal_factored(dtype=torch.float64))
    with pytest.raises(InputError, match="neither is given"):
        module(lights())
    with pytest.raises(InputError, match="both are given"):
        module(lights(), eye=points(), view=points())


def test_refuses_frames_that_are_no_rotations():
    with pytest.raises(InputError, match="frames"):
        shader(random_zonal_factored(dtype=torch.float64))(
            lights(), view=points(), frames=torch.zeros(9, 3, 3, dtype=torch.float64)
        )


def test_refuses_to_learn_what_it_does_not_have_or_bounces_have_baked_in():
    with pytest.raises(InputError, match="learn names 'values'"):
        shader(random_zonal_factored(), learn="values")
    with pytest.raises(InputError, match="learn names 'albedo'"):
        shader(random_zonal_factored(diffuse=False), learn="albedo")
    with pytest.raises(InputError, match="specular cannot be learned: 1 bounce of"):
        shader(random_zonal_factored(bounces=1), learn="specular")


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("diffuse", [False, True])
@pytest.mark.parametrize("glossy", [0, 4, 9])
def test_is_the_factored_transfer_of_the_pose(channels, exact, diffuse, glossy):
    transfer = random_zonal_factored(
        glossy=glossy, channels=channels, exact=exact, diffuse=diffuse, dtype=torch.float64
    )
    module, light = shader(transfer), lights()
    frames, posed = turns(9, dtype=torch.float64), transfer.positions.roll(2, 0)
    wanted = turned_by_hand(transfer, frames, posed)
    for eye in ({"eye": points()}, {"view": points()}):
        found = module(light, frames=frames, positions=posed, **eye)
        assert (found - by_definition(wanted, light, **eye)).abs().max() <= 1e-12 * 30


def test_the_rest_pose_needs_nothing():
    transfer = random_zonal_factored(dtype=torch.float64)
    module, light = shader(transfer), lights()
    identity = torch.eye(3, dtype=torch.float64).expand(9, 3, 3)
    rest = module(light, eye=points())
    assert close(module(light, eye=points(), frames=identity, positions=transfer.positions), rest, 64)
    assert close(module(light, eye=points(), positions=transfer.positions), rest, 4096)


def test_all_turned_together_changes_nothing():
    transfer = random_zonal_factored(order=6, dtype=torch.float64)
    module, light, turn = shader(transfer), lights(order=6), turns(dtype=torch.float64)
    frames, posed, eye = turns(9, dtype=torch.float64, seed=5), transfer.positions.roll(1, 0), points()
    still = module(light, eye=eye, frames=frames, positions=posed)
    turned = module(light, turn, eye=turn @ eye, frames=turn @ frames, positions=posed @ turn.mT)
    assert (turned - still).abs().max() <= 1e-5 * still.abs().max()
    estimated = module(light, turn, eye=turn @ eye, positions=posed @ turn.mT)
    assert (estimated - module(light, eye=eye, positions=posed)).abs().max() <= 1e-5 * still.abs().max()


@pytest.mark.parametrize("glossy", [4, 9])
@pytest.mark.parametrize(
    ("many", "eyes", "poses"),
    [((), (), (2,)), ((3,), (), ()), ((), (3,), ()), ((2,), (2,), (2,)), ((4, 1, 1), (3, 1), (2,)), ((0,), (), ())],
)
def test_batches_of_lights_eyes_and_poses_broadcast(glossy, many, eyes, poses):
    transfer = random_zonal_factored(glossy=glossy, dtype=torch.float64)
    module = shader(transfer)
    light, eye, frames = lights(*many), points(*eyes), turns(*poses, 9, dtype=torch.float64)
    posed = transfer.positions + 0.1 * torch.randn(*poses, 9, 3, generator=torch.Generator().manual_seed(0)).double()
    found = module(light, eye=eye, frames=frames, positions=posed)
    shape = torch.broadcast_shapes(many, eyes, poses)
    assert found.shape == (*shape, 9, 3)
    cases = zip(
        found.reshape(-1, 9, 3),
        light.expand(*shape, 16, 3).reshape(-1, 16, 3),
        eye.expand(*shape, 3).reshape(-1, 3),
        frames.expand(*shape, 9, 3, 3).reshape(-1, 9, 3, 3),
        posed.expand(*shape, 9, 3).reshape(-1, 9, 3),
        strict=True,
    )
    for one, lamp, place, pose, where in cases:
        assert close(one, module(lamp, eye=place, frames=pose, positions=where), 256)


def test_a_fixed_pose_is_the_same():
    transfer = random_zonal_factored(channels=3, dtype=torch.float64)
    module, light, frames = shader(transfer), lights(2), turns(9, dtype=torch.float64)
    posed = transfer.positions.roll(1, 0)
    fixed = module.fix_pose(frames, positions=posed)
    assert close(fixed(light, eye=points()), module(light, eye=points(), frames=frames, positions=posed), 256)
    assert close(module.fix_pose(frames)(light, view=points()), module(light, view=points(), frames=frames), 256)
    assert close(module.fix_pose()(light, eye=points()), module(light, eye=points()), 256)


def test_receivers_without_a_normal_have_no_gloss():
    transfer = random_zonal_factored(diffuse=False, dtype=torch.float64)
    transfer.normals[gloss(transfer).receivers[1]] = 0
    radiance = shader(transfer)(lights(), eye=points(), positions=transfer.positions)
    assert radiance.isfinite().all()
    assert torch.equal(radiance[gloss(transfer).receivers[1]], torch.zeros(3, dtype=torch.float64))


def test_an_environment_goes_through_the_graph_with_eye_and_pose():
    transfer = random_zonal_factored()
    module, frames = shader(transfer), turns(9)
    environment = torch.rand(6, 4, 4, 3, generator=torch.Generator().manual_seed(0))
    view = torch.tensor([1.0, 2.0, 3.0])
    found = EnvironmentShader(module, 4)(environment, frames=frames, view=view)
    wanted = module(sh.project_cube(environment, 4), frames=frames, view=view)
    assert (found - wanted).abs().max() <= 1e-5 * wanted.abs().max()


def test_gradients_flow_to_everything():
    transfer = random_zonal_factored(4, glossy=3, lobes=1, order=3, dtype=torch.float64)
    names = ["axis", "coefficients", "exact", "factors", "specular", "albedo"]
    module = shader(transfer, learn=names)
    # The table of factors is large: one number of it is enough.
    assert {name.rpartition(".")[2] for name, _ in module.named_parameters()} == set(names)
    parameters = {name: value for name, value in module.named_parameters() if not name.endswith("factors")}
    light, eye = lights(order=3).requires_grad_(), points().requires_grad_()
    posed = transfer.positions.clone().requires_grad_()

    def radiance(light, eye, posed, *values):
        chosen = dict(zip(parameters, values, strict=True))
        return torch.func.functional_call(module, chosen, (light,), {"eye": eye, "positions": posed})

    assert torch.autograd.gradcheck(radiance, (light, eye, posed, *parameters.values()))
    module(light, eye=eye, positions=posed).square().sum().backward()
    factors = module.layers["factored"].factors
    assert factors.grad.isfinite().all()
    assert factors.grad.abs().max() > 0


def test_what_is_computed_without_gradients_is_what_is_computed_with_them():
    transfer = random_zonal_factored(dtype=torch.float64)
    module, light, frames = shader(transfer), lights(2), turns(2, 9, dtype=torch.float64)
    recorded = module(light, view=points(), frames=frames.clone().requires_grad_()).detach()
    assert close(module(light, view=points(), frames=frames), recorded, 64)


def test_compiles_as_one_graph(untyped):
    torch.compiler.reset()
    transfer = random_zonal_factored()
    module, light, eye = shader(transfer), lights(2, dtype=torch.float32), points(2).float()
    posed = torch.stack([transfer.positions, transfer.positions.roll(1, 0)])
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    found, wanted = compiled(light, eye=eye, positions=posed), module(light, eye=eye, positions=posed)
    assert (found - wanted).abs().max() <= 1e-5 * wanted.abs().max()
    torch.compiler.reset()


def test_extreme_distances_and_an_eye_at_a_receiver():
    transfer = random_zonal_factored()
    module, light = shader(transfer), lights(dtype=torch.float32)
    for eye in (points().float() * 1e15, points().float() * 1e-15, transfer.positions[gloss(transfer).receivers[0]]):
        assert module(light, eye=eye, positions=transfer.positions).isfinite().all()
    assert math.isfinite(float(module(light, view=points().float() * 1e-30).sum()))
