"""Rounding error of means of an encoder's code: its largest value, and its covariance over windows.

The mean of a rounded code has the error e(μ) = Σ_k A_k sin(2πkμ/h + k π), where h is the step and μ the angle before
rounding. This is the Fourier series of the rounding error, with A_k = h/(πk) for a constant code and less if noise or a
ripple dithers the code. The position of the angle between two codes is unknown (all positions are equally probable).
Two windows whose angles differ by d therefore have errors with the covariance Σ A_k²/2 cos(2πk d/h). If nothing moves,
the error is the same in all windows, and a mean over windows does not reduce it.
Source: docs/theory/detection_of_steady_states.md, "Where it ends".
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig_basics.arrays import Array

_MIN_CODES = 5  # samples on either side of the most frequent code, needed to estimate the noise
_NORMAL = NormalDist()  # importing scipy's would take a tenth of a second at every `rig test`
_TERMS = 24
_NEAR = 1.5  # argument up to which J0 decreases; for larger ones J0 oscillates and its rms is used
_MAX_HIDDEN_WINDOWS = 6  # with more windows the noise of the hidden part is increased, so that a slope gains nothing


def code_noise(below: Array, above: Array, samples: NDArray[Any]) -> Array:
    """Standard deviation of the noise before rounding, in steps; NaN if it cannot be estimated from the codes.

    Codes on both sides of the most frequent one must occur. Two codes alone are not sufficient, because a reading on
    the edge between them alternates without noise too. Normal noise of s steps about μ is below −½ and above ½ with the
    quantiles (−½ − μ)/s and (μ − ½)/s, whose sum is −1/s.

    Args:
        below, above: shares of the samples on either side of the most frequent code.
        samples: number of samples.
    """
    valid = (np.minimum(below, above) * samples >= _MIN_CODES) & (np.maximum(below, above) < 0.5)
    low, high = (np.where(valid, share, 0.1).ravel() for share in (below, above))
    quantiles = [_NORMAL.inv_cdf(a) + _NORMAL.inv_cdf(b) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
    return np.where(valid, -1 / np.array(quantiles).reshape(valid.shape), np.nan)


def half_width(step: float, noise: float, *ripple: float) -> float:
    """Largest difference between the mean of a rounded code and the mean before rounding, in the unit of `step`.

    A constant code leaves half a step. Noise of s steps leaves Σ_k e^{−2π²k²s²}/(kπ) at most (the Fourier series of the
    rounding error with every term at its maximum). A ripple of amplitude A steps multiplies each term by |J0(2πkA)|.

    Args:
        step: step of the code.
        noise: standard deviation before rounding, in steps (`code_noise`).
        ripple: amplitudes of the parts that repeat with the rotor.
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
        step: step of the code.
        noise: standard deviation before rounding, in steps.
        ripple: amplitudes of the parts that repeat with the rotor, unit of `step`; each multiplies a term by
            |J0(2πkA)|, of which the rms over neighbouring amplitudes is used.
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

    The measured differences have rounding errors themselves: a constant code hides a movement of up to one step. The
    share of each term that is unknown therefore, 1 − e^{−2π²k² var(d)/h²}, is added to the diagonal. The addition grows
    with the number of windows, so that a hidden slope keeps its deviation.

    Args:
        terms: amplitudes of the error (`rounding_terms`), shape (k,).
        step: step of the code, unit of the means.
        means: measured means, shape (n,).
    """
    n = len(means)
    if step <= 0 or not len(terms):
        return np.zeros((n, n))
    k = np.arange(1, len(terms) + 1)
    apart = np.subtract.outer(means, means) / step
    size = 0.5 * terms**2
    common = np.einsum("k,kij->ij", size, np.cos(2 * math.pi * k[:, None, None] * apart))
    apart_variance = 2 * float(size.sum()) / step**2  # of a measured difference, which contains two rounding errors
    changed = size * -np.expm1(-2 * (math.pi * k) ** 2 * apart_variance)
    hidden = max(1.0, n / _MAX_HIDDEN_WINDOWS) * float(changed.sum())
    return np.asarray(common + hidden * np.eye(n), np.float64)
