"""Does importance from expected light weigh transfer as the radiance under that light is?"""

import pytest
import torch

from torchprt import sh
from torchprt.compression import clustered_pca, light_importance, natural_light_importance
from torchprt.errors import InputError


def lights(count=4, order=3, seed=0):
    return torch.randn(count, order**2, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def unit(light):
    return light / light.square().sum((1, 2), keepdim=True).sqrt()


def random_turns(count, seed=0):
    """Uniform over all rotations, from quaternions."""
    generator = torch.Generator().manual_seed(seed)
    w, x, y, z = torch.nn.functional.normalize(torch.randn(4, count, generator=generator, dtype=torch.float64), dim=0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def weighed(difference, importance):
    return ((difference @ importance) * difference).sum(-1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": 0}, "order is 0: it must be 1 or more"),
        ({"order": 2, "channels": 0}, "channels is 0: it must be 1 or more"),
        ({"order": 2, "rows": -1}, "rows is -1: it must be 1 or more"),
        ({"order": 2, "falloff": -1}, "falloff is -1: it must be a finite number from 0"),
        ({"order": 2, "falloff": float("inf")}, "falloff is inf"),
        ({"order": 2, "falloff": float("nan")}, "falloff is nan"),
    ],
)
def test_misuse_of_the_spectrum_is_named(options, message):
    with pytest.raises(InputError, match=message):
        natural_light_importance(**options)


@pytest.mark.parametrize(
    ("given", "options", "message"),
    [
        (lights(0), {}, "lights is empty"),
        (torch.ones(2, 5, 3), {}, "5"),
        (lights().index_fill(0, torch.tensor([1]), torch.nan), {}, "lights holds a number that is not finite"),
        (lights().index_fill(0, torch.tensor([1]), 0), {}, "lights holds one that is zero everywhere"),
        (lights(), {"turned": "pitch"}, "turned is 'pitch': choose one of none, yaw, any"),
        (lights(), {"channels": 2}, "channels is 2: transfer has 1 or 3"),
        (lights(), {"rows": 0}, "rows is 0"),
        (lights(), {"floor": 0}, "floor is 0: it must be above 0"),
        (lights(), {"floor": 1.5}, "floor is 1.5"),
    ],
)
@pytest.mark.usefixtures("untyped")
def test_misuse_of_lights_is_named(given, options, message):
    with pytest.raises(InputError, match=message):
        light_importance(given, **options)


@pytest.mark.parametrize("order", [1, 5, 12])
def test_the_spectrum_falls_by_band_and_has_a_mean_of_one(order):
    importance = natural_light_importance(order)
    assert importance.shape == (order**2,)
    torch.testing.assert_close(importance.mean(), torch.tensor(1.0, dtype=torch.float64), rtol=1e-15, atol=0)
    torch.testing.assert_close(importance[0] / importance[-1], torch.tensor(float(order**2)).double())
    assert (natural_light_importance(order, falloff=0) == 1).all()


def test_the_spectrum_is_that_of_every_row_and_channel():
    assert torch.equal(natural_light_importance(3, channels=3, rows=4), natural_light_importance(3).repeat(12))


@pytest.mark.parametrize("turned", ["none", "yaw", "any"])
@pytest.mark.parametrize("channels", [1, 3])
def test_the_weighed_error_is_that_of_radiance_under_the_lights(turned, channels):
    given, order, rows, floor = lights(), 3, 2, 0.25
    importance = light_importance(given, turned=turned, channels=channels, rows=rows, floor=floor)
    generator = torch.Generator().manual_seed(1)
    # [points, C, M, N]: differences of exit matrices.
    matrices = torch.randn(7, channels, rows, order**2, generator=generator, dtype=torch.float64)
    if turned == "none":
        turns = torch.eye(3, dtype=torch.float64)[None]
    elif turned == "yaw":
        # Other angles than the function takes, and more of them.
        yaw = 360 * torch.arange(29, dtype=torch.float64) / 29 + 5
        turns = sh.yaw_pitch_roll(torch.stack([yaw, 0 * yaw, 0 * yaw], 1))
    else:
        turns = random_turns(20_000)
    met = sh.rotate(unit(given)[:, None], turns).flatten(0, 1)
    # Radiance squared, summed over rows and channels, the mean over lights and turns.
    exact = (matrices.expand(-1, 3, -1, -1) @ met.permute(2, 1, 0)).square().sum((1, 2)).mean(1)
    plain = matrices.square().sum((1, 2, 3))
    found = weighed(matrices.flatten(1), importance) - floor * plain
    # Up to one factor for all; random turns agree within their Monte Carlo error of 1 / sqrt(20 000), six of them.
    tolerance = 6 / 20_000**0.5 if turned == "any" else 1e-12
    torch.testing.assert_close(found / found.sum(), exact / exact.sum(), rtol=tolerance, atol=0)


def test_the_mean_of_the_diagonal_is_one_and_the_floor():
    importance = light_importance(lights(order=4), rows=3, floor=0.125)
    assert importance.shape == (48, 48)
    torch.testing.assert_close(
        importance.diagonal().mean(), torch.tensor(1.125, dtype=torch.float64), rtol=1e-14, atol=0
    )
    assert torch.equal(importance, importance.mT)


def test_how_bright_a_light_is_does_not_matter():
    given = lights()
    scaled = given * torch.tensor([1e-30, 1e-3, 1.0, 1e30], dtype=torch.float64)[:, None, None]
    torch.testing.assert_close(light_importance(scaled), light_importance(given), rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(light_importance(given.float()), light_importance(given), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("turned", ["none", "yaw", "any"])
def test_one_light_of_one_band_is_positive_definite(turned):
    given = torch.zeros(1, 36, 3)
    given[0, 0, 0] = 1.0
    for channels in (1, 3):
        values = torch.linalg.eigvalsh(light_importance(given, turned=turned, channels=channels, floor=1e-3))
        # To the rounding of the largest eigenvalue, which is 36 (or three times that in one channel of three).
        assert values[0] >= 1e-3 - 108 * 36 * torch.finfo(torch.float64).eps


def test_any_turn_leaves_the_power_of_bands():
    importance = light_importance(lights(order=4), turned="any")
    assert torch.equal(importance, importance.diag().diag())
    for band in importance.diag().split([1, 3, 5, 7]):
        assert (band == band[0]).all()


def test_turning_about_the_vertical_first_changes_nothing():
    given = lights(order=5)
    turn = sh.yaw_pitch_roll(torch.tensor([77.0, 0.0, 0.0], dtype=torch.float64))
    torch.testing.assert_close(light_importance(sh.rotate(given, turn)), light_importance(given), rtol=0, atol=1e-12)


def test_it_lowers_the_error_of_radiance_under_such_lights():
    data = torch.randn(1500, 16, generator=torch.Generator().manual_seed(2))
    # Light with most of its amplitude in the first band.
    given = lights(5, order=4, seed=3) * torch.tensor([1.0] + 15 * [0.1], dtype=torch.float64)[:, None]
    errors = []
    for importance in (None, light_importance(given, turned="none", floor=1e-3)):
        packed = clustered_pca(data, 12, 2, importance=importance)
        errors.append(float(((packed.reconstruct() - data).double() @ unit(given)).square().sum()))
    assert errors[1] < errors[0] / 2
