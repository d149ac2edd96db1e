"""Are a few receivers of a scene the same receivers?"""

import pytest
import torch
from shapes import square
from transfers import KINDS, gloss, random_glossy, replaced, stored

from torchprt.errors import InputError
from torchprt.measure import sample_receivers, sample_transfer
from torchprt.scene import Material, Object, Scene, load, make_mesh, samples
from torchprt.shade import shader
from torchprt.transport import OrderWarning, bake

pytestmark = pytest.mark.filterwarnings("ignore::torchprt.transport.OrderWarning")


def shiny(gloss="phong:10", **options):
    return Material(albedo=0.0, gloss=gloss, **options)


def quiet(scene, **options):
    return bake(scene, order=3, rays=128, progress=False, **options)


@pytest.mark.parametrize("count", [0, -1, 10])
def test_refuses_a_count_that_there_is_not(count):
    with pytest.raises(InputError, match=f"count is {count}: the scene has 9"):
        sample_receivers(load(square(resolution=3), material=shiny()), count)


def test_refuses_a_scene_where_nothing_is_glossy():
    with pytest.raises(InputError, match="has 0 glossy receivers"):
        sample_receivers(load(square()), 1)


@pytest.mark.parametrize("chosen", [[4], [-1]])
def test_refuses_a_receiver_that_the_transfer_does_not_have(chosen):
    with pytest.raises(InputError, match=f"receiver {chosen[0]}: there are 4"):
        sample_transfer(random_glossy(vertices=6, glossy=4), torch.tensor(chosen))


def places(transfer, chosen):
    return transfer.positions[gloss(transfer).receivers.long()[chosen]]


@pytest.mark.parametrize("seed", [0, 1])
def test_they_have_the_matrices_that_they_have_in_the_whole_scene(seed):
    blocker = samples.plane_and_blocker(3).objects[1]
    scene = Scene([Object(square(2.0, 9), shiny()), Object(blocker.mesh, Material(0.0), "blocker")])
    few, chosen = sample_receivers(scene, 7, seed)
    assert len(chosen) == 7 == len(torch.unique(chosen))
    whole, part = quiet(scene), quiet(few)
    assert len(gloss(part).receivers) < 7 * 3 + 1
    there = (places(part, chosen)[:, None] == whole.positions).all(-1).nonzero()
    assert torch.equal(there[:, 0], torch.arange(7))
    wanted = stored(whole)[:, there[:, 1]]
    # The same rays meet the same surfaces: float32 sums of 128.
    torch.testing.assert_close(stored(part)[:, chosen], wanted, rtol=0, atol=1e-5 * float(wanted.abs().max()))
    open_sky = quiet(few, shadows=False)
    assert float((stored(part) - stored(open_sky)).abs().max()) > 0.01


def test_other_seeds_choose_others():
    scene = load(square(resolution=9), material=shiny())
    first, second = (set(map(tuple, points.tolist())) for points in (chosen_of(scene, seed) for seed in (0, 1)))
    assert first != second
    assert first == set(map(tuple, chosen_of(scene, 0).tolist()))


def chosen_of(scene, seed):
    few, chosen = sample_receivers(scene, 9, seed)
    geometry = few.geometry()
    return geometry.receiver_positions[geometry.glossy[chosen]]


def test_materials_and_reverse_sides_stay_theirs():
    sheet = square(1.0, 3, height=1.0)
    objects = [Object(square(2.0, 3), shiny("phong:5")), Object(sheet, shiny("ggx:0.5", two_sided=True))]
    few, chosen = sample_receivers(Scene(objects), 27)
    geometry = few.geometry()
    rows = geometry.glossy[chosen]
    assert [model.spec for model in geometry.gloss] == ["phong:5", "ggx:0.5"]
    high = geometry.receiver_positions[rows][:, 1] == 1
    assert torch.equal(geometry.gloss_of_glossy[chosen] == 1, high)
    assert int(high.sum()) == 18
    assert sorted(geometry.receiver_normals[rows][high][:, 1].tolist()) == [-1.0] * 9 + [1.0] * 9


def test_receivers_without_a_face_or_a_normal_are_left_out():
    mesh = square(resolution=3)
    positions = torch.cat([mesh.positions, torch.tensor([[0.0, 3.0, 0.0]])])
    scene = load(make_mesh(positions, mesh.faces), material=shiny())
    few, chosen = sample_receivers(scene, 9)
    assert len(chosen) == 9
    assert float(few.geometry().receiver_positions[few.geometry().glossy[chosen]][:, 1].max()) == 0


def test_an_anisotropic_gloss_keeps_its_tangents():
    scene = samples.dish(24)
    whole = scene.geometry()
    few, chosen = sample_receivers(scene, 40)
    part = few.geometry()
    rows = part.glossy[chosen]
    there = torch.cdist(part.receiver_positions[rows], whole.receiver_positions[whole.glossy]).argmin(1)
    same = (part.receiver_normals[rows] - whole.receiver_normals[whole.glossy][there]).abs().amax(1) < 1e-12
    assert int(same.sum()) > 30
    torch.testing.assert_close(part.tangents[chosen][same], whole.tangents[there][same], rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_part_of_a_transfer_shades_as_it_did(kind):
    transfer = random_glossy(kind, vertices=9, glossy=6, order=3, dtype=torch.float64, diffuse=False)
    chosen = torch.tensor([4, 0, 4])
    part = sample_transfer(transfer, chosen)
    light = torch.randn(9, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    options = {"exponent": 8.0} if kind == "incident" else {}
    eye = torch.tensor([3.0, 4.0, 5.0], dtype=torch.float64)
    whole = shader(replaced(transfer, specular=torch.ones(1, 1)), **options)(light, eye=eye)
    torch.testing.assert_close(shader(part, **options)(light, eye=eye), whole[gloss(transfer).receivers[chosen]])
    assert part.vertices == 3
    assert sample_transfer(transfer, chosen[:0]).vertices == 0


def test_a_coarse_order_is_still_told():
    few, _ = sample_receivers(load(square(), material=shiny("phong:200")), 2)
    with pytest.warns(OrderWarning):
        quiet(few)
