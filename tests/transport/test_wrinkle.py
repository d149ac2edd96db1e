"""Is the transfer of a groove what rays find, and does one bilinear map of lobes hold it?"""

import math

import numpy as np
import pytest
import torch
from transfers import gloss, stored

from torchprt import sh
from torchprt.compression import fit_bilinear
from torchprt.compression.bilinear import interpolation, reconstruct
from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, height_field, tiled
from torchprt.shade import sample
from torchprt.transport import bake, groove_transfer, wrinkle
from torchprt.transport.diffuse import unshadowed

EPS = torch.finfo(torch.float64).eps


def numbers(*values):
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize("depth", [0, -1.0, math.inf, math.nan])
def test_refuses_a_depth_that_is_none(depth):
    with pytest.raises(InputError, match="give the depth of the deepest groove"):
        wrinkle(4, depth=depth)


@pytest.mark.parametrize(
    ("vectors", "options", "message"),
    [
        (torch.zeros(1, 4, 8, 8), {}, "order is 2"),
        (torch.zeros(1, 9, 8, 8), {"lobes": 0}, "lobes 0"),
        (torch.zeros(1, 9, 8, 3), {}, "vectors are 8 x 3 for a map of 4 x 4"),
        (torch.full((1, 9, 8, 8), torch.nan), {}, "NaN or infinity"),
    ],
)
def test_refuses_a_signal_that_cannot_be_fitted(vectors, options, message):
    with pytest.raises(InputError, match=message):
        fit_bilinear(vectors, (4, 4), **options)


def test_a_groove_without_depth_is_a_plane():
    flat = groove_transfer(torch.linspace(0, 1, 7, dtype=torch.float64), numbers(0.0), 6)
    plane = unshadowed(torch.tensor([[0.0, 0.0, 1.0]]), 6).T
    # The closed form is rounded to single precision.
    assert (flat - plane).abs().max() < 1e-7


def test_no_points_have_no_transfer():
    assert groove_transfer(numbers(), numbers(), 4).shape == (0, 16)


def test_a_ridge_sees_what_a_normal_sees_above_the_horizon():
    # The neighbouring ridges are as high: the horizon is level, and so is the ridge.
    ridge = groove_transfer(numbers(0.0, 1.0), numbers(0.4), 5)
    assert (ridge - unshadowed(torch.tensor([[0.0, 0.0, 1.0]]), 5).T).abs().max() < 1e-7


def test_a_groove_repeats_and_mirrors_itself():
    x, depth = torch.linspace(0.05, 0.45, 5, dtype=torch.float64), numbers(0.3)
    here = groove_transfer(x, depth, 4)
    # sin(2 pi x) of a place two widths away has lost two bits.
    assert (groove_transfer(x + 2, depth, 4) - here).abs().max() < 1e-8
    order = torch.tensor([m for l in range(4) for m in range(-l, l + 1)])
    odd = ((order > 0) & (order % 2 == 1)) | ((order < 0) & (order % 2 == 0))
    mirrored = here * torch.where(odd, -1.0, 1.0)
    assert (groove_transfer(1 - x, depth, 4) - mirrored).abs().max() < 1e-8
    along = torch.tensor([m < 0 for l in range(4) for m in range(-l, l + 1)])
    assert here[:, along].abs().max() < 16 * EPS


@pytest.mark.parametrize("depth", [0.1, 0.35, 1.5])
def test_transfer_is_what_marching_along_rays_finds(depth):
    directions = sh.fibonacci(4000)[0].numpy()
    directions = directions[directions[:, 2] > 0]
    steps = np.linspace(0, 1, 1500)[1:]
    for x in (0.03, 0.2, 0.38, 0.5, 0.77):
        slope = -np.pi * depth * np.sin(2 * np.pi * x)
        normal = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
        height = depth / 2 * (np.cos(2 * np.pi * x) - 1)
        # Marched by x; a ray along y never leaves its height.
        flat = np.maximum(np.abs(directions[:, 0]), 1e-9)
        place = x + np.sign(directions[:, :1]) * steps
        ray = height + steps * (directions[:, 2] / flat)[:, None]
        visible = (ray > depth / 2 * (np.cos(2 * np.pi * place) - 1)).all(1)
        weight = np.maximum(directions @ normal, 0) * visible * (4 * np.pi / 4000) / np.pi
        wanted = torch.from_numpy(weight) @ sh.basis(torch.from_numpy(directions), 5)
        found = groove_transfer(numbers(x), numbers(depth), 5)[0]
        # 2000 directions: a horizon of length pi cuts about 1 / sqrt(2000) of them wrongly, on either side.
        assert (found - wanted).abs().max() < 0.01 * float(found.norm())


def test_transfer_is_what_the_bake_of_a_relief_finds():
    depth, count = 0.3, 128
    wave = depth / 2 * (torch.cos(2 * torch.pi * torch.arange(count, dtype=torch.float64) / count) - 1)
    relief = tiled(height_field(wave.expand(4, count)), 2)
    x = numbers(0.1, 0.3, 0.5)
    slope = -math.pi * depth * torch.sin(2 * math.pi * x)
    height = depth / 2 * (torch.cos(2 * math.pi * x) - 1)
    points = Points(torch.stack([x, 0.5 + 0 * x, height + 1e-4], -1), torch.stack([-slope, 0 * x, 1 + 0 * x], -1), 0.5)
    baked = bake(Scene([Object(relief, Material(0.5))]), order=6, rays=4096, receivers=points, progress=False)
    found = groove_transfer(x, numbers(depth), 6)
    # 4096 rays leave .3 %; five tiles leave the horizon beyond them open, .2 %.
    assert (stored(baked)[0].mT - found).norm() < 0.008 * found.norm()


@pytest.mark.parametrize("tiles", [False, True])
@pytest.mark.parametrize(("fine", "coarse"), [(12, 4), (7, 7), (5, 1), (9, 2)])
def test_interpolation_reads_what_a_map_shows(fine, coarse, tiles):
    matrix = interpolation(fine, coarse, tiles)
    # A map reads itself, and constants.
    assert (matrix.sum(1) - 1).abs().max() <= 4 * EPS
    assert (interpolation(coarse, coarse, tiles) - torch.eye(coarse)).abs().max() <= 16 * EPS


@pytest.fixture(scope="module")
def small():
    # Made before the fixture that sets one thread; two wait for each other at every tiny operation.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    found = wrinkle(8, depth=0.2, order=5)
    torch.set_num_threads(threads)
    return found


def texels_of(patch):
    """Axes [L, 3, H, W], coefficients [C, L, Z, H, W] and exact bands [C, 4, H, W] of a map."""
    lobes, size = gloss(patch).signal, (patch.receivers.rows, patch.receivers.columns)
    parts = (lobes.axis[0], lobes.coefficients[:, 0], lobes.exact[:, 0])
    return tuple(part.unflatten(-1, size) for part in parts)


def test_lobes_of_the_wrinkle_map_meet_its_transfer_between_texels(small):
    small.check()
    assert gloss(small).signal.smooth
    assert (small.receivers.tiles_u, small.receivers.tiles_v) == (True, False)
    generator = torch.Generator().manual_seed(0)
    uv = 0.07 + 0.86 * torch.rand(200, 2, generator=generator, dtype=torch.float64)
    found, _ = sample(small, uv)
    exact = found.exact[:, 0]
    wanted = groove_transfer(uv[:, 0], 0.2 * uv[:, 1], 5).mT
    values = sh.basis(found.axis[0].mT, 5).movedim(-1, 1)
    high = (values[:, 4:] * found.coefficients[0, 0][:, sh.bands(5)[4:] - 2]).sum(0)
    relative = (torch.cat([exact[0], high]) - wanted).norm() / wanted.norm()
    # What the map says of itself over all its cells, and as much again for other places.
    assert relative < 2 * gloss(small).signal.fit_error
    assert gloss(small).signal.fit_error < 0.03


def test_the_map_is_read_by_shading_as_the_fit_reads_it(small):
    down, across = interpolation(16, 8, False), interpolation(16, 8, True)
    wanted = reconstruct(*texels_of(small), down, across)
    place = (torch.arange(16, dtype=torch.float64) + 0.5) / 16
    v, u = torch.meshgrid(place, place, indexing="ij")
    found, _ = sample(small, torch.stack([u, v], -1).reshape(-1, 2))
    values = sh.basis(found.axis[0].mT, 5).movedim(-1, 1)
    high = (values[:, 4:] * found.coefficients[0, 0][:, sh.bands(5)[4:] - 2]).sum(0)
    assert (torch.cat([found.exact[0, 0], high]) - wanted[0].flatten(1)).abs().max() <= 1e4 * EPS


def test_one_fit_of_all_beats_fits_of_each_between_texels(small):
    """Lobes of neighbours correspond: the best axes of each texel alone do not."""
    from torchprt.compression.bilinear import _best_coefficients

    generator = torch.Generator().manual_seed(1)
    down, across = interpolation(16, 8, False), interpolation(16, 8, True)
    signal = groove_transfer(
        (torch.arange(16).double() + 0.5) / 16, 0.2 * (torch.arange(16).double()[:, None] + 0.5) / 16, 5
    )
    signal = signal.movedim(-1, 0)[None]
    coarse = torch.linalg.pinv(down) @ signal @ torch.linalg.pinv(across).mT
    alone = torch.nn.functional.normalize(torch.randn(3, 3, 8, 8, generator=generator, dtype=torch.float64), dim=1)
    coefficients, _ = _best_coefficients(alone, coarse, 5)
    apart = reconstruct(alone, coefficients, coarse[:, :4], down, across)
    together = reconstruct(*texels_of(small), down, across)
    assert (together - signal).norm() < 0.1 * (apart - signal).norm()


def test_a_signal_of_low_bands_alone_needs_no_lobes():
    low = torch.zeros(1, 16, 8, 8, dtype=torch.float64)
    low[:, :4] = 1
    found = fit_bilinear(low, (4, 4))
    found.check()
    assert gloss(found).signal.coefficients.abs().max() == 0
    assert gloss(found).signal.fit_error < 64 * EPS


# Powers of two, so that nothing is rounded otherwise: twenty steps of a descent would make more of it.
@pytest.mark.parametrize("scale", [2.0**-40, 2.0**40])
def test_the_scale_of_the_signal_does_not_matter(scale):
    signal = groove_transfer((torch.arange(8).double() + 0.5) / 8, numbers(0.1, 0.2, 0.3)[:, None], 4)
    signal = signal.movedim(-1, 0)[None]
    one = fit_bilinear(signal, (2, 4), tiles_u=True, iterations=20)
    other = fit_bilinear(scale * signal, (2, 4), tiles_u=True, iterations=20)
    assert gloss(other).signal.fit_error == pytest.approx(gloss(one).signal.fit_error, rel=1e-3)
    assert torch.isfinite(gloss(other).signal.coefficients).all()
