"""What do shaders lose in narrow types, and nothing more? Errors are multiples of the epsilon of the type."""

import math

import pytest
import torch
from every_shader import asked, every_transfer, lights
from transfers import KINDS, random_glossy
from zonal_transfers import random_zonal, turns

from torchprt import sh
from torchprt.brdf import sample_hemisphere_map
from torchprt.errors import InputError
from torchprt.pose import DeformedFrames, SkinnedMesh
from torchprt.shade import EnvironmentShader, shader

NARROW = [torch.bfloat16, torch.float16]
TRANSFERS = every_transfer()


def off(value, wanted):
    """Relative RMS, in float64."""
    value, wanted = value.double(), wanted.double()
    return ((value - wanted).square().mean() / wanted.square().mean()).sqrt()


def rounded(rotation, dtype):
    return rotation.to(dtype).double()


# Misuse


@pytest.mark.parametrize("name", ["exit dense 1", "diffuse zonal 3", "visibility clustered 1"])
def test_refuses_a_light_that_is_wider_than_the_shader_or_narrower_than_float64(untyped, name):
    for module, light, works in (
        (shader(TRANSFERS[name]), lights(dtype=torch.float64), "float32"),
        (shader(TRANSFERS[name]).bfloat16(), lights(dtype=torch.float64), "float32"),
        (shader(TRANSFERS[name], dtype=torch.float64), lights(), "float64"),
        (shader(TRANSFERS[name]), torch.ones(16, 3, dtype=torch.int64), "float32"),
    ):
        look = asked(module.needs, module.vertices)
        with pytest.raises(InputError, match=f"light is {light.dtype} but the shader works in torch.{works}: convert"):
            module(light, **look)


def test_refuses_what_no_rounding_makes_of_a_rotation():
    for dtype in NARROW:
        eps = torch.finfo(dtype).eps
        for matrix in ((1 + 2 * eps) * torch.eye(3), -torch.eye(3), torch.full((3, 3), math.nan)):
            with pytest.raises(InputError, match="rotation"):
                sh.check_rotation(matrix.to(dtype))
        with pytest.raises(InputError, match=r"but rotation is torch.float64"):
            sh.rotate(lights(dtype=dtype), torch.eye(3, dtype=torch.float64))


def test_refuses_to_write_a_result_over_one_of_another_type(make_transfer):
    module = shader(make_transfer(order=4))
    out = module(lights())
    with pytest.raises(InputError, match=r"out cannot be used with a light in torch\.bfloat16: the shader is"):
        module(lights(dtype=torch.bfloat16), out=out)


# Every shader


@pytest.mark.parametrize("dtype", NARROW)
@pytest.mark.parametrize("name", TRANSFERS)
def test_a_narrow_shader_is_off_by_about_an_epsilon(name, dtype):
    transfer = TRANSFERS[name]
    exact = shader(transfer)
    look = asked(exact.needs, exact.vertices, 3)
    rotation = turns(3)
    wanted = exact(lights(3), rotation, **look)
    for module in (shader(transfer).to(dtype), shader(transfer, dtype=dtype)):
        assert module.dtype == dtype
        for light, turn in (
            (lights(3), rotation),
            (lights(3).to(dtype), rotation),
            (lights(3).to(dtype), turns(3, dtype=dtype)),
        ):
            found = module(light, turn, **look)
            assert found.dtype == light.dtype
            # Light, transfer, what meets at a representative and the sum of layers are rounded, each to half of one.
            assert off(found, wanted) < 1.5 * torch.finfo(dtype).eps


@pytest.mark.parametrize("dtype", NARROW)
@pytest.mark.parametrize("name", TRANSFERS)
def test_autocast_costs_less_than_an_epsilon_and_changes_no_type(name, dtype):
    module = shader(TRANSFERS[name])
    look = asked(module.needs, module.vertices, 3)
    wanted = module(lights(3), turns(3), **look)
    with torch.autocast("cpu", dtype):
        found = module(lights(3), turns(3), **look)
    assert found.dtype == torch.float32
    assert 0 < off(found, wanted) < torch.finfo(dtype).eps


@pytest.mark.parametrize("name", TRANSFERS)
def test_what_is_fixed_of_a_narrow_shader_is_as_near(name):
    transfer, dtype = TRANSFERS[name], torch.bfloat16
    exact, narrow = shader(transfer), shader(transfer).to(dtype)
    look = asked(exact.needs, exact.vertices)
    view = {key: value for key, value in look.items() if key == "view"}
    pose = {key: value for key, value in look.items() if key == "frames"}
    wanted, light = exact(lights(2), **look), lights(2).to(dtype)
    eps = torch.finfo(dtype).eps
    made = []
    if pose:
        made.append(narrow.fix_pose(**pose)(light, **view))
    if view:
        still = narrow.fix_pose(**pose) if pose else narrow
        made += [still.fix_eye(**view)(light), still.fix_light(light)(**view)]
    assert all(found.dtype == dtype and off(found, wanted) < 1.5 * eps for found in made)
    with torch.autocast("cpu", dtype):
        assert exact.vectors(**look).dtype == torch.float32


@pytest.mark.parametrize("name", TRANSFERS)
def test_narrow_shaders_learn(name):
    """Gradients arrive, in the type of what is learned, and are near those of float32."""
    transfer = TRANSFERS[name]
    exact = shader(transfer)
    learn = sorted({each for layer in exact.layers.values() for each in (*layer.learnable, *layer.signal.learnable)})
    look = asked(exact.needs, exact.vertices)
    gradients = []
    for dtype in (torch.float32, torch.bfloat16):
        module = shader(transfer, learn=learn).to(dtype)
        module(lights(), **look).square().sum().backward()
        gradients.append({key: value.grad for key, value in module.named_parameters()})
        assert all(value.grad.dtype == value.dtype for value in module.parameters())
    for key, wanted in gradients[0].items():
        assert off(gradients[1][key], wanted) < 4 * torch.finfo(torch.bfloat16).eps, key


def test_places_directions_and_tables_stay_in_float32():
    wide = {"points", "frames", "axis", "factors", "exponent", "rest", "basis", "slopes", "parity", "project", "shares"}
    seen = set()
    for transfer in TRANSFERS.values():
        whole, module = shader(transfer), shader(transfer).half()
        for key, buffer in module.named_buffers():
            name = key.rpartition(".")[2]
            if name in wide:
                seen.add(name)
                assert torch.equal(buffer, dict(whole.named_buffers())[key])
                assert buffer.dtype == torch.float32
            elif buffer.is_floating_point():
                assert buffer.dtype == torch.float16, key
        back = module.float()
        assert all(not b.is_floating_point() or b.dtype == torch.float32 for b in back.buffers())
        assert all(not b.is_floating_point() or b.dtype == torch.float64 for b in back.double().buffers())
    assert seen == wide


def test_a_learned_axis_stays_in_float32_with_its_gradient():
    module = shader(random_zonal(), learn=["axis", "coefficients"])
    module(lights()).sum().backward()
    axis = module.layers["diffuse"].signal.axis
    before, slope = axis.detach().clone(), axis.grad.clone()
    module.bfloat16()
    signal = module.layers["diffuse"].signal
    assert isinstance(signal.axis, torch.nn.Parameter)
    assert torch.equal(signal.axis, before)
    assert torch.equal(signal.axis.grad, slope)
    assert signal.coefficients.dtype == signal.coefficients.grad.dtype == torch.bfloat16


# Parts


@pytest.mark.parametrize("dtype", NARROW)
def test_a_narrow_rotation_is_the_rotation_that_it_is_nearest_to(dtype):
    exact = turns(50, dtype=torch.float64)
    light = lights(50, dtype=torch.float64)
    found = sh.rotate(light.to(dtype), exact.to(dtype)).double()
    u, _, v = torch.linalg.svd(rounded(exact, dtype))
    wanted = sh.rotate(light.to(dtype).double(), u @ v)
    eps = torch.finfo(dtype).eps
    # The result is rounded once, and nothing else is.
    assert ((found - wanted).abs() <= 0.51 * eps * wanted.abs() + 1e-5 * wanted.abs().max()).all()
    module = sh.Rotation(4).to(dtype)
    assert module.points.dtype == torch.float32
    assert (module(light.to(dtype), exact.to(dtype)).double() - found).abs().max() <= eps * found.abs().max()


@pytest.mark.parametrize("dtype", NARROW)
def test_functions_of_narrow_directions_are_those_of_the_rounded_ones(dtype):
    directions = torch.nn.functional.normalize(torch.randn(100, 3, generator=torch.Generator().manual_seed(1)), dim=-1)
    # Above the horizon, below which functions of the hemisphere mean nothing.
    directions[:, 2].abs_()
    narrow = directions.to(dtype)
    sh.check_directions(narrow)
    for function in (sh.basis, sh.hemisphere_basis):
        found, wanted = function(narrow, 8), function(narrow.double(), 8)
        assert found.dtype == dtype
        assert ((found - wanted).abs() <= 0.51 * torch.finfo(dtype).eps * wanted.abs() + 1e-4).all()


def test_light_of_a_turned_frame_does_not_change_under_autocast():
    light, rotation = lights(4), turns(4)
    tracked = light.clone().requires_grad_()
    wanted, graph = sh.rotate(light, rotation), sh.rotate(tracked, rotation)
    module, bands = sh.Rotation(4), sh.rotation_bands(rotation, 4)
    by_module = module(light, rotation)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(sh.rotate(light, rotation), wanted)
        assert torch.equal(sh.rotate(tracked, rotation), graph)
        assert torch.equal(module(light, rotation), by_module)
        assert all(torch.equal(a, b) for a, b in zip(sh.rotation_bands(rotation, 4), bands, strict=True))


def test_a_large_table_is_indexed_right_from_narrow_directions():
    """bfloat16 counts to 256: places in a table of more texels would be others, and beyond its end."""
    table = torch.rand(2, 64, 64, generator=torch.Generator().manual_seed(1))
    view = sh.to_horizon(torch.randn(500, 3, generator=torch.Generator().manual_seed(2)))
    view[0] = torch.tensor([0.7071, 0.7071, 0.0])
    for dtype in NARROW:
        found = sample_hemisphere_map(table.to(dtype), view.to(dtype))
        wanted = sample_hemisphere_map(table.to(dtype).double(), view.to(dtype).double())
        assert found.dtype == dtype
        assert (found - wanted).abs().max() < 2 * torch.finfo(dtype).eps


@pytest.mark.parametrize("dtype", NARROW)
def test_environments_are_projected_in_float32(dtype):
    """A sun beside a thousand dim texels: their sum leaves the range of float16, and the digits of bfloat16."""
    texels = torch.rand(2, 6, 16, 16, 3, generator=torch.Generator().manual_seed(1))
    texels[:, 0, 3, 4] = 6e4
    module = EnvironmentShader(shader(random_glossy("exit")), 16)
    view = {"view": torch.tensor([0.3, 1.0, 0.2])}
    wanted = module(texels, **view)
    eps = torch.finfo(dtype).eps
    with torch.autocast("cpu", dtype):
        assert off(module(texels, **view), wanted) < eps
        light = sh.project_cube(texels, 4)
        panorama = sh.project_latlong(texels[:, 0, :8], 4)
    assert torch.equal(light, sh.project_cube(texels, 4))
    assert torch.equal(panorama, sh.project_latlong(texels[:, 0, :8], 4))
    narrow = module.to(dtype)
    assert narrow.weights.dtype == torch.float32
    found = narrow(texels.to(dtype), **view)
    assert found.dtype == dtype
    assert off(found, wanted) < 2 * eps


@pytest.mark.parametrize("dtype", NARROW)
def test_poses_are_worked_out_in_float32(dtype):
    transfer = random_zonal(side=4)
    rest, faces = transfer.positions, transfer.faces
    posed = (rest @ turns(1)[0].T * 2).to(dtype)
    estimate = DeformedFrames(rest, faces, normals=transfer.normals)
    wanted = estimate(posed.float())
    assert torch.equal(estimate.to(dtype)(posed), wanted)
    weights = torch.softmax(torch.randn(16, 3, generator=torch.Generator().manual_seed(1)), -1)
    joints = torch.eye(4).expand(3, 4, 4).clone()
    joints[:, :3, :3] = turns(3)
    skin = SkinnedMesh(rest, weights)
    moved = skin(joints)
    with torch.autocast("cpu", dtype):
        assert all(torch.equal(a, b) for a, b in zip(skin(joints), moved, strict=True))
        assert torch.equal(estimate(posed.float()), wanted)
    assert all(torch.equal(a, b) for a, b in zip(skin.to(dtype)(joints), moved, strict=True))


@pytest.mark.parametrize("dtype", NARROW)
def test_a_table_of_the_light_is_read_in_float32(dtype):
    transfer = random_zonal()
    wanted = shader(transfer, method="table")(lights(3))
    found = shader(transfer, method="table").to(dtype)(lights(3).to(dtype))
    assert found.dtype == dtype
    assert off(found, wanted) < torch.finfo(dtype).eps
    with torch.autocast("cpu", dtype):
        assert off(shader(transfer, method="table")(lights(3)), wanted) < torch.finfo(dtype).eps


@pytest.mark.parametrize("kind", KINDS)
def test_a_compiled_shader_works_under_autocast(fresh, kind):
    module = shader(TRANSFERS[f"{kind} clustered 3"])
    look = asked(module.needs, module.vertices, 2)
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    with torch.autocast("cpu", torch.bfloat16):
        wanted = module(lights(2), turns(2), **look)
        found = compiled(lights(2), turns(2), **look)
    assert found.dtype == torch.float32
    assert off(found, wanted) < torch.finfo(torch.bfloat16).eps
