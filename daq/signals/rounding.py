# pyright: strict
"""The error that rounding leaves in means of an encoder's code, as a covariance over windows.

The mean of a rounded code is off by e(μ) = Σ_k A_k sin(2πkμ/h + k π) with h the step and μ the angle that was rounded:
the Fourier series of the rounding error, A_k = h/(πk) for a code that stands, less where noise or a wobble dithers it.
Where between two codes the angle stands is not known (any place is as probable as another), so two windows whose
angles are d apart have errors with the covariance Σ A_k²/2 cos(2πk d/h): the same error where nothing moves, which no
mean over windows makes smaller.
Source: docs/theory/steady_states.md, "Where it ends".
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TERMS = 24
_NEAR = 1.5  # argument of J0 below which it falls; beyond it oscillates and its rms is taken
_HIDES = 6  # windows: with more the noise that stands for what is hidden is wider, so that a slope is no better known


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
