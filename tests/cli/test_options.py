"""Are poses read from a file, and what holds none refused?"""

import numpy as np
import pytest
import torch

from torchprt.cli import options
from torchprt.errors import InputError


def test_poses_are_read(tmp_path):
    values = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    np.save(tmp_path / "a.npy", values)
    found = options.positions(tmp_path / "a.npy")
    assert found.dtype == torch.float64
    assert np.array_equal(found.numpy(), values)


@pytest.mark.parametrize("content", [None, b"", b"no array", np.zeros((4, 3)), np.zeros((2, 4, 2)), np.array(["a"])])
def test_refuses_what_holds_no_poses(tmp_path, content):
    path = tmp_path / "a.npy"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content)
    with pytest.raises(InputError, match=r"a\.npy"):
        options.positions(path)
