"""Do the shaders compile without a graph break, and give the same?"""

import pytest
import torch

from torchprt.sh import yaw_pitch_roll
from torchprt.shade import EnvironmentShader, shader


@pytest.mark.parametrize("channels", [1, 3])
def test_a_shader_compiles_as_one_graph(make_transfer, untyped, channels):
    module = shader(make_transfer(order=3, channels=channels))
    light = torch.randn(2, 9, 3, generator=torch.Generator().manual_seed(0))
    rotation = yaw_pitch_roll(torch.tensor([[0.0, 0.0, 0.0], [40.0, 50.0, 60.0]]))
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(light, rotation), module(light, rotation), rtol=1e-5, atol=1e-6)
    assert torch.allclose(compiled(light), module(light), rtol=1e-5, atol=1e-6)


def test_the_graph_from_cube_map_to_picture_compiles_as_one_graph(make_transfer, untyped):
    module = EnvironmentShader(shader(make_transfer(order=3)), 4, tone="filmic")
    environment = torch.rand(2, 6, 4, 4, 3, generator=torch.Generator().manual_seed(0))
    rotation = yaw_pitch_roll(torch.tensor([[0.0, 0.0, 0.0], [40.0, 50.0, 60.0]]))
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(environment, rotation), module(environment, rotation), rtol=1e-5, atol=1e-6)
