"""Terms H and Q of each direction from a ring-down's fit, significant or only likely.

H = 8 η/(3 A²) and Q = (3π/8) (S/A)/(ζω) from the fit's relative change η of the frequency and change S of the damping
ratio at A = 1 mm (docs/theory/ring_down.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from identification.ring_down.averaging import amplitudes
from identification.ring_down.backbone import REFERENCE_M
from identification.ring_down.decay import FittedDecay
from rig_basics.arrays import Array

_CUBIC, _GROWTH = 8 / (3 * REFERENCE_M**2), 3 * math.pi / 8 / REFERENCE_M


@dataclass(frozen=True)
class DirectionTerms:
    """Amplitude terms of one direction.

    Attributes:
        direction: 1 or 2.
        values: H (1/m²) and Q (s/m), shape (2,); 0 without a term.
        covariance: covariance of (ln f, ζ, H, Q), shape (4, 4); zeros for a term that is assumed to be absent.
        found: whether H and Q are significant. A term with a variance that is not significant is considered likely
            because the other direction has it.
        largest_m: largest amplitude of the direction in the records, m.
    """

    direction: int
    values: Array
    covariance: Array
    found: tuple[bool, bool]
    largest_m: float


def direction_terms(fitted: FittedDecay, labels: tuple[str, ...], stretch: Array) -> list[DirectionTerms]:
    """Return the terms of every direction of a fit.

    Args:
        fitted: solved fit.
        labels: numbers of the directions.
        stretch: factor on the standard deviation of each parameter, shape (size,).
    """
    model, out = fitted.model, list[DirectionTerms]()
    full = fitted.solution.minimum.covariance * np.outer(stretch, stretch)
    largest = [max(own) for own in zip(*amplitudes(model, fitted.solution.coefficients), strict=True)]
    for mode, label in enumerate(labels):
        values, covariance, found = np.zeros(2), np.zeros((4, 4)), (False, False)
        covariance[:2, :2] = full[2 * mode : 2 * mode + 2, 2 * mode : 2 * mode + 2]
        if model.backbone is not None:
            at = np.array([2 * mode, 2 * mode + 1, model.tail + 2 * mode, model.tail + 2 * mode + 1])
            kinds = any(model.backbone.hardens), any(model.backbone.drags)  # a kind that no direction has is absent
            opened = model.backbone.opened[2 * mode : 2 * mode + 2]
            keep = np.array([True, True, *(on and there for on, there in zip(opened, kinds, strict=True))])
            rates = model.mode_rates(fitted.theta, mode)
            bent, drag = rates.hardening * keep[2], rates.drag * keep[3]
            growth = _GROWTH / (rates.zeta * rates.omega)
            values = np.array([_CUBIC * bent, growth * drag])
            turn = np.diag([1.0, 1.0, _CUBIC, growth])
            turn[3, :2] = -values[1] * np.array([1.0, 1.0 / rates.zeta])
            own = full[np.ix_(at, at)] * np.outer(keep, keep)
            covariance = turn @ own @ turn.T
            found = (model.backbone.hardens[mode], model.backbone.drags[mode])
        out.append(DirectionTerms(int(label), values, covariance, found, float(largest[mode])))
    return out
