"""Is what an eye is shown the integral of light and reflectance? Unshadowed receivers, against quadrature."""

import dataclasses
import math

import pytest
import torch
from transfers import frame_of, gloss, random_glossy, replaced, stored

from torchprt import brdf, sh
from torchprt.errors import InputError
from torchprt.shade import shader, with_material
from torchprt.transfer import Dense, Exit

ORDER, DEGREE = 3, 48


def light():
    return torch.randn(ORDER**2, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def receivers(kind, **arguments):
    return random_glossy(
        kind, vertices=3, order=ORDER, diffuse=False, specular=(1, 1), dtype=torch.float64, **arguments
    )


def frames(transfer):
    return torch.stack([frame_of(transfer, g) for g in range(3)])


def unshadowed_exit(model, output_order, projection="optimal"):
    """Exit matrices by quadrature over the incident hemisphere, from the kernels of the BRDF."""
    transfer = receivers("exit", output_order=output_order, projection=projection)
    nodes, weights = sh.gauss_legendre_hemisphere(DEGREE)
    kernel = brdf.exit_kernel(model, nodes, output_order, projection)
    matrix = torch.stack([(kernel * weights) @ sh.basis(nodes @ frame, ORDER) for frame in frames(transfer)])
    return replaced(transfer, values=matrix[None], specular=torch.ones(1, 1, dtype=torch.float64))


def unshadowed_incident(output_order):
    transfer = receivers("incident", output_order=output_order)
    nodes, weights = sh.gauss_legendre_hemisphere(DEGREE)
    into = sh.basis(nodes, output_order).mT * weights
    matrix = torch.stack([into @ sh.basis(nodes @ frame, ORDER) for frame in frames(transfer)])
    return replaced(transfer, values=matrix[None], specular=torch.ones(1, 1, dtype=torch.float64))


def integral(model, frame, view):
    """int_H f(v, s) s_z L(s) ds toward one local view, by a dense rule."""
    nodes, weights = sh.gauss_legendre_hemisphere(160)
    incident = sh.evaluate(light(), nodes @ frame)
    return ((model(view, nodes) * nodes[:, 2] * weights)[:, None] * incident).sum(0)


def world_views(transfer, g, local):
    return local @ frame_of(transfer, g)


def test_a_lambert_layer_is_irradiance_over_pi_toward_every_eye():
    transfer = unshadowed_exit(brdf.Lambert(), 2)
    normal_light = sh.convolve(light(), sh.clamped_cosine(ORDER))
    wanted = torch.stack([sh.evaluate(normal_light, n[None])[0] for n in transfer.normals]) / math.pi
    for module in (
        shader(transfer),
        shader(unshadowed_incident(ORDER), brdf=brdf.Lambert()),
        shader(with_material(unshadowed_incident(ORDER), brdf.Lambert(), output_order=1)),
    ):
        for eye in (torch.tensor([0.3, -4.0, 2.0]), torch.tensor([50.0, 1.0, 1.0])):
            # The quadrature of a BRDF is refined to 1e-4.
            assert (module(light(), eye=eye.double()) - wanted).abs().max() < 1e-4 * wanted.abs().max()


@pytest.mark.parametrize("model", [brdf.Phong(8), brdf.GGX(0.5), brdf.Ward(0.4, 0.7)], ids=lambda model: model.spec)
def test_exit_radiance_is_the_best_fit_to_the_integral_over_the_light(model):
    transfer = unshadowed_exit(model, 4)
    module = shader(transfer)
    nodes, weights = sh.gauss_legendre_hemisphere(20)
    for g in (0, 2):
        wanted = torch.stack([integral(model, frame_of(transfer, g), view) for view in nodes])
        found = module(light(), view=world_views(transfer, g, nodes))[:, g]
        rest = found - wanted
        size = (weights[:, None] * wanted.square()).sum().sqrt()
        # What is left is orthogonal to every exit function: nothing of order 4 fits better ...
        left = sh.hemisphere_basis(nodes, 4).mT @ (weights[:, None] * rest)
        assert left.norm() < 2e-3 * size
        # ... and as much as the order is known to leave of such a BRDF, for lights of random coefficients.
        error = float((weights[:, None] * rest.square()).sum().sqrt() / size)
        assert error < 4 * brdf.exit_error(model, 4, ORDER) + 2e-3


def test_projections_differ_by_less_than_what_they_lose():
    model = brdf.Phong(4)
    wanted = shader(unshadowed_exit(model, 6))(light(), view=torch.tensor([0.3, 0.4, 0.5]).double())
    reduced = shader(unshadowed_exit(model, 6, "reduced"))(light(), view=torch.tensor([0.3, 0.4, 0.5]).double())
    assert (reduced - wanted).abs().max() < 1e-2 * wanted.abs().max()


@pytest.mark.parametrize("exponent", [0, 1.0, 12.5, 1000])
def test_a_phong_exponent_blurs_the_light_about_the_mirror_direction(exponent):
    """Without a horizon transferred incident radiance is the light itself, and the result a convolution."""
    transfer = receivers("incident", output_order=ORDER)
    turn = sh.rotation_matrix(frames(transfer), ORDER)
    transfer = replaced(transfer, values=turn[None], specular=torch.ones(1, 1, dtype=torch.float64))
    eye = 100 * transfer.normals[0] + torch.tensor([3.0, 40.0, 5.0]).double()
    found = shader(transfer, exponent=exponent)(light(), eye=eye)
    blurred = sh.convolve(light(), sh.phong(exponent, ORDER))
    for v in range(3):
        normal, toward = transfer.normals[v], torch.nn.functional.normalize(eye - transfer.positions[v], dim=0)
        if toward @ normal > 0:
            mirrored = 2 * (toward @ normal) * normal - toward
            wanted = sh.evaluate(blurred, mirrored[None])[0]
            assert (found[v] - wanted).abs().max() < 1e-13 * wanted.abs().max()


def test_each_receiver_may_have_its_own_exponent():
    transfer = unshadowed_incident(ORDER)
    exponents = torch.tensor([1.0, 10.0, 100.0], dtype=torch.float64)
    eye = torch.tensor([3.0, 4.0, 5.0]).double()
    found = shader(transfer, exponent=exponents)(light(), eye=eye)
    for v, exponent in enumerate(exponents):
        wanted = shader(transfer, exponent=float(exponent))(light(), eye=eye)
        assert torch.allclose(found[v], wanted[v], rtol=1e-13)


@pytest.mark.parametrize("value", [-1, torch.nan, torch.inf, torch.tensor([1.0, -2.0, 3.0])])
def test_refuses_an_exponent_that_is_no_lobe(value):
    with pytest.raises(InputError, match="exponent must be finite and zero or more"):
        shader(receivers("incident"), exponent=value)


def test_refuses_exponents_for_other_receivers():
    with pytest.raises(InputError, match=r"exponent has shape \[2\]: give one, or one for each of the 3 glossy"):
        shader(receivers("incident"), exponent=torch.ones(2))


def test_refuses_two_reflectances():
    with pytest.raises(InputError, match="exponent and brdf are both given: give one"):
        shader(receivers("incident"), exponent=3.0, brdf=brdf.Lambert())


def test_refuses_to_learn_the_exponent_of_a_brdf():
    with pytest.raises(InputError, match="learn names 'exponent'"):
        shader(receivers("incident"), brdf=brdf.Lambert(), learn="exponent")


@pytest.mark.parametrize("projection", ["optimal", "reduced", "zero", "odd", "even"])
def test_a_material_given_at_run_time_is_one_given_before(projection):
    model, incident = brdf.Phong(6), receivers("incident", channels=3, output_order=4)
    for order in (None, 2):
        glossy = with_material(incident, model, order, projection)
        assert list(glossy.layers) == ["exit"]
        assert gloss(glossy).output_order == (order or 4)
        assert gloss(glossy).materials == ["phong:6"]
        later = shader(incident, brdf=model, output_order=order, projection=projection)
        eye = torch.tensor([3.0, 4.0, 5.0]).double()
        wanted = shader(glossy)(light(), eye=eye)
        assert (later(light(), eye=eye) - wanted).abs().max() < 1e-12 * wanted.abs().max()


def test_a_material_on_half_precision_and_on_no_receiver():
    half = receivers("incident").to(torch.float16)
    found = stored(with_material(half, brdf.Phong(6)))
    assert found.dtype == torch.float16
    exact = stored(with_material(half.to(torch.float64), brdf.Phong(6)))
    assert (found - exact).abs().max() < 2**-11 * exact.abs().max()
    empty = random_glossy("incident", vertices=3, glossy=0)
    assert stored(with_material(empty, brdf.Phong(6))).shape == (1, 0, 9, 16)


def test_a_material_chosen_later_converges_to_one_baked_in():
    """What is lost is transferred incident radiance above its order: a horizon that SH draw ever sharper."""
    model, eye = brdf.Phong(6), torch.tensor([3.0, 4.0, 5.0]).double()
    wanted = shader(unshadowed_exit(model, 6))(light(), eye=eye)
    errors = [
        float((shader(with_material(unshadowed_incident(order), model, 6))(light(), eye=eye) - wanted).norm())
        for order in (1, 2, 3)
    ]
    # At the order of the light and above, the fit on the hemisphere is exact.
    assert errors[0] > errors[1] > 10 * errors[2]
    assert errors[2] < 1e-3 * wanted.norm()


@pytest.mark.parametrize("projection", ["optimal", "zero"])
def test_full_visibility_on_the_fly_is_the_unshadowed_matrix(projection):
    model = brdf.Phong(6)
    transfer = random_glossy(
        "visibility",
        vertices=3,
        order=ORDER,
        output_order=4,
        projection=projection,
        specular=(1, 1),
        dtype=torch.float64,
    )
    nodes, weights = sh.gauss_legendre_hemisphere(gloss(transfer).degree)
    everywhere = torch.zeros(9, 3, dtype=torch.float64)
    everywhere[0] = math.sqrt(2 * math.pi)
    kernel = brdf.exit_kernel(model, nodes, 4, projection)
    transfer = replaced(transfer, values=everywhere[None], kernel=kernel * weights)
    matrix = torch.stack([(kernel * weights) @ sh.basis(nodes @ frame, ORDER) for frame in frames(transfer)])
    shared = {name: getattr(gloss(transfer), name) for name in ("receivers", "tangents", "specular")}
    layer = Exit(signal=Dense(values=matrix[None]), output_order=4, projection=projection, **shared)
    matrices = dataclasses.replace(transfer, layers={"diffuse": transfer.layers["diffuse"], "exit": layer})
    eye = torch.tensor([3.0, 4.0, 5.0]).double()
    wanted = shader(matrices)(light(), eye=eye)
    assert (shader(transfer)(light(), eye=eye) - wanted).abs().max() < 1e-13 * wanted.abs().max()
