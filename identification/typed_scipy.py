"""Functions of SciPy with the types that SciPy does not declare."""

# SciPy has no types: its members are unknown, and each result has a cast
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, cast

import scipy.fft as _fft
import scipy.linalg as _linalg
import scipy.ndimage as _ndimage
import scipy.signal as _signal

from rig_basics.arrays import Array, Complex

Mode = Literal["reflect", "nearest"]


def next_fast_len(count: int) -> int:
    """Smallest length of at least `count` for which a real FFT is fast."""
    return int(_fft.next_fast_len(count, real=True) or count)


def median_filter(values: Array, size: int, mode: Mode = "reflect") -> Array:
    """Running median over `size` values."""
    return cast(Array, _ndimage.median_filter(values, size, mode=mode))


def uniform_filter1d(values: Array, size: int, mode: Mode = "reflect") -> Array:
    """Running mean over `size` values."""
    return cast(Array, _ndimage.uniform_filter1d(values, size, mode=mode))


def maximum_filter1d(values: Array, size: int) -> Array:
    """Running maximum over `size` values."""
    return cast(Array, _ndimage.maximum_filter1d(values, size))


def minimum_filter1d(values: Array, size: int) -> Array:
    """Running minimum over `size` values."""
    return cast(Array, _ndimage.minimum_filter1d(values, size))


def gaussian_filter1d(values: Complex, sigma: float, truncate: float) -> Complex:
    """Gaussian filter with the standard deviation `sigma`, in values, cut off at `truncate` standard deviations."""
    return cast(Complex, _ndimage.gaussian_filter1d(values, sigma, truncate=truncate))


def lfilter(numerator: Sequence[complex], denominator: Sequence[complex], values: Complex) -> Complex:
    """Signal after a filter with complex coefficients, `denominator` starting with 1."""
    return cast(Complex, _signal.lfilter(numerator, denominator, values))


def toeplitz(column: Array) -> Array:
    """Symmetric Toeplitz matrix with a given first column."""
    return cast(Array, _linalg.toeplitz(column))


def solveh_banded(bands: Array, right: Complex) -> Complex:
    """Solution of a Hermitian positive-definite banded system, `bands` in upper form."""
    return cast(Complex, _linalg.solveh_banded(bands, right, check_finite=False))
