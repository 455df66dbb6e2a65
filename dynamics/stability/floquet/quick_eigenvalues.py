"""Compiled eigenvalues of one small real matrix. At this size a LAPACK call takes ten times as long.

Source: the EISPACK routines elmhes and hqr (B. T. Smith et al., Matrix Eigensystem Routines, Springer 1976).
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled

_MAX_SWEEPS = 60
_EPS = 2.220446049250313e-16


@compiled(part=True)
def _to_hessenberg(a: Array) -> None:
    """Similar upper Hessenberg matrix by stabilised elimination, in place."""
    n = a.shape[0]
    for m in range(1, n - 1):
        pivot, row = 0.0, m
        for j in range(m, n):
            if abs(a[j, m - 1]) > abs(pivot):
                pivot, row = a[j, m - 1], j
        if row != m:
            for j in range(m - 1, n):
                a[row, j], a[m, j] = a[m, j], a[row, j]
            for j in range(n):
                a[j, row], a[j, m] = a[j, m], a[j, row]
        if pivot != 0.0:
            for i in range(m + 1, n):
                f = a[i, m - 1] / pivot
                if f != 0.0:
                    a[i, m - 1] = 0.0
                    for j in range(m, n):
                        a[i, j] -= f * a[m, j]
                    for j in range(n):
                        a[j, m] += f * a[j, i]


@compiled(part=True)
def _start_of_sweep(a: Array, low: int, top: int, x: float, y: float, w: float) -> tuple[int, float, float, float]:
    """Row at which two small subdiagonals let the sweep begin, and the first column of the shifted square there."""
    m = top - 2
    while True:
        z = a[m, m]
        r, s = x - z, y - z
        p = (r * s - w) / a[m + 1, m] + a[m, m + 1]
        q = a[m + 1, m + 1] - z - r - s
        r = a[m + 2, m + 1]
        size = abs(p) + abs(q) + abs(r)
        p, q, r = p / size, q / size, r / size
        if m == low:
            break
        u = abs(a[m, m - 1]) * (abs(q) + abs(r))
        v = abs(p) * (abs(a[m - 1, m - 1]) + abs(z) + abs(a[m + 1, m + 1]))
        if u <= _EPS * v:
            break
        m -= 1
    for i in range(m + 2, top + 1):
        a[i, i - 2] = 0.0
        if i > m + 2:
            a[i, i - 3] = 0.0
    return m, p, q, r


@compiled(part=True)
def _reflect(a: Array, low: int, top: int, k: int, p: float, q: float, r: float, s: float) -> None:
    """One Householder reflection of rows and columns k … k + 2."""
    p += s
    x, y, z = p / s, q / s, r / s
    q, r = q / p, r / p
    three = k + 1 < top
    for j in range(k, top + 1):
        p = a[k, j] + q * a[k + 1, j]
        if three:
            p += r * a[k + 2, j]
            a[k + 2, j] -= p * z
        a[k + 1, j] -= p * y
        a[k, j] -= p * x
    for i in range(low, min(top, k + 3) + 1):
        p = x * a[i, k] + y * a[i, k + 1]
        if three:
            p += z * a[i, k + 2]
            a[i, k + 2] -= p * r
        a[i, k + 1] -= p * q
        a[i, k] -= p


@compiled(part=True)
def _double_shift_sweep(a: Array, low: int, top: int, x: float, y: float, w: float) -> None:
    """One implicit double-shift QR sweep on rows and columns low … top."""
    m, p, q, r = _start_of_sweep(a, low, top, x, y, w)
    for k in range(m, top):
        size = 1.0
        if k > m:
            p, q = a[k, k - 1], a[k + 1, k - 1]
            r = a[k + 2, k - 1] if k + 1 < top else 0.0
            size = abs(p) + abs(q) + abs(r)
            if size == 0.0:
                continue
            p, q, r = p / size, q / size, r / size
        s = np.sqrt(p * p + q * q + r * r)
        if p < 0.0:
            s = -s
        if k > m:
            a[k, k - 1] = -s * size
        elif low != m:
            a[k, k - 1] = -a[k, k - 1]
        _reflect(a, low, top, k, p, q, r, s)


@compiled(part=True)
def _start_of_block(a: Array, top: int, norm: float) -> int:
    """First row of the unreduced block that ends at top. The subdiagonal before it is set to zero."""
    low = top
    while low > 0:
        size = abs(a[low - 1, low - 1]) + abs(a[low, low])
        if size == 0.0:
            size = norm
        if abs(a[low, low - 1]) <= _EPS * size:
            a[low, low - 1] = 0.0
            break
        low -= 1
    return low


@compiled(part=True)
def _pair(x: float, y: float, w: float, shift: float) -> tuple[complex, complex]:
    """Both eigenvalues of a two by two block."""
    p = 0.5 * (y - x)
    q = p * p + w
    z = np.sqrt(abs(q))
    x += shift
    if q < 0.0:
        return complex(x + p, z), complex(x + p, -z)
    z = p + z if p >= 0.0 else p - z
    return complex(x + z), complex(x - w / z if z != 0.0 else x)


@compiled(nogil=True)
def eigenvalues(a: Array, values: Complex) -> bool:
    """Compute the eigenvalues of a real matrix.

    Args:
        a: shape (n, n); overwritten.
        values: complex, shape (n,), filled.
    Returns:
        Whether the iteration converged. Otherwise the values are invalid.
    """
    n = a.shape[0]
    norm = 0.0
    for i in range(n):
        for j in range(n):
            norm += abs(a[i, j])
    if not np.isfinite(norm):
        return False
    _to_hessenberg(a)
    top: int
    top, shift, sweeps = n - 1, 0.0, 0
    while top >= 0:
        low = _start_of_block(a, top, norm)
        x = a[top, top]
        if low == top:
            values[top] = x + shift
            top, sweeps = top - 1, 0
            continue
        y, w = a[top - 1, top - 1], a[top, top - 1] * a[top - 1, top]
        if low == top - 1:
            values[top - 1], values[top] = _pair(x, y, w, shift)
            top, sweeps = top - 2, 0
            continue
        if sweeps == _MAX_SWEEPS:
            return False
        if sweeps in (10, 20):
            shift += x
            for i in range(top + 1):
                a[i, i] -= x
            size = abs(a[top, top - 1]) + abs(a[top - 1, top - 2])
            x = y = 0.75 * size
            w = -0.4375 * size * size
        sweeps += 1
        _double_shift_sweep(a, low, top, x, y, w)
    return True
