"""Is every kind of file of format 1 still read, as what it was, and written as the format of today?

`format1/` holds a file of each kind, random numbers that the torchprt of that format wrote, and in `expected` the
radiance that it shaded from them in float64: under `light`, toward `eye`, at `positions`.
"""

import json
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from transfers import gloss, same

from torchprt import sh
from torchprt.errors import InputError
from torchprt.shade import lay, shader
from torchprt.transfer import FORMAT, Clustered, Dense, Zonal, load, save

FOLDER = Path(__file__).parent / "format1"
EXPECTED = load_file(FOLDER / "expected.safetensors")
KINDS = {
    "diffuse": "diffuse",
    "glossy": "diffuse + exit",
    "factored": "diffuse + factored",
    "incident": "diffuse + incident",
    "visibility": "diffuse + visibility",
    "clustered": "clustered diffuse",
    "clustered_glossy": "diffuse + clustered exit",
    "clustered_factored": "diffuse + clustered factored",
    "clustered_incident": "diffuse + clustered incident",
    "clustered_visibility": "diffuse + clustered visibility",
    "zonal": "zonal diffuse",
    "zonal_factored": "zonal diffuse + zonal factored",
}
FILES = [*KINDS, "zonal_map"]
EPSILON = torch.finfo(torch.float64).eps


def path_of(name):
    return FOLDER / f"{name}.safetensors"


def parts(path):
    """Tensors and metadata of a file, to be damaged."""
    with safe_open(path, framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata())  # noqa: SIM118


def refusal(path):
    """What is said when a file is refused: one sentence that starts with its name."""
    with pytest.raises(InputError) as caught:
        load(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def radiance(transfer):
    module = shader(transfer, dtype=torch.float64)
    given = {"eye": EXPECTED["eye"]} if "eye" in module.needs else {}
    if "pose" in module.needs:
        given["positions"] = EXPECTED["positions"]
    with torch.no_grad():
        return module(EXPECTED["light"], **given)


def near(name):
    # Sums of some hundred products of numbers near 1; axes are rounded to float32, and were not of unit length.
    return 4 * torch.finfo(torch.float32).eps if "zonal" in name else 64 * EPSILON


def test_there_is_a_file_of_every_kind():
    assert {path.stem for path in FOLDER.glob("*.safetensors")} == {*FILES, "expected"}
    for name in FILES:
        _, metadata = parts(path_of(name))
        assert (metadata["format"], metadata["kind"]) == ("1", name.replace("_", " "))


@pytest.mark.parametrize("name", KINDS)
def test_is_shaded_as_it_was(name):
    transfer = load(path_of(name))
    assert transfer.kind == KINDS[name]
    assert (radiance(transfer) - EXPECTED[name]).abs().max() <= near(name) * EXPECTED[name].abs().max()


@pytest.mark.parametrize("name", KINDS)
def test_a_fixed_eye_light_or_pose_is_what_it_was(name):
    module = shader(load(path_of(name)), dtype=torch.float64)
    given = {"eye": EXPECTED["eye"]} if "eye" in module.needs else {}
    # Visibility turns light by frames that are orthogonal to float32, in which they are stored, or transfer by them.
    most = 1e-6 if "visibility" in name else near(name)
    most *= float(EXPECTED[name].abs().max())
    with torch.no_grad():
        if "pose" in module.needs:
            module = module.fix_pose(positions=EXPECTED["positions"])
            assert (module(EXPECTED["light"], **given) - EXPECTED[name]).abs().max() <= most
        if given:
            assert (module.fix_eye(**given)(EXPECTED["light"]) - EXPECTED[name]).abs().max() <= most
            assert (module.fix_light(EXPECTED["light"])(**given) - EXPECTED[name]).abs().max() <= most


def test_a_map_holds_the_lobes_of_its_texels():
    values, _ = parts(path_of("zonal_map"))
    patch = load(path_of("zonal_map"))
    texels, signal = patch.receivers, patch.layers["diffuse"].signal
    assert patch.kind == "zonal diffuse"
    assert (texels.rows, texels.columns, texels.tiles_u, texels.tiles_v) == (3, 4, True, False)
    for row in range(3):
        for column in range(4):
            number = 4 * row + column
            assert torch.equal(patch.albedo[number], values["albedo"][:, row, column])
            assert signal.squared_error[number] == values["squared_error"][row, column]
            vector = torch.zeros(9, dtype=torch.float64)
            vector[:4] = values["exact"][0, :, row, column]
            for lobe in range(2):
                axis = torch.nn.functional.normalize(values["axis"][lobe, :, row, column].double(), dim=0)
                vector[4:] += sh.basis(axis, 3)[4:] * values["coefficients"][0, lobe, 0, row, column]
            wanted = patch.albedo[number].double() * (vector @ EXPECTED["light"])
            with torch.no_grad():
                found = shader(patch, dtype=torch.float64)(EXPECTED["light"])[number]
            assert (found - wanted).abs().max() <= 64 * EPSILON * max(float(wanted.abs().max()), 1.0)


def test_a_map_is_laid_on_a_surface():
    patch = load(path_of("zonal_map"))
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    positions = torch.cat([corners, torch.zeros(4, 1)], 1)
    laid = lay(patch, positions, torch.tensor([[0, 1, 2], [0, 2, 3]]), corners)
    assert (laid.kind, laid.vertices) == ("zonal diffuse", 4)


@pytest.mark.parametrize("name", FILES)
def test_provenance_and_what_was_lost_are_kept(name):
    transfer = load(path_of(name))
    _, metadata = parts(path_of(name))
    said = transfer.provenance
    for layer in transfer.layers.values():
        # Of two layers in lobes the last is the one whose fit was told.
        said = {**said, **layer.metadata(), **layer.signal.metadata()}
    said |= transfer.receivers.metadata()
    for entry in set(metadata) - {"kind", "format", "conventions"}:
        assert said[entry] == json.loads(metadata[entry]), entry


@pytest.mark.parametrize("name", FILES)
def test_stored_numbers_are_those_of_the_file_as_they_are(name):
    """Names and dimensions of size 1 are all that changed."""
    values, _ = parts(path_of(name))
    transfer = load(path_of(name))
    layer = list(transfer.layers.values())[-1]
    held = {**transfer.receivers.tensors(), **layer.tensors(), **layer.signal.tensors()} if name != "zonal_map" else {}
    for old, new in {"transfer": "values", "matrix": "values", "visibility": "values", "glossy": "receivers"}.items():
        if old in values and held:
            assert torch.equal(held[new].reshape(values[old].shape), values[old])
    for each in set(values) & set(held):
        assert held[each].dtype == values[each].dtype
        assert torch.equal(held[each].reshape(values[each].shape), values[each])
    classes = {"clustered": Clustered, "zonal": Zonal}
    assert type(layer.signal) is classes.get(name.split("_")[0], Dense)


@pytest.mark.parametrize("name", FILES)
def test_is_written_in_the_format_of_today_and_comes_back_the_same(tmp_path, name):
    transfer = load(path_of(name))
    written = tmp_path / "a.safetensors"
    save(transfer, written)
    values, metadata = parts(written)
    assert metadata["format"] == str(FORMAT) == "2"
    assert metadata["kind"] == transfer.kind
    former = {"transfer", "matrix", "visibility", "diffuse", "glossy", "axis", "mean", "albedo"}
    assert not former & set(values)
    back = load(written)
    assert same(back, transfer)
    if name in KINDS:
        assert torch.equal(radiance(back), radiance(transfer))


@pytest.mark.parametrize("name", ["glossy", "factored", "incident", "visibility", "clustered_glossy"])
def test_a_glossy_kind_without_diffuse_vectors_has_no_diffuse_layer(tmp_path, name):
    values, metadata = parts(path_of(name))
    save_file(values | {"diffuse": values["diffuse"][..., :0].contiguous()}, tmp_path / "a.safetensors", metadata)
    transfer, whole = load(tmp_path / "a.safetensors"), load(path_of(name))
    assert list(transfer.layers) == list(whole.layers)[1:]
    assert transfer.order == 3
    with torch.no_grad():
        below = shader(whole, dtype=torch.float64).layers["diffuse"](EXPECTED["light"]).mT
    assert (radiance(transfer) + below - EXPECTED[name]).abs().max() <= near(name) * EXPECTED[name].abs().max()


def test_glossy_lobes_without_diffuse_lobes_have_no_diffuse_layer(tmp_path):
    values, metadata = parts(path_of("zonal_factored"))
    for each in ("axis", "coefficients", "exact"):
        values[f"diffuse_{each}"] = values[f"diffuse_{each}"][..., :0].contiguous()
    save_file(values, tmp_path / "a.safetensors", metadata)
    transfer = load(tmp_path / "a.safetensors")
    assert list(transfer.layers) == ["factored"]
    assert transfer.needs == {"eye", "pose"}


def test_a_map_of_one_albedo_has_one(tmp_path):
    values, metadata = parts(path_of("zonal_map"))
    for albedo in (torch.tensor([[[0.2]], [[0.4]], [[0.6]]]), torch.tensor([[[0.3]]])):
        save_file(values | {"albedo": albedo}, tmp_path / "a.safetensors", metadata)
        assert torch.equal(load(tmp_path / "a.safetensors").albedo, albedo.flatten()[None])


# Damage


@pytest.mark.parametrize("name", FILES)
def test_names_a_missing_tensor(tmp_path, name):
    values, metadata = parts(path_of(name))
    damaged = tmp_path / "a.safetensors"
    # Lobes were diffuse too: dense vectors beside them never held anything.
    for each in set(values) - ({"diffuse"} if name == "zonal_factored" else set()):
        save_file({other: value for other, value in values.items() if other != each}, damaged, metadata)
        assert f"lacks the tensor '{each}': it is damaged, bake it again" in refusal(damaged)


@pytest.mark.parametrize("name", FILES)
def test_names_missing_metadata(tmp_path, name):
    values, metadata = parts(path_of(name))
    damaged = tmp_path / "a.safetensors"
    for each in set(metadata) - {"kind", "format", "conventions"}:
        save_file(values, damaged, {other: value for other, value in metadata.items() if other != each})
        assert f"lacks the metadata '{each}': it is damaged, bake it again" in refusal(damaged)
        save_file(values, damaged, metadata | {each: "nothing of JSON"})
        assert f"lacks the metadata '{each}'" in refusal(damaged)
    for each in ("kind", "format"):
        save_file(values, damaged, {other: value for other, value in metadata.items() if other != each})
        assert "is not a transfer of torchprt" in refusal(damaged)


@pytest.mark.parametrize("name", FILES)
def test_refuses_tensors_of_other_shapes_and_values(tmp_path, untyped, name):
    values, metadata = parts(path_of(name))
    damaged = tmp_path / "a.safetensors"
    # `original` may be empty, `diffuse` too, and beside lobes nothing is read of it.
    for each in set(values) - {"original", "diffuse"}:
        value = values[each]
        for shape in ((*value.shape, 1), (), (value.numel() + 1,)):
            save_file(values | {each: torch.zeros(shape, dtype=value.dtype)}, damaged, metadata)
            refusal(damaged)
        if value.is_floating_point() and value.numel():
            spoilt = value.clone()
            spoilt.view(-1)[0] = torch.nan
            save_file(values | {each: spoilt}, damaged, metadata)
            assert "NaN" in refusal(damaged)


@pytest.mark.parametrize("name", FILES)
def test_refuses_a_file_cut_short(tmp_path, name):
    whole = path_of(name).read_bytes()
    cut = tmp_path / "a.safetensors"
    for length in (0, 7, 100, len(whole) // 2, len(whole) - 1):
        cut.write_bytes(whole[:length])
        assert "is not a whole safetensors file" in refusal(cut)


@pytest.mark.parametrize("kind", ["holographic", "clustered holographic", "wavelet glossy", "zonal diffuse map", ""])
def test_refuses_a_kind_that_it_does_not_know(tmp_path, kind):
    values, metadata = parts(path_of("glossy"))
    save_file(values, tmp_path / "a.safetensors", metadata | {"kind": kind})
    message = refusal(tmp_path / "a.safetensors")
    assert f"kind '{kind}', which this torchprt does not know: update torchprt" in message


def test_refuses_labels_that_name_no_cluster(tmp_path):
    values, metadata = parts(path_of("clustered_glossy"))
    save_file(values | {"label": values["label"] + 2}, tmp_path / "a.safetensors", metadata)
    assert "label of the transfer names clusters that it does not have" in refusal(tmp_path / "a.safetensors")


def test_refuses_what_a_newer_torchprt_wrote(tmp_path):
    for name in FILES:
        values, metadata = parts(path_of(name))
        for newer in ("3", "12", "next"):
            save_file(values, tmp_path / "a.safetensors", metadata | {"format": newer})
            message = refusal(tmp_path / "a.safetensors")
            assert f"has format {newer}, newer than the 2 of this torchprt: update torchprt" in message


def test_what_is_not_glossy_is_kept_beside_what_is():
    transfer = load(path_of("glossy"))
    assert gloss(transfer).receivers.tolist() == parts(path_of("glossy"))[0]["glossy"].tolist()
    assert transfer.layers["diffuse"].receivers is None
