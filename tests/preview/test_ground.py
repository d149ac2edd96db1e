"""Is a ground left out where a model is framed, and does it fade toward its rim and nowhere else?"""

import math
from types import SimpleNamespace

import torch

from torchprt.preview import frame, subject
from torchprt.preview.ground import opacity


def set_of(rings=8, radius=10.0, middle=(2.0, -1.0)):
    """A model of four vertices, and rings of ground around another place."""
    model = torch.rand(4, 3, generator=torch.Generator().manual_seed(0))
    around = torch.arange(32) / 32 * 2 * math.pi
    far = torch.linspace(0, radius, rings)[:, None]
    x, z = middle[0] + far * around.cos(), middle[1] + far * around.sin()
    disc = torch.stack([x, torch.zeros_like(x), z], -1).reshape(-1, 3)
    ground = torch.cat([torch.zeros(4), torch.ones(len(disc))]).bool()
    return SimpleNamespace(positions=torch.cat([model, disc]), ground=ground), rings


def test_without_ground_all_is_subject_and_opaque():
    for receivers in (
        SimpleNamespace(positions=torch.rand(5, 3)),
        SimpleNamespace(positions=torch.rand(5, 3), ground=None),
        SimpleNamespace(positions=torch.rand(5, 3), ground=torch.zeros(5, dtype=torch.bool)),
    ):
        assert torch.equal(subject(receivers), receivers.positions)
        assert opacity(receivers) is None


def test_a_bare_ground_is_framed_itself():
    receivers = SimpleNamespace(positions=torch.rand(5, 3), ground=torch.ones(5, dtype=torch.bool))
    assert torch.equal(subject(receivers), receivers.positions)


def test_the_camera_holds_the_model_and_not_the_ground():
    receivers, _ = set_of()
    assert frame(subject(receivers)) == frame(receivers.positions[:4])
    assert frame(subject(receivers)) != frame(receivers.positions)


def test_the_ground_fades_from_its_middle_to_its_rim_and_the_model_does_not():
    receivers, rings = set_of()
    opaque = opacity(receivers)
    assert (opaque[:4] == 1).all()
    by_ring = opaque[4:].view(rings, 32)
    assert (by_ring.amax(1) - by_ring.amin(1)).max() < 1e-4
    assert (by_ring[0] == 1).all()
    assert (by_ring[-1] < 1e-5).all()
    assert (by_ring[:, 0].diff() <= 1e-6).all()
    assert ((by_ring > 0.1) & (by_ring < 0.9)).any()


def test_a_ground_of_one_point_is_no_fault():
    receivers = SimpleNamespace(positions=torch.zeros(2, 3), ground=torch.tensor([False, True]))
    assert torch.equal(opacity(receivers), torch.ones(2))
