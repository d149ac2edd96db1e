"""Does a light come back from its file, and does a file that is none say so?"""

import numpy as np
import pytest
import torch

from torchprt.errors import InputError
from torchprt.light import read_coefficients, write_coefficients


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.npy"


def light(order, dtype=torch.float32):
    return torch.randn(order**2, 3, generator=torch.Generator().manual_seed(order), dtype=dtype)


def refused(path, *words, order=None):
    with pytest.raises(InputError) as caught:
        read_coefficients(path, order)
    for word in (path.name, *words):
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_refuses_a_file_that_is_missing_or_a_folder(path, tmp_path):
    refused(path, "does not exist")
    refused(tmp_path, "it is a folder")


def test_a_file_that_is_cut_anywhere_is_refused(path):
    write_coefficients(light(3), path)
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        refused(path, "not a whole .npy")


def test_a_file_with_wrong_bytes_in_its_head_is_read_or_refused_but_never_breaks(path):
    write_coefficients(light(2), path)
    content = path.read_bytes()
    random = np.random.default_rng(0)
    refusals = 0
    for _ in range(400):
        damaged = bytearray(content)
        for at in random.integers(0, 128, size=random.integers(1, 4)):
            damaged[at] = random.integers(0, 256)
        path.write_bytes(bytes(damaged))
        try:
            assert read_coefficients(path).shape[1] == 3
        except InputError:
            refusals += 1
    assert refusals > 200


def test_a_head_that_promises_more_than_there_is(path):
    with path.open("wb") as stream:
        head = {"descr": "<f4", "fortran_order": False, "shape": (10**13, 3)}
        np.lib.format.write_array_header_1_0(stream, head)
    refused(path, "not a whole .npy")


@pytest.mark.parametrize(
    "content", [b"", b"PK\3\4" + b"\0" * 60, b"\x93NUMPY", b"\x93NUMPY\x09\x00" + b"\0" * 90, b"x" * 300]
)
def test_refuses_a_foreign_file(path, content):
    path.write_bytes(content)
    refused(path, "not a whole .npy")


def test_refuses_an_archive_of_arrays(path):
    with path.open("wb") as stream:
        np.savez(stream, light=light(2).numpy())
    refused(path, "not a whole .npy")


def test_never_runs_what_a_pickle_says(path, tmp_path):
    class Writes:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    np.save(path, np.array([[Writes()] * 3], dtype=object), allow_pickle=True)
    refused(path, "not a whole .npy")
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("shape", [(), (3,), (48,), (16, 1), (16, 4), (3, 16), (1, 16, 3), (4, 4, 3)])
def test_refuses_another_shape(path, shape):
    np.save(path, np.zeros(shape))
    refused(path, str(list(shape)), "[order^2, 3]")


@pytest.mark.parametrize("count", [0, 2, 15, 17])
def test_refuses_a_count_that_is_no_square(path, count):
    np.save(path, np.zeros((count, 3)))
    refused(path, f"{count} coefficients")


@pytest.mark.parametrize("dtype", [complex, bool, "U3", "datetime64[s]"])
def test_refuses_what_is_no_number(path, dtype):
    np.save(path, np.zeros((4, 3), dtype=dtype))
    refused(path, str(np.dtype(dtype)))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_refuses_what_is_not_finite_in_float32(path, value):
    values = np.zeros((4, 3))
    values[2, 1] = value
    np.save(path, values)
    refused(path, "NaN or infinite")


def test_refuses_another_order_and_names_both(path):
    write_coefficients(light(3), path)
    refused(path, "order 3", "order 5", "--order 5", order=5)
    assert len(read_coefficients(path, 3)) == 9


@pytest.mark.parametrize("order", [1, 2, 5, 32])
def test_comes_back_bit_for_bit(path, order):
    write_coefficients(light(order), path)
    assert torch.equal(read_coefficients(path, order), light(order))
    assert np.load(path).dtype == np.float32


@pytest.mark.parametrize("dtype", [np.float16, np.float64, ">f4", np.int32, np.uint8])
def test_any_kind_of_number_is_read_as_float32(path, dtype):
    values = np.arange(12).reshape(4, 3)
    for stored in (values.astype(dtype), np.asfortranarray(values.astype(dtype))):
        np.save(path, stored)
        found = read_coefficients(path)
        assert found.dtype == torch.float32
        assert torch.equal(found, torch.from_numpy(values).float())


def test_writes_what_carries_gradients_or_is_a_view(path):
    whole = light(4, torch.float64).requires_grad_()
    write_coefficients(whole[:9], path)
    assert torch.equal(read_coefficients(path), whole[:9].detach().float())


def test_any_name_is_written_as_it_is_and_nothing_beside_it(tmp_path):
    for name in ("a.npy", "b.NPY", "c.light", "d"):
        write_coefficients(light(2), tmp_path / name)
        assert torch.equal(read_coefficients(tmp_path / name), light(2))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npy", "b.NPY", "c.light", "d"]


def test_a_light_that_cannot_be_written_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_coefficients(light(2), tmp_path / "none" / "a.npy")
    assert not list(tmp_path.iterdir())
