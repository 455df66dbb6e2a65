"""Encoders that are mounted off the axis of their pendulums.

A scale whose centre lies off the axis reads θ + a sin θ + b cos θ, an error once per turn of the pendulum. A pendulum
that turns by a third of a revolution shows only a part of it. That part bends the run-down as a drag with the square of
the speed does, so the readings have to decide between both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.least_squares import Minimum
from identification.pendulums.transient import TransientProblem
from rig_basics.arrays import Array

UNKNOWNS = 4
"""a and b of encoder A, then of encoder B, rad: the last unknowns of a problem with them."""
_STD_RAD = 0.02  # prior standard deviation of each: about a degree, a scale of 10 mm radius 0.2 mm off its axis
_SIGNIFICANT_STDS = 3.5  # of the length of two normal errors: exp(−3.5²/2) = 0.002


@dataclass(frozen=True)
class OffAxis:
    """Error of one encoder.

    Attributes:
        encoder: "A" or "B".
        amplitude_rad, std_rad: its amplitude and the standard deviation of that, rad.
    """

    encoder: str
    amplitude_rad: float
    std_rad: float

    @property
    def significant(self) -> bool:
        """Whether noise exceeds such an amplitude in fewer than one of 400 fits of an encoder without an error."""
        return self.amplitude_rad > _SIGNIFICANT_STDS * self.std_rad

    @property
    def sentence(self) -> str:
        """The error in words."""
        size, std = np.degrees([self.amplitude_rad, self.std_rad]).tolist()
        return (
            f"encoder {self.encoder} reads {size:.2g} ± {std:.1g}° too much and too little once per turn of its "
            "pendulum, as a scale that is mounted off its axis. The fit of the spin-down includes this; releases and "
            "points do not. Mount it again"
        )


def errors_of(minimum: Minimum) -> tuple[OffAxis, OffAxis]:
    """Return the errors of both encoders by a fit with them."""
    found = list[OffAxis]()
    for encoder, at in (("A", [-4, -3]), ("B", [-2, -1])):
        part, covariance = minimum.theta[at], minimum.covariance[np.ix_(at, at)]
        size = float(np.hypot(*part))
        along = part / size if size else np.array([1.0, 0.0])
        found.append(OffAxis(encoder, size, float(np.sqrt(along @ covariance @ along))))
    return found[0], found[1]


def columns(angle_rad: Array, sizes: tuple[int, int]) -> Array:
    """Return the derivatives of the readings by the unknowns, shape (n, 4).

    Args:
        angle_rad: angles of A at its blocks, then of B, shape (n,).
        sizes: number of blocks of each encoder, n in total.
    """
    out = np.zeros((len(angle_rad), UNKNOWNS))
    for i, rows in enumerate((slice(0, sizes[0]), slice(sizes[0], sum(sizes)))):
        out[rows, 2 * i], out[rows, 2 * i + 1] = np.sin(angle_rad[rows]), np.cos(angle_rad[rows])
    return out


def with_off_axis(problem: TransientProblem) -> TransientProblem:
    """Return a problem with the errors of both encoders as last unknowns."""

    def predict(theta: Array, end_s: float, slopes: bool = True, /) -> tuple[Array, Array]:
        own, error = theta[:-UNKNOWNS], theta[-UNKNOWNS:]
        angle, slope = problem.predict(own, end_s, slopes)
        first, second = problem.cut(end_s)
        sizes = len(first.time_s), len(second.time_s)
        by = columns(angle, sizes)
        shown = angle + by @ error
        if not slopes:
            return shown, slope
        turn = np.array([error[1], -error[0], error[3], -error[2]])  # d(a sin θ + b cos θ)/dθ = a cos θ − b sin θ
        return shown, np.hstack([slope * (1.0 - by @ turn)[:, None], by])

    none = np.zeros(UNKNOWNS)
    prior, std = np.r_[problem.prior, none], np.r_[problem.prior_std, np.full(UNKNOWNS, _STD_RAD)]
    return replace(problem, predict=predict, prior=prior, prior_std=std)
