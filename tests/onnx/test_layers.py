"""Do all layers with all signals shade as they are defined, alone and beside each other, and their files as well?"""

import functools
import itertools

import onnxruntime
import pytest
import torch
from transfers import KINDS, by_definition, gloss, random_glossy, replaced
from zonal_transfers import bumpy, turns, vectors_by_definition

from torchprt.compression import compress, decompress, fit
from torchprt.errors import InputError
from torchprt.onnx import describe, export
from torchprt.onnx.parity import tolerance
from torchprt.shade import at_rest, shader
from torchprt.transfer import Dense, Transfer

pytestmark = pytest.mark.usefixtures("untyped")

ORDER, SIDE, GLOSSY = 3, 4, 11
EXPONENT = torch.linspace(0.5, 30, GLOSSY)
REFUSED = ("visibility", "zonal")
SIGNALS = ("dense", "clustered", "zonal")
CELLS = [cell for cell in itertools.product(("diffuse", *KINDS), SIGNALS) if cell != REFUSED]
VIEW = torch.tensor([1.0, 2.0, -0.5])


def whole(kind="exit"):
    """A layer of `kind` over a diffuse one, on a mesh."""
    made = random_glossy(kind, SIDE**2, GLOSSY, order=ORDER, output_order=2, dtype=torch.float64)
    positions, faces = bumpy(SIDE)
    return replaced(made, positions=positions, faces=faces)


def alone(transfer, name):
    return Transfer(receivers=transfer.receivers, layers={name: transfer.layers[name]})


@functools.cache
def cell(layer, signal):
    """Transfer of one layer, with one signal."""
    transfer = alone(whole("exit" if layer == "diffuse" else layer), layer)
    if signal == "clustered":
        return compress(transfer, clusters=3, components=2)
    return fit(transfer, lobes=1) if signal == "zonal" else transfer


def choices(transfer):
    return {"exponent": EXPONENT} if "reflectance" in transfer.needs else {}


def light(seed=1):
    return torch.randn(ORDER**2, 3, generator=torch.Generator().manual_seed(seed))


def written_out(transfer, frames=None):
    """The transfer with every number of every layer, in a pose, float64; where the receivers have turned to, too."""
    transfer = decompress(transfer.to(torch.float64)) if "clustered" in transfer.kind else transfer
    turned = torch.eye(3).expand(transfer.vertices, 3, 3) if frames is None else frames
    for name, layer in transfer.layers.items():
        if layer.signal.kind == "zonal":
            own = turned[layer.index(transfer.vertices)]
            rows = [vectors_by_definition(transfer, own, name, row) for row in range(layer.signal.shape[2])]
            matrices = torch.stack(rows).permute(1, 3, 0, 2)
            values = rows[0] if name == "diffuse" else matrices
            transfer = transfer.with_layers(**{name: layer.replace(signal=Dense(values=values))})
        if "eye" in layer.needs:
            own = turned[layer.index(transfer.vertices)].double()
            tangents = (own @ layer.tangents.double().unsqueeze(-1)).squeeze(-1)
            transfer = transfer.with_layers(**{name: transfer.layers[name].replace(tangents=tangents)})
    normals = (turned.double() @ transfer.normals.double().unsqueeze(-1)).squeeze(-1)
    return replaced(transfer, normals=normals)


def defined(transfer, light, view, frames=None):
    """Exit radiance [V, 3], a receiver after the other, of every layer by itself."""
    radiance = torch.zeros(transfer.vertices, 3, dtype=torch.float64)
    for name in transfer.layers:
        part = written_out(alone(transfer, name), frames)
        if name == "diffuse":
            vectors = part.layers[name].signal.values.double().expand(3, -1, -1)
            radiance += part.albedo.double() * torch.einsum("cnv,nc->vc", vectors, light.double())
        else:
            chosen = EXPONENT if "reflectance" in part.needs else None
            radiance += by_definition(part, light, view=view, exponent=chosen)
    return radiance


def same(found, wanted, epsilon):
    return (found - wanted).abs().max() <= epsilon * wanted.abs().max()


def run(path, **inputs):
    """Radiance [V, 3] in ONNX Runtime of one light, not turned."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    single = {name: value.numpy() for name, value in inputs.items() if name in ("frames", "positions")}
    feed = single | {name: value[None].numpy() for name, value in inputs.items() if name not in single}
    if "light" in feed:
        feed["rotation"] = torch.eye(3)[None].numpy()
    return torch.from_numpy(session.run(["radiance"], feed)[0])[0].double()


def named(about):
    """Of what a file says of its layers, what they are."""
    return [{key: layer[key] for key in ("name", "kind", "signal")} for layer in about["layers"]]


# One layer with one signal


def test_lobes_of_visibility_are_refused_and_it_is_said_why():
    with pytest.raises(InputError, match=r"visibility has no lobes: .* turn with its frame, .* bake with factors"):
        cell(*REFUSED)


@pytest.mark.parametrize(("layer", "signal"), CELLS)
def test_every_layer_with_every_signal_shades_as_it_is_defined(layer, signal):
    transfer = cell(layer, signal)
    assert transfer.kind == (layer if signal == "dense" else f"{signal} {layer}")
    module = shader(transfer, dtype=torch.float64, **choices(transfer))
    view = {"view": VIEW.double()} if "eye" in transfer.needs else {}
    # Sums of some hundred products of float64.
    assert same(module(light().double(), **view), defined(transfer, light(), VIEW), 1e-12)
    if signal == "zonal":
        frames = turns(SIDE**2)
        found = module(light().double(), frames=frames.double(), **view)
        # Frames are rotations to single precision.
        assert same(found, defined(transfer, light(), VIEW, frames), 1e-6)


@pytest.mark.parametrize(("layer", "signal"), CELLS)
def test_every_layer_with_every_signal_has_a_file_that_computes_the_same(layer, signal, tmp_path):
    transfer = cell(layer, signal)
    report = export(transfer, tmp_path / "a.onnx", **choices(transfer))
    assert report.parity.passed
    more = {
        frozenset(): [],
        frozenset({"eye"}): ["eye"],
        frozenset({"pose"}): ["frames"],
        frozenset({"eye", "pose"}): ["eye", "positions"],
    }[transfer.needs - {"reflectance"}]
    assert list(report.inputs) == ["light", "rotation", *more]
    about = describe(tmp_path / "a.onnx")
    assert (about["kind"], about["format"]) == (transfer.kind, 2)
    assert named(about) == [{"name": layer, "kind": layer, "signal": signal}]


@pytest.mark.parametrize("kind", ["exit", "incident"])
@pytest.mark.parametrize("pose", ["frames", "positions"])
def test_lobes_of_many_rows_follow_frames_and_positions_in_a_file(kind, pose, tmp_path):
    transfer = fit(whole(kind), lobes=1)
    report = export(transfer, tmp_path / "a.onnx", eye="direction", pose=pose, **choices(transfer))
    assert report.parity.passed
    assert list(report.inputs) == ["light", "rotation", "view", pose]
    if pose == "frames":
        frames = turns(SIDE**2)
        found = run(tmp_path / "a.onnx", light=light(), view=VIEW, frames=frames)
        module = shader(transfer, **choices(transfer))
        # Parity's own bound, and that frames are rotations to single precision.
        assert same(found, defined(transfer, light(), VIEW, frames), tolerance(ORDER, module) + 1e-6)


# Layers beside each other


def test_a_file_says_what_its_layers_are(tmp_path):
    transfer = compress(whole(), layer="diffuse", clusters=3, components=2)
    export(transfer, tmp_path / "a.onnx", check=False)
    about = describe(tmp_path / "a.onnx")
    assert (about["kind"], about["format"]) == ("clustered diffuse + exit", 2)
    assert named(about) == [
        {"name": "diffuse", "kind": "diffuse", "signal": "clustered"},
        {"name": "exit", "kind": "exit", "signal": "dense"},
    ]
    assert (about["glossy"], about["output_order"]) == (GLOSSY, 2)


def test_what_depends_on_the_eye_is_told_wherever_it_stands(tmp_path):
    transfer = Transfer(receivers=whole().receivers, layers=dict(reversed(whole().layers.items())))
    assert transfer.kind == "exit + diffuse"
    export(transfer, tmp_path / "a.onnx", check=False)
    about = describe(tmp_path / "a.onnx")
    assert [layer["name"] for layer in about["layers"]] == ["exit", "diffuse"]
    assert (about["glossy"], about["specular"], about["output_order"]) == (GLOSSY, "applied, one a receiver", 2)


@pytest.mark.parametrize("kind", KINDS)
def test_clusters_of_one_layer_stand_beside_those_of_another(kind, tmp_path):
    transfer = compress(whole(kind), layer="diffuse", clusters=2, components=2)
    transfer = compress(transfer, layer=kind, clusters=3, components=1)
    assert transfer.kind == f"clustered diffuse + clustered {kind}"
    assert export(transfer, tmp_path / "a.onnx", eye="direction", **choices(transfer)).parity.passed
    found, wanted = run(tmp_path / "a.onnx", light=light(), view=VIEW), defined(transfer, light(), VIEW)
    assert same(found, wanted, tolerance(ORDER, shader(transfer, **choices(transfer))))


def two_eye_layers():
    """Exit matrices of some receivers and factored ones of others, which share some, over a diffuse layer."""
    first = whole()
    second = random_glossy("factored", SIDE**2, order=ORDER, dtype=torch.float64).layers["factored"]
    others = torch.arange(6, SIDE**2)
    assert 0 < torch.isin(others, gloss(first).receivers).sum() < len(others)
    return first.with_layers(factored=second.take(others, others))


@pytest.mark.parametrize("fixed", [{}, {"fix_light": light()}, {"fix_eye": VIEW}], ids=["all", "light", "eye"])
def test_two_layers_that_depend_on_the_eye_are_one_graph(fixed, tmp_path):
    transfer = two_eye_layers()
    report = export(transfer, tmp_path / "a.onnx", eye="direction", **fixed)
    assert report.parity.passed
    inputs = {name: value for name, value in (("light", light()), ("view", VIEW)) if name in report.inputs}
    found, wanted = run(tmp_path / "a.onnx", **inputs), defined(transfer, light(), VIEW)
    assert same(found, wanted, tolerance(ORDER, shader(transfer)))


@pytest.mark.parametrize("fixed", [{}, {"fix_light": light()}], ids=["all", "light"])
def test_a_layer_without_receivers_is_left_out(fixed, tmp_path):
    none = torch.arange(0)
    transfer = two_eye_layers()
    transfer = transfer.with_layers(exit=transfer.layers["exit"].take(none, none))
    report = export(transfer, tmp_path / "a.onnx", eye="direction", **fixed)
    assert report.parity.passed
    inputs = {name: value for name, value in (("light", light()), ("view", VIEW)) if name in report.inputs}
    found, wanted = run(tmp_path / "a.onnx", **inputs), defined(transfer, light(), VIEW)
    assert same(found, wanted, tolerance(ORDER, shader(transfer)))


@pytest.mark.parametrize("kind", ["exit", "incident"])
@pytest.mark.parametrize("still", ["dense", "clustered"])
def test_lobes_beside_a_layer_that_stands_still_stand_still(kind, still, tmp_path):
    transfer = whole(kind)
    if still == "clustered":
        transfer = compress(transfer, layer="diffuse", clusters=2, components=2)
    transfer = transfer.with_layers(**{kind: fit(alone(whole(kind), kind), lobes=1).layers[kind]})
    assert "pose" not in transfer.needs
    with pytest.raises(InputError, match=r"pose is given, but .* does not deform"):
        export(transfer, tmp_path / "a.onnx", pose="frames", **choices(transfer))
    report = export(transfer, tmp_path / "a.onnx", eye="direction", **choices(transfer))
    assert list(report.inputs) == ["light", "rotation", "view"]
    assert report.parity.passed
    found, wanted = run(tmp_path / "a.onnx", light=light(), view=VIEW), defined(transfer, light(), VIEW)
    assert same(found, wanted, tolerance(ORDER, shader(transfer, **choices(transfer))))
    assert at_rest(transfer).kind == f"{'' if still == 'dense' else 'clustered '}diffuse + {kind}"
