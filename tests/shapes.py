"""Small shapes whose light is known."""

import math

import torch

from torchprt.scene import make_mesh


def grid(columns, rows):
    """Faces of a grid of `columns x rows` vertices, counter-clockwise with columns to the right and rows up."""
    index = torch.arange(columns * rows).view(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return torch.cat([torch.stack([a, b, c], -1).view(-1, 3), torch.stack([a, c, d], -1).view(-1, 3)])


def square(size=1.0, resolution=5, height=0.0, up=True):
    """A level square of side `size` around the y axis, facing up or down."""
    ticks = torch.linspace(-size / 2, size / 2, resolution, dtype=torch.float64)
    x, z = torch.meshgrid(ticks, ticks, indexing="xy")
    positions = torch.stack([x, torch.full_like(x, height), -z], -1).view(-1, 3)
    faces = grid(resolution, resolution)
    return make_mesh(positions, faces if up else faces.flip(1), name="square")


def disc(radius, height, segments=256):
    """A level disc of equal area to a circle of `radius`, facing down."""
    angle = torch.arange(segments, dtype=torch.float64) * (2 * math.pi / segments)
    step = 2 * math.pi / segments
    circumradius = radius * math.sqrt(step / math.sin(step))
    rim = torch.stack([angle.cos() * circumradius, torch.full_like(angle, height), angle.sin() * circumradius], -1)
    positions = torch.cat([torch.tensor([[0.0, height, 0.0]], dtype=torch.float64), rim])
    around = torch.arange(segments)
    faces = torch.stack([torch.zeros_like(around), around + 1, (around + 1) % segments + 1], -1)
    return make_mesh(positions, faces, name="disc")


def bowl(opening, rings=32, segments=64):
    """The inside of a unit sphere without the cap within `opening` (radians) of +y, and the area of the cap over that
    of the sphere. Each point of it sees equal areas equally, so its light has a closed form."""
    theta = torch.linspace(opening, math.pi, rings, dtype=torch.float64)
    phi = torch.arange(segments + 1, dtype=torch.float64) * (2 * math.pi / segments)
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    positions = torch.stack([theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()], -1).view(-1, 3)
    mesh = make_mesh(positions, grid(segments + 1, rings).flip(1), normals=-positions, name="bowl")
    return mesh, (1 - math.cos(opening)) / 2
