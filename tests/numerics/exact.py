"""What kernels should give, to 50 digits, from textbook formulas and none of the package's."""

import mpmath
import numpy as np
import torch

DIGITS = 50


def basis_row(direction, order):
    """Every y_lm, l < `order`, of one direction: Q_l^m(z) Re or Im (x + iy)^m from the recurrence of P_l^m."""
    with mpmath.workdps(DIGITS):
        x, y, z = (mpmath.mpf(value) for value in direction)
        values = {}
        power = mpmath.mpc(1)
        for m in range(order):
            # P_m^m / sin^m, then upward in l: (l - m) P_l = (2l - 1) z P_(l-1) - (l + m - 1) P_(l-2).
            last, p = mpmath.mpf(0), (-1) ** m * mpmath.fac2(2 * m - 1)
            for l in range(m, order):
                if l > m:
                    last, p = p, ((2 * l - 1) * z * p - (l + m - 1) * last) / (l - m)
                scale = mpmath.sqrt((2 * l + 1) / (4 * mpmath.pi) * mpmath.factorial(l - m) / mpmath.factorial(l + m))
                scale *= mpmath.sqrt(2) if m else 1
                values[l, m], values[l, -m] = scale * p * power.real, scale * p * (power.imag if m else power.real)
            power *= mpmath.mpc(x, y)
        return [values[l, m] for l in range(order) for m in range(-l, l + 1)]


def basis(order, directions):
    return _rounded(basis_row(direction, order) for direction in directions.tolist())


def hemisphere_basis(order, directions):
    """Stieltjes' procedure in 50 digits, on the nodes of a rule that is exact for it."""
    with mpmath.workdps(DIGITS):
        nodes, weights = _gauss_legendre(order + 1)
        recurrences = [_stieltjes(m, order, nodes, weights) for m in range(order)]
        rows = []
        for direction in directions.tolist():
            x, y, z = (mpmath.mpf(value) for value in direction)
            values, power = {}, mpmath.mpc(1)
            for m, (head, steps) in enumerate(recurrences):
                before, last = mpmath.mpf(0), head
                # The sign of odd m, as that of the basis of the sphere.
                cosine, sine = (-1) ** m * power.real, (-1) ** m * power.imag
                for l in range(m, order):
                    if l > m:
                        middle, norm, size = steps[l - m - 1]
                        before, last = last, ((z - middle) * last - norm * before) / size
                    values[l, m], values[l, -m] = last * cosine, last * (sine if m else cosine)
                power *= mpmath.mpc(x, y)
            rows.append([values[l, m] for l in range(order) for m in range(-l, l + 1)])
        return _rounded(rows)


def clamped_cosine(order):
    """2 pi int_0^1 z P_l(z) dz."""
    return _rounded([2 * mpmath.pi * _moment(mpmath.mpf(1), l) for l in range(order)])


def phong(order, exponent):
    """(k + 1) int_0^1 z^k P_l(z) dz."""
    with mpmath.workdps(DIGITS):
        rows = [[(k + 1) * _moment(k, l) for l in range(order)] for k in map(mpmath.mpf, exponent.tolist())]
    return _rounded(rows)


def disc(order, angle):
    """2 pi (P_(l-1)(c) - P_(l+1)(c)) / (2l + 1), which cancels: by as many digits more as that takes."""
    with mpmath.workdps(4 * DIGITS):
        rows = []
        for c in (mpmath.cos(mpmath.mpf(each)) for each in angle.tolist()):
            p = [mpmath.mpf(1), mpmath.mpf(1), c]
            for l in range(1, order):
                p.append(((2 * l + 1) * c * p[-1] - l * p[-2]) / (l + 1))
            rows.append([2 * mpmath.pi * (p[l] - p[l + 2]) / (2 * l + 1) for l in range(order)])
    return _rounded(rows)


def _moment(k, l):
    """int_0^1 z^k P_l(z) dz = sqrt(pi) 2^(-k - 1) k! / (((k - l) / 2)! ((k + l + 1) / 2)!)."""
    with mpmath.workdps(DIGITS):
        below = mpmath.rgamma(1 + (k - l) / mpmath.mpf(2)) * mpmath.rgamma((k + l + 3) / mpmath.mpf(2))
        return mpmath.sqrt(mpmath.pi) * mpmath.mpf(2) ** (-k - 1) * mpmath.gamma(1 + k) * below


def _gauss_legendre(count):
    """Nodes and weights on [0, 1]: numpy's, brought to all digits by Newton's steps."""
    nodes, weights = [], []
    for start in np.polynomial.legendre.leggauss(count)[0].tolist():
        z = mpmath.mpf(start)
        for _ in range(4):
            last, p = mpmath.mpf(1), z
            for l in range(1, count):
                last, p = p, ((2 * l + 1) * z * p - l * last) / (l + 1)
            slope = count * (z * p - last) / (z * z - 1)
            z -= p / slope
        nodes.append((z + 1) / 2)
        weights.append(1 / ((1 - z * z) * slope * slope))
    return nodes, weights


def _stieltjes(m, order, nodes, weights):
    weight = [w * ((1 - z) * (1 + z)) ** m for z, w in zip(nodes, weights, strict=True)]
    head = 1 / mpmath.sqrt((2 if m == 0 else 1) * mpmath.pi * mpmath.fsum(weight))
    before, last = [mpmath.mpf(0)] * len(nodes), [1 / mpmath.sqrt(mpmath.fsum(weight))] * len(nodes)
    norm, steps = mpmath.mpf(0), []
    for _ in range(m + 1, order):
        middle = mpmath.fsum(w * z * p * p for w, z, p in zip(weight, nodes, last, strict=True))
        following = [(z - middle) * p - norm * q for z, p, q in zip(nodes, last, before, strict=True)]
        size = mpmath.sqrt(mpmath.fsum(w * p * p for w, p in zip(weight, following, strict=True)))
        steps.append((middle, norm, size))
        before, last, norm = last, [p / size for p in following], size
    return head, steps


def _rounded(rows):
    numbers = [[float(v) for v in row] if isinstance(row, list) else float(row) for row in rows]
    return torch.tensor(numbers, dtype=torch.float64)
