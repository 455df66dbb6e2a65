# pyright: strict
"""The error that rounding leaves in means of an encoder's code: at most, and as a covariance over windows.

The mean of a rounded code is off by e(μ) = Σ_k A_k sin(2πkμ/h + k π) with h the step and μ the angle that was rounded:
the Fourier series of the rounding error, A_k = h/(πk) for a code that stands, less where noise or a wobble dithers it.
Where between two codes the angle stands is not known (any place is as probable as another), so two windows whose
angles are d apart have errors with the covariance Σ A_k²/2 cos(2πk d/h): the same error where nothing moves, which no
mean over windows makes smaller.
Source: docs/theory/steady_states.md, "Where it ends".
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_CODES = 5  # samples on either side of the usual code, to know its noise
_NORMAL = NormalDist()  # scipy's would cost every `rig test` a tenth of a second of loading
_TERMS = 24
_NEAR = 1.5  # argument of J0 below which it falls; beyond it oscillates and its rms is taken
_HIDES = 6  # windows: with more the noise that stands for what is hidden is wider, so that a slope is no better known


def code_noise(below: Array, above: Array, samples: NDArray[Any]) -> Array:
    """Standard deviation of the noise before rounding, in steps; nan where the codes do not tell.

    Both codes beside the usual one must have been seen: from two codes alone the noise is not known, for a reading on
    the edge between them flips without noise too. Normal noise of s steps about μ goes below −½ and above ½ with the
    quantiles (−½ − μ)/s and (μ − ½)/s, whose sum is −1/s.

    Args:
        below, above: shares of the samples on either side of the usual code.
        samples: how many there were.
    """
    told = (np.minimum(below, above) * samples >= _LEAST_CODES) & (np.maximum(below, above) < 0.5)
    low, high = (np.where(told, share, 0.1).ravel() for share in (below, above))
    quantiles = [_NORMAL.inv_cdf(a) + _NORMAL.inv_cdf(b) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
    return np.where(told, -1 / np.array(quantiles).reshape(told.shape), np.nan)


def half_width(step: float, noise: float, *ripple: float) -> float:
    """How far the mean of a rounded code may be from the mean of what was rounded, in the unit of `step`.

    A code that stands leaves half a step. Noise of s steps leaves Σ_k e^{−2π²k²s²}/(kπ) at most (the Fourier series
    of the rounding error, every term at its largest), a ripple of amplitude A steps makes each term |J0(2πkA)| of it.

    Args:
        step: of the code.
        noise: before rounding, in steps (`code_noise`).
        ripple: amplitudes of what repeats with the rotor.
    """
    if step <= 0:
        return 0.0
    total = 0.0
    for k in range(1, 9):
        term = math.exp(-2 * (math.pi * k * noise) ** 2) / (math.pi * k)
        for amplitude in ripple:
            argument = 2 * math.pi * k * amplitude / step
            term *= min(1.0, math.sqrt(2 / (math.pi * max(argument, 1e-9))))  # the envelope of J0
        total += term
    return step * min(0.5, total)


def rounding_terms(step: float, noise: float, *ripple: float) -> Array:
    """Amplitudes A_k of the rounding error of a mean, k = 1 … 24, unit of `step`, shape (24,).

    Args:
        step: of the code.
        noise: standard deviation before rounding, in steps.
        ripple: amplitudes of what repeats with the rotor, unit of `step`; each makes a term |J0(2πkA)| of it, of
            which the rms over the amplitudes nearby is taken.
    """
    k = np.arange(1, _TERMS + 1)
    terms = step * np.exp(-2 * (math.pi * k * noise) ** 2) / (math.pi * k)
    for amplitude in ripple if step > 0 else ():
        argument = 2 * math.pi * k * amplitude / step
        near = 1 - argument**2 / 4 + argument**4 / 64 - argument**6 / 2304  # J0 to 1e-4
        terms = terms * np.where(argument < _NEAR, near, 1 / np.sqrt(math.pi * np.maximum(argument, _NEAR)))
    return np.asarray(terms, np.float64)


def rounding_covariance(terms: Array, step: float, means: Array) -> Array:
    """Covariance of the windows' rounding errors, shape (n, n).

    The measured differences have rounding errors themselves: a code that stands hides a movement of up to a step. The
    share of each term that this leaves unknown, 1 − e^{−2π²k² var(d)/h²}, is added on the diagonal, by as much as gives
    a hidden slope its deviation however many windows there are.

    Args:
        terms: amplitudes of the error (`rounding_terms`), shape (k,).
        step: of the code, unit of the means.
        means: measured, shape (n,).
    """
    n = len(means)
    if step <= 0 or not len(terms):
        return np.zeros((n, n))
    k = np.arange(1, len(terms) + 1)
    apart = np.subtract.outer(means, means) / step
    size = 0.5 * terms**2
    common = np.einsum("k,kij->ij", size, np.cos(2 * math.pi * k[:, None, None] * apart))
    apart_variance = 2 * float(size.sum()) / step**2  # of a measured difference, from two errors of its own
    changed = size * -np.expm1(-2 * (math.pi * k) ** 2 * apart_variance)
    hidden = max(1.0, n / _HIDES) * float(changed.sum())
    return np.asarray(common + hidden * np.eye(n), np.float64)
