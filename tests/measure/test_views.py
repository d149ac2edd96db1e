"""Do pictures of equal radiance differ by nothing, and are worse ones told as worse?"""

import builtins

import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.measure.views import MOST, Views, cameras, check_flip, flip
from torchprt.transfer import Vertices

SIZE = (64, 48)
LIGHT = torch.full((9, 3), 1.0)


@pytest.fixture(scope="module")
def ball():
    mesh = trimesh.creation.icosphere(subdivisions=2)
    points = torch.tensor(mesh.vertices, dtype=torch.float32)
    return Vertices(positions=points, normals=points, faces=torch.tensor(mesh.faces, dtype=torch.int32))


@pytest.fixture(scope="module")
def radiance(ball):
    return (0.3 + 0.2 * ball.positions).clamp(min=0)


@pytest.mark.parametrize("eye", [(0.0, 0.0, 0.0), (0.0, 0.5, 0.0)])
def test_an_eye_in_the_model_is_refused(ball, eye):
    with pytest.raises(InputError, match=r"the eye at 0,0(\.5)?,0 sees nothing"):
        Views(ball, [LIGHT], torch.tensor([eye]), size=SIZE)


def test_without_flip_one_sentence_says_what_to_install(monkeypatch):
    imported = builtins.__import__

    def missing(name, *rest, **options):
        if name == "flip_evaluator":
            raise ImportError(name)
        return imported(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(InputError, match=r"install torchprt\[tradeoff\]"):
        check_flip()


def test_pictures_that_are_equal_differ_by_nothing(ball, radiance):
    views = Views(ball, [LIGHT], size=SIZE)
    pictures = views.pictures([radiance[None]])
    assert views.compare(pictures, pictures) == (MOST, 0.0)


def test_a_larger_error_is_more_flip_and_less_psnr(ball, radiance):
    views = Views(ball, [LIGHT], size=SIZE)
    wanted = views.pictures([radiance[None]])
    found = [views.compare(views.pictures([(radiance * (1 + part))[None]]), wanted) for part in (0.01, 0.05, 0.5)]
    assert found[0][0] > found[1][0] > found[2][0]
    assert 0 < found[0][1] < found[1][1] < found[2][1] < 1


def test_the_worst_of_lights_and_eyes_counts(ball, radiance):
    eyes = torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, -3.0]])
    views = Views(ball, [LIGHT, 2 * LIGHT], eyes, size=SIZE)
    wanted = [radiance.expand(2, -1, -1), 2 * radiance.expand(2, -1, -1)]
    # Half of the ball is wrong, which the first eye does not see, under the second light.
    wrong = torch.where(ball.positions[:, 2:] < -0.3, 1.5 * wanted[1][1], wanted[1][1])
    found = [wanted[0], torch.stack([wrong, wrong])]
    both = views.compare(views.pictures(found), views.pictures(wanted))
    alone = Views(ball, [2 * LIGHT], eyes[1:], size=SIZE)
    assert both == alone.compare(alone.pictures([wrong[None]]), alone.pictures([wanted[1][1:]]))
    first = Views(ball, [LIGHT, 2 * LIGHT], eyes[:1], size=SIZE)
    assert first.compare(first.pictures(found), first.pictures(wanted)) == (MOST, 0.0)


def test_what_looks_the_same_from_everywhere_is_seen_from_every_eye(ball, radiance):
    eyes = torch.tensor([[0.0, 0.0, 3.0], [0.0, 3.0, 0.5]])
    views = Views(ball, [LIGHT], eyes, size=SIZE)
    (pictures,) = views.pictures([radiance[None]])
    assert len(pictures) == 2
    assert not torch.equal(pictures[0], pictures[1])


def test_cameras_stand_at_the_eyes_and_look_at_the_model(ball):
    eyes = torch.tensor([[0.0, 0.0, 3.0], [1.0, 2.0, 0.5]])
    found = cameras(ball, eyes)
    assert torch.allclose(torch.tensor([camera.eye for camera in found]), eyes, atol=1e-6)
    assert all(torch.tensor(camera.target).norm() < 1e-6 for camera in found)
    assert torch.allclose(Views(ball, [LIGHT], eyes, size=SIZE).eyes.float(), eyes, atol=1e-6)


def test_flip_is_that_of_black_and_white():
    black, white = torch.zeros(32, 32, 3), torch.ones(32, 32, 3)
    # The largest difference that there is; close to it between these two (figure 2 of the paper's supplement).
    assert 0.9 < float(flip(white, black).mean()) <= 1
    assert float(flip(black, black).max()) == 0
