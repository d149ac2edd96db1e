"""Do signals, however they are stored, refuse what does not fit, keep what they hold, and come back from a file?"""

import math
from types import SimpleNamespace

import pytest
import torch
from transfers import random_glossy, replaced, same
from zonal_transfers import random_zonal, random_zonal_factored, vectors_by_definition

from torchprt.compression import compress
from torchprt.errors import InputError
from torchprt.transfer import Clustered, Dense, Diffuse, Factored, Zonal, load, save

EPSILON = torch.finfo(torch.float64).eps


def normal(*shape, seed=0, dtype=torch.float64):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


def dense(rows=None, channels=3, receivers=9, order=4):
    """Vectors, or matrices of so many rows."""
    values = normal(channels, order**2, receivers) if rows is None else normal(channels, receivers, rows, order**2)
    return Dense(values=values)


def clustered(rows=1, channels=3, receivers=9, order=4, shared=0, stored=torch.float64):
    """Three clusters of 0, 2 and 1 PCA vectors, the numbers as they are or in `shared` axes."""
    counts = torch.tensor([0, 2, 1])
    label = torch.arange(receivers, dtype=torch.uint8) % 3
    total, numbers = int(counts[label.long()].sum()), shared or channels * rows * order**2
    weights = normal(total, seed=1)
    code = (40 * weights + 128).clamp(0, 255).byte() if stored == torch.uint8 else weights.to(stored)
    ranges = 3 if stored == torch.uint8 else 0
    return Clustered(
        label=label,
        weights=code,
        mean=normal(3, numbers, seed=2),
        basis=normal(3, numbers, seed=3),
        shared=normal(shared, channels, rows, order**2, seed=4),
        offsets=torch.tensor([0, 0, 2, 3]),
        low=-normal(ranges, seed=5).abs(),
        step=normal(ranges, seed=6).abs() / 100,
        squared_error=torch.arange(receivers).float(),
        method="static",
        compression_error=0.1,
    )


def zonal(rows=1, channels=3, exact=True, order=4):
    layers = random_zonal_factored(
        glossy=9, rows=rows, channels=channels, exact=exact, order=order, dtype=torch.float64
    ).layers
    return layers["factored"].signal


STORED = {
    "vectors": dense,
    "matrices": lambda: dense(rows=4),
    "one row": lambda: dense(rows=1),
    "clustered": clustered,
    "clustered matrices": lambda: clustered(rows=4),
    "clustered bytes": lambda: clustered(stored=torch.uint8),
    "clustered in shared axes": lambda: clustered(rows=4, shared=7),
    "clustered bytes in shared axes": lambda: clustered(rows=4, shared=7, stored=torch.uint8),
    "zonal": zonal,
    "zonal rows": lambda: zonal(rows=4),
    "zonal without exact bands": lambda: zonal(rows=2, exact=False),
}


@pytest.fixture(params=STORED)
def signal(request):
    return STORED[request.param]()


def matrices(signal):
    """`[C, G, M, N]` in float64, whatever holds them, by definition where there is one."""
    if isinstance(signal, Zonal):
        holder = SimpleNamespace(layers={"held": SimpleNamespace(signal=signal)})
        rows = [vectors_by_definition(holder, layer="held", row=row).mT for row in range(signal.shape[2])]
        return torch.stack(rows, 2)
    if isinstance(signal, Clustered):
        return clustered_by_definition(signal)
    values = signal.values.double()
    return values.mT[:, :, None] if values.ndim == 3 else values


def clustered_by_definition(signal):
    """One receiver and one PCA vector after the other."""
    found, place = [], 0
    for label in signal.label.tolist():
        numbers = signal.mean[label].double()
        for row in range(int(signal.offsets[label]), int(signal.offsets[label + 1])):
            weight = signal.weights[place].double()
            if len(signal.low):
                weight = signal.low[row].double() + signal.step[row].double() * weight
            numbers = numbers + weight * signal.basis[row].double()
            place += 1
        found.append(numbers)
    numbers = torch.stack(found)
    if len(signal.shared):
        return torch.einsum("gq,qcmn->cgmn", numbers, signal.shared.double())
    return numbers.unflatten(1, signal.shared.shape[1:]).movedim(1, 0)


# What does not fit


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            torch.zeros(16, 25),
            r"values of the transfer are torch\.float32 \[16, 25\]: they must be floats, \[C, N, G\]",
        ),
        (torch.zeros(1, 1, 9, 16, 25), r"\[1, 1, 9, 16, 25\]: they must be floats, \[C, N, G\] or \[C, G, M, N\]"),
        (torch.zeros(2, 16, 25), "2 channels: it must have 1 or 3"),
        (torch.zeros(2, 25, 9, 16), "2 channels: it must have 1 or 3"),
        (torch.zeros(1, 15, 25), "15 coefficients a vertex: it must be the square"),
        (torch.zeros(1, 25, 9, 15), "15 coefficients a vertex: it must be the square"),
        (torch.zeros(1, 0, 25), "0 coefficients a vertex"),
        (torch.zeros(1, 16, 25, dtype=torch.int32), "'values' of the transfer is int32"),
        (torch.zeros(1, 25, 9, 16, dtype=torch.int32), "values of the transfer are torch.int32"),
    ],
)
def test_refuses_values_that_are_no_transfer(values, message):
    with pytest.raises(InputError, match=message):
        Dense(values=values)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("label", torch.zeros(9), "'label' of the transfer is float32: it must be uint8 or int16"),
        ("label", torch.zeros(8, dtype=torch.uint8), r"'squared_error' .* must be \[G\] with .*G = 8"),
        ("weights", torch.zeros(9, dtype=torch.int16), "'weights' of the transfer is int16"),
        ("weights", torch.zeros(9, dtype=torch.uint8), "low and step .* have 0 and 0 entries: weights of uint8 take 3"),
        ("low", torch.zeros(3), r"low and step .* have 3 and 0 entries: weights of float64 take 0"),
        ("basis", torch.zeros(3, 7), r"'basis' .* must be \[E, Q\] with .*Q = 48"),
        ("mean", torch.zeros(3, 7), r"must be \[E, Q\] with .*Q = 7"),
        ("shared", torch.zeros(0, 3, 1, 9), "mean of the transfer has 48 numbers for a signal of 27"),
        ("shared", torch.zeros(0, 2, 1, 16), "2 channels"),
        ("shared", torch.zeros(0, 3, 1, 15), "15 coefficients a vertex"),
        ("shared", torch.zeros(7, 3, 1, 16), r"'shared' .* must be \[Q\|0, C, M, N\] with .*Q = 48"),
        ("shared", torch.zeros(0, 3, 16), r"'shared' .* must be \[Q\|0, C, M, N\]"),
        ("offsets", torch.tensor([0, 2, 3]), "offsets of the transfer are 3 for 3 clusters: one more is needed"),
    ],
)
def test_refuses_clusters_that_do_not_fit(field, value, message):
    with pytest.raises(InputError, match=message):
        clustered().replace(**{field: value})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("axis", torch.zeros(4, 9), r"'axis' of the transfer has shape \[4, 9\]: it must be \[M, L, 3, G\]"),
        ("axis", torch.zeros(1, 4, 3, 8), "must be .* with .*G = 8"),
        ("coefficients", torch.zeros(1, 1, 3, 2, 9), r"'coefficients' .* with .*L = 4"),
        ("coefficients", torch.zeros(1, 2, 4, 2, 9), r"'coefficients' .* with .*M = 1"),
        ("coefficients", torch.zeros(2, 1, 4, 2, 9), "2 channels: it must have 1 or 3|'exact'"),
        ("exact", torch.zeros(1, 1, 3, 9), "exact of the transfer holds 3 coefficients: it must be 0, or 4"),
        ("exact", torch.zeros(3, 1, 4, 9), "'exact'"),
        ("squared_error", torch.zeros(8), "'squared_error'"),
    ],
)
def test_refuses_lobes_that_do_not_fit(field, value, message):
    with pytest.raises(InputError, match=message):
        replaced(random_zonal(), **{field: value})


def test_refuses_lobes_without_a_band():
    with pytest.raises(InputError, match="have no band"):
        replaced(random_zonal(exact=False), coefficients=torch.zeros(1, 1, 4, 0, 9))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("coefficients", torch.zeros(1, 2, 3, 3, 4), r"layers of the transfer are of orders \[4, 5\]"),
        ("factors", torch.zeros(3, 32, 32), "'factors' .* holds 3 factors: the signal has 2 rows"),
        ("axis", torch.zeros(3, 3, 3, 4), r"must be .* with .*M = 3"),
    ],
)
def test_refuses_rows_in_lobes_that_do_not_fit(field, value, message):
    with pytest.raises(InputError, match=message):
        replaced(random_zonal_factored(), **{field: value})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("exact", torch.zeros(1, 1, 0, 9), r"layers of the transfer are of orders \[2, 4\]"),
        ("axis", torch.zeros(1, 2, 3, 0), "must be .* with .*G = 0"),
    ],
)
def test_refuses_a_diffuse_layer_in_lobes_that_does_not_fit(field, value, message):
    with pytest.raises(InputError, match=message):
        replaced(random_zonal_factored(), "diffuse", **{field: value})


# What check finds


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("axis", torch.full((1, 4, 3, 9), 0.5), "axis of the transfer holds 36 vectors that are not of unit length"),
        ("axis", torch.zeros(1, 4, 3, 9), "36 vectors that are not of unit length"),
        ("coefficients", torch.full((1, 1, 4, 2, 9), math.nan), "signal.coefficients' of the transfer holds 72 NaN"),
        ("albedo", torch.full((9, 3), 1.5), r"albedo of the transfer is outside \[0, 1\]"),
        ("faces", torch.tensor([[0, 1, 9]]), "faces of the transfer name vertices"),
    ],
)
def test_the_check_refuses_lobes_that_mean_nothing(tmp_path, field, value, message):
    transfer = replaced(random_zonal(), **{field: value})
    with pytest.raises(InputError, match=message):
        transfer.check()
    with pytest.raises(InputError, match=message):
        save(transfer, tmp_path / "a.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["diffuse", "factored"])
def test_the_check_looks_at_the_axes_of_all_layers(name):
    transfer = random_zonal_factored()
    transfer.layers[name].signal.axis.mul_(1.01)
    with pytest.raises(InputError, match="axis of the transfer holds"):
        transfer.check()


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("label", torch.full((9,), 3, dtype=torch.uint8), "label of the transfer names clusters that it does not have"),
        ("label", torch.full((9,), -1), "label of the transfer names clusters that it does not have"),
        ("label", torch.zeros(9, dtype=torch.uint8), "weights of the transfer are 9, but its receivers have 0"),
        ("offsets", torch.tensor([0, 0, 2, 2]), "offsets of the transfer do not count its PCA vectors"),
        ("offsets", torch.tensor([1, 1, 2, 3]), "offsets of the transfer do not count its PCA vectors"),
        ("offsets", torch.tensor([0, 2, 1, 3]), "offsets of the transfer do not count its PCA vectors"),
        ("mean", torch.full((3, 48), torch.nan), "'mean' of the transfer holds 144 NaN"),
    ],
)
def test_the_check_finds_clusters_that_do_not_count(field, value, message):
    made = clustered()
    made.check()
    with pytest.raises(InputError, match=message):
        made.replace(**{field: value}).check()


@pytest.mark.parametrize(("clusters", "dtype"), [(256, torch.uint8), (1 << 15, torch.int16)])
def test_labels_name_as_many_clusters_as_their_type_holds(clusters, dtype):
    made = clustered()
    full = made.replace(
        label=torch.tensor([clusters - 1] * 9).to(dtype),
        mean=made.mean[:1].expand(clusters, -1),
        offsets=torch.zeros(clusters + 1, dtype=made.offsets.dtype),
        basis=made.basis[:0],
        weights=made.weights[:0],
    )
    full.check()
    with pytest.raises(InputError, match="names clusters that it does not have"):
        full.replace(mean=full.mean[1:], offsets=full.offsets[1:]).check()


# What they hold


def test_says_its_shape(signal):
    receivers, channels, rows, columns = signal.shape
    assert matrices(signal).shape == (channels, receivers, rows, columns)
    signal.check()


def test_is_written_out_number_by_number_where_it_can_be(signal):
    if signal.follows_pose:
        with pytest.raises(InputError, match="a zonal signal cannot be written out number by number here: shade it"):
            signal.dense()
        return
    wanted, found = matrices(signal), signal.dense()
    assert found.shape == signal.shape
    assert found.dtype == torch.float64
    assert not found.approximates
    # Sums of up to 2 PCA vectors in up to 7 shared axes.
    assert (matrices(found) - wanted).abs().max() <= 64 * EPSILON * wanted.abs().max()


@pytest.mark.parametrize("order", [2, 3, 4])
def test_a_lower_order_is_its_first_columns(signal, order):
    lower = signal.to_order(order)
    assert type(lower) is type(signal)
    assert lower.shape == (*signal.shape[:3], order**2)
    wanted = matrices(signal)[..., : order**2]
    assert (matrices(lower) - wanted).abs().max() <= 64 * EPSILON * wanted.abs().max()
    assert all(value.is_contiguous() for value in lower.tensors().values())


@pytest.mark.parametrize("order", [-1, 0, 5])
def test_refuses_an_order_that_it_does_not_have(signal, order):
    with pytest.raises(InputError, match=f"order {order} is not between"):
        signal.to_order(order)


@pytest.mark.parametrize(("exact", "order"), [(False, 0), (False, 6), (True, 1), (True, 6)])
def test_lobes_refuse_an_order_that_cuts_what_is_exact(exact, order):
    with pytest.raises(InputError, match=f"order {order} is not between {2 if exact else 1} and the 5"):
        random_zonal(exact=exact, order=5).to_order(order)


@pytest.mark.parametrize("exact", [False, True])
def test_fewer_bands_of_lobes_are_the_first_ones(exact):
    signal = random_zonal(exact=exact, order=5).layers["diffuse"].signal
    fewer = signal.to_order(3)
    assert fewer.order == 3
    assert torch.equal(fewer.coefficients, signal.coefficients[:, :, :, : 1 if exact else 3])
    assert torch.equal(fewer.exact, signal.exact)


@pytest.mark.parametrize("index", [[], [4], [8, 0, 3], [2, 2, 7, 2], list(range(9))])
def test_some_receivers_are_those_in_that_order(signal, index):
    chosen = torch.tensor(index, dtype=torch.int64)
    taken = signal.take(chosen)
    taken.check()
    assert taken.shape == (len(index), *signal.shape[1:])
    if index:
        # Products of other sizes may be summed in another order.
        wanted = matrices(signal)
        assert (matrices(taken) - wanted[:, chosen]).abs().max() <= 16 * EPSILON * wanted.abs().max()
    if "squared_error" in signal.layouts:
        assert torch.equal(taken.squared_error, signal.squared_error[chosen])


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32])
def test_another_storage_is_the_same_to_its_rounding(signal, dtype):
    stored = signal.to(dtype)
    assert type(stored) is type(signal)
    assert stored.dtype == dtype
    assert stored.bytes < signal.bytes
    wanted = matrices(signal)
    # An axis is off by half an epsilon in each of its components, a band of order 4 three times that.
    assert (matrices(stored) - wanted).abs().max() <= 16 * torch.finfo(dtype).eps * wanted.abs().max()
    # Weights of clusters stay as they are, and so does what is known of the cost.
    for name in ("label", "weights", "offsets", "squared_error"):
        if name in signal.layouts:
            assert torch.equal(getattr(stored, name), getattr(signal, name))


# A layer whose rows can be combined holds matrices.
@pytest.mark.parametrize("name", sorted(STORED.keys() - {"vectors"}))
def test_rows_are_combined_where_that_can_be_stored(name):
    signal = STORED[name]()
    rows = normal(5, signal.shape[2], seed=9)
    if signal.follows_pose:
        with pytest.raises(InputError, match="the rows of a zonal signal cannot be combined"):
            signal.combined(rows)
        return
    made = signal.combined(rows)
    assert type(made) is type(signal)
    wanted = rows @ matrices(signal)
    assert made.shape == (signal.shape[0], signal.shape[1], 5, signal.shape[3])
    assert (matrices(made) - wanted).abs().max() <= 64 * EPSILON * wanted.abs().max()


@pytest.mark.parametrize(("exact", "bands"), [(False, 4), (True, 2)])
def test_the_order_of_lobes_counts_the_bands_that_are_stored_apart(exact, bands):
    transfer = random_zonal(exact=exact, order=4)
    signal = transfer.layers["diffuse"].signal
    assert signal.coefficients.shape[3] == bands
    assert (transfer.order, signal.lobes, transfer.channels, transfer.vertices) == (4, 4, 1, 9)
    assert transfer.bytes == 4 * 9 * (4 * 3 + 4 * bands + (4 if exact else 0))


def test_half_precision_halves_the_bytes_and_keeps_axes_that_pass():
    transfer = random_zonal()
    for dtype in (torch.float16, torch.bfloat16):
        half = transfer.to(dtype)
        half.check()
        assert half.bytes == transfer.bytes // 2


# Files


@pytest.mark.parametrize("name", STORED)
def test_every_signal_comes_back_from_its_file(tmp_path, make_transfer, name):
    signal = STORED[name]()
    transfer = random_glossy(vertices=9, order=4, channels=3)
    rows = signal.shape[2]
    if rows == 1:
        layer = transfer.layers["diffuse"].replace(signal=signal)
        made = transfer.with_layers(diffuse=layer)
        assert isinstance(layer, Diffuse)
    else:
        exit_ = random_glossy("factored", vertices=9, channels=3).layers["factored"]
        layer = exit_.replace(signal=signal, factors=normal(rows, 8, 8))
        made = transfer.with_layers(factored=layer)
        assert isinstance(layer, Factored)
    save(made, tmp_path / "a.safetensors")
    assert same(load(tmp_path / "a.safetensors"), made)


@pytest.mark.parametrize("side", [0, 1, 3])
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_lobes_come_back_as_they_were_saved(tmp_path, side, exact, channels, dtype):
    transfer = random_zonal(side, exact=exact, channels=channels, dtype=dtype, smooth=True, fit_error=0.01, rays=64)
    save(transfer, tmp_path / "a.safetensors")
    back = load(tmp_path / "a.safetensors")
    assert same(back, transfer)
    assert (back.layers["diffuse"].signal.smooth, back.layers["diffuse"].signal.fit_error) == (True, 0.01)


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("diffuse", [False, True])
def test_glossy_lobes_come_back_from_their_file(tmp_path, exact, channels, diffuse):
    transfer = random_zonal_factored(exact=exact, channels=channels, diffuse=diffuse)
    save(transfer, tmp_path / "a.safetensors")
    back = load(tmp_path / "a.safetensors")
    assert same(back, transfer)
    assert ("diffuse" in back.layers) == diffuse
    lobes = back.layers["factored"].signal.lobes
    assert (back.order, lobes, back.channels, back.vertices) == (4, 3, channels, 9)
    assert back.to_order(3).order == 3
    assert back.to(torch.float16).bytes < back.bytes


@pytest.mark.parametrize("bits", [8, 32])
def test_what_compression_makes_comes_back_from_its_file(tmp_path, bits):
    transfer = compress(random_glossy(vertices=20), clusters=2, components=2, bits=bits, shared=3)
    save(transfer, tmp_path / "a.safetensors")
    assert same(load(tmp_path / "a.safetensors"), transfer)
