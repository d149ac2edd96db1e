"""Do the shaders compile without a graph break, and give the same?"""

import pytest
import torch
from transfers import KINDS, random_glossy

from torchprt.brdf import Lambert
from torchprt.sh import yaw_pitch_roll
from torchprt.shade import EnvironmentShader, shader
from torchprt.shade.display import TONES


@pytest.mark.parametrize("channels", [1, 3])
def test_a_shader_compiles_as_one_graph(make_transfer, fresh, channels):
    module = shader(make_transfer(order=3, channels=channels))
    light = torch.randn(2, 9, 3, generator=torch.Generator().manual_seed(0))
    rotation = yaw_pitch_roll(torch.tensor([[0.0, 0.0, 0.0], [40.0, 50.0, 60.0]]))
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(light, rotation), module(light, rotation), rtol=1e-5, atol=1e-6)
    assert torch.allclose(compiled(light), module(light), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("tone", TONES)
def test_the_graph_from_cube_map_to_picture_compiles_as_one_graph(make_transfer, fresh, tone):
    module = EnvironmentShader(shader(make_transfer(order=3)), 4, tone=tone)
    environment = torch.rand(2, 6, 4, 4, 3, generator=torch.Generator().manual_seed(0))
    rotation = yaw_pitch_roll(torch.tensor([[0.0, 0.0, 0.0], [40.0, 50.0, 60.0]]))
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(environment, rotation), module(environment, rotation), rtol=1e-5, atol=1e-6)


def some():
    """Lights, rotations and eyes for a shader of glossy transfer, compared in eager mode and compiled."""
    generator = torch.Generator().manual_seed(0)
    light = torch.randn(2, 4, 3, generator=generator)
    rotation = yaw_pitch_roll(torch.tensor([[0.0, 0.0, 0.0], [40.0, 50.0, 60.0]]))
    return light, rotation, torch.randn(2, 3, generator=generator)


def same(found, wanted):
    # float32, sums of some hundred products, in another order.
    return (found - wanted).abs().max() <= 1e-5 * wanted.abs().max()


@pytest.mark.parametrize("kind", KINDS)
def test_a_glossy_shader_compiles_as_one_graph(fresh, kind):
    module = shader(random_glossy(kind, order=2, output_order=2, glossy=3, channels=3))
    light, rotation, eye = some()
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    # The eye exactly at a receiver, too.
    eye[1] = module.layers[kind].points[:, 0]
    assert same(compiled(light, rotation, eye=eye), module(light, rotation, eye=eye))


@pytest.mark.parametrize("kind", ["exit", "visibility"])
def test_fixed_shaders_compile_as_one_graph(fresh, kind):
    module = shader(random_glossy(kind, order=2, output_order=2))
    light, rotation, eye = some()
    fixed = module.fix_eye(eye=eye[0])
    assert same(
        torch.compile(fixed, fullgraph=True, backend="aot_eager")(light, rotation), module(light, rotation, eye=eye[0])
    )
    lit = module.fix_light(light, rotation)
    assert same(torch.compile(lit, fullgraph=True, backend="aot_eager")(eye=eye), module(light, rotation, eye=eye))


def test_a_material_at_run_time_compiles_as_one_graph(fresh):
    module = shader(random_glossy("incident", order=2, output_order=2), brdf=Lambert())
    light, rotation, eye = some()
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    assert same(compiled(light, rotation, eye=eye), module(light, rotation, eye=eye))
