"""Does every public function of tensors in `sh` and `light` work under torch.func, and is each of them tried?"""

import pytest
import torch
from one_device import faults_of, moved
from torch.func import jacfwd, jacrev, vmap

from torchprt import InputError, light, sh

ORDER = 3


def values(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def positive(*shape):
    return values(*shape).abs() + 0.1


def above(*shape):
    """Unit directions with z above zero, and y."""
    return torch.nn.functional.normalize(values(*shape, 3).abs() + 0.1, dim=-1)


def turns(*shape):
    return sh.yaw_pitch_roll(90 * values(*shape, 3))


def lit(*shape):
    """Lights whose means are positive, and which ring."""
    made = values(*shape, ORDER**2, 3)
    made[..., 0, :] = made[..., 0, :].abs() + 0.5
    return made


ONE = lit()
KERNEL = sh.clamped_cosine(ORDER)
DOWN = torch.nn.functional.normalize(values(20, 3), dim=-1)
CENTRE = torch.tensor([4.0, 0.5, -4.0], dtype=torch.float64)
# What a function is called with, with a batch of two in front, and the call.
CALLS = {
    "sh.basis": (above(2, 4), lambda d: sh.basis(d, ORDER)),
    "sh.check_directions": (above(2, 4), lambda d: (sh.check_directions(d), d)[1]),
    "sh.check_rotation": (turns(2), lambda r: (sh.check_rotation(r), r)[1]),
    "sh.convolve": (lit(2), lambda l: sh.convolve(l, KERNEL)),
    "sh.disc": (positive(2), lambda a: sh.disc(a, ORDER)),
    "sh.evaluate": (lit(2), lambda l: sh.evaluate(l, DOWN)),
    "sh.exit_functions": (above(2, 4), lambda d: sh.exit_functions(d, ORDER)),
    "sh.from_e3nn": (lit(2), sh.from_e3nn),
    "sh.from_pyshtools": (values(2, 3, 2, ORDER, ORDER), sh.from_pyshtools),
    "sh.from_sign_free": (lit(2), sh.from_sign_free),
    "sh.hemisphere_basis": (above(2, 4), lambda d: sh.hemisphere_basis(d, ORDER)),
    "sh.least_window": (lit(2), lambda l: sh.least_window(l)[0]),
    "sh.phong": (positive(2), lambda k: sh.phong(k, ORDER)),
    "sh.product": (lit(2), lambda l: sh.product(l, l)),
    "sh.product_matrix": (values(2, 9), lambda a: sh.product_matrix(a, ORDER, ORDER)),
    "sh.project_cube": (positive(2, 6, 4, 4, 3), lambda c: sh.project_cube(c, ORDER)),
    "sh.project_latlong": (positive(2, 4, 8, 3), lambda i: sh.project_latlong(i, ORDER)),
    "sh.project_samples": (values(2, 20, 3), lambda v: sh.project_samples(v, DOWN, ORDER, torch.ones_like(DOWN[:, 0]))),
    "sh.rotate": (turns(2), lambda r: sh.rotate(ONE, r)),
    "sh.rotation_bands": (turns(2), lambda r: sh.rotation_bands(r, ORDER)[-1]),
    "sh.rotation_matrix": (turns(2), lambda r: sh.rotation_matrix(r, ORDER)),
    "sh.to_e3nn": (lit(2), sh.to_e3nn),
    "sh.to_horizon": (values(2, 4, 3), sh.to_horizon),
    "sh.to_pyshtools": (lit(2), sh.to_pyshtools),
    "sh.to_sign_free": (lit(2), sh.to_sign_free),
    "sh.window": (lit(2), lambda l: sh.window(l, KERNEL)),
    "sh.yaw_pitch_roll": (values(2, 3), sh.yaw_pitch_roll),
    "sh.zonal": (above(2), lambda a: sh.zonal(KERNEL, a)),
    "light.clear_sky": (above(2), lambda s: light.clear_sky(s, 3.0, ORDER)),
    "light.clear_sky_radiance": (above(2), lambda s: light.clear_sky_radiance(DOWN, s, 3.0)),
    "light.constant": (positive(2, 3), lambda c: light.constant(c, ORDER)),
    "light.cube_to_latlong": (positive(2, 6, 4, 4, 3), lambda c: light.cube_to_latlong(c, 4)),
    "light.directional": (values(2, 3), lambda d: light.directional(d, order=ORDER)),
    "light.disc": (values(2, 3), lambda d: light.disc(d, 0.2, 1.0, ORDER, normalise=True)),
    "light.dominant": (lit(2), lambda l: torch.cat(light.dominant(l))),
    "light.hemisphere": (values(2, 3), lambda d: light.hemisphere(d, 1.0, 0.5, ORDER)),
    "light.incident": (values(2, 4, 3), lambda p: light.incident([light.SphereEmitter(CENTRE, 0.5, 2.0)], p, ORDER)),
    "light.latlong_to_cube": (positive(2, 8, 16, 3), lambda i: light.latlong_to_cube(i, 4)),
    "light.overcast_sky": (values(2, 3), lambda d: light.overcast_sky(2.0, d, ORDER)),
    "light.project": (positive(2, 4, 8, 3), lambda i: light.project(i, ORDER)),
    "light.sphere": (values(2, 3) + 3, lambda c: light.sphere(c, 0.5, 1.0, ORDER)),
    "light.sun_radiance": (positive(2), lambda a: light.sun_radiance(a.clamp(max=1.2), 3.0)),
    "light.window_factors": (lit(2), lambda l: light.window_factors(l, "auto")),
    "light.windowed": (lit(2), lambda l: light.windowed(l, "auto")),
}
# What takes no tensor, or gives Python numbers, files or reports of an image: work of the host.
HOST = {
    "sh.Projection", "sh.Rotation", "sh.bands", "sh.clamped_cosine", "sh.cube_basis", "sh.cube_directions",
    "sh.cube_weights", "sh.exit_count", "sh.fibonacci", "sh.gaunt", "sh.gauss", "sh.gauss_legendre",
    "sh.gauss_legendre_hemisphere", "sh.hann", "sh.hemisphere_error", "sh.hemisphere_gram", "sh.hemisphere_nodes",
    "sh.hemisphere_projection",
    "sh.lanczos", "sh.latlong_basis", "sh.latlong_directions", "sh.latlong_weights", "sh.lebedev", "sh.order_of",
    "sh.project_function",
    "light.BUILT_IN", "light.DamagedImageWarning", "light.Emitter", "light.ImageReport", "light.MeshEmitter",
    "light.RectangleEmitter", "light.SphereEmitter", "light.WINDOWS", "light.blend_weights", "light.built_in",
    "light.capture", "light.local_light",
    "light.inspect", "light.read", "light.read_coefficients", "light.read_with_report", "light.studio",
    "light.sample_points", "light.with_sample_points", "light.write_coefficients", "light.write_exr",
}  # fmt: skip


def close(found, wanted):
    torch.testing.assert_close(found, wanted, rtol=1e-9, atol=1e-9)


def test_every_public_name_is_tried_or_known_as_work_of_the_host():
    public = {f"{room.__name__.removeprefix('torchprt.')}.{name}" for room in (sh, light) for name in room.__all__}
    assert CALLS.keys() | HOST == public
    assert not CALLS.keys() & HOST


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("name", CALLS)
def test_a_batch_is_what_vmap_makes_of_one(name):
    given, call = CALLS[name]
    close(vmap(call)(given), torch.stack([call(one) for one in given]))


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("name", CALLS)
def test_jacobians_of_both_modes_agree(name):
    given, call = CALLS[name]
    one = given[0]
    backward = jacrev(call)(one)
    close(jacfwd(call)(one), backward)
    close(backward, torch.autograd.functional.jacobian(call, one))


@pytest.mark.parametrize(
    ("bad", "call", "fault"),
    [
        (torch.full((4, 8, 3), -1.0), lambda i: light.project(i, ORDER), "negative radiance"),
        (torch.full((9, 3), torch.nan), sh.least_window, "not finite"),
        (torch.zeros(3), lambda d: light.directional(d, order=ORDER), "finite and not zero"),
        (2 * torch.eye(3), sh.check_rotation, "orthogonal"),
        (torch.zeros(3), sh.check_directions, "unit length"),
    ],
)
def test_values_are_checked_where_nothing_is_traced(bad, call, fault):
    with pytest.raises(InputError, match=fault):
        call(bad)


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("name", CALLS)
def test_all_stays_on_the_device_of_what_is_given(name, monkeypatch):
    given, call = CALLS[name]
    # What the calls here take beside what they are given.
    for other in ("CENTRE", "DOWN", "KERNEL", "ONE"):
        monkeypatch.setitem(globals(), other, moved(globals()[other]))
    assert not [fault for fault in faults_of(call, given) if "test_transforms" not in fault]
