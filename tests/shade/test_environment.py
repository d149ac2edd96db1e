"""Is the graph from cube map to picture the same as its parts one after another?"""

import pytest
import torch
from transfers import KINDS, random_glossy

from torchprt.errors import InputError
from torchprt.sh import cube_directions, evaluate, project_cube, yaw_pitch_roll
from torchprt.shade import EnvironmentShader, display, shader


def cubes(*batch, size=8, dtype=torch.float32):
    return torch.rand(*batch, 6, size, size, 3, generator=torch.Generator().manual_seed(1), dtype=dtype)


@pytest.mark.parametrize("size", [1, 0, -3])
def test_refuses_cube_maps_without_texels(make_transfer, size):
    with pytest.raises(InputError, match=f"size {size} of the cube map is too small"):
        EnvironmentShader(shader(make_transfer()), size)


def test_refuses_a_cube_map_of_another_size(make_transfer):
    graph = EnvironmentShader(shader(make_transfer()), 8)
    with pytest.raises(InputError, match=r"faces of \(4, 4\) texels but the graph was made for 8 x 8"):
        graph(cubes(size=4))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 2), (0,)])
def test_is_projection_then_shading(make_transfer, channels, batch):
    module = shader(make_transfer(channels=channels))
    environment = cubes(*batch)
    wanted = module(project_cube(environment, 4))
    found = EnvironmentShader(module, 8)(environment)
    assert found.shape == (*batch, 25, 3)
    # The same sums over 384 texels, perhaps in another order.
    assert torch.allclose(
        found,
        wanted,
        rtol=0,
        atol=32 * torch.finfo(torch.float32).eps * float(wanted.abs().amax()) if wanted.numel() else 0,
    )


def test_turns_the_environment(make_transfer):
    module = shader(make_transfer())
    environment = cubes(2)
    rotation = yaw_pitch_roll(torch.tensor([[0.0, 0.0, 0.0], [10.0, 120.0, 33.0]]))
    found = EnvironmentShader(module, 8)(environment, rotation)
    wanted = module(project_cube(environment, 4), rotation)
    assert torch.allclose(found, wanted, rtol=0, atol=32 * torch.finfo(torch.float32).eps * float(wanted.abs().max()))


def test_a_band_limited_environment_shades_as_its_coefficients(make_transfer):
    light = torch.randn(9, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    module = shader(make_transfer(order=3), dtype=torch.float64)
    environment = evaluate(light, cube_directions(64).reshape(-1, 3)).reshape(6, 64, 64, 3)
    # The cube-map rule errs by about half a per cent at 8 x 8 and falls nearly as size^-4.
    found, wanted = EnvironmentShader(module, 64)(environment), module(light)
    assert (found - wanted).abs().max() <= 1e-5 * wanted.abs().max()


def test_with_a_tone_map_it_gives_a_picture(make_transfer):
    module = shader(make_transfer())
    environment = cubes(2)
    picture = EnvironmentShader(module, 8, exposure=1.5, tone="filmic")(environment)
    linear = EnvironmentShader(module, 8)(environment)
    assert torch.equal(picture, display(linear, exposure=1.5, tone="filmic"))
    assert 0 <= picture.min() < picture.max() <= 1


def test_gradients_reach_the_environment_and_the_rotation(make_transfer):
    graph = EnvironmentShader(shader(make_transfer(side=2, order=2, dtype=torch.float64)), 2)
    environment = cubes(1, size=2, dtype=torch.float64).requires_grad_()
    rotation = torch.eye(3, dtype=torch.float64)[None].clone().requires_grad_()
    assert torch.autograd.gradcheck(graph, (environment, rotation))


@pytest.mark.parametrize("kind", KINDS)
def test_the_eye_reaches_a_shader_that_depends_on_it(kind):
    module = shader(random_glossy(kind))
    environment, turn = cubes(2), yaw_pitch_roll(torch.tensor([10.0, 120.0, 33.0]))
    eye = torch.tensor([1.0, 2.0, 3.0])
    light = project_cube(environment, 4)
    for look in ({"eye": eye}, {"view": eye}):
        found = EnvironmentShader(module, 8)(environment, turn, **look)
        wanted = module(light, turn, **look)
        assert (found - wanted).abs().max() <= 64 * torch.finfo(torch.float32).eps * wanted.abs().max()
    with pytest.raises(InputError, match="neither is given"):
        EnvironmentShader(module, 8)(environment)


def test_refuses_an_eye_that_a_diffuse_shader_cannot_use(make_transfer):
    eye = torch.tensor([1.0, 2.0, 3.0])
    for module in (shader(make_transfer()), shader(random_glossy()).fix_eye(eye=eye)):
        for look in ({"eye": eye}, {"view": eye}):
            with pytest.raises(InputError, match="eye or view is given, but what this shader gives does not depend"):
                EnvironmentShader(module, 8)(cubes(), **look)


def test_a_fixed_eye_is_shaded_from_cube_maps_too():
    module = shader(random_glossy())
    eye = torch.tensor([1.0, 2.0, 3.0])
    found = EnvironmentShader(module.fix_eye(eye=eye), 8)(cubes(2))
    wanted = EnvironmentShader(module, 8)(cubes(2), eye=eye)
    assert (found - wanted).abs().max() <= 64 * torch.finfo(torch.float32).eps * wanted.abs().max()
