import math

import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError

EPS = {torch.float32: 2**-23, torch.float64: 2**-52}


def turns(count, dtype=torch.float64, seed=0):
    """Uniformly random rotations, by QR with the sign fixed."""
    normal = torch.randn(count, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    q, r = torch.linalg.qr(normal)
    q = q * torch.diagonal(r, dim1=-2, dim2=-1).sign().unsqueeze(-2)
    return (q * torch.linalg.det(q)[:, None, None]).to(dtype)


def lights(*shape, dtype=torch.float64, seed=1):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)).to(dtype)


@pytest.fixture(params=["values", "gradients"])
def rotate(request):
    """`sh.rotate` on both its ways: by Euler turns, and by quadrature because a gradient is recorded."""
    if request.param == "values":
        return sh.rotate
    return lambda light, rotation: sh.rotate(light, rotation.clone().requires_grad_()).detach()


def test_refuses_a_reflection():
    with pytest.raises(InputError, match="reflection"):
        sh.rotate(lights(9, 3), torch.diag(torch.tensor([1.0, 1.0, -1.0])).double())


@pytest.mark.parametrize("fault", [1.001 * torch.eye(3), torch.zeros(3, 3), math.nan * torch.eye(3)])
def test_refuses_what_is_not_orthogonal(fault):
    with pytest.raises(InputError, match="orthogonal"):
        sh.check_rotation(torch.stack([torch.eye(3), fault]))


def test_refuses_a_light_that_is_not_square_and_order_zero():
    with pytest.raises(InputError, match="square"):
        sh.rotate(lights(8, 3), torch.eye(3).double())
    for make in (
        sh.Rotation,
        lambda n: sh.rotation_bands(torch.eye(3), n),
        lambda n: sh.rotation_matrix(torch.eye(3), n),
    ):
        with pytest.raises(InputError, match="order"):
            make(0)


def test_refuses_a_light_and_a_rotation_of_different_types(rotate):
    with pytest.raises(InputError, match="float32 but rotation is"):
        rotate(lights(9, 3, dtype=torch.float32), turns(1))


def test_takes_no_lights_and_no_channels(rotate):
    assert rotate(lights(0, 9, 3), turns(1)).shape == (0, 9, 3)
    assert rotate(lights(9, 3), turns(2)[:0]).shape == (0, 9, 3)
    assert sh.rotation_matrix(turns(2)[:0], 3).shape == (0, 9, 9)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("order", [1, 2, 3, 6, 20, 32])
def test_agrees_with_the_light_evaluated_at_the_directions_turned_back(order, dtype, rotate):
    rotation, light = turns(3, dtype), lights(3, order * order, 3, dtype=dtype)
    directions, _ = sh.fibonacci(200)
    turned = sh.evaluate(rotate(light, rotation).double(), directions)
    back = directions @ rotation.double()
    expected = torch.stack([sh.evaluate(l, d) for l, d in zip(light.double(), back, strict=True)])
    # Random coefficients: values of size order; the basis loses another factor of order.
    assert (turned - expected).abs().max() < 8 * order**2 * EPS[dtype]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("order", [1, 2, 3, 6, 20, 21, 32])
def test_the_matrix_turns_the_basis(order, dtype):
    rotation = torch.cat([turns(4), torch.eye(3)[None], *[torch.diag(d)[None] for d in 2 * torch.eye(3) - 1]]).to(dtype)
    directions, _ = sh.fibonacci(100)
    turned = sh.basis(directions @ rotation.double().mT, order)
    expected = sh.basis(directions, order) @ sh.rotation_matrix(rotation, order).double().mT
    # y is of size order at most and the error of a float32 entry of `rotation` grows with the band.
    assert (turned - expected).abs().max() < 4 * order**2 * EPS[dtype]


@pytest.mark.parametrize("order", [3, 6, 25])
def test_float32_matrices_keep_to_the_accuracy_of_their_input(order):
    rotation = turns(8, torch.float32)
    single, double = sh.rotation_matrix(rotation, order), sh.rotation_matrix(rotation.double(), order)
    # 2e-7 at order 6; above order 20 the recurrence runs in float64, so only the last rounding is left.
    assert (single - double).abs().max() < (0.5 if order > 20 else order) * EPS[torch.float32]


@pytest.mark.parametrize("order", [1, 4])
def test_the_bands_are_the_blocks_of_the_matrix(order):
    rotation = turns(6).reshape(2, 3, 3, 3)
    bands, matrix = sh.rotation_bands(rotation, order), sh.rotation_matrix(rotation, order)
    assert [band.shape for band in bands] == [(2, 3, 2 * l + 1, 2 * l + 1) for l in range(order)]
    for flat, whole in zip(zip(*(b.flatten(0, 1) for b in bands), strict=True), matrix.flatten(0, 1), strict=True):
        assert torch.equal(torch.block_diag(*flat), whole)


@pytest.mark.parametrize("order", [2, 6])
@pytest.mark.parametrize(
    ("left", "right"), [((), ()), ((4,), ()), ((), (4,)), ((4,), (4,)), ((5, 1), (4,)), ((1,), (4,))]
)
def test_leading_dimensions_broadcast(order, left, right, rotate):
    light = lights(*left, order * order, 2)
    rotation = turns(max(1, math.prod(right))).reshape(*right, 3, 3)
    expected = sh.rotation_matrix(rotation, order) @ light
    torch.testing.assert_close(rotate(light, rotation), expected, atol=1e-13, rtol=0)


def test_the_module_is_the_function_with_constants_as_buffers():
    module = sh.Rotation(6, torch.float64)
    light, rotation = lights(3, 36, 3), turns(3).requires_grad_()
    assert torch.equal(module(light, rotation), sh.rotate(light, rotation))
    assert {buffer.dtype for buffer in module.float().buffers()} == {torch.float32}
    assert not module.state_dict()


@pytest.mark.parametrize("order", [2, 6, 7])
def test_gradients_of_the_light_turn_it_back(order):
    light, rotation = lights(3, order**2, 2).requires_grad_(), turns(3)
    upstream = lights(3, order**2, 2, seed=5)
    (gradient,) = torch.autograd.grad(sh.rotate(light, rotation), light, upstream)
    torch.testing.assert_close(gradient, sh.rotate(upstream, rotation.mT), atol=16 * order * EPS[torch.float64], rtol=0)


# torch compiles its own rules of forward derivatives in a way that is going away.
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_forward_derivatives_are_those_of_the_quadrature():
    light, rotation, change = lights(16, 2), torch.eye(3).double(), lights(3, 3)
    spin = change - change.mT
    value, slope = torch.func.jvp(lambda r: sh.rotate(light, r), (rotation,), (spin,))
    torch.testing.assert_close(value, light, atol=32 * EPS[torch.float64], rtol=0)
    # Central differences along the turn exp(t spin): the error is of the order of t^2, and of eps / t.
    ahead, behind = (sh.rotate(light, torch.linalg.matrix_exp(t * spin)) for t in (1e-5, -1e-5))
    torch.testing.assert_close(slope, (ahead - behind) / 2e-5, atol=1e-7, rtol=0)


@pytest.mark.parametrize("turn", [sh.rotate, lambda light, rotation: sh.rotation_matrix(rotation, 19) @ light])
def test_gradients_after_the_first_use_was_in_inference_mode(turn):
    light, rotation = lights(19**2, 1, dtype=torch.float32), turns(1, torch.float32)[0]
    with torch.inference_mode():
        turn(light, rotation)
        turn(light, rotation)
    light.requires_grad_(), rotation.requires_grad_()
    turn(light, rotation).sum().backward()
    assert light.grad.isfinite().all()
    assert rotation.grad.isfinite().all()


@pytest.mark.parametrize("start", [torch.eye(3), torch.diag(torch.tensor([1.0, -1.0, -1.0])), turns(1)[0]])
def test_gradients_are_right_where_angles_have_none(start):
    start = start.double().requires_grad_()
    light = lights(16, 2).requires_grad_()
    # Gradients of the polynomial in the nine numbers: steps off the rotations must not be refused.
    assert torch.autograd.gradcheck(sh.Rotation(4, torch.float64), (light, start))
    assert torch.autograd.gradcheck(lambda r: sh.rotation_matrix(r, 4), start)


def test_yaw_pitch_roll_turn_about_the_axes_of_the_conventions():
    def about(axis, degrees):
        generator = torch.zeros(3, 3, dtype=torch.float64)
        generator[(axis + 2) % 3, (axis + 1) % 3] = math.radians(degrees)
        return torch.linalg.matrix_exp(generator - generator.T)

    angles = torch.tensor([[30.0, -50.0, 70.0], [90.0, 0.0, 0.0], [0.0, 180.0, 0.0]], dtype=torch.float64)
    expected = torch.stack([about(1, y) @ about(0, p) @ about(2, r) for y, p, r in angles.tolist()])
    # The reference is a series of matrix products: some 16 roundings.
    torch.testing.assert_close(sh.yaw_pitch_roll(angles), expected, atol=16 * 2**-52, rtol=0)
    z = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(expected[1] @ z, torch.tensor([1.0, 0.0, 0.0]).double(), atol=1e-15, rtol=0)


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_very_dim_and_very_bright_lights_turn_the_same(scale, rotate):
    light, rotation = lights(36, 3, dtype=torch.float32), turns(1, torch.float32)[0]
    torch.testing.assert_close(rotate(light * scale, rotation), rotate(light, rotation) * scale, atol=0.0, rtol=1e-3)
