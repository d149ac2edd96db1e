"""Is a ground left out where a model is framed, and does it fade toward its rim and nowhere else?"""

import math

import torch

from torchprt.preview import Still, frame, subject
from torchprt.preview.ground import opacity
from torchprt.scene import samples
from torchprt.transfer import Vertices
from torchprt.transport import bake

MODEL, RINGS, AROUND = 4, 12, 32


def vertices(positions, objects):
    faces = torch.zeros(0, 3, dtype=torch.int32)
    return Vertices(positions=positions, normals=torch.zeros_like(positions), faces=faces, objects=objects)


def rows(name, role, first, last):
    return {"name": name, "role": role, "side": "front", "rows": [first, last]}


def on_ground(middle=(2.0, -1.0), radius=10.0):
    """A model of four vertices, and rings of ground around another place."""
    model = torch.rand(MODEL, 3, generator=torch.Generator().manual_seed(0))
    around = torch.arange(AROUND) / AROUND * 2 * math.pi
    far = torch.linspace(0, radius, RINGS)[:, None]
    x, z = middle[0] + far * around.cos(), middle[1] + far * around.sin()
    positions = torch.cat([model, torch.stack([x, torch.zeros_like(x), z], -1).reshape(-1, 3)])
    count = len(positions)
    return vertices(positions, [rows("model", "receiver", 0, MODEL), rows("ground", "ground", MODEL, count)])


def test_without_ground_all_is_subject_and_opaque():
    plain = vertices(torch.rand(5, 3), [])
    assert torch.equal(subject(plain), plain.positions)
    assert opacity(plain) is None


def test_a_bare_ground_is_framed_itself_and_opaque():
    bare = vertices(torch.rand(5, 3), [rows("ground", "ground", 0, 5)])
    assert torch.equal(subject(bare), bare.positions)
    assert opacity(bare) is None


def test_the_camera_holds_the_model_and_not_the_ground():
    receivers = on_ground()
    assert frame(subject(receivers)) == frame(receivers.positions[:MODEL])
    assert frame(subject(receivers)) != frame(receivers.positions)


def test_the_ground_fades_from_its_middle_to_its_rim_and_the_model_does_not():
    opaque = opacity(on_ground())
    assert (opaque[:MODEL] == 1).all()
    by_ring = opaque[MODEL:].view(RINGS, AROUND)
    # As round as a circle of 32 corners is.
    assert (by_ring.amax(1) - by_ring.amin(1)).max() < 1e-4
    assert (by_ring[0] == 1).all()
    assert (by_ring[-1] < 1e-5).all()
    assert (by_ring[:, 0].diff() <= 1e-6).all()
    assert ((by_ring > 0.1) & (by_ring < 0.9)).any()


def test_a_ground_of_one_point_is_no_fault():
    one = vertices(torch.zeros(2, 3), [rows("model", "receiver", 0, 1), rows("ground", "ground", 1, 2)])
    assert torch.equal(opacity(one), torch.ones(2))


def test_the_picture_ends_in_its_background_without_an_edge():
    transfer = bake(samples.still_life(16), order=2, shadows=False)
    camera = frame(subject(transfer.receivers), (0.0, 0.3, 1.0), aspect=200 / 120)
    shape = {"size": (200, 120), "camera": camera}
    white = torch.ones(transfer.vertices, 3)
    fading = Still(transfer.positions, transfer.faces, opacity=opacity(transfer.receivers), **shape)
    # Beside the model, from the sky down.
    column = fading.radiance(white, background=0.0)[:, 2, 0]
    assert float(column[0]) == 0
    assert float(column[-1]) > 0.8
    assert float(column.diff().abs().max()) < 0.08
    plain = transfer.with_ground()
    assert opacity(plain.receivers) is None
    edge = Still(plain.positions, plain.faces, **shape).radiance(white, background=0.0)[:, 2, 0]
    assert float(edge.diff().abs().max()) > 0.4
