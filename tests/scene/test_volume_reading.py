"""Do volumes come in from files as they were written, where the files place them, and are bad ones refused in words?"""

import importlib
import struct

import numpy as np
import pytest
import torch

from torchprt.errors import InputError
from torchprt.scene import read_volume
from torchprt.scene.volume_grid import chosen, placed


@pytest.fixture
def density():
    values = np.zeros((6, 5, 7), np.float32)
    values[1:4, 2:4, 3:6] = np.random.default_rng(0).uniform(1, 2, (3, 2, 3))
    return values


@pytest.fixture
def save(tmp_path):
    def save(array=None, **arrays):
        path = tmp_path / ("a.npz" if arrays else "a.npy")
        if arrays:
            np.savez(path, **arrays)
        else:
            np.save(path, array)
        return path

    return save


def header_alone(path, shape, dtype="<f4"):
    """An .npy that ends where its numbers should begin."""
    with path.open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return path


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.full((2, 2, 2), np.nan), "NaN or infinite"),
        (np.full((2, 2, 2), 1e300), "NaN or infinite"),
        (np.full((2, 2, 2), -1.0), "down to -1"),
        (np.zeros((2, 2, 2)), "empty"),
        (np.zeros((2, 0, 2)), "one cell or more"),
        (np.ones((2, 2)), "one cell or more"),
        (np.ones((2, 2, 2, 3)), "2 or 4"),
        (np.full((2, 2, 2, 2), 1.5), "1.5 to 1.5"),
        (np.full((2, 2, 2, 2), (1.0, np.nan)), "nan"),
        (np.array(["a"]), "no|not a whole"),
    ],
)
def test_refuses_arrays_that_are_no_volume(save, values, said):
    with pytest.raises(InputError, match=said) as refused:
        read_volume(save(values))
    assert "a.npy" in str(refused.value)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"albedo": np.ones(3)}, "give extinction or density"),
        ({"density": np.ones((1, 1, 1)), "extinction": np.ones((1, 1, 1))}, "give extinction or density"),
        ({"density": np.ones((1, 1, 1)), "albdo": np.ones(3)}, "albdo"),
        ({"density": np.ones((2, 2, 2)), "albedo": np.ones((2, 2, 1, 1))}, r"\[2, 2, 1, 1\]"),
        ({"density": np.ones((2, 2, 2)), "spacing": np.ones(2)}, "one number, or three"),
        ({"density": np.ones((2, 2, 2)), "spacing": 0.0}, "no extent"),
        ({"density": np.ones((2, 2, 2)), "phase": 1.5}, "in \\(-1, 1\\)"),
    ],
)
def test_refuses_archives_that_hold_something_else(save, arrays, said):
    with pytest.raises(InputError, match=said):
        read_volume(save(**arrays))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"scale": 0}, "above 0"),
        ({"scale": np.inf}, "above 0"),
        ({"coarsen": 0}, "from 1"),
        ({"grid": "density"}, "no names of grids"),
        ({"albedo": 1.2}, "1.2"),
        ({"spacing": -1}, "no extent"),
        ({"origin": (np.nan, 0, 0)}, "finite"),
    ],
)
def test_refuses_options_that_say_nothing(save, density, options, said):
    with pytest.raises(InputError, match=said):
        read_volume(save(density), **options)


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY", b"NanoVDB0", b" BDV", b"PK\x03\x04", b"#?RADIANCE\n"])
@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_refuses_files_that_are_damaged_or_others(tmp_path, content, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"a{suffix} is"):
        read_volume(path)


def test_refuses_what_is_no_file_of_a_volume(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_volume(tmp_path / "a.npy")
    for suffix, said in ((".ply", "a mesh, not a volume"), (".raw", "ends in .npy")):
        (tmp_path / f"a{suffix}").write_bytes(b"x")
        with pytest.raises(InputError, match=said):
            read_volume(tmp_path / f"a{suffix}")


def test_a_grid_that_no_memory_holds_is_refused_before_it_is_read(tmp_path):
    with pytest.raises(InputError, match=r"a\.npy has 8192 x 8192 x 8192 cells, which take 4\d{3} GB"):
        read_volume(header_alone(tmp_path / "a.npy", (8192, 8192, 8192)))
    # Coarser it would fit, but the numbers are not there.
    with pytest.raises(InputError, match="not a whole"):
        read_volume(header_alone(tmp_path / "a.npy", (4096, 4096, 4096)), coarsen=32)


def test_an_array_is_extinction_without_the_empty_cells_around_it(save, density):
    found = read_volume(save(density), scale=3, spacing=(1, 2, 0.5), origin=(10, 20, 30), phase=0.5)
    torch.testing.assert_close(found.extinction, torch.from_numpy(density[1:4, 2:4, 3:6] * 3))
    assert found.origin == (11.0, 24.0, 31.5)
    assert found.spacing == (1.0, 2.0, 0.5)
    assert found.moments[1] == 0.5
    assert found.albedo.tolist() == [[1.0]]


@pytest.mark.parametrize("kind", [np.float16, np.float64, ">f4", np.uint8])
def test_numbers_of_any_kind_are_read(save, kind):
    values = np.arange(1, 9).reshape(2, 2, 2)
    found = read_volume(save(np.asfortranarray(values.astype(kind))))
    assert torch.equal(found.extinction, torch.from_numpy(values).float())


@pytest.mark.parametrize("channels", [1, 3])
def test_albedo_stays_with_its_cells_and_an_option_stands_in_its_place(save, density, channels):
    albedo = np.random.default_rng(1).uniform(0, 1, (*density.shape, channels)).astype(np.float32)
    expected = torch.from_numpy(albedo[1:4, 2:4, 3:6].reshape(-1, channels))
    behind = save(np.concatenate([density[..., None], albedo], -1))
    for found in (read_volume(behind), read_volume(save(extinction=density, albedo=albedo))):
        torch.testing.assert_close(found.albedo, expected)
    assert read_volume(behind, albedo=0.25).albedo.tolist() == [[0.25]]
    found = read_volume(save(density=density, albedo=[0.1, 0.2, 0.3], origin=[1, 2, 3], spacing=0.5, phase=[1.0, 0.25]))
    torch.testing.assert_close(found.albedo, torch.tensor([[0.1, 0.2, 0.3]]))
    assert found.origin == (1.5, 3.0, 4.5)
    assert found.moments == (1.0, 0.25)


def test_coarse_cells_take_as_much_light_and_scatter_as_much_of_it(save, density):
    albedo = np.random.default_rng(1).uniform(0, 1, (*density.shape, 3)).astype(np.float32)
    path = save(extinction=density, albedo=albedo)
    fine, coarse = read_volume(path), read_volume(path, coarsen=2)
    assert coarse.spacing == (2.0, 2.0, 2.0)
    for axis in range(3):
        assert coarse.origin[axis] <= fine.origin[axis]
        assert coarse.origin[axis] % 2 == 0
    assert 8 * float(coarse.extinction.sum()) == pytest.approx(float(fine.extinction.sum()), rel=1e-6)
    scattered = [(each.extinction.flatten()[:, None] * each.albedo).sum(0) for each in (fine, coarse)]
    torch.testing.assert_close(8 * scattered[1], scattered[0])


@pytest.mark.parametrize(
    ("linear", "said"),
    [(np.ones((3, 3)), "turned or sheared"), (np.diag([1.0, 1.0, 0.0]), "turned or sheared")],
)
def test_refuses_grids_that_do_not_stand_along_the_axes(tmp_path, linear, said):
    with pytest.raises(InputError, match=said):
        placed(tmp_path, linear, np.zeros(3), [0, 0, 0], [1, 1, 1], lambda low, high: np.zeros(1))


def test_axes_that_are_exchanged_or_reversed_come_to_stand_where_the_file_says(tmp_path, density):
    # z up to y up, cells of three sizes, cell (2, 3, 4) the first.
    linear, shift = np.array([[0.5, 0, 0], [0, 0, 2.0], [0, -1.0, 0]]), np.array([10.0, 20.0, 30.0])
    low = [2, 3, 4]
    high = [at + size - 1 for at, size in zip(low, density.shape, strict=True)]

    def read(first, last):
        return density[tuple(slice(a - at, b - at + 1) for a, b, at in zip(first, last, low, strict=True))]

    for turned in (linear, linear * [[-1], [1], [1]]):
        grid = placed(tmp_path, turned, shift, low, high, read)
        values = np.concatenate([grid.sheets(start, min(start + 2, 6))[0] for start in range(0, 6, 2)])
        assert values.shape == grid.shape == (6, 7, 5)
        for cell in np.argwhere(density):
            middle = turned @ (cell + low) + shift
            place = (middle - grid.origin) / grid.spacing - 0.5
            np.testing.assert_allclose(place, place.round(), atol=1e-9)
            assert values[tuple(place.round().astype(int))] == density[tuple(cell)]


def test_the_grid_is_the_one_asked_for_the_only_one_or_density(tmp_path):
    assert chosen(tmp_path, ["heat"], None) == 0
    assert chosen(tmp_path, ["heat", "density"], None) == 1
    assert chosen(tmp_path, ["density", "heat"], "heat") == 1
    for names, asked, said in (([], None, "no grid of floats"), (["a", "b"], None, "say which"), (["a"], "b", "'a'")):
        with pytest.raises(InputError, match=said):
            chosen(tmp_path, names, asked)


@pytest.mark.parametrize("suffix", [".nvdb", ".vdb"])
def test_without_the_package_it_says_what_to_install(tmp_path, monkeypatch, suffix):
    for name in ("warp", "openvdb", "pyopenvdb", "bpy"):
        monkeypatch.setitem(importlib.sys.modules, name, None)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"NanoVDB2")
    with pytest.raises(InputError, match="warp-lang" if suffix == ".nvdb" else "openvdb"):
        read_volume(path)


def test_a_grid_of_nanovdb_comes_in_where_it_stands(tmp_path, density):
    warp = pytest.importorskip("warp", reason="warp-lang is not installed")
    warp.config.log_level = warp.LOG_ERROR
    path = tmp_path / "a.nvdb"
    warp.Volume.load_from_numpy(density, min_world=(-1.0, 2.0, 3.0), voxel_size=0.5, device="cpu").save_to_nvdb(path)
    found = read_volume(path, scale=2, phase=0.85)
    torch.testing.assert_close(found.extinction, torch.from_numpy(2 * density[1:4, 2:4, 3:6]))
    # Its cell (0, 0, 0) has its middle at min_world.
    assert found.origin == pytest.approx((-1 + 0.25, 2 + 0.75, 3 + 1.25))
    assert found.spacing == (0.5, 0.5, 0.5)
    whole = path.read_bytes()
    for content in (b"", whole[:100], whole[:-2000], struct.pack("<QIHH", 0, 0, 1, 0) + whole[16:]):
        path.write_bytes(content)
        with pytest.raises(InputError, match="no whole NanoVDB"):
            read_volume(path)


def test_a_grid_of_openvdb_comes_in_where_it_stands(tmp_path, density):
    vdb = pytest.importorskip("openvdb", reason="no module openvdb is installed")
    grids = [vdb.FloatGrid(), vdb.FloatGrid()]
    for grid, name, more in zip(grids, ("heat", "density"), (5, 1), strict=True):
        grid.copyFromArray(density * more, ijk=(-4, 5, 6))
        grid.name, grid.transform = name, vdb.createLinearTransform(0.5)
        grid.transform.postTranslate((1.0, 2.0, 3.0))
    path = tmp_path / "a.vdb"
    vdb.write(str(path), grids=grids)
    found = read_volume(path)
    torch.testing.assert_close(found.extinction, torch.from_numpy(density[1:4, 2:4, 3:6]))
    assert found.origin == pytest.approx((1 - 1.75, 2 + 3.25, 3 + 4.25))
    assert float(read_volume(path, grid="heat").extinction.max()) == pytest.approx(5 * density.max())
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(InputError, match="no whole OpenVDB"):
        read_volume(path)
