"""Motion once per turn that the model does not contain: its size from the residuals, and its part of the covariance.

A small error of the model once per turn moves the imbalance by much more than noise of the same size, since it has its
phase. Such an error is a random effect in each sensor,

    Re(w(t) e^{iψ}) + Re(μ(t) s(t)),

with the driven response s of the fit: w is a motion besides the response (a tilt, a stand that moves), μ a relative
error of the response (a changed imbalance, a slip of the phase, a nonlinear laser). Both are complex and Gaussian with
standard deviations σ_w (m) and σ_μ, and a correlation e^{−|Δt|/L} over time. Half of their variance is common to both
sensors (an effect of the rotor), half is the sensor's own. A third effect is the error of a nonlinear laser, a square
and a cube of the motion with coefficients of standard deviation σ_κ. It shows best at other multiples of the speed.

With the columns Z of both at knots in time, the fit leaves Z̃ᵀr, Z̃ = (1 − XCXᵀ)Z, whose covariance is ν G + G Σ G with
G = Z̃ᵀZ̃, the noise ν at the speed of the rotor and the covariance Σ of the effects. The likelihood of Z̃ᵀr determines
σ_w, σ_μ, σ_κ and ν. The effect
moves the unknowns by C XᵀZ, and adds C XᵀZ Σ ZᵀX C to their covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identification.run_up.design import Design
from identification.run_up.model import RunUpRecord
from rig_basics.arrays import Array, Complex

_KNOTS = 24  # in time; half of a correlation length has three of them
_CORRELATED = 0.25  # correlation length over the duration of the passage
_POWERS = (2, 3)  # of the motion, in the error of a nonlinear laser
_MIN_GAIN = 16.3  # of 2 ln L: P(χ² with 3 degrees of freedom > 16.3) = 1e-3
_FIRST_STEP, _LAST_STEP = 2.0, 0.05  # of the search, in ln σ; 5 % of σ is well below its own uncertainty
_LEAST_UM, _LEAST_PERCENT = 1e-2, 1e-3  # sizes that are named
_PRESENT, _ABSENT = -4.0, -8.0  # first ln σ: 2 and 0.03 % of the noise in its columns


@dataclass(frozen=True)
class Unmodelled:
    """Random effect that the model does not contain.

    Attributes:
        motion_m: standard deviation σ_w, m.
        response: relative standard deviation σ_μ.
        curvature: standard deviation σ_κ of the laser's error over the largest motion.
        gain: increase of 2 ln L by the effect.
        columns: XᵀZ, shape (unknowns, m).
        variance: Σ, shape (m, m).
    """

    motion_m: float
    response: float
    curvature: float
    gain: float
    columns: Array
    variance: Array

    def covariance(self, design: Design, jacobian: Array) -> Array:
        """Part of the covariance of jacobian @ unknowns, shape (k, k)."""
        moved = jacobian @ design.covariance @ self.columns
        return moved @ self.variance @ moved.T

    @property
    def sentence(self) -> str:
        """Message with the size and what may cause it."""
        sizes = (
            (1e6 * self.motion_m, _LEAST_UM, "µm once per turn"),
            (100 * self.response, _LEAST_PERCENT, "% of the response once per turn"),
            (100 * self.curvature, _LEAST_PERCENT, "% of the largest motion as a nonlinear laser's error"),
        )
        shown = ", ".join(f"{size:.2g} {words}" for size, least, words in sizes if size >= least)
        return (
            f"the model does not contain all that the sensors show: about {shown}; intervals are widened by it. Look "
            "for an imbalance that changed on the way, a slip of the rotor's phase, a laser that is nonlinear or whose "
            "stand moves, and pendulums locked at different heights, which tilt the disk"
        )


def unmodelled(record: RunUpRecord, design: Design) -> Unmodelled | None:
    """Estimate the random effect from the residuals of a fit; None if it is not significant."""
    z = _columns(record, design)
    crossed = design.matrix.T @ z
    gram = z.T @ z - crossed.T @ design.covariance @ crossed
    size = np.sqrt(np.maximum(np.diag(gram), 0.0)) + 1e-300
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    kept = values > 1e-9 * values[-1]
    turn = vectors[:, kept] / np.sqrt(values[kept]) / size[:, None]  # turnᵀ G turn = 1
    seen = turn.T @ (z.T @ design.residual - crossed.T @ (design.covariance @ (design.matrix.T @ design.residual)))
    parts = [turn.T @ gram @ one @ gram @ turn for one in _variances()]

    def twice_log(logs: Array) -> float:
        """2 ln L of ln σ_w, ln σ_μ, ln σ_κ and ln √ν, up to a constant. The noise is not below that of the sensors."""
        spread = sum((np.exp(2 * s) * part for s, part in zip(logs, parts, strict=False)), _noise(logs) * identity)
        factor = np.linalg.cholesky(spread)
        whitened = np.linalg.solve(factor, seen)
        return -float(whitened @ whitened) - 2 * float(np.sum(np.log(np.diag(factor))))

    identity, power = np.eye(len(seen)), max(1.0, float(np.mean(seen**2)))
    unit = np.array([0.5 * np.log(len(seen) / np.trace(part)) for part in parts] + [0.0])
    best = _climbed(twice_log, max((unit + np.array(start) for start in _starts()), key=twice_log))
    without = -float(seen @ seen) / power - len(seen) * np.log(power)
    gain = twice_log(best) - without
    if gain < _MIN_GAIN:
        return None
    sizes = np.exp(best)
    variance: Array = np.sum([s**2 * one for s, one in zip(sizes, _variances(), strict=False)], axis=0)
    return Unmodelled(float(sizes[0]), float(sizes[1]), float(sizes[2]), gain, crossed, variance)


def _noise(logs: Array) -> float:
    return max(1.0, float(np.exp(2 * logs[-1])))


def _starts() -> list[list[float]]:
    """Each effect alone, and all together; the noise is that of the sensors."""
    effects = [[_PRESENT if k == own else _ABSENT for k in range(3)] for own in range(3)]
    return [[*one, 0.0] for one in (*effects, [_PRESENT] * 3)]


def _climbed(value: Callable[[Array], float], at: Array) -> Array:
    """Maximum of a function by steps along each variable, halved at a maximum."""
    step, best = _FIRST_STEP, value(at)
    while step > _LAST_STEP:
        tried = [at + step * one for one in np.eye(len(at))]
        tried += [2 * at - one for one in tried]
        values = [value(one) for one in tried]
        if max(values) > best:
            at, best = tried[int(np.argmax(values))], max(values)
        else:
            step *= 0.5
    return at


def _columns(record: RunUpRecord, design: Design) -> Array:
    """Columns of all effects, shape (n, m): w and μ by sensor, knot and part, then κ by sensor and power."""
    channels, structure = record.channels, design.structure
    theta = structure.theta(design.phi)
    total = sum(len(c.time_s) for c in channels)
    turning, curved = np.zeros((2, total, 2, _KNOTS, 2)), np.zeros((total, 2, len(_POWERS)))
    row, column = 0, design.nonlinear
    for axis, (channel, c) in enumerate(zip(channels, design.coefficients, strict=True)):
        rows = slice(row, row + len(channel.time_s))
        row = rows.stop
        turn = (1.0, -1j)[axis] * np.exp(1j * record.drive.history.phase(record.when(theta, axis))[:, 0])
        driven = _driven(design, rows, column, c)
        column += len(c)
        knots = np.linspace(record.drive.start_s, record.drive.end_s, _KNOTS)
        place = (channel.time_s - knots[0]) / (knots[1] - knots[0])
        hats = np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(_KNOTS)))
        for effect, signal in enumerate((turn * channel.weight, driven)):
            parts = np.stack([signal.real, -signal.imag], axis=1)
            turning[effect, rows, axis] = hats[:, :, None] * parts[:, None, :]
        motion = driven.real / channel.weight
        largest = float(np.abs(motion).max()) + 1e-300
        for k, power in enumerate(_POWERS):
            curved[rows, axis, k] = largest * (motion / largest) ** power * channel.weight
    return np.hstack([np.moveaxis(turning, 0, 1).reshape(total, -1), curved.reshape(total, -1)])


def _driven(design: Design, rows: slice, column: int, c: Array) -> Complex:
    """Complex response of a sensor to imbalance and bow. The columns of a complex amplitude are Re s and −Im s."""
    own = design.matrix[rows, column : column + len(c)]
    driven = np.zeros(own.shape[0], np.complex128)
    for at in (slice(0, 2), design.structure.bow_at):
        if at.stop > at.start:
            driven += complex(*c[at]) * (own[:, at][:, 0] - 1j * own[:, at][:, 1])
    return driven


def _variances() -> tuple[Array, Array, Array]:
    """Covariances for unit σ_w, unit σ_μ and unit σ_κ, in the order of the columns."""
    knot = np.arange(_KNOTS) / (_KNOTS - 1)
    over_time = np.exp(-np.abs(knot[:, None] - knot) / _CORRELATED)
    sensors = np.array([[1.0, 0.5], [0.5, 1.0]])
    turning = np.asarray(np.kron(sensors, np.kron(over_time, np.eye(2))), np.float64)
    count, own = len(turning), 2 * len(_POWERS)
    found = np.zeros((3, 2 * count + own, 2 * count + own))
    found[0, :count, :count] = found[1, count : 2 * count, count : 2 * count] = turning
    found[2, 2 * count :, 2 * count :] = np.eye(own)
    return found[0], found[1], found[2]
