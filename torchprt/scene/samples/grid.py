"""A flat sheet of triangles, which the other samples are put together from."""

import numpy as np
from jaxtyping import Float, Int


def grid(
    origin: tuple[float, float, float],
    along: tuple[float, float, float],
    across: tuple[float, float, float],
    columns: int,
    rows: int,
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Positions and faces of `columns` by `rows` squares from `origin`, facing along x across.

    Diagonals alternate, so that interpolation favours no direction.
    """
    s = np.linspace(0, 1, columns + 1)
    t = np.linspace(0, 1, rows + 1)
    positions = np.array(origin) + s[None, :, None] * np.array(along) + t[:, None, None] * np.array(across)
    corner = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)[:, :-1]
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    even = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(even, np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    return positions.reshape(-1, 3), np.stack([first, second], axis=2).reshape(-1, 3)


def join(
    *parts: tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"]],
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Several sheets as one."""
    starts = np.cumsum([0] + [len(positions) for positions, _ in parts[:-1]])
    return (
        np.concatenate([positions for positions, _ in parts]),
        np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=True)]),
    )
