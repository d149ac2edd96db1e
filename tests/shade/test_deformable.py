"""Does zonal transfer turn with the surface, while the light stays where it is?"""

import math

import pytest
import torch
from torch.nn.functional import normalize
from transfers import replaced
from zonal_transfers import by_definition, random_zonal, turns, vectors_by_definition

from torchprt import sh
from torchprt.compression import fit_lobes
from torchprt.errors import InputError
from torchprt.pose import deformed_frames
from torchprt.shade import EnvironmentShader, shader
from torchprt.transfer import diffuse_transfer

EPSILON = {torch.float32: torch.finfo(torch.float32).eps, torch.float64: torch.finfo(torch.float64).eps}
ALBEDOS = [("V", 3), ("V", 1), (1, 3), (1, 1)]
KINDS = [(1, False), (1, True), (3, False), (3, True)]


def lights(*batch, order=4, dtype=torch.float32, seed=1):
    return torch.randn(*batch, order**2, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def close(value, wanted, epsilons):
    error = (value.double() - wanted.double()).abs().max()
    return error <= epsilons * EPSILON[value.dtype] * wanted.abs().max()


# Misuse


def test_refuses_a_light_of_another_order():
    with pytest.raises(InputError, match="light has 9 coefficients but the transfer is of order 4"):
        shader(random_zonal())(lights(order=3))


@pytest.mark.parametrize("learn", ["values", ["axis", "normals"]])
def test_refuses_to_learn_what_it_does_not_have(learn):
    with pytest.raises(
        InputError, match=r"learn names '(values|normals)': .* 'zonal diffuse' can learn 'albedo', 'axis'"
    ):
        shader(random_zonal(), learn=learn)


def test_refuses_to_learn_an_albedo_that_bounces_have_baked_in():
    with pytest.raises(InputError, match="albedo cannot be learned: 2 bounces"):
        shader(random_zonal(bounces=2), learn="albedo")


def test_refuses_an_unknown_method(untyped):
    with pytest.raises(InputError, match="method 'texture' is unknown: use 'direct' or 'table'"):
        shader(random_zonal(), method="texture")


@pytest.mark.parametrize("method", ["direct", "table"])
@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (torch.eye(3).expand(8, 3, 3), r"frames have shape \[8, 3, 3\]: the transfer has 9 receivers"),
        (torch.eye(3), r"frames have shape \[3, 3\]"),
        (torch.zeros(9, 3, 3), "frames must be orthogonal within 1e-4"),
        (2 * torch.eye(3).expand(9, 3, 3), "frames must be orthogonal within 1e-4: remove scale"),
        (torch.diag(torch.tensor([1.0, 1.0, 0.0])).expand(9, 3, 3), "frames must be orthogonal"),
        (torch.full((9, 3, 3), math.nan), "frames must be orthogonal"),
        (-torch.eye(3).expand(9, 3, 3), r"frames holds? a reflection"),
    ],
)
def test_refuses_frames_that_are_no_rotations(untyped, method, frames, message):
    with pytest.raises(InputError, match=message):
        shader(random_zonal(), method=method)(lights(), frames=frames)


def test_refuses_positions_of_another_mesh_or_that_are_not_finite(untyped):
    transfer = random_zonal()
    module = shader(transfer)
    with pytest.raises(InputError, match=r"positions have shape \[8, 3\]: the rest pose has 9 vertices"):
        module(lights(), positions=transfer.positions[:8])
    for value in (math.nan, math.inf):
        posed = transfer.positions.clone()
        posed[3, 1] = value
        with pytest.raises(InputError, match="positions hold NaN or infinity"):
            module(lights(), positions=posed)


def test_refuses_to_fix_more_than_one_pose(untyped):
    with pytest.raises(InputError, match="fix one pose at a time"):
        shader(random_zonal()).fix_pose(turns(2, 9))


# What it computes


@pytest.mark.parametrize(("channels", "exact"), KINDS)
@pytest.mark.parametrize("albedo", ALBEDOS)
@pytest.mark.parametrize("side", [0, 1, 3])
def test_is_the_sum_of_lobes_that_the_paper_writes(channels, exact, albedo, side):
    transfer = random_zonal(side, channels=channels, exact=exact, albedo=albedo)
    light, frames = lights(), turns(side * side)
    for found, wanted in (
        (shader(transfer)(light, frames=frames), by_definition(transfer, light, frames)),
        (shader(transfer)(light), by_definition(transfer, light)),
    ):
        assert found.shape == (side * side, 3)
        if side:
            # Four lobes of 16 terms, the basis good to some roundings times the order.
            assert close(found, wanted, 64)


@pytest.mark.parametrize("order", [1, 2, 3, 6, 12])
@pytest.mark.parametrize("lobes", [0, 1, 2])
def test_every_order_and_number_of_lobes(order, lobes):
    exacts = [False] if order < 2 else [False, True]
    for exact in exacts:
        transfer = random_zonal(lobes=lobes, order=order, exact=exact, dtype=torch.float64)
        light, frames = lights(order=order, dtype=torch.float64), turns(9, dtype=torch.float64)
        found = shader(transfer)(light, frames=frames)
        wanted = by_definition(transfer, light, frames)
        assert (found - wanted).abs().max() <= 1e-12 * max(float(wanted.abs().max()), 1.0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("exact", [False, True])
def test_identity_frames_reproduce_the_transfer_that_was_fitted(dtype, exact):
    transfer = random_zonal(exact=exact, dtype=dtype)
    static = diffuse_transfer(
        vectors_by_definition(transfer),
        **{name: getattr(transfer, name) for name in ("albedo", "positions", "normals", "faces")},
    )
    light = lights(5, dtype=dtype)
    wanted = shader(static)(light.double())
    module = shader(transfer)
    for posed in ({}, {"frames": torch.eye(3, dtype=dtype).expand(9, 3, 3)}, {"positions": transfer.positions}):
        # Estimated frames are off by some roundings of the edges.
        assert close(module(light, **posed), wanted, 512 if "positions" in posed else 64)


@pytest.mark.parametrize("lobes", [1, 3])
def test_the_rest_pose_of_fitted_lobes_is_their_reconstruction(lobes):
    vectors = torch.randn(9, 1, 16, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    found = fit_lobes(vectors, lobes)
    transfer = replaced(
        random_zonal(dtype=torch.float64, albedo=(1, 1)),
        axis=found.axis[None],
        coefficients=found.coefficients[:, None],
        exact=found.exact[:, None],
        albedo=torch.ones(1, 1, dtype=torch.float64),
    )
    made = shader(transfer).vectors()
    assert (made - found.reconstruct().permute(1, 2, 0)).abs().max() <= 64 * EPSILON[torch.float64]
    assert lobes < 3 or torch.equal(made[:, :4], vectors.permute(1, 2, 0)[:, :4])


@pytest.mark.parametrize(("channels", "exact"), KINDS)
def test_frames_and_light_turned_together_change_nothing(channels, exact):
    transfer = random_zonal(channels=channels, exact=exact, order=6)
    module, light, frames, turn = shader(transfer), lights(order=6), turns(9), turns(7, seed=3)
    still = module(light, frames=frames)
    for turned in (
        module(sh.rotate(light.expand(7, -1, -1), turn), frames=turn[:, None] @ frames),
        module(light, turn, frames=turn[:, None] @ frames),
        shader(transfer).double()(light.double(), turn.double(), frames=(turn[:, None] @ frames).double()),
    ):
        assert (turned - still).abs().max() <= 1e-5 * still.abs().max()


@pytest.mark.parametrize("method", ["direct", "table"])
def test_a_mesh_that_moves_rigidly_is_lit_as_by_a_light_that_turns_the_other_way(method):
    transfer = random_zonal(dtype=torch.float64)
    module, light = shader(transfer, method=method), lights(dtype=torch.float64)
    turn = turns(dtype=torch.float64)
    moved = module(light, positions=transfer.positions @ turn.mT + 3.0)
    frames = module(light, frames=turn.expand(9, 3, 3))
    assert (moved - frames).abs().max() <= 1e-12 * frames.abs().max()
    if method == "direct":
        assert (moved - module(light, turn.mT)).abs().max() <= 1e-12 * frames.abs().max()


def test_the_exact_bands_are_exact_in_every_pose():
    transfer = random_zonal(exact=True, dtype=torch.float64)
    signal = transfer.layers["diffuse"].signal
    transfer = replaced(transfer, coefficients=torch.zeros_like(signal.coefficients))
    frames, light = turns(9, dtype=torch.float64), lights(dtype=torch.float64)
    found = shader(transfer)(light, frames=frames)
    low = torch.zeros(9, 16, dtype=torch.float64)
    low[:, :4] = signal.exact[0, 0].T
    turned = sh.rotate(low[..., None], frames)[..., 0]
    assert close(found, transfer.albedo * (turned @ light), 16)


def test_frames_count_where_positions_are_given_too():
    transfer, frames = random_zonal(), turns(9)
    module = shader(transfer)
    both = module(lights(), frames=frames, positions=transfer.positions)
    assert torch.equal(both, module(lights(), frames=frames))


def test_positions_are_frames_that_are_estimated():
    transfer = random_zonal(5, dtype=torch.float64)
    posed = transfer.positions * torch.tensor([1.0, 2.0, 0.5]).double() + 0.2 * transfer.positions.roll(1, 0)
    module = shader(transfer)
    frames = deformed_frames(transfer.positions, transfer.faces, posed, normals=transfer.normals)
    light = lights(dtype=torch.float64)
    assert close(module(light, positions=posed), module(light, frames=frames), 16)


@pytest.mark.parametrize("method", ["direct", "table"])
@pytest.mark.parametrize(("channels", "exact"), KINDS)
@pytest.mark.parametrize(
    ("many", "poses"),
    [((), (2,)), ((3,), ()), ((2,), (2,)), ((4, 1), (3,)), ((1, 3), (2, 1)), ((0,), ()), ((), (0,)), ((2, 1), (1, 3))],
)
def test_batches_of_lights_and_poses_broadcast(method, channels, exact, many, poses):
    transfer = random_zonal(channels=channels, exact=exact)
    module = shader(transfer, method=method)
    light, frames = lights(*many), turns(*poses, 9)
    found = module(light, frames=frames)
    shape = torch.broadcast_shapes(many, poses)
    assert found.shape == (*shape, 9, 3)
    wide, posed = light.expand(*shape, 16, 3).reshape(-1, 16, 3), frames.expand(*shape, 9, 3, 3).reshape(-1, 9, 3, 3)
    for one, lamp, pose in zip(found.reshape(-1, 9, 3), wide, posed, strict=True):
        wanted = module(lamp, frames=pose)
        assert (one - wanted).abs().max() <= 64 * EPSILON[torch.float32] * wanted.abs().max()


@pytest.mark.parametrize(("channels", "exact"), KINDS)
@pytest.mark.parametrize("albedo", ALBEDOS)
def test_a_fixed_pose_is_the_same_at_the_cost_of_a_static_one(channels, exact, albedo):
    transfer = random_zonal(channels=channels, exact=exact, albedo=albedo)
    module, frames, light, turn = shader(transfer), turns(9), lights(3), turns(3)
    fixed = module.fix_pose(frames)
    assert fixed.layers["diffuse"].signal.values.shape == (channels, 16, 9)
    assert close(fixed(light, turn), module(light, turn, frames=frames), 32)
    assert close(module.fix_pose()(light), module(light), 32)
    posed = transfer.positions.roll(1, 0)
    assert close(module.fix_pose(positions=posed)(light), module(light, positions=posed), 32)


def test_radiance_is_contiguous_in_the_vertices():
    assert shader(random_zonal())(lights(2), frames=turns(9)).mT.is_contiguous()


def test_dark_receivers_stay_dark_and_finite():
    transfer = random_zonal()
    transfer.layers["diffuse"].signal.coefficients[..., 4] = 0
    transfer.layers["diffuse"].signal.exact[..., 4] = 0
    for method in ("direct", "table"):
        radiance = shader(transfer, method=method)(lights(), frames=turns(9))
        assert torch.equal(radiance[4], torch.zeros(3))
        assert radiance.isfinite().all()


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_extreme_lights(scale):
    transfer = random_zonal()
    module, frames = shader(transfer), turns(9)
    radiance = module(lights() * scale, frames=frames)
    assert close(radiance.double() / scale, by_definition(transfer, lights(), frames), 64 * 2**29)
    assert radiance.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_widened_and_its_axes_are_of_unit_length_again(dtype):
    transfer = random_zonal(dtype=torch.float64)
    half = transfer.to(dtype)
    module = shader(half)
    axis = module.layers["diffuse"].signal.axis
    assert axis.dtype == torch.float32
    assert (axis.norm(dim=2) - 1).abs().max() <= 4 * EPSILON[torch.float32]
    wanted = by_definition(transfer, lights(), turns(9))
    # An axis is off by half an epsilon in each of its components, a band three times that.
    assert (module(lights(), frames=turns(9)) - wanted).abs().max() <= 8 * torch.finfo(dtype).eps * wanted.abs().max()


def test_an_environment_goes_through_the_graph_in_a_pose():
    transfer = random_zonal()
    module, frames = shader(transfer), turns(9)
    environment = torch.rand(2, 6, 4, 4, 3, generator=torch.Generator().manual_seed(0))
    light = sh.project_cube(environment, 4)
    found = EnvironmentShader(module, 4)(environment, frames=frames)
    assert close(found, module(light, frames=frames), 64)
    posed = transfer.positions.roll(1, 0)
    assert close(EnvironmentShader(module, 4)(environment, positions=posed), module(light, positions=posed), 64)


# The table


@pytest.mark.parametrize(("order", "allowed"), [(3, 0.005), (4, 0.01), (6, 0.03)])
@pytest.mark.parametrize("exact", [False, True])
def test_the_table_is_off_by_what_it_states(order, allowed, exact):
    transfer = random_zonal(16, order=order, exact=exact, dtype=torch.float64)
    light, frames = lights(order=order, dtype=torch.float64), turns(256, dtype=torch.float64)
    wanted = shader(transfer)(light, frames=frames)
    off = shader(transfer, method="table")(light, frames=frames) - wanted
    assert 0 < off.norm() / wanted.norm() < allowed


def test_the_table_goes_on_around_and_over_the_poles():
    # One lobe that is swept across the seam at +-180 degrees and over both poles.
    steps = torch.linspace(-0.2, 0.2, 401, dtype=torch.float64)
    zero = torch.zeros_like(steps)
    paths = [
        torch.stack([steps.sin(), zero + 0.3, -steps.cos()], -1),
        torch.stack([steps.sin(), steps.cos(), zero], -1),
        torch.stack([0.3 * steps.sin(), -steps.cos(), steps.sin()], -1),
        torch.stack([zero, steps.cos(), steps.sin()], -1),
    ]
    axis = normalize(torch.cat(paths), dim=-1).T[None]
    count = axis.shape[-1]
    transfer = replaced(
        random_zonal(1, lobes=1, order=6, exact=False, dtype=torch.float64),
        axis=axis[None],
        coefficients=torch.ones(1, 1, 1, 6, count, dtype=torch.float64),
        exact=torch.zeros(1, 1, 0, count, dtype=torch.float64),
        positions=torch.zeros(count, 3, dtype=torch.float64),
        normals=torch.zeros(count, 3, dtype=torch.float64),
        squared_error=torch.zeros(count),
        faces=torch.zeros(0, 3, dtype=torch.int64),
        albedo=torch.ones(1, 1, dtype=torch.float64),
    )
    light = lights(order=6, dtype=torch.float64)
    read, direct = (shader(transfer, method=method)(light) for method in ("table", "direct"))
    assert (read - direct).abs().max() < 0.05 * direct.abs().max()
    step = read.view(4, 401, 3).diff(dim=1).abs().amax()
    assert step < 1.5 * direct.view(4, 401, 3).diff(dim=1).abs().amax()


def test_a_table_of_band_0_is_exact():
    transfer = random_zonal(order=1, exact=False, dtype=torch.float64)
    light = lights(order=1, dtype=torch.float64)
    read = shader(transfer, method="table")(light, frames=turns(9, dtype=torch.float64))
    assert close(read, by_definition(transfer, light), 16)


# Gradients and graphs


@pytest.mark.parametrize("method", ["direct", "table"])
@pytest.mark.parametrize(("channels", "exact"), KINDS)
def test_gradients_flow_to_lobes_albedo_frames_and_light(method, channels, exact):
    transfer = random_zonal(2, lobes=2, order=3, channels=channels, exact=exact, dtype=torch.float64)
    names = ["axis", "coefficients", "albedo"] + ["exact"] * exact
    module = shader(transfer, method=method, learn=names)
    parameters = dict(module.named_parameters())
    assert sorted(name.rpartition(".")[2] for name in parameters) == sorted(names)
    light = lights(order=3, dtype=torch.float64).requires_grad_()
    # Frames as functions of free numbers, since they must stay rotations.
    angles = torch.rand(4, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64).mul(90).requires_grad_()

    def radiance(light, angles, *values):
        inputs = {"frames": sh.yaw_pitch_roll(angles)}
        return torch.func.functional_call(module, dict(zip(parameters, values, strict=True)), (light,), inputs)

    assert torch.autograd.gradcheck(radiance, (light, angles, *parameters.values()))


def test_gradients_flow_to_positions():
    transfer = random_zonal(3, lobes=2, order=3, dtype=torch.float64)
    posed = transfer.positions.clone().requires_grad_()
    module = shader(transfer)
    assert torch.autograd.gradcheck(lambda posed: module(lights(order=3, dtype=torch.float64), positions=posed), posed)


def test_gradients_flow_through_a_fixed_pose():
    transfer = random_zonal(2, dtype=torch.float64)
    module = shader(transfer, learn=["coefficients"])
    light = lights(dtype=torch.float64)
    fixed, general = (
        module.fix_pose(turns(4, dtype=torch.float64))(light),
        module(light, frames=turns(4, dtype=torch.float64)),
    )
    learned = module.layers["diffuse"].signal.coefficients
    for radiance in (fixed, general):
        learned.grad = None
        radiance.square().sum().backward()
        wanted = learned.grad.clone()
    learned.grad = None
    module.fix_pose(turns(4, dtype=torch.float64))(light).square().sum().backward()
    assert close(learned.grad, wanted, 64)


@pytest.mark.parametrize("method", ["direct", "table"])
def test_gradients_are_finite_at_the_poles(method):
    transfer = random_zonal(2, dtype=torch.float64)
    axis = transfer.layers["diffuse"].signal.axis[0]
    axis[:] = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)[:, None]
    axis[1] = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)[:, None]
    module = shader(transfer, method=method, learn="axis")
    module(lights(dtype=torch.float64)).square().sum().backward()
    assert module.layers["diffuse"].signal.axis.grad.isfinite().all()


def test_what_is_computed_without_gradients_is_what_is_computed_with_them():
    transfer = random_zonal(order=6, channels=3)
    module, light, frames = shader(transfer), lights(2, order=6), turns(2, 9)
    recorded = module(light, frames=frames.requires_grad_())
    assert recorded.requires_grad
    assert close(module(light, frames=frames.detach()), recorded.detach(), 32)
    with torch.inference_mode():
        assert close(module(light, frames=frames.detach()), recorded.detach(), 32)


def test_learning_axes_of_any_length_counts_them_as_directions():
    transfer = random_zonal()
    module = shader(transfer, learn="axis")
    before = module(lights()).detach()
    with torch.no_grad():
        module.layers["diffuse"].signal.axis.mul_(3.0)
    assert close(module(lights()).detach(), before, 64)


@pytest.mark.parametrize(("method", "exact"), [("direct", True), ("table", False)])
def test_compiles_as_one_graph(untyped, method, exact):
    torch.compiler.reset()
    transfer = random_zonal(exact=exact)
    module, light, frames = shader(transfer, method=method), lights(2), turns(2, 9)
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(light, turns(2), frames=frames), module(light, turns(2), frames=frames), atol=1e-5)
    posed = torch.stack([transfer.positions.roll(1, 0), transfer.positions])
    assert torch.allclose(compiled(light, positions=posed), module(light, positions=posed), atol=1e-5)
    torch.compiler.reset()


def test_the_state_goes_from_one_shader_to_another():
    first, second = shader(random_zonal()), shader(random_zonal(seed=1))
    second.load_state_dict(first.state_dict())
    assert torch.equal(first(lights(), frames=turns(9)), second(lights(), frames=turns(9)))
