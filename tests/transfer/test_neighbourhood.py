"""Does a neighbourhood say where it stands and what it holds, and come back from a file as it was?"""

import pytest
import torch
from neighbourhoods import random_neighbourhood
from zonal_transfers import random_zonal_factored

from torchprt import InputError
from torchprt.compression import compress
from torchprt.onnx import export
from torchprt.shade import shader
from torchprt.transfer import Dense, Grid, Neighbourhood, grid_in, load, save


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"shape": (1, 2, 2)}, "2 or more"),
        ({"shape": (2, 2)}, "three counts"),
        ({"spacing": (1.0, 0.0, 1.0)}, "above zero"),
        ({"origin": (0.0, float("nan"), 0.0)}, "finite"),
    ],
)
def test_refuses_a_grid_that_is_none(wrong, words):
    with pytest.raises(InputError, match=words):
        Grid(**{"shape": (2, 3, 2), "origin": (0.0, 0.0, 0.0), "spacing": (1.0, 1.0, 1.0)} | wrong)


def test_refuses_an_empty_box():
    with pytest.raises(InputError, match="is empty"):
        grid_in((0.0, 0.0, 0.0), (1.0, 0.0, 1.0), (2, 2, 2))


def test_refuses_what_is_no_neighbourhood():
    with pytest.raises(InputError, match="square of the output order"):
        Neighbourhood(signal=Dense(values=torch.zeros(1, 8, 5, 9)))
    with pytest.raises(InputError, match="above the order"):
        Neighbourhood(signal=Dense(values=torch.zeros(1, 8, 16, 9)))
    with pytest.raises(InputError, match="cannot be in lobes"):
        Neighbourhood(signal=random_zonal_factored(rows=4).layers["factored"].signal)
    with pytest.raises(InputError, match="leave receivers out"):
        Neighbourhood(signal=Dense(values=torch.zeros(1, 2, 4, 9)), receivers=torch.tensor([0, 1]))


def test_what_shades_surfaces_refuses_it_in_a_sentence(tmp_path):
    transfer = random_neighbourhood()
    for act in (shader, lambda given: export(given, tmp_path / "a.onnx")):
        with pytest.raises(InputError, match="receivers read it"):
            act(transfer)
    with pytest.raises(InputError, match="not around an object"):
        compress_of_a_surface().receivers.as_grid()


def compress_of_a_surface():
    return random_zonal_factored()


def test_nodes_stand_where_their_numbers_say():
    grid = grid_in((-1.0, 0.0, 2.0), (1.0, 3.0, 2.5), (3, 4, 2))
    assert grid.count == 24
    i, j, k = 2, 1, 1
    torch.testing.assert_close(grid.positions[(i * 4 + j) * 2 + k].tolist(), [1.0, 1.0, 2.5])
    assert grid.box == ([-1.0, 0.0, 2.0], [1.0, 3.0, 2.5])
    middles = grid.places(0.5)
    assert len(middles) == 2 * 3 * 1
    torch.testing.assert_close(middles[0].tolist(), [-0.5, 0.5, 2.25])


@pytest.mark.parametrize("clustered", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
def test_comes_back_from_a_file_as_it_was(channels, clustered, tmp_path):
    transfer = random_neighbourhood(channels)
    transfer.receivers.share, transfer.receivers.border = 0.02, 0.017
    transfer.layers["neighbourhood"].inside = 3
    if clustered:
        transfer = compress(transfer, clusters=4, components=3)
    save(transfer, tmp_path / "a.safetensors")
    found = load(tmp_path / "a.safetensors")
    assert repr(found.receivers) == repr(transfer.receivers)
    assert found.layers["neighbourhood"].metadata() == transfer.layers["neighbourhood"].metadata()
    for one, other in (
        (found.receivers.positions, transfer.receivers.positions),
        *zip(
            found.layers["neighbourhood"].signal.tensors().values(),
            transfer.layers["neighbourhood"].signal.tensors().values(),
            strict=True,
        ),
    ):
        assert torch.equal(one, other)


def test_fewer_bands_of_light_are_the_first_ones():
    transfer = random_neighbourhood()
    fewer = transfer.to_order(3)
    values = transfer.layers["neighbourhood"].signal.values
    assert torch.equal(fewer.layers["neighbourhood"].signal.values, values[..., :9])
    with pytest.raises(InputError, match="above the order"):
        transfer.to_order(2)
