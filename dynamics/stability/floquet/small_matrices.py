"""Compiled arithmetic of small matrices: products and the exponential."""

from __future__ import annotations

import math

import numpy as np

from dynamics.arrays import Array
from dynamics.compiled_code import compiled

_DEGREE = 16  # of the Taylor polynomial: at norm 0.8 the remainder is 0.8^17/17! = 6e-17
_NORM = 0.8
_WEIGHTS = np.array([1.0 / math.factorial(k) for k in range(_DEGREE + 1)])


@compiled(part=True)
def multiply(a: Array, b: Array, out: Array) -> None:
    """out = a b for square matrices; out must be a different array."""
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
        for k in range(n):
            f = a[i, k]
            for j in range(n):
                out[i, j] += f * b[k, j]


@compiled(part=True)
def add(out: Array, factor: float, a: Array) -> None:
    """out += factor a, in place."""
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] += factor * a[i, j]


@compiled(part=True)
def _copy(factor: float, a: Array, out: Array) -> None:
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] = factor * a[i, j]


@compiled(part=True)
def _squarings(a: Array) -> int:
    """Number of halvings of a that brings its row-sum norm below the limit of the Taylor polynomial."""
    norm = 0.0
    for i in range(a.shape[0]):
        row = 0.0
        for j in range(a.shape[0]):
            row += abs(a[i, j])
        norm = max(norm, row)
    count = 0
    while norm > _NORM and count < 1000:
        norm *= 0.5
        count += 1
    return count


@compiled(part=True)
def exponential(a: Array, work: Array, out: Array) -> None:
    """Write exp(a) to out: scaling and squaring of the degree-16 Taylor polynomial (Paterson–Stockmeyer, six products).

    Args:
        a: shape (n, n), left unchanged.
        work: scratch, shape (5, n, n).
        out: shape (n, n).
    Source: N. Higham, Functions of Matrices (SIAM 2008), sections 4.2 and 10.3.
    """
    n = a.shape[0]
    squarings = _squarings(a)
    _copy(0.5**squarings, a, work[0])
    multiply(work[0], work[0], work[1])
    multiply(work[1], work[0], work[2])
    multiply(work[1], work[1], work[3])
    _copy(_WEIGHTS[_DEGREE], work[3], out)
    for block in range(_DEGREE // 4 - 1, -1, -1):
        if block < _DEGREE // 4 - 1:
            multiply(out, work[3], work[4])
            _copy(1.0, work[4], out)
        for k in range(1, 4):
            add(out, _WEIGHTS[4 * block + k], work[k - 1])
        for i in range(n):
            out[i, i] += _WEIGHTS[4 * block]
    for _ in range(squarings):
        multiply(out, out, work[4])
        _copy(1.0, work[4], out)
