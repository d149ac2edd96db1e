"""Is a transfer that is a map of its file the same as one that was copied, and is nothing copied with it?"""

import copy
import dataclasses
import os
import pickle
import shutil

import pytest
import torch
from contents import differing
from transfers import random_glossy, replaced, same, stored

from torchprt.errors import InputError
from torchprt.shade import shader
from torchprt.transfer import load, save
from torchprt.transfer.layout import FLOATS


@pytest.fixture
def written(make_transfer, tmp_path):
    path = tmp_path / "scene.safetensors"
    save(make_transfer(), path)
    return path


@pytest.mark.parametrize("content", [b"", b"\xff" * 64, b"{}" * 100])
def test_refuses_what_is_no_safetensors_file(tmp_path, content):
    path = tmp_path / "foreign.safetensors"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"foreign\.safetensors is not a whole safetensors file"):
        load(path, mapped=True)


def test_refuses_a_dtype_that_no_transfer_has(written):
    whole = written.read_bytes().replace(b'"F32"', b'"U32"')
    written.write_bytes(whole)
    with pytest.raises(InputError, match="is U32"):
        load(written, mapped=True)


@pytest.mark.parametrize("place", [0, 17, -1])
@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_refuses_a_single_value_that_is_not_finite(make_transfer, tmp_path, place, value, monkeypatch):
    path = tmp_path / "a.safetensors"
    transfer = make_transfer()
    save(transfer, path)
    damaged = stored(transfer).clone()
    damaged.view(-1)[place] = value
    monkeypatch.setattr("torchprt.transfer.transfer.Transfer.check", lambda self: None)
    save(replaced(transfer, values=damaged), path)
    monkeypatch.undo()
    for mapped in (True, False):
        with pytest.raises(InputError, match=r"'diffuse\.signal\.values' of the transfer holds 1 NaN or infinite"):
            load(path, mapped=mapped)
    # Who asks what it is, and not for its numbers, need not wait for them.
    assert differing(load(path, numbers=False), transfer) == {"diffuse.signal.values"}


@pytest.mark.parametrize("dtype", FLOATS)
def test_is_what_was_written(make_transfer, tmp_path, dtype):
    transfer = make_transfer(channels=3, dtype=dtype)
    save(transfer, tmp_path / "a.safetensors")
    assert same(load(tmp_path / "a.safetensors", mapped=True), transfer)


def test_tensors_without_numbers_and_those_that_others_put_anywhere(written, tmp_path):
    """A header of no multiple of eight bytes, as the format allows."""
    whole = written.read_bytes()
    length = int.from_bytes(whole[:8], "little")
    odd = tmp_path / "odd.safetensors"
    odd.write_bytes((length + 3).to_bytes(8, "little") + whole[8 : 8 + length] + b"   " + whole[8 + length :])
    assert same(load(odd, mapped=True), load(written))


def test_what_is_written_into_it_is_not_in_the_file(written):
    before = written.read_bytes()
    mapped = load(written, mapped=True)
    stored(mapped).fill_(7.0)
    assert float(stored(mapped).min()) == 7.0
    assert written.read_bytes() == before


def test_stays_when_another_file_takes_its_place(written, make_transfer):
    mapped, copied = load(written, mapped=True), load(written, mapped=False)
    save(make_transfer(seed=5, channels=3), written)
    assert same(mapped, copied)
    if os.name != "nt":
        written.unlink()
        assert same(mapped, copied)


def test_a_result_takes_the_place_of_the_file_that_it_is_a_map_of(written):
    mapped = load(written, mapped=True)
    save(mapped.to(torch.float16), written)
    assert same(load(written), mapped.to(torch.float16))


def test_what_copies_storages_copies_no_other_tensors(written):
    mapped, copied = load(written, mapped=True), load(written, mapped=False)
    for each in (mapped.receivers, *mapped.layers.values(), *(layer.signal for layer in mapped.layers.values())):
        for value in each.tensors().values():
            assert value.untyped_storage().nbytes() == value.numel() * value.element_size()
    assert len(pickle.dumps(mapped)) == len(pickle.dumps(copied))
    for again in (pickle.loads(pickle.dumps(mapped)), copy.deepcopy(mapped), dataclasses.replace(mapped)):
        assert same(again, copied)


@pytest.mark.parametrize("kind", ["exit", "visibility"])
def test_a_shader_shares_the_memory_of_the_map(kind, tmp_path):
    whole = random_glossy(kind, vertices=20)
    save(whole, tmp_path / "a.safetensors")
    mapped = load(tmp_path / "a.safetensors", mapped=True)
    module = shader(mapped)
    places = {value.untyped_storage().data_ptr() for value in module.buffers()}
    assert stored(mapped).untyped_storage().data_ptr() in places
    light, eye = torch.rand(mapped.order**2, 3), torch.tensor([0.0, 2.0, 5.0])
    assert torch.equal(module(light, eye=eye), shader(whole)(light, eye=eye))


def test_a_file_larger_than_memory_is_mapped(tmp_path):
    """Of zeros that no disk stores; the map of torch cannot be made of it."""
    path, receivers = tmp_path / "large.safetensors", 1 << 10
    from torchprt.transfer import diffuse_transfer

    places = torch.zeros(receivers, 3)
    small = diffuse_transfer(
        torch.zeros(1, 4, receivers), torch.ones(1, 1), places, places, torch.zeros(0, 3, dtype=torch.int32)
    )
    save(small, path)
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 1 << 36
    if memory > 1 << 38 or shutil.disk_usage(tmp_path).total < memory:
        pytest.skip("needs a disk that takes a file larger than memory")
    # As a tensor that nobody reads, at the end.
    count = 2 * memory
    whole = path.read_bytes()
    length = int.from_bytes(whole[:8], "little")
    header = whole[8 : 8 + length].rstrip()[:-1]
    end = len(whole) - 8 - length
    header += b',"unread":{"dtype":"U8","shape":[%d],"data_offsets":[%d,%d]}}' % (count, end, end + count)
    header += b" " * (-len(header) % 8)
    with path.open("wb") as file:
        file.write(len(header).to_bytes(8, "little") + header + whole[8 + length :])
        try:
            file.truncate(8 + len(header) + end + count)
        except OSError:
            pytest.skip("this file system has no files of holes")
    assert same(load(path), small)
