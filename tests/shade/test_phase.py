"""Is what a cell scatters toward an eye its phase function times what arrives?"""

import math

import pytest
import torch
from volumes import random_cells, random_volume

from torchprt import sh
from torchprt.compression import compress, fit
from torchprt.errors import InputError
from torchprt.shade import shader
from torchprt.transfer import Phase

WIDE = torch.float64
EYE = torch.tensor([3.0, -2.0, 4.0], dtype=WIDE)


def light(*batch, order=4):
    return torch.randn(*batch, order**2, 3, generator=torch.Generator().manual_seed(2), dtype=WIDE)


def incident(transfer, lamp):
    """The coefficients of what arrives, `[V, M, 3]`."""
    return transfer.layers["phase"].signal.values[0] @ lamp


def test_refuses_an_eye_that_is_missing_or_nowhere():
    shade = shader(random_volume("phase", dtype=WIDE))
    with pytest.raises(InputError, match="neither is given"):
        shade(light())
    with pytest.raises(InputError, match="zero vector"):
        shade(light(), view=torch.zeros(3, dtype=WIDE))


@pytest.mark.parametrize("kind", ["phase", "diffuse"])
def test_a_volume_has_no_lobes(kind):
    with pytest.raises(InputError, match="no surface"):
        fit(random_volume(kind))


def test_integrates_the_phase_function_against_what_arrives():
    """The definition, by quadrature over the sphere: int p(-v . s) L(s) ds, L from all sides."""
    moments = (1.0, 0.7, 0.2)
    transfer = random_volume("phase", moments=moments, dtype=WIDE)
    found = shader(transfer)(light(), eye=EYE)
    nodes, weights = sh.gauss_legendre(8)
    arriving = sh.basis(nodes, 3) @ incident(transfer, light())
    toward = torch.nn.functional.normalize(EYE - transfer.positions.double(), dim=-1)
    cosine = -toward @ nodes.T
    # (2 l + 1) / 4 pi times the Legendre polynomials.
    legendre = (torch.ones_like(cosine), cosine, (3 * cosine**2 - 1) / 2)
    phase = sum((2 * l + 1) / (4 * math.pi) * moments[l] * legendre[l] for l in range(3))
    wanted = ((phase * weights).unsqueeze(-1) * arriving).sum(1) * transfer.layers["phase"].albedo
    torch.testing.assert_close(found, wanted, rtol=1e-12, atol=1e-12)


def test_one_moment_is_an_isotropic_volume():
    transfer = random_volume("phase", moments=(1.0,), dtype=WIDE)
    seen = shader(transfer)
    torch.testing.assert_close(seen(light(), eye=EYE), seen(light(), eye=-EYE), rtol=0, atol=0)
    wanted = incident(transfer, light())[:, 0] / math.sqrt(4 * math.pi) * transfer.layers["phase"].albedo
    torch.testing.assert_close(seen(light(), eye=EYE), wanted)


def test_an_eye_far_away_is_a_view_and_one_at_a_cell_sees_the_mean():
    transfer = random_volume("phase", dtype=WIDE)
    shade = shader(transfer)
    torch.testing.assert_close(shade(light(), eye=1e9 * EYE), shade(light(), view=EYE), rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(shade(light(), view=1e-200 * EYE), shade(light(), view=1e200 * EYE))
    there = shade(light(), eye=transfer.positions[3].double())[3]
    mean = incident(transfer, light())[3, 0] / math.sqrt(4 * math.pi) * transfer.layers["phase"].albedo[3]
    torch.testing.assert_close(there, mean)


def test_is_as_right_far_from_the_origin():
    near = random_volume("phase", dtype=WIDE)
    place = near.receivers
    far = near.__class__(receivers=place.replace(origin=[1e4 + each for each in place.origin]), layers=near.layers)
    moved = far.positions.double() - 1e4
    shifted = (moved - near.positions).abs().max()
    assert shifted < 1e-3
    eyes = shader(far)(light(), eye=EYE + 1e4)
    torch.testing.assert_close(eyes, shader(near)(light(), eye=EYE), rtol=1e-2, atol=1e-2)


def test_fixed_eyes_and_lights_give_the_same():
    transfer = random_volume("phase", channels=3, dtype=WIDE)
    shade = shader(transfer)
    wanted = shade(light(2, 1), eye=torch.stack([EYE, -EYE]))
    assert wanted.shape == (2, 2, transfer.vertices, 3)
    torch.testing.assert_close(shade.fix_eye(eye=EYE)(light(2)), wanted[:, 0])
    torch.testing.assert_close(shade.fix_light(light(2, 1))(eye=torch.stack([EYE, -EYE])), wanted)


def test_learns_and_has_gradients():
    shade = shader(random_volume("phase", dtype=WIDE), learn=["albedo", "values"])
    eye = EYE.clone().requires_grad_()
    shade(light(), eye=eye).square().sum().backward()
    assert all(each.grad.abs().sum() > 0 for each in (eye, shade.layers["phase"].albedo))

    def seen(place):
        return shade(light(), eye=place)

    assert torch.autograd.gradcheck(seen, EYE.clone().requires_grad_())


@pytest.mark.parametrize("kind", ["phase", "diffuse"])
def test_clusters_of_cells_hold_what_they_say(kind):
    transfer = random_volume(kind, random_cells((6, 5, 4)))
    packed = compress(transfer, clusters=4, components=3)
    # Seen alike, to what was lost.
    given = {"eye": EYE.float()} if kind == "phase" else {}
    wanted, found = (shader(each)(light().float(), **given) for each in (transfer, packed))
    lost = packed.layers[kind].signal.compression_error
    assert 0 < lost < 1
    assert (found - wanted).norm() <= 1.5 * lost * wanted.norm()
    whole = compress(transfer, clusters=1, components=16 if kind == "diffuse" else transfer.vertices - 1)
    torch.testing.assert_close(shader(whole)(light().float(), **given), wanted, rtol=1e-3, atol=1e-3)


def test_a_layer_of_some_cells_leaves_the_others_dark():
    transfer = random_volume("phase", dtype=WIDE)
    layer = transfer.layers["phase"].take(torch.tensor([1, 4]), torch.tensor([1, 4]))
    assert isinstance(layer, Phase)
    some = shader(transfer.with_layers(phase=layer))(light(), eye=EYE)
    wanted = shader(transfer)(light(), eye=EYE)
    torch.testing.assert_close(some[[1, 4]], wanted[[1, 4]])
    assert some.abs().sum(-1).count_nonzero() == 2
