import math

import pytest
import torch
from scipy.stats import qmc

from torchprt import sh
from torchprt.errors import InputError
from torchprt.transport import frames, hemisphere
from torchprt.transport.diffuse import projection, unshadowed

EPS = torch.finfo(torch.float64).eps


@pytest.mark.parametrize("count", [0, -1])
def test_refuses_a_set_of_no_directions(count):
    with pytest.raises(InputError, match="rays"):
        hemisphere(count)


def test_refuses_a_negative_seed():
    with pytest.raises(InputError, match="seed"):
        hemisphere(4, seed=-1)


@pytest.mark.parametrize("count", [1, 2, 1000])
def test_directions_are_unit_and_above_the_horizon(count):
    directions = hemisphere(count, seed=3)
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(count, dtype=torch.float64), atol=4 * EPS, rtol=0)
    assert (directions[:, 2] > 0).all()


def test_the_seed_turns_the_set_about_the_normal_and_nothing_else():
    one, other = hemisphere(64, seed=1), hemisphere(64, seed=2)
    assert not torch.allclose(one, other)
    # The fraction of index * golden ratio (below 40) has lost six bits, and 2 pi multiplies it.
    torch.testing.assert_close(one @ one.T, other @ other.T, atol=2 * math.pi * 64 * EPS, rtol=0)


def normals_with_extremes():
    normals = torch.randn(1000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    poles = torch.tensor(
        [[0, -1, 0], [0, 1, 0], [1, 0, 0], [0, 0, -1], [1e-9, -1, 0], [1e-200, -1, 0], [0, -1, 3e-5]],
        dtype=torch.float64,
    )
    normals = torch.cat([normals, poles])
    return normals / normals.norm(dim=-1, keepdim=True)


def test_frames_are_proper_rotations_even_at_their_pole():
    turned = frames(normals_with_extremes())
    identity = torch.eye(3, dtype=torch.float64).expand_as(turned)
    torch.testing.assert_close(turned @ turned.mT, identity, atol=16 * EPS, rtol=0)
    torch.testing.assert_close(torch.linalg.det(turned), torch.ones(len(turned), dtype=torch.float64))


def test_the_normal_is_the_third_row_of_a_frame():
    normals = normals_with_extremes()
    assert torch.equal(frames(normals)[:, 2], normals)


def test_a_zero_normal_has_a_frame_like_any_other():
    turned = frames(torch.zeros(1, 3, dtype=torch.float64))
    assert torch.equal(turned, frames(torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64)))


def test_frames_turn_no_faster_than_twice_their_normals_away_from_straight_down():
    normals = normals_with_extremes()
    normals = normals[normals[:, 1] > -0.9]
    nudged = normals + 1e-6 * torch.randn(
        normals.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)
    )
    nudged = nudged / nudged.norm(dim=-1, keepdim=True)
    change = (frames(nudged) - frames(normals)).flatten(1).norm(dim=-1)
    # The spin about the normal is tan(theta / 2) times the turn, below 4.4 where y > -0.9.
    assert (change / (nudged - normals).norm(dim=-1)).max() < 2 * 4.4


@pytest.mark.parametrize("order", [1, 5, 32])
def test_a_receiver_that_sees_everything_gets_the_closed_form_and_one_that_sees_nothing_gets_zero(order):
    project = projection(hemisphere(300), order)
    pole = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    # A sum of 300 float32 numbers.
    tolerance = 300 * torch.finfo(torch.float32).eps * float(project.abs().max())
    torch.testing.assert_close(project.sum(-1), unshadowed(pole, order)[:, 0], atol=tolerance, rtol=0)
    assert not (project @ torch.zeros(300)).any()


@pytest.mark.parametrize("order", [1, 2, 5, 16])
def test_unshadowed_transfer_is_the_projected_cosine(order):
    normal = torch.tensor([[0.6, -0.48, 0.64]], dtype=torch.float64)
    # The kink of the cosine lies on the equator of z: half a product rule integrates the polynomial above it exactly.
    nodes, weights = sh.gauss_legendre(2 * order + 2)
    turned = frames(normal)[0]
    half = torch.cat([nodes[:, :2] * 0, nodes[:, 2:]], -1)
    z = (half[:, 2] + 1) / 2
    phi = torch.atan2(nodes[:, 1], nodes[:, 0])
    radius = torch.sqrt(1 - z * z)
    local = torch.stack([radius * phi.cos(), radius * phi.sin(), z], -1)
    expected = (weights / 2 * z / math.pi) @ sh.basis(local @ turned, order)
    torch.testing.assert_close(unshadowed(normal, order)[:, 0].double(), expected, atol=1e-6, rtol=0)


# RMS error of a coefficient of a shadowed cosine, order 5, whole-sphere sets (published with the method's notes).
COUNTS = (256, 1024, 4096, 10000)
PUBLISHED = {
    "random": (8.2e-2, 4.2e-2, 2.1e-2, 1.3e-2),
    "stratified": (2.7e-2, 7.8e-3, 2.5e-3, 1.2e-3),
    "centroids": (1.1e-2, 3.8e-3, 1.4e-3, 7.9e-4),
    "sobol": (1.6e-2, 4.5e-3, 1.5e-3, 9.8e-4),
    "fibonacci": (9.7e-3, 3.4e-3, 1.2e-3, 6.2e-4),
}
# One random set errs alike for all receivers: only the mean over many is a figure.
REPEATS = {"random": 12, "stratified": 8, "centroids": 1, "sobol": 4, "fibonacci": 1}


def on_sphere(u, v):
    """The equal-area map from the unit square."""
    z, phi = 1 - 2 * u, 2 * math.pi * v
    radius = torch.sqrt(1 - z * z)
    return torch.stack([radius * phi.cos(), radius * phi.sin(), z], -1)


def in_bins(count, columns_a_row, jitter):
    """One point in each bin of a grid over the unit square: at its middle, or moved by `jitter` (0 to 1)."""
    rows = round(math.sqrt(count / columns_a_row))
    columns = count // rows
    row, column = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    return on_sphere(
        ((row + jitter(rows, columns)) / rows).flatten(), ((column + jitter(rows, columns)) / columns).flatten()
    )


def direction_set(name, count, repeat):
    generator = torch.Generator().manual_seed(repeat)

    def scattered(rows, columns):
        return torch.rand(rows, columns, generator=generator, dtype=torch.float64)

    if name == "random":
        return on_sphere(*scattered(2, count))
    if name == "stratified":
        return in_bins(count, 1, scattered)
    if name == "centroids":
        return in_bins(count, 0.5, lambda rows, columns: torch.full((rows, columns), 0.5, dtype=torch.float64))
    if name == "sobol":
        # The sequence is balanced at powers of two, and says so; 10000 is as published.
        points = qmc.Sobol(2, rng=repeat).random_base2(14)[:count]
        return on_sphere(*torch.from_numpy(points).T)
    return sh.fibonacci(count)[0]


@pytest.fixture(scope="module")
def shadowed_cosines():
    """A projection of 150 cosines behind random caps from any set of directions, and its truth. The published signal
    is a scan's; the caps are such that the RMS of a coefficient is the same, .252."""
    generator = torch.Generator().manual_seed(0)
    axes, normals = torch.nn.functional.normalize(
        torch.randn(2, 150, 3, generator=generator, dtype=torch.float64), dim=-1
    )
    cosine = 0.3 + 0.7 * torch.rand(150, 1, generator=generator, dtype=torch.float64)

    def project(directions):
        kernel = (normals @ directions.T).clamp(min=0) * (axes @ directions.T < cosine)
        return (4 * math.pi / directions.shape[0]) * kernel @ sh.basis(directions, 5)

    truth = project(sh.fibonacci(100_000)[0])
    assert truth.square().mean().sqrt() == pytest.approx(0.252, rel=0.1)
    return project, truth


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("name", PUBLISHED)
def test_direction_sets_err_as_published(shadowed_cosines, name, count):
    project, truth = shadowed_cosines
    sets = [direction_set(name, count, repeat) for repeat in range(REPEATS[name])]
    error = torch.stack([(project(directions) - truth).square().mean() for directions in sets]).mean().sqrt()
    # Random sets agree within the chance of twelve; that of an even set also depends on the shapes of the shadows,
    # which are caps here and were a scan's.
    tolerance = 0.15 if name == "random" else 0.35
    assert float(error) == pytest.approx(PUBLISHED[name][COUNTS.index(count)], rel=tolerance)


def test_fibonacci_sets_err_least(shadowed_cosines):
    project, truth = shadowed_cosines
    errors = {name: (project(direction_set(name, 1024, 0)) - truth).square().mean() for name in PUBLISHED}
    assert min(errors, key=errors.get) == "fibonacci"
