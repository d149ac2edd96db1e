"""Small neighbourhoods, and an object that is moved, for tests."""

import functools

import torch

from torchprt.scene import Material, Object, Scene, make_mesh
from torchprt.sh import yaw_pitch_roll
from torchprt.transfer import Dense, Neighbourhood, Transfer, grid_in
from torchprt.transport import bake_neighbourhood

ORDER, OUT = 4, 3


def random_neighbourhood(channels=1, shape=(4, 3, 5), order=ORDER, output_order=OUT, dtype=torch.float32, seed=0):
    """The identity and a little noise at every node."""
    generator = torch.Generator().manual_seed(seed)
    grid = grid_in((-1.0, -2.0, -1.5), (1.5, 0.5, 1.0), shape)
    noise = torch.randn(channels, grid.count, output_order**2, order**2, generator=generator, dtype=torch.float64)
    values = torch.eye(output_order**2, order**2, dtype=torch.float64) + 0.2 * noise
    layer = Neighbourhood(signal=Dense(values=values.to(dtype)))
    return Transfer(receivers=grid, layers={"neighbourhood": layer})


def box_mesh(low, high, name="box"):
    """A closed box, facing outward."""
    low, high = (torch.tensor(corner, dtype=torch.float64) for corner in (low, high))
    corners = torch.tensor([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=torch.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = torch.tensor([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])
    return make_mesh(low + corners * (high - low), faces, name=name)


def slab(albedo=0.5):
    """A flat box, .8 wide and .1 high, around the origin."""
    return Scene([Object(box_mesh((-0.4, -0.05, -0.4), (0.4, 0.05, 0.4)), Material(albedo))])


@functools.cache
def slab_around(bounces=0):
    """The slab baked on a grid that is quick to bake."""
    return bake_neighbourhood(
        slab((0.8, 0.3, 0.1)),
        order=ORDER,
        grid=(18, 14, 18),
        box=(-1.5, -1.5, -1.5, 1.5, 0.5, 1.5),
        rays=512,
        bounces=bounces,
        progress=False,
        threads=1,
    )


def posed(*, at=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), dtype=torch.float32):
    """A rigid motion `[4, 4]`."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = yaw_pitch_roll(torch.tensor(turn, dtype=torch.float64))
    pose[:3, 3] = torch.tensor(at)
    return pose.to(dtype)


def lights(*batch, order=ORDER, dtype=torch.float32, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*batch, order**2, 3, generator=generator, dtype=torch.float64).to(dtype)


def receivers(count=50, dtype=torch.float32, seed=2):
    """Places in and around the grid of `random_neighbourhood`, and unit normals."""
    generator = torch.Generator().manual_seed(seed)
    places = torch.rand(count, 3, generator=generator, dtype=torch.float64) * 4 - torch.tensor([1.7, 2.7, 2.2])
    normals = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)
    return {"positions": places.to(dtype), "normals": normals.to(dtype)}
