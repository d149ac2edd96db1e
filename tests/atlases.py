"""Atlases by hand: the texels of a cube with a chart a side, and gutters of what is nearest in the same chart."""

import torch

from torchprt.transfer import Atlas, Dense, Diffuse, Transfer

# Normal, and where u and v go on each side: u x v points inward, as v goes down on the map.
SIDES = [
    ((1, 0, 0), (0, 0, -1), (0, -1, 0)),
    ((-1, 0, 0), (0, 0, 1), (0, -1, 0)),
    ((0, 1, 0), (1, 0, 0), (0, 0, 1)),
    ((0, -1, 0), (1, 0, 0), (0, 0, -1)),
    ((0, 0, 1), (1, 0, 0), (0, -1, 0)),
    ((0, 0, -1), (-1, 0, 0), (0, -1, 0)),
]


def cube(texels=6, gutter=2, size=None):
    """A cube from -1 to 1: six charts of `texels` x `texels` in two rows of three; `size`: rows, columns."""
    cell = texels + 2 * gutter
    rows, columns = size or (2 * cell, 3 * cell)
    positions, normals, texel, chart, gutters, sources = [], [], [], [], [], []
    corners, faces, uv = [], [], []
    for number, (n, u, v) in enumerate(torch.tensor(SIDES, dtype=torch.float32)):
        top, left = gutter + cell * (number // 3), gutter + cell * (number % 3)
        y, x = torch.meshgrid(
            torch.arange(-gutter, texels + gutter), torch.arange(-gutter, texels + gutter), indexing="ij"
        )
        inside = ((x >= 0) & (x < texels) & (y >= 0) & (y < texels)).flatten()
        x, y = x.flatten(), y.flatten()
        at = (top + y) * columns + left + x
        s, t = (2 * (x[inside] + 0.5) / texels - 1), (2 * (y[inside] + 0.5) / texels - 1)
        positions.append(n + s[:, None] * u + t[:, None] * v)
        normals.append(n.expand(len(s), 3))
        texel.append(at[inside])
        chart.append(torch.full((len(s),), number))
        gutters.append(at[~inside])
        nearest = (top + y.clamp(0, texels - 1)) * columns + left + x.clamp(0, texels - 1)
        sources.append(nearest[~inside])
        corners.append(torch.stack([n - u - v, n + u - v, n + u + v, n - u + v]))
        # Counter-clockwise from outside: u x v goes in.
        faces.append(torch.tensor([[0, 2, 1], [0, 3, 2]]) + 4 * number)
        ends = torch.tensor([[left, top], [left + texels, top], [left + texels, top + texels], [left, top + texels]])
        uv.append((ends / torch.tensor([columns, rows]))[torch.tensor([[0, 2, 1], [0, 3, 2]])])
    texel, order = torch.cat(texel).sort()
    gutters, ascending = torch.cat(gutters).sort()
    source = torch.searchsorted(texel, torch.cat(sources)[ascending])
    weights = torch.zeros(len(gutters), 4)
    weights[:, 0] = 1
    normals = torch.cat(normals)[order]
    return Atlas(
        rows=rows,
        columns=columns,
        positions=torch.cat(positions)[order],
        normals=normals,
        texel=texel.int(),
        chart=torch.cat(chart)[order].int(),
        mesh_positions=torch.cat(corners),
        mesh_normals=torch.tensor(SIDES)[:, 0].float().repeat_interleave(4, 0),
        mesh_faces=torch.cat(faces).int(),
        mesh_uv=torch.cat(uv),
        gutter=gutters.int(),
        gutter_sources=source[:, None].expand(-1, 4).contiguous().int(),
        gutter_weights=weights,
        objects=[{"name": "cube.ply", "role": "receiver", "vertices": [0, 24], "faces": [0, 12], "charts": [0, 6]}],
    )


def lit_cube(order=3, channels=1, texels=6, gutter=2):
    """Transfer of the cube, unshadowed, whose albedo differs from side to side."""
    from torchprt.transport.diffuse import unshadowed

    place = cube(texels, gutter)
    vectors = unshadowed(place.normals.double(), order).float()[None].expand(channels, -1, -1).contiguous()
    albedo = torch.tensor(
        [[0.8, 0.2, 0.1], [0.5, 0.5, 0.5], [0.9, 0.9, 0.9], [0.1, 0.3, 0.2], [0.2, 0.4, 0.8], [0.7] * 3]
    )
    layer = Diffuse(albedo=albedo[place.chart.long()], signal=Dense(values=vectors))
    return Transfer(receivers=place, layers={"diffuse": layer}, transport="unshadowed")
