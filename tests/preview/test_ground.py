"""Does a ground fade evenly, leave the model whole, and stay out of the frame?"""

import numpy as np
import torch
import trimesh

from torchprt.preview import Still, frame
from torchprt.preview.ground import opacity, subject
from torchprt.scene import Object, Scene, make_mesh
from torchprt.transport import bake


def stood():
    ball = trimesh.creation.icosphere(2)
    scene = Scene([Object(make_mesh(np.array(ball.vertices), np.array(ball.faces)))])
    return bake(scene.on_ground(), order=2, shadows=False), len(ball.vertices)


def test_without_a_ground_nothing_fades():
    transfer, _ = stood()
    assert opacity(transfer.without_ground().receivers) is None
    assert opacity(transfer.with_ground().receivers) is None
    assert torch.equal(subject(transfer.with_ground().receivers), transfer.positions)


def test_a_ground_alone_is_all_that_there_is_to_see():
    transfer, count = stood()
    alone = transfer.receivers.take(torch.arange(count, transfer.vertices))
    assert bool(alone.ground().all())
    assert opacity(alone) is None
    assert torch.equal(subject(alone), alone.positions)


def test_it_is_whole_at_the_model_and_gone_at_its_rim_and_falls_between():
    transfer, count = stood()
    seen = opacity(transfer.receivers)
    assert torch.equal(seen[:count], torch.ones(count))
    places = transfer.positions[count:]
    away = places[:, [0, 2]].norm(dim=-1)
    order = away.argsort()
    falling = seen[count:][order]
    assert bool((falling.diff() <= 1e-6).all())
    assert torch.equal(falling[away[order] < 1.1].unique(), torch.ones(1))
    assert float(falling[-30:].max()) < 1e-6


def test_the_picture_ends_in_its_background_without_an_edge():
    transfer, _ = stood()
    camera = frame(subject(transfer.receivers), (0.0, 0.3, 1.0), aspect=200 / 120)
    still = Still(
        transfer.positions, transfer.faces, size=(200, 120), camera=camera, opacity=opacity(transfer.receivers)
    )
    column = still.radiance(torch.ones(transfer.vertices, 3), background=0.0)[:, 2, 0]
    assert float(column[0]) == 0
    assert float(column[-1]) > 0.8
    assert float(column.diff().abs().max()) < 0.08
    whole = Still(transfer.positions, transfer.faces, size=(200, 120), camera=camera)
    edge = whole.radiance(torch.ones(transfer.vertices, 3), background=0.0)[:, 2, 0]
    assert float(edge.diff().abs().max()) > 0.4
