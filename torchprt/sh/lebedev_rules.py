"""Lebedev rules of low degree: what lights of up to nine bands need, without scipy, which takes long to load.

Such a rule is the same from all 48 turns and reflections of an octahedron: its points are the corners, the middles of
the edges and of the faces, and orbits of general points, of one weight each.
Source: Lebedev and Laikov 1999, "A quadrature formula for the sphere of the 131st algebraic order of accuracy".
"""

import itertools
import math

import numpy as np
from jaxtyping import Float

_RULES: dict[int, tuple[float, float, float, tuple[tuple[float, float, float], ...]]] = {
    3: (0.1666666666666667, 0.0, 0.0, ()),
    5: (0.06666666666666667, 0.0, 0.075, ()),
    7: (0.04761904761904762, 0.03809523809523810, 0.03214285714285714, ()),
    9: (0.009523809523809524, 0.0, 0.03214285714285714, ((0.4597008433809831, 0.0, 0.02857142857142857),)),
    11: (
        0.01269841269841270,
        0.02257495590828924,
        0.02109375,
        ((0.3015113445777636, 0.3015113445777636, 0.02017333553791887),),
    ),
    13: (
        0.0005130671797338464,
        0.01660406956574204,
        -0.02958603896103896,
        ((0.4803844614152614, 0.4803844614152614, 0.02657620708215946), (0.3207726489807764, 0.0, 0.01652217099371571)),
    ),
    15: (
        0.01154401154401154,
        0.0,
        0.01194390908585628,
        (
            (0.3696028464541502, 0.3696028464541502, 0.01111055571060340),
            (0.6943540066026664, 0.6943540066026664, 0.01187650129453714),
            (0.3742430390903412, 0.0, 0.01181230374690448),
        ),
    ),
    17: (
        0.003828270494937162,
        0.0,
        0.009793737512487512,
        (
            (0.1851156353447362, 0.1851156353447362, 0.008211737283191111),
            (0.6904210483822922, 0.6904210483822922, 0.009942814891178103),
            (0.3956894730559419, 0.3956894730559419, 0.009595471336070963),
            (0.4783690288121502, 0.0, 0.009694996361663028),
        ),
    ),
}
"""By degree: shares of the sphere of a corner, of the middle of an edge and of a face, 0 where there are none; then two
coordinates of a general point and the share of each of its orbit."""


def low_rule(degree: int) -> tuple[Float[np.ndarray, "D 3"], Float[np.ndarray, " D"]] | None:
    """Directions and weights, summing to 4 pi, of the rule of just this degree; None if it is not kept here."""
    if degree not in _RULES:
        return None
    corner, edge, face, general = _RULES[degree]
    orbits = [((1.0, 0.0, 0.0), corner), ((0.5**0.5, 0.5**0.5, 0.0), edge), (((1 / 3) ** 0.5,) * 3, face)]
    orbits += [((a, b, math.sqrt(1 - (a * a + b * b))), share) for a, b, share in general]
    points = [(_orbit(point), share) for point, share in orbits if share]
    return (
        np.concatenate([each for each, _ in points]),
        np.concatenate([np.full(len(each), 4 * np.pi * share) for each, share in points]),
    )


def _orbit(point: tuple[float, ...]) -> Float[np.ndarray, "D 3"]:
    """All places that turns and reflections of an octahedron take `point` to, each once."""
    turned = np.array(list(itertools.permutations(point)))
    signs = np.array(list(itertools.product((1.0, -1.0), repeat=3)))
    # Without negative zeros.
    return np.unique((turned[:, None] * signs).reshape(-1, 3), axis=0) + 0.0
