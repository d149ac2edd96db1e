"""Do rays in packets end where single rays end?"""

import pytest
import torch
from shapes import square

from torchprt.scene import samples
from torchprt.trace import Tracer
from torchprt.transport import frames, hemisphere
from torchprt.transport.solve import vertex_receivers

pytest.importorskip("numba", reason="packets need `pip install 'torchprt[fast]'`")
from torchprt.trace.embree import Embree, library
from torchprt.trace.packets import Packets, packet_order

SETTINGS = {16: "", 8: "isa=avx2"}


@pytest.fixture(scope="module")
def sculpture():
    geometry = samples.organic(8000).geometry()
    single, packets = (Tracer(geometry.positions, geometry.faces, engine) for engine in ("embreex", "packets"))
    return geometry, single, packets, vertex_receivers(geometry, single)[::5]


def differing(first, second):
    return int((first != second).sum())


@pytest.mark.parametrize("rays", [1, 3, 15, 16, 17, 100, 256])
def test_whatever_the_number_of_rays_they_end_where_single_rays_do(sculpture, rays):
    """But for those that meet an edge within rounding: at most one in a hundred thousand."""
    _, single, packets, receivers = sculpture
    arguments = receivers.origins, receivers.frames(), hemisphere(rays).float()
    seen, expected = packets.visibility(*arguments), single.visibility(*arguments)
    assert 0.05 < float(expected.mean()) < 1
    assert differing(seen, expected) <= seen.numel() / 1e5
    found, wanted = packets.hits(*arguments), single.hits(*arguments)
    alike = found.triangle == wanted.triangle
    assert int((~alike).sum()) <= seen.numel() / 1e5
    for name in ("u", "v"):
        # Where a ray grazes its triangle, rounding of its direction is as much as this in barycentrics.
        torch.testing.assert_close(getattr(found, name)[alike], getattr(wanted, name)[alike], rtol=0, atol=2e-3)
        assert float((getattr(found, name) - getattr(wanted, name))[alike].abs().mean()) < 1e-5
    assert differing(found.front[alike], wanted.front[alike]) <= seen.numel() / 1e5


def test_rays_from_samples_start_where_they_should(sculpture):
    """Every third ray of a receiver has the same origin."""
    _, single, packets, receivers = sculpture
    shift = 0.01 * torch.randn(len(receivers), 3, 3, generator=torch.Generator().manual_seed(0))
    arguments = receivers.origins[:, None] + shift, receivers.frames(), hemisphere(100).float()
    assert differing(packets.visibility(*arguments), single.visibility(*arguments)) <= 2
    assert differing(packets.hits(*arguments).triangle, single.hits(*arguments).triangle) <= 2
    lifted = receivers.origins, *arguments[1:]
    assert differing(packets.visibility(*arguments), packets.visibility(*lifted)) > 100


@pytest.mark.parametrize("lanes", SETTINGS)
def test_packets_of_any_width_answer_alike(sculpture, lanes):
    """As on processors that have less than this one."""
    geometry, single, _, receivers = sculpture
    widest = library()
    if lanes > widest.lanes:
        pytest.skip(f"this processor has packets of {widest.lanes} rays")
    embree = Embree(widest.path, SETTINGS[lanes])
    assert embree.lanes == lanes
    vertices = single.local(geometry.positions).float().numpy()
    engine = Packets(vertices, geometry.faces.int().numpy(), embree)
    arguments = receivers.origins, receivers.frames(), hemisphere(100).float()
    assert differing(engine.visibility(*arguments), single.visibility(*arguments)) <= 2
    assert differing(engine.hits(*arguments).triangle, single.hits(*arguments).triangle) <= 2


def test_answers_do_not_depend_on_who_else_is_asked(sculpture):
    _, _, packets, receivers = sculpture
    turned, directions = receivers.frames(), hemisphere(200).float()
    whole = packets.visibility(receivers.origins, turned, directions)
    hits = packets.hits(receivers.origins, turned, directions)
    for rows in (slice(7, 8), slice(100, 177)):
        some = receivers.origins[rows], turned[rows], directions
        assert torch.equal(packets.visibility(*some), whole[rows])
        assert torch.equal(packets.hits(*some).u, hits.u[rows])


def test_a_ray_at_an_edge_meets_one_of_its_triangles():
    """Straight down on the diagonal of a square, and on its corner: which triangle is up to the engine."""
    mesh = square(resolution=2)
    tracer = Tracer(mesh.positions, mesh.faces, "packets")
    above = mesh.positions.mean(0, keepdim=True) + torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64)
    origin = tracer.local(above).float().repeat(20, 1)
    found = tracer.hits(origin, torch.eye(3).expand(20, 3, 3), torch.tensor([[0.0, -1.0, 0.0]]))
    assert (found.triangle >= 0).all()
    assert len(found.triangle.unique()) == 1


@pytest.mark.parametrize("rays", [1, 40])
def test_nobody_asks(sculpture, rays):
    _, _, packets, _ = sculpture
    nothing = torch.zeros(0, 3), torch.zeros(0, 3, 3), hemisphere(rays).float()
    assert packets.visibility(*nothing).shape == (0, rays)
    assert packets.hits(*nothing).triangle.shape == (0, rays)


@pytest.mark.parametrize(("count", "lanes"), [(1, 16), (16, 16), (17, 16), (100, 8), (1024, 16)])
def test_packets_hold_every_direction_once_and_near_ones_together(count, lanes):
    directions = hemisphere(count)
    order = packet_order(directions.numpy(), lanes)
    assert len(order) == -(-count // lanes) * lanes
    assert sorted(order[:count]) == list(range(count))
    assert (order[count:] == order[count - 1]).all()
    if count == 1024:
        groups = directions[order.tolist()].view(-1, lanes, 3)
        radius = (groups - groups.mean(1, keepdim=True)).norm(dim=-1).amax(1)
        # A disc of a 64th of the hemisphere has the radius .18.
        assert float(radius.median()) < 0.22
        assert float(radius.max()) < 0.4


def test_frames_turn_packets_as_they_turn_rays():
    """A receiver that looks down sees what one that looks up does not."""
    mesh = square(resolution=3)
    tracer = Tracer(mesh.positions, mesh.faces, "packets")
    up = torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64)
    turned = frames(torch.cat([up, -up])).float()
    middle = torch.tensor([[0.0, 0.1, 0.0]], dtype=torch.float64)
    origins = tracer.local(middle).float().expand(2, 3).contiguous()
    seen = tracer.visibility(origins, turned, hemisphere(64).float())
    assert bool(seen[0].all())
    assert float(seen[1].mean()) < 0.2
