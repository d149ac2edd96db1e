"""Is a picture of a volume what emission and absorption along each ray say?"""

import math

import pytest
import torch
from volumes import ball, by_hand, cells_of, puff, random_cells, random_volume, seeing_all

from torchprt.errors import InputError
from torchprt.preview import Camera
from torchprt.shade import Composite, VolumeShader, pinhole

WIDE = torch.float64
ALL = ("exact", "trilinear", "nearest")


def rays(count, seed=0, dtype=WIDE, reach=1.5):
    """From around the random cells through them, some from inside."""
    generator = torch.Generator().manual_seed(seed)
    middle = torch.tensor([0.05, 1.1, 2.0])
    from_, toward = torch.randn(2, count, 3, generator=generator)
    origins = middle + reach * from_
    return origins.to(dtype), (middle + 0.4 * toward - origins).to(dtype)


def source(cells, *batch, seed=3, dtype=WIDE):
    return torch.rand(*batch, cells.count, 3, generator=torch.Generator().manual_seed(seed), dtype=WIDE).to(dtype)


# Misuse


@pytest.mark.usefixtures("untyped")
def test_refuses_what_is_no_volume_no_rays_and_no_way_of_reading():
    cells = random_cells()
    with pytest.raises(InputError, match="'cubic'"):
        Composite(cells, reading="cubic")
    with pytest.raises(InputError, match="none with 'exact'"):
        Composite(cells, samples=4)
    with pytest.raises(InputError, match="1 or more"):
        Composite(cells, reading="nearest", samples=0)
    with pytest.raises(InputError, match="'albedo'"):
        Composite(cells, learn=["albedo"])
    composite, (start, toward) = Composite(cells, dtype=WIDE), rays(3)
    with pytest.raises(InputError, match=f"has {cells.count} cells"):
        composite(torch.zeros(2, 3), start, toward)
    with pytest.raises(InputError, match="zero vector"):
        composite(source(cells), start, 0 * toward)
    with pytest.raises(InputError, match="NaN or infinity"):
        composite(source(cells), start / 0, toward)
    with pytest.raises(InputError, match="far holds NaN"):
        composite(source(cells), start, toward, torch.full((3,), torch.nan))
    transfer = random_volume()
    with pytest.raises(InputError, match="at the target"):
        VolumeShader(transfer, target=(1.0, 2.0, 3.0))(torch.zeros(16, 3), eye=torch.tensor([1.0, 2.0, 3.0]))
    with pytest.raises(InputError, match="no pixels"):
        VolumeShader(transfer, size=(0, 3))


@pytest.mark.parametrize("reading", ALL)
def test_no_rays_and_no_lights_are_no_fault(reading):
    cells = random_cells()
    composite, (start, toward) = Composite(cells, reading=reading, dtype=WIDE), rays(5)
    seen, through = composite(source(cells, 0), start, toward)
    assert seen.shape == (0, 5, 3)
    assert through.shape == (0, 5)
    seen, through = composite(source(cells, 2), start[:0], toward[:0])
    assert seen.shape == (2, 0, 3)


# What it is


def test_agrees_with_a_ray_that_goes_from_cell_to_cell():
    cells = random_cells()
    glow, (start, toward) = source(cells), rays(60)
    # Along an axis, along a plane between cells, and past the volume.
    straight = torch.tensor([[0.3, 1.0, -3.0], [-0.2, 0.9, -3.0], [9.0, 9.0, 9.0]], dtype=WIDE)
    start = torch.cat([start, straight])
    toward = torch.cat([toward, torch.tensor([[0.0, 0, 2], [0, 0, 1e-30], [1, 0, 0]], dtype=WIDE)])
    seen, through = Composite(cells, dtype=WIDE)(glow, start, toward)
    for ray in range(len(start)):
        wanted, left = by_hand(cells, glow, start[ray], toward[ray])
        torch.testing.assert_close(seen[ray], wanted, rtol=1e-6, atol=1e-6)
        assert float(through[ray]) == pytest.approx(left, rel=1e-6)
    assert float(through[-1]) == 1
    assert bool((through[:-2] < 1).any())


@pytest.mark.parametrize("reading", ALL)
def test_a_uniform_box_is_one_less_e_to_the_depth(reading):
    cells = cells_of(torch.full((4, 5, 6), 0.8))
    start, toward = torch.tensor([[2.0, 2.5, -3.0], [2.0, -9.0, 3.0]]), torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.3, 0.0]])
    composite = Composite(cells, reading=reading, samples=None if reading == "exact" else 400)
    seen, through = composite(torch.full((cells.count, 3), 2.5), start, toward)
    wanted = torch.exp(-0.8 * torch.tensor([6.0, 5.0]))
    torch.testing.assert_close(through, wanted, rtol=1e-4, atol=0)
    torch.testing.assert_close(seen, 2.5 * (1 - wanted)[:, None].expand(2, 3), rtol=1e-4, atol=0)


def test_a_ball_comes_to_the_chords_of_a_sphere():
    cells = ball(40, extinction=1.5)
    start = torch.zeros(300, 3)
    start[:, 0], start[:, 1], start[:, 2] = torch.linspace(0.01, 0.8, 300), 0.01, -3
    seen, through = Composite(cells)(torch.ones(cells.count, 3), start, torch.tensor([[0.0, 0.0, 1.0]]))
    chord = 2 * torch.sqrt(1 - start[:, 0] ** 2 - start[:, 1] ** 2)
    # Stairs of a cell at either end.
    assert (through.log() / -1.5 - chord).abs().max() <= 2 * 0.05 * 1.5
    assert abs(float((through.log() / -1.5 - chord).mean())) <= 0.02
    torch.testing.assert_close(seen[:, 0], 1 - through, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("reading", ALL)
def test_what_is_in_front_hides_what_is_behind(reading):
    cells = cells_of(torch.tensor([0.0, 50.0, 0.0, 50.0, 0.0]).view(1, 1, 5))
    glow = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    # Trilinear steps through the faint rim of the other.
    composite = Composite(cells, reading=reading, samples=None if reading == "exact" else 200)
    start = torch.tensor([[0.5, 0.5, -4.0], [0.5, 0.5, 9.0]])
    seen, through = composite(glow, start, torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    torch.testing.assert_close(seen, glow, rtol=0, atol=1e-4)
    assert bool((through < 1e-6).all())


@pytest.mark.parametrize("reading", ALL)
@pytest.mark.parametrize("batch", [(), (2,)])
def test_rays_through_its_box_that_meet_nothing_see_the_background(reading, batch):
    extinction = torch.zeros(8, 8, 8)
    extinction[0, 0, 0] = extinction[7, 7, 7] = 1.0
    composite = Composite(cells_of(extinction), reading=reading)
    start = torch.tensor([0.5, 7.5, -1.0]).expand(*batch, 1, 3)
    seen, through = composite(torch.ones(*batch, 2, 3), start, torch.tensor([[0.0, 0.0, 1.0]]))
    assert float(seen.abs().max()) == 0
    assert bool((through == 1).all())


@pytest.mark.parametrize("reading", ALL)
def test_beside_the_volume_and_before_a_near_surface_there_is_only_background(reading):
    cells = random_cells()
    composite, (start, toward) = Composite(cells, reading=reading, dtype=WIDE), rays(20, reach=3.0)
    far = start + 100 * torch.nn.functional.normalize(start - torch.tensor([0.05, 1.1, 2.0]), dim=-1)
    for ends, place in ((None, far), (torch.full((20,), 1e-9, dtype=WIDE), far), (torch.zeros(20, dtype=WIDE), start)):
        seen, through = composite(source(cells), place, toward if ends is not None else place - start, ends)
        assert float(seen.abs().max()) == 0
        assert bool((through == 1).all())


def test_a_ray_that_is_cut_in_two_composes():
    cells = random_cells()
    composite, (start, toward) = Composite(cells, dtype=WIDE), rays(50)
    cut = torch.rand(50, generator=torch.Generator().manual_seed(1), dtype=WIDE) * 2.5
    whole, through = composite(source(cells), start, toward)
    before, first = composite(source(cells), start, toward, cut)
    unit = torch.nn.functional.normalize(toward, dim=-1)
    behind, second = composite(source(cells), start + cut[:, None] * unit, toward)
    torch.testing.assert_close(before + first[:, None] * behind, whole, rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(first * second, through, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("reading", ["trilinear", "nearest"])
def test_steps_converge(reading):
    """Nearest to the cells themselves; between cells to steps ten times as many."""
    cells = random_cells((5, 6, 4))
    glow, (start, toward) = source(cells), rays(80)
    if reading == "nearest":
        wanted = Composite(cells, dtype=WIDE)(glow, start, toward)
    else:
        wanted = Composite(cells, reading=reading, samples=4000, dtype=WIDE)(glow, start, toward)
    errors = []
    for samples in (20, 80, 320):
        found = Composite(cells, reading=reading, samples=samples, dtype=WIDE)(glow, start, toward)
        errors.append(max(float((a - b).square().mean().sqrt()) for a, b in zip(found, wanted, strict=True)))
    assert errors[1] < errors[0] / 2
    assert errors[2] < errors[1] / 2
    assert errors[2] < 2e-3


@pytest.mark.parametrize("reading", ALL)
def test_batches_broadcast_as_single_calls(reading):
    cells = random_cells()
    composite, (start, toward) = Composite(cells, reading=reading, dtype=WIDE), rays(6)
    glow = source(cells, 3)
    many = composite(glow, start, toward)
    each = composite(glow, torch.stack([start] * 3), toward)
    both = composite(glow[:, None], torch.stack([start, start + 0.1]), toward)
    assert both[0].shape == (3, 2, 6, 3)
    for number in range(3):
        alone = composite(glow[number], start, toward)
        other = composite(glow[number], start + 0.1, toward)
        for part in range(2):
            torch.testing.assert_close(many[part][number], alone[part])
            torch.testing.assert_close(each[part][number], alone[part])
            torch.testing.assert_close(both[part][number], torch.stack([alone[part], other[part]]))


@pytest.mark.parametrize("reading", ALL)
def test_gradients_flow_to_all(reading):
    cells = random_cells((2, 2, 2))
    composite = Composite(cells, reading=reading, samples=None if reading == "exact" else 6, dtype=WIDE)
    start, toward = rays(4, seed=5)

    def seen(glow, extinction, start, toward, far):
        # Of a parameter in the place of the buffer.
        return torch.func.functional_call(composite, {"extinction": extinction}, (glow, start, toward, far))

    given = (source(cells), composite.extinction.clone(), start, toward, torch.tensor([1.0, 2.0, 9.0, 0.3]).double())
    assert torch.autograd.gradcheck(seen, [each.requires_grad_() for each in given])


@pytest.mark.parametrize("reading", ALL)
def test_single_precision_is_enough_also_from_far_away(reading):
    cells = random_cells()
    composite, wide = (Composite(cells, reading=reading, dtype=dtype) for dtype in (torch.float32, WIDE))
    start, toward = rays(40)
    away = start - 3e4 * torch.nn.functional.normalize(toward, dim=-1)
    for place in (start, away):
        wanted = wide(source(cells), place, toward)
        found = composite(source(cells).float(), place, toward)
        assert found[0].dtype == torch.float32
        for one, other in zip(found, wanted, strict=True):
            torch.testing.assert_close(one.double(), other, rtol=1e-4, atol=2e-5)


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize("reading", ALL)
def test_compiles(reading):
    cells = random_cells()
    composite, (start, toward) = Composite(cells, reading=reading), rays(7, dtype=torch.float32)
    glow = source(cells, dtype=torch.float32)
    made = torch.compile(composite, backend="aot_eager", fullgraph=True)
    for one, other in zip(made(glow, start, toward), composite(glow, start, toward), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)


# A camera


@pytest.mark.parametrize("eye", [(3.0, 2.0, -4.0), (-1.0, 0.3, 0.2)])
def test_rays_are_those_of_the_camera_of_pictures(eye):
    target = (0.2, -0.3, 0.1)
    wanted = Camera(eye, target, field=50.0).directions(7, 5)
    found = pinhole(torch.tensor(eye).double(), torch.tensor(target).double(), (7, 5), 50.0)
    torch.testing.assert_close(found, wanted, rtol=1e-6, atol=1e-7)


def test_looks_straight_down_with_north_up():
    found = pinhole(torch.tensor([0.0, 5.0, 0.0]), torch.zeros(3), (3, 3))
    assert float(found[0, 1, 2]) < 0 < float(found[1, 2, 0])
    assert bool(pinhole(torch.zeros(3), torch.zeros(3), (3, 3)).isfinite().all())


def test_a_volume_that_all_light_reaches_is_as_bright_as_the_light():
    cells = puff(12)
    light = torch.zeros(2, 9, 3)
    light[0, 0], light[1, 0] = math.sqrt(4 * math.pi), 2 * math.sqrt(4 * math.pi)
    shade = VolumeShader(seeing_all(cells), size=(24, 16))
    image = shade(light, eye=torch.tensor([0.0, 1.0, 4.0]))
    assert image.shape == (2, 16, 24, 4)
    torch.testing.assert_close(image[0, ..., :3], image[0, ..., 3:].expand(-1, -1, 3), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(image[1, ..., :3], 2 * image[0, ..., :3])
    assert 0.05 < float(image[0, ..., 3].mean()) < 0.9
    assert float(image[0, 0, 0].abs().max()) == 0


def test_shades_each_eye_for_its_own_picture():
    transfer = random_volume("phase")
    shade = VolumeShader(transfer, size=(6, 4), reading="trilinear")
    eyes, light = torch.tensor([[0.0, 1.0, 9.0], [5.0, 1.0, 0.0]]), torch.randn(16, 3)
    both = shade(light, eye=eyes)
    for number in range(2):
        torch.testing.assert_close(both[number], shade(light, eye=eyes[number]), rtol=1e-4, atol=1e-5)
    assert (both[0] - both[1]).abs().max() > 0.01


def test_learns_extinction_from_a_picture():
    cells = ball(6, extinction=1.0)
    light, eye = torch.zeros(9, 3), torch.tensor([0.0, 0.0, 4.0])
    light[0] = math.sqrt(4 * math.pi)
    wanted = VolumeShader(seeing_all(ball(6, extinction=2.0)), size=(8, 8))(light, eye=eye)
    shade = VolumeShader(seeing_all(cells), size=(8, 8), learn=["extinction"])
    optimiser = torch.optim.Adam(shade.parameters(), 0.1)
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        loss = (shade(light, eye=eye) - wanted).square().mean()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0] / 100
