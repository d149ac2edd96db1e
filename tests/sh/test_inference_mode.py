"""Do constants that were first made in inference mode serve gradients afterwards?"""

import pytest
import torch

from torchprt import light, sh

TASKS = {
    "project_cube": lambda values: sh.project_cube(values.expand(6, 5, 5, 3), 4),
    "project_latlong": lambda values: sh.project_latlong(values.expand(7, 14, 3), 4),
    "product": lambda values: sh.product(values.expand(16, 3), values.expand(16, 3)),
    "product_matrix": lambda values: sh.product_matrix(values[..., 0].expand(16), 4, 4),
    "latlong_to_cube": lambda values: light.latlong_to_cube(values.expand(7, 14, 3), 5),
    "cube_to_latlong": lambda values: light.cube_to_latlong(values.expand(6, 9, 9, 3), 7),
}


@pytest.mark.parametrize("name", TASKS)
def test_gradients_after_a_first_use_in_inference_mode(name):
    task = TASKS[name]
    # A dtype that no other test uses with these sizes, so that the tables are made here.
    with torch.inference_mode():
        task(torch.ones(1, 3, dtype=torch.float64))
    values = torch.ones(1, 3, dtype=torch.float64, requires_grad=True)
    task(values).sum().backward()
    assert values.grad.isfinite().all()
