"""Is a transfer that is written a piece at a time the file that the library of its format would make?"""

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from torchprt.errors import InputError
from torchprt.transfer import Dense, Diffuse, Transfer, Vertices, load, pieces, save
from torchprt.transfer.written import Entry, write_pieces

TENSORS = {
    "vectors": torch.randn(3, 4, 50, generator=torch.Generator().manual_seed(0)),
    # As a bake leaves them: receivers first, seen with receivers last.
    "turned": torch.randn(50, 12, generator=torch.Generator().manual_seed(1)).view(50, 3, 4).permute(1, 2, 0),
    "strided": torch.arange(60.0).view(10, 6)[::2, 1:4],
    "index": torch.arange(7, dtype=torch.int32),
    "long": torch.arange(5),
    "half": torch.arange(9.0).to(torch.float16),
    "brain": torch.arange(9.0).to(torch.bfloat16),
    "bytes": torch.arange(5, dtype=torch.uint8),
    "empty": torch.zeros(0, 3),
    "number": torch.tensor(2.5, dtype=torch.float64),
}


def written(path, tensors, dtype=None):
    with path.open("wb") as file:
        write_pieces(file, {name: Entry(each, dtype or each.dtype) for name, each in tensors.items()}, {"kind": "a"})
    return path


def test_values_that_a_narrow_type_cannot_hold_are_refused(tmp_path):
    with pytest.raises(InputError, match="'large' of the transfer holds values too large for float16"):
        written(tmp_path / "a", {"large": torch.tensor([1.0, 1e6])}, torch.float16)


@pytest.mark.parametrize("numbers", [1, 7, 100, 1 << 22])
def test_pieces_are_the_whole_and_each_number_once(numbers):
    for value in TENSORS.values():
        count = torch.zeros(value.shape, dtype=torch.int64)
        for place in pieces.pieces(value, numbers):
            count[place] += 1
            assert value[place].numel() <= numbers
        assert bool((count == 1).all())


@pytest.mark.parametrize("numbers", [1, 7, 100, 1 << 22])
def test_the_library_reads_what_was_written(numbers, tmp_path, monkeypatch):
    monkeypatch.setattr(pieces, "NUMBERS", numbers)
    path = written(tmp_path / "a.safetensors", TENSORS)
    found = load_file(path)
    assert found.keys() == TENSORS.keys()
    for name, value in TENSORS.items():
        assert found[name].dtype == value.dtype
        assert torch.equal(found[name], value)
    with safe_open(path, "pt") as file:
        assert file.metadata() == {"kind": "a"}


def test_the_same_is_the_same_bytes_however_it_is_cut(tmp_path, monkeypatch):
    whole = written(tmp_path / "a", TENSORS).read_bytes()
    monkeypatch.setattr(pieces, "NUMBERS", 5)
    assert written(tmp_path / "b", TENSORS).read_bytes() == whole


def test_a_type_that_is_asked_for_is_that_of_the_whole_converted(tmp_path):
    g = torch.Generator().manual_seed(2)
    normals = torch.nn.functional.normalize(torch.randn(20, 3, generator=g), dim=-1)
    layer = Diffuse(albedo=torch.full((1, 1), 0.5), signal=Dense(values=torch.randn(1, 9, 20, generator=g)))
    receivers = Vertices(positions=normals, normals=normals, faces=torch.zeros(0, 3, dtype=torch.int32))
    transfer = Transfer(receivers=receivers, layers={"diffuse": layer})
    save(transfer, tmp_path / "a.safetensors", dtype=torch.float16)
    save(transfer.to(torch.float16), tmp_path / "b.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    assert load(tmp_path / "a.safetensors").layers["diffuse"].albedo.dtype == torch.float32
