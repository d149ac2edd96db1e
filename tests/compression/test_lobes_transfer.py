"""Does zonal transfer stand for the transfer that it was fitted to, and smooth lobes for what is between vertices?"""

import dataclasses

import pytest
import torch
from transfers import KINDS, gloss, random_glossy, replaced, stored

from torchprt.compression import Lobes, fit, fit_lobes
from torchprt.compression.lobes import edges_of
from torchprt.errors import InputError
from torchprt.sh import clamped_cosine, zonal
from torchprt.transfer import load, save


def test_refuses_visibility_which_does_not_turn_as_light_does():
    with pytest.raises(InputError, match=r"visibility has no lobes: .* bake with factors instead"):
        fit(random_glossy("visibility"))


def test_refuses_what_is_fitted_already(make_transfer):
    with pytest.raises(InputError, match="transfer of kind 'zonal diffuse' is compressed already"):
        fit(fit(make_transfer(side=2, order=3), lobes=1))


@pytest.mark.parametrize("channels", [1, 3])
def test_diffuse_transfer_becomes_zonal_and_says_what_it_cost(make_transfer, tmp_path, channels):
    transfer = make_transfer(side=4, order=3, channels=channels)
    made = fit(transfer, lobes=2)
    assert made.kind == "zonal diffuse"
    made.check()
    signal, unknown = gloss(made).signal, gloss(made).signal.squared_error.double()
    back = Lobes(signal.axis[0], signal.coefficients[:, 0], signal.exact[:, 0], unknown).reconstruct()
    squared = (back - stored(transfer).permute(2, 0, 1)).double().square().sum((1, 2))
    torch.testing.assert_close(unknown, squared, rtol=1e-5, atol=1e-12)
    assert signal.fit_error == pytest.approx(float(squared.sum().sqrt() / stored(transfer).double().norm()), rel=1e-5)
    save(made, tmp_path / "a.safetensors")
    assert torch.equal(gloss(load(tmp_path / "a.safetensors")).signal.axis, signal.axis)
    for name in ("positions", "normals", "faces", "albedo"):
        assert torch.equal(getattr(made, name), getattr(transfer, name))


def test_transfer_in_half_precision_is_fitted(make_transfer):
    made = fit(make_transfer(side=2, order=3, dtype=torch.float16), lobes=1)
    assert gloss(made).signal.axis.dtype == torch.float32


@pytest.mark.parametrize(("glossy", "diffuse"), [(None, True), (3, False)])
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "visibility"])
def test_rows_of_matrices_become_lobes(kind, glossy, diffuse):
    transfer = random_glossy(kind, vertices=5, glossy=glossy, order=3, output_order=2, diffuse=diffuse)
    made = fit(transfer, lobes=1)
    assert made.kind == ("zonal diffuse + " if diffuse else "") + f"zonal {kind}"
    made.check()
    signal, unknown = gloss(made).signal, gloss(made).signal.squared_error.double()
    squared = 0
    for row in range(signal.axis.shape[0]):
        back = Lobes(signal.axis[row], signal.coefficients[:, row], signal.exact[:, row], unknown).reconstruct()
        squared = squared + (back - stored(transfer)[:, :, row].movedim(1, 0)).double().square().sum((1, 2))
    torch.testing.assert_close(unknown, squared, rtol=1e-5, atol=1e-9)


def test_smooth_lobes_can_be_interpolated(make_transfer):
    """Cosines about normals that turn over a grid, and shadows of them: smooth in space."""
    mesh = make_transfer(side=12)
    x, _, z = mesh.positions.double().unbind(1)
    up = torch.nn.functional.normalize(torch.stack([x, torch.ones_like(x), z], -1), dim=-1)
    shadow = torch.nn.functional.normalize(torch.stack([torch.ones_like(x), x * z, z], -1), dim=-1)
    vectors = (zonal(clamped_cosine(5), up) - 0.3 * zonal(clamped_cosine(5) ** 2 / 3, shadow))[:, None]
    edges = edges_of(mesh.faces)
    one, other = edges.T
    true = (vectors[one] + vectors[other]) / 2

    def errors(smooth):
        made = fit_lobes(vectors, 3, smooth=smooth, faces=mesh.faces)
        parts = [(part[..., one] + part[..., other]) / 2 for part in (made.axis, made.coefficients, made.exact)]
        axis = torch.nn.functional.normalize(parts[0], dim=1)
        between = Lobes(axis, parts[1], parts[2], made.error.new_zeros(len(edges))).reconstruct()
        whole = made.reconstruct()
        return (between - true).norm(), ((whole[one] + whole[other]) / 2 - true).norm()

    smooth, apart = errors(True)
    assert smooth < 2 * apart + 2e-3 * true.norm()
    # Lobes that do not correspond are nothing in the middle.
    assert errors(False)[0] > 3 * smooth


def test_a_fit_without_receivers_is_refused(make_transfer):
    transfer = make_transfer(side=2)
    empty = {name: getattr(transfer, name)[:0] for name in ("positions", "normals", "faces", "albedo")}
    empty["albedo"] = transfer.albedo[:1]
    with pytest.raises(InputError, match="no receivers"):
        fit(replaced(transfer, values=stored(transfer)[..., :0], **empty))


def test_all_layers_are_fitted_each_as_it_is_alone():
    transfer = random_glossy("exit", vertices=6, glossy=4, order=3, output_order=2)
    made = fit(transfer, lobes=1)
    assert made.kind == "zonal diffuse + zonal exit"
    for name in transfer.layers:
        alone = fit(dataclasses.replace(transfer, layers={name: transfer.layers[name]}), lobes=1)
        assert torch.equal(alone.layers[name].signal.coefficients, made.layers[name].signal.coefficients)
    assert made.needs == {"eye", "pose"}
