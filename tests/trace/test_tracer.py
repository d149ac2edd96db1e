"""Do rays hit what they should, and never the surface that they start on?"""

import math

import pytest
import torch
from shapes import square

from torchprt.errors import InputError
from torchprt.trace import Tracer
from torchprt.transport import frames, hemisphere

SIDE = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 0, -1]], dtype=torch.float64)


def test_refuses_a_scene_without_triangles():
    with pytest.raises(InputError, match="no triangles"):
        Tracer(SIDE, torch.zeros(0, 3, dtype=torch.int64))


def test_refuses_a_scene_without_extent():
    with pytest.raises(InputError, match="no extent"):
        Tracer(torch.zeros(3, 3, dtype=torch.float64), torch.tensor([[0, 1, 2]]))


def rotations(count):
    matrices, _ = torch.linalg.qr(
        torch.randn(count, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    )
    return matrices * torch.linalg.det(matrices).sign()[:, None, None]


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_a_flat_surface_never_shadows_itself(scale, shift):
    """Whatever its attitude, size and place: every ray of the hemisphere escapes, the grazing ones too."""
    mesh = square(resolution=25)
    directions = hemisphere(1000).float()
    for turn in rotations(6):
        positions = (mesh.positions @ turn.T + shift) * scale
        normal = turn[:, 1].expand(len(positions), 3)
        tracer = Tracer(positions, mesh.faces)
        size = torch.full((len(positions),), scale / 24)
        answers = tracer.visibility(tracer.origins(positions, normal, size), frames(normal).float(), directions)
        assert (answers == 1).all()


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4])
def test_contact_shadows_are_not_lost_in_the_offset(gap):
    """A lid a ten-thousandth of the scene above the floor leaves nothing of the sky."""
    floor, lid = square(resolution=3), square(resolution=3, height=gap)
    tracer = Tracer(torch.cat([floor.positions, lid.positions]), torch.cat([floor.faces, lid.faces + 9]))
    centre, up = floor.positions[4:5], torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64)
    directions = hemisphere(4000)
    directions = directions[directions[:, 2] > 3 * gap]
    answers = tracer.visibility(tracer.origins(centre, up, 0.5), frames(up).float(), directions.float())
    assert (answers == 0).all()


def test_no_ray_slips_between_triangles():
    """From inside a closed body nothing escapes, also through its vertices and edges."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)
    positions = torch.from_numpy(ball.vertices.copy())
    tracer = Tracer(positions, torch.from_numpy(ball.faces.copy()).long())
    middles = torch.from_numpy(ball.triangles_center.copy())
    edges = positions[torch.from_numpy(ball.edges_unique.copy())].mean(1)
    targets = torch.cat([positions, middles, edges])
    targets = targets / targets.norm(dim=-1, keepdim=True)
    origin = tracer.local(torch.zeros(1, 3, dtype=torch.float64)).float()
    identity = torch.eye(3)[None]
    assert (tracer.visibility(origin, identity, targets.float()) == 0).all()


def test_a_hit_names_triangle_place_and_side():
    tracer = Tracer(SIDE, torch.tensor([[0, 1, 2]]))
    above = tracer.origins(torch.tensor([[0.2, 0.5, -0.3], [0.2, -0.5, -0.3]], dtype=torch.float64), torch.zeros(2, 3))
    down = torch.tensor([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    hits = tracer.hits(above, torch.eye(3).expand(2, 3, 3), down)
    assert hits.triangle.tolist() == [[0, -1], [-1, 0]]
    # Corners run counter-clockwise seen from above.
    assert (bool(hits.front[0, 0]), bool(hits.front[1, 1])) == (True, False)
    for row, column in [(0, 0), (1, 1)]:
        assert float(hits.u[row, column]) == pytest.approx(0.2, abs=1e-6)
        assert float(hits.v[row, column]) == pytest.approx(0.3, abs=1e-6)


def test_visibility_and_hits_agree():
    import trimesh

    knot = trimesh.creation.torus(1.0, 0.6)
    positions, normals = torch.from_numpy(knot.vertices.copy()), torch.from_numpy(knot.vertex_normals.copy())
    tracer = Tracer(positions, torch.from_numpy(knot.faces.copy()).long())
    arguments = tracer.origins(positions, normals, 0.2), frames(normals).float(), hemisphere(200).float()
    assert torch.equal(tracer.visibility(*arguments) > 0, tracer.hits(*arguments).triangle < 0)


def test_a_camera_sees_the_square_in_front_of_it():
    mesh = square(2.0)
    tracer = Tracer(mesh.positions, mesh.faces)
    ticks = torch.linspace(-2, 2, 41, dtype=torch.float64)
    x, z = torch.meshgrid(ticks, ticks, indexing="xy")
    seen = tracer.camera(torch.tensor([0.0, 1.0, 0.0]), torch.stack([x, -torch.ones_like(x), z], -1)).triangle >= 0
    inside = (x.abs() < 0.99) & (z.abs() < 0.99)
    outside = (x.abs() > 1.01) | (z.abs() > 1.01)
    assert seen[inside].all()
    assert not seen[outside].any()


def test_scale_is_a_power_of_two_that_makes_the_scene_of_unit_size():
    for factor in (1e-6, 1.0, 3.7e5):
        tracer = Tracer(SIDE * factor, torch.tensor([[0, 1, 2]]))
        assert math.log2(tracer.scale) == round(math.log2(tracer.scale))
        assert 0.25 <= float(tracer.local(SIDE * factor).abs().max()) <= 0.5
