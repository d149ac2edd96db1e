"""Can a graph hold the way from an environment, or from a lamp, to its coefficients?"""

import pytest
import torch

from torchprt import light


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize(
    ("function", "shape"),
    [
        (lambda image: light.project(image, 4), (2, 8, 16, 3)),
        (lambda cube: light.project(cube, 4), (2, 6, 8, 8, 3)),
        (lambda image: light.latlong_to_cube(image, 4), (2, 8, 16, 3)),
        (lambda cube: light.cube_to_latlong(cube, 8), (2, 6, 4, 4, 3)),
        (lambda direction: light.directional(direction, order=4), (5, 3)),
        (lambda direction: light.disc(direction, 0.2, 1.0, 4, normalise=True), (5, 3)),
        (lambda direction: light.hemisphere(direction, 1.0, 0.5, 4), (5, 3)),
        (lambda direction: light.overcast_sky(2.0, direction, 4), (5, 3)),
    ],
)
def test_one_graph_gives_the_eager_result(function, shape):
    given = torch.rand(shape) + 0.1
    torch.compiler.reset()
    compiled = torch.compile(function, fullgraph=True, backend="eager")
    assert torch.allclose(compiled(given), function(given), rtol=1e-5, atol=1e-5)
