"""Does a transfer come back from its file as it went, and is everything else refused by name?"""

import json
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from transfers import gloss, random_glossy, replaced, same, stored

from torchprt.errors import InputError
from torchprt.transfer import FORMAT, load, save
from torchprt.transfer.layout import FLOATS


@pytest.fixture
def written(make_transfer, tmp_path):
    path = tmp_path / "scene.safetensors"
    save(make_transfer(), path)
    return path


def parts(path):
    """Tensors and metadata of a file, to be damaged."""
    with safe_open(path, framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata())  # noqa: SIM118


def test_refuses_a_file_that_does_not_exist(tmp_path):
    with pytest.raises(InputError, match=r"none\.safetensors does not exist"):
        load(tmp_path / "none.safetensors")


def test_refuses_a_folder(tmp_path, make_transfer):
    with pytest.raises(InputError, match="it is a folder"):
        load(tmp_path)
    folder = tmp_path / "folder.safetensors"
    folder.mkdir()
    with pytest.raises(InputError, match=r"folder\.safetensors is a folder"):
        save(make_transfer(), folder)


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\n", b"\0" * 64, b"\xff" * 64, b"{}" * 100])
def test_refuses_an_empty_or_foreign_file(tmp_path, content):
    path = tmp_path / "foreign.safetensors"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"foreign\.safetensors is not a whole safetensors file"):
        load(path)


def test_refuses_safetensors_of_someone_else(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_file({"weight": torch.zeros(3)}, path)
    with pytest.raises(InputError, match="not a transfer"):
        load(path)


def test_refuses_a_file_cut_short_anywhere(written, tmp_path):
    whole = written.read_bytes()
    cut = tmp_path / "cut.safetensors"
    # Every length within the header, and a spread of lengths within the tensors.
    lengths = [*range(64), *range(64, len(whole), 211), len(whole) - 1]
    for length in lengths:
        cut.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"cut\.safetensors"):
            load(cut)


@pytest.mark.parametrize("name", ["diffuse.signal.values", "diffuse.albedo", "positions", "normals", "faces"])
def test_names_a_missing_tensor(written, name):
    values, metadata = parts(written)
    del values[name]
    save_file(values, written, metadata=metadata)
    with pytest.raises(InputError, match=f"lacks the tensor '{name}'"):
        load(written)


@pytest.mark.parametrize(
    "name", ["transport", "bounces", "rays", "seed", "error", "signal", "version", "receivers", "layers"]
)
def test_names_missing_metadata(written, name):
    values, metadata = parts(written)
    del metadata[name]
    save_file(values, written, metadata=metadata)
    with pytest.raises(InputError, match=f"lacks the metadata '{name}'"):
        load(written)


def test_names_metadata_that_is_not_json(written):
    values, metadata = parts(written)
    save_file(values, written, metadata=metadata | {"rays": "many"})
    with pytest.raises(InputError, match="metadata 'rays'"):
        load(written)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"format": str(FORMAT + 1)}, f"format {FORMAT + 1}, newer than the {FORMAT}.*update torchprt"),
        ({"format": "next"}, "format next"),
        ({"receivers": '{"kind": "voxels"}'}, "receivers of kind 'voxels' is unknown .*: update torchprt"),
        (
            {
                "layers": '[{"name": "diffuse", "kind": "holographic", "signal": '
                '{"kind": "dense", "tensors": ["values"]}}]'
            },
            "layer of kind 'holographic' is unknown to this torchprt: update torchprt",
        ),
        (
            {"layers": '[{"name": "diffuse", "kind": "diffuse", "signal": {"kind": "wavelet"}}]'},
            "signal of kind 'wavelet' is unknown to this torchprt: update torchprt",
        ),
    ],
)
def test_refuses_what_a_newer_torchprt_wrote(written, entries, message):
    values, metadata = parts(written)
    save_file(values, written, metadata=metadata | entries)
    with pytest.raises(InputError, match=message):
        load(written)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("diffuse.signal.values", torch.zeros(1, 16, 25, dtype=torch.int8), "int8"),
        ("diffuse.signal.values", torch.zeros(1, 17, 25), "17 coefficients"),
        ("diffuse.signal.values", torch.full((1, 16, 25), torch.nan), "'diffuse.signal.values' .* holds 400 NaN"),
        ("diffuse.albedo", torch.zeros(7, 3), "about 7 receivers, but its signal holds 25"),
        ("positions", torch.full((25, 3), -torch.inf), "'positions' .* infinite"),
        ("faces", torch.tensor([[0, 1, 99]]), "name vertices"),
    ],
)
def test_names_the_file_and_the_tensor_at_fault(written, name, value, message):
    values, metadata = parts(written)
    save_file(values | {name: value}, written, metadata=metadata)
    with pytest.raises(InputError, match=rf"scene\.safetensors: .*{message}"):
        load(written)


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("channels", [1, 3])
def test_comes_back_bit_for_bit(make_transfer, tmp_path, dtype, channels):
    transfer = make_transfer(
        channels=channels, dtype=dtype, transport="interreflected", bounces=2, rays=512, seed=7, error=1e-3,
        signal=0.25, version="0.1.0",
    )  # fmt: skip
    save(transfer, tmp_path / "a.safetensors")
    assert same(load(tmp_path / "a.safetensors"), transfer)


@pytest.mark.parametrize(
    "entries",
    [
        {"layers": "5"},
        {"layers": "null"},
        {"layers": "[[]]"},
        {"layers": '[{"kind": "diffuse", "signal": {"kind": "dense"}}]'},
        {"layers": '[{"name": "diffuse", "kind": "diffuse"}]'},
        {"layers": '[{"name": "diffuse", "kind": "diffuse", "signal": {"kind": "dense", "lobes": 3}}]'},
        {"receivers": "{}"},
        {"receivers": '{"kind": "texels", "rows": "many", "columns": 5}'},
    ],
)
def test_refuses_metadata_that_say_something_else(written, entries):
    values, metadata = parts(written)
    save_file(values, written, metadata=metadata | entries)
    with pytest.raises(InputError, match=r"(?s)scene\.safetensors has damaged metadata \(.*\): bake it again"):
        load(written)


def test_refuses_no_layers(written):
    values, metadata = parts(written)
    save_file(values, written, metadata=metadata | {"layers": "[]"})
    with pytest.raises(InputError, match=r"scene\.safetensors: the transfer has no layer"):
        load(written)


def test_layers_that_share_tensors_are_written(tmp_path):
    transfer = random_glossy(glossy=4)
    shared = transfer.with_layers(coat=gloss(transfer).replace(signal=gloss(transfer).signal.take(torch.arange(4))))
    save(shared, tmp_path / "a.safetensors")
    assert same(load(tmp_path / "a.safetensors"), shared)


@pytest.mark.parametrize("side", [0, 1])
def test_no_vertex_and_one_vertex_come_back(make_transfer, tmp_path, side):
    save(make_transfer(side=side), tmp_path / "a.safetensors")
    assert load(tmp_path / "a.safetensors").vertices == side


def test_extreme_values_come_back(make_transfer, tmp_path):
    transfer = make_transfer()
    stored(transfer)[0, :, :3] = torch.tensor([1e-30, -1e30, torch.finfo(torch.float32).max])
    save(transfer, tmp_path / "a.safetensors")
    assert torch.equal(stored(load(tmp_path / "a.safetensors")), stored(transfer))


def test_tensors_that_are_views_or_need_gradients_are_written(make_transfer, tmp_path):
    transfer = make_transfer()
    view = replaced(transfer, values=stored(transfer).mT.contiguous().mT.requires_grad_())
    save(view, tmp_path / "a.safetensors")
    assert torch.equal(stored(load(tmp_path / "a.safetensors")), stored(transfer))


def test_metadata_are_readable_without_torchprt(written):
    _, metadata = parts(written)
    assert metadata["kind"] == "diffuse"
    assert metadata["format"] == str(FORMAT)
    assert "Condon-Shortley" in metadata["conventions"]
    assert json.loads(metadata["transport"]) == "shadowed"
    assert json.loads(metadata["receivers"]) == {"kind": "vertices", "tensors": ["positions", "normals", "faces"]}
    signal = {"kind": "dense", "tensors": ["values"]}
    assert json.loads(metadata["layers"]) == [
        {"name": "diffuse", "kind": "diffuse", "tensors": ["albedo"], "signal": signal}
    ]


def test_refuses_two_layers_of_one_name(written):
    values, metadata = parts(written)
    metadata["layers"] = json.dumps(2 * json.loads(metadata["layers"]))
    save_file(values, written, metadata=metadata)
    with pytest.raises(InputError, match="two layers are called 'diffuse'"):
        load(written)


@pytest.mark.parametrize("number", ["0", "²", "-1", "1.0", ""])
def test_refuses_what_is_no_format(number, written):
    values, metadata = parts(written)
    save_file(values, written, metadata=metadata | {"format": number})
    with pytest.raises(InputError, match="update torchprt"):
        load(written)


def test_refuses_another_suffix_and_writes_nothing(make_transfer, tmp_path):
    with pytest.raises(InputError, match=r"scene\.pt must end in \.safetensors"):
        save(make_transfer(), tmp_path / "scene.pt")
    assert list(tmp_path.iterdir()) == []


def test_refuses_values_that_are_not_finite_and_keeps_the_old_file(make_transfer, written):
    before = written.read_bytes()
    transfer = make_transfer()
    stored(transfer)[0, 0, 0] = torch.nan
    with pytest.raises(InputError, match="holds 1 NaN"):
        save(transfer, written)
    assert written.read_bytes() == before
    assert [path.name for path in written.parent.iterdir()] == [written.name]


def test_a_failure_while_writing_leaves_the_old_file_alone(make_transfer, written, monkeypatch):
    def half(file, entries, metadata):
        file.write(b"half")
        raise OSError("disk full")

    before = written.read_bytes()
    monkeypatch.setattr("torchprt.transfer.file.write_pieces", half)
    with pytest.raises(InputError, match="disk full"):
        save(make_transfer(seed=1), written)
    assert written.read_bytes() == before
    assert [path.name for path in written.parent.iterdir()] == [written.name]


def test_what_was_read_stays_when_the_file_is_overwritten_in_its_place(written):
    """As `cp` does; a map of the file would change, or end the process where the file is shorter."""
    transfer = load(written)
    before = stored(transfer).clone()
    with written.open("r+b") as file:
        file.write(bytes(written.stat().st_size))
    assert torch.equal(stored(transfer), before)


def test_refuses_a_folder_that_is_missing(make_transfer, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        save(make_transfer(), tmp_path / "nowhere" / "a.safetensors")


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that even root may not write")
def test_refuses_a_folder_that_must_not_be_written(make_transfer):
    with pytest.raises(InputError, match="cannot be written"):
        save(make_transfer(), "/proc/self/a.safetensors")
