"""Comparison of two sensors of one displacement: ratio of their gains, and whether the ratio is plausible.

Both measure the disk centre's displacement along one axis, so the ratio of their readings is 1 within the uncertainty
of calibration and lever. The ratio is a regression of one on the other. The clocks differ by a delay and a rate, which
the regression estimates too. Noise of the regressor would reduce the ratio. Therefore both are averaged over blocks
that are short compared with the motion, and the remaining noise is subtracted from the sums. Blocks and splines change
the ratio by less than 1e-4, a tenth of the uncertainty of an ordinary calibration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from rig_basics.arrays import Array

Verdict = Literal["agree", "disagree", "too little motion"]

_BLOCK_S = 4e-3  # averaging reduces a motion of 20 Hz by 0.2 %, equally for both sensors
_MIN_SAMPLES, _CLUSTERS = 400, 20
_MAX_RATIO_STD = 0.01  # a ratio with a larger uncertainty is not used
_LIMIT = 2.576  # standard deviations: once in a hundred campaigns by chance
_PASSES = 3


@dataclass(frozen=True)
class Witness:
    """An additional sensor along an axis, on the run's clock.

    Attributes:
        device: name of its device.
        axis: "x" or "y".
        reference: device that measures along the axis for the rig; may be empty.
        time_s, value_m: samples, shape (n,), s and m; NaN if invalid.
        gain_std: relative standard uncertainty of the ratio of both gains, from the rig file.
    """

    device: str
    axis: str
    reference: str
    time_s: Array
    value_m: Array
    gain_std: float


@dataclass(frozen=True)
class WitnessAgreement:
    """Comparison of a witness with its reference sensor.

    Attributes:
        device, reference, axis: as in Witness.
        ratio: displacement of the witness over that of the reference; NaN if there is too little motion.
        ratio_std: standard uncertainty of the ratio from noise alone.
        allowed_std: standard uncertainty from noise, calibration and lever together.
        delay_s: delay of the witness' time stamps, s.
        verdict: "disagree" if the deviation of the ratio from 1 occurs by chance less than once in a hundred times.
    """

    device: str
    reference: str
    axis: str
    ratio: float
    ratio_std: float
    allowed_std: float
    delay_s: float
    verdict: Verdict

    @property
    def text(self) -> str:
        """Result in words."""
        pair = f"{self.device} and {self.reference} along {self.axis}"
        if self.verdict == "too little motion":
            return f"{pair}: too little motion of both to compare them"
        found = f"{pair}: {self.device} shows {self.ratio:.5f} ± {self.ratio_std:.1g} × {self.reference}"
        allowed = f"1 ± {self.allowed_std:.2g} by calibration, lever and noise"
        if self.verdict == "agree":
            return f"{found}, expected {allowed}"
        return (
            f"{found}, expected {allowed}. One of the gains or levers (gain_std, lever_ratio) differs from the rig "
            f"file. Two sensors do not show which one; the readings of {self.reference} are used"
        )


def agreement(witness: Witness, time_s: Array, value_m: Array) -> WitnessAgreement:
    """Compare a witness with its reference sensor.

    Args:
        time_s, value_m: samples of the reference on the same clock, shape (m,), s and m; NaN if invalid.
    """
    pair = _blocks(time_s, value_m, witness.time_s, witness.value_m)
    found = None if pair is None else _ratio(pair)
    if found is None or found[1] > _MAX_RATIO_STD:
        nothing = math.nan if found is None else found[1]
        return WitnessAgreement(
            witness.device, witness.reference, witness.axis, math.nan, nothing, math.nan, math.nan, "too little motion"
        )
    ratio, std, delay = found
    allowed = math.hypot(std, witness.gain_std)
    verdict: Verdict = "agree" if abs(ratio - 1) <= _LIMIT * allowed else "disagree"
    return WitnessAgreement(witness.device, witness.reference, witness.axis, ratio, std, allowed, delay, verdict)


@dataclass(frozen=True)
class _Blocks:
    """Averages over the blocks in which both sensors have samples.

    Attributes:
        time_s, a, b: shape (n,).
        noise: variance of a's noise in a block, m².
        bend_s2: difference of the second-derivative terms of b's and a's averages, s².
    """

    time_s: Array
    a: Array
    b: Array
    noise: float
    bend_s2: float


def _blocks(ta: Array, a: Array, tb: Array, b: Array) -> _Blocks | None:
    if min(len(ta), len(tb)) < _MIN_SAMPLES:
        return None
    step = max(_BLOCK_S, 2 * _spacing(ta), 2 * _spacing(tb))
    start, end = max(ta[0], tb[0]), min(ta[-1], tb[-1])
    count = int((end - start) / step)
    if count < _MIN_SAMPLES:
        return None
    (na, ca, ma), (nb, cb, mb) = (_averages(t, v, start, step, count) for t, v in ((ta, a), (tb, b)))
    usual_a, usual_b = (float(np.median(n[n > 0])) if n.any() else 0.0 for n in (na, nb))
    whole = (na > 0.7 * usual_a) & (nb > 0.7 * usual_b)
    if np.count_nonzero(whole) < _MIN_SAMPLES:
        return None
    # each average is at its own samples' mean time; a's is moved to b's along its slope
    slope = np.gradient(ma, step)
    fine = np.isfinite(slope)
    whole &= fine
    ma = ma + np.where(fine, slope, 0.0) * np.where(whole, cb - ca, 0.0)
    # an average of n samples is x + T²/24 (1 − 1/n²) ẍ
    bend = step**2 / 24 * (usual_a**-2 - usual_b**-2)
    return _Blocks(cb[whole], ma[whole], mb[whole], _white(a) ** 2 / usual_a, bend)


def _spacing(time_s: Array) -> float:
    return float(np.median(np.diff(time_s)))


def _averages(time_s: Array, value: Array, start: float, step: float, count: int) -> tuple[Array, Array, Array]:
    """Return per block: number of valid samples, their mean time and their mean."""
    at = np.floor((time_s - start) / step).astype(np.int64)
    good = np.isfinite(value) & (at >= 0) & (at < count)
    at, time, seen = at[good], time_s[good], value[good]
    number = np.bincount(at, minlength=count).astype(np.float64)
    with np.errstate(invalid="ignore"):
        middle = np.bincount(at, time - start, count) / number + start
        mean = np.bincount(at, seen, count) / number
    return number, middle, mean


def _white(value: Array) -> float:
    """Standard deviation of a sample's white noise, from second differences."""
    bent = np.diff(value, 2)
    bent = bent[np.isfinite(bent)]
    return float(1.4826 * np.median(np.abs(bent - np.median(bent))) / math.sqrt(6)) if len(bent) else math.nan


def _ratio(blocks: _Blocks) -> tuple[float, float, float] | None:
    """Return the ratio of b's motion to a's, its standard deviation, and b's delay in s; None if one does not move."""
    time, a, b = blocks.time_s, blocks.a, blocks.b
    if not np.ptp(a) > 0 or not np.ptp(b) > 0:
        return None
    smooth = CubicSpline(time, a)
    step = float(np.median(np.diff(time)))
    apart = np.flatnonzero(np.diff(time) > 1.5 * step)  # a spline oscillates next to a gap
    near = np.zeros(len(time), bool)
    for k in (-2, -1, 0, 1, 2, 3):
        near[np.clip(apart + k, 0, len(time) - 1)] = True
    time, b = time[~near], b[~near]
    ratio, std, delay, drift = math.nan, math.nan, 0.0, 0.0
    middle = time - 0.5 * (time[0] + time[-1])
    span = max(float(middle[-1]), 1e-9)
    for _ in range(_PASSES):
        at = np.clip(time - delay - drift * middle / span, smooth.x[0], smooth.x[-1])
        seen, rate = smooth(at) + blocks.bend_s2 * smooth(at, 2), smooth(at, 1)
        design = np.column_stack([seen, -rate, -rate * middle / span, np.ones_like(time), middle / span])
        normal = design.T @ design
        normal[0, 0] -= len(time) * blocks.noise  # contribution of a's noise to the sum of squares
        if normal[0, 0] <= 0:
            return None
        theta, inverse = _solved(normal, design.T @ b)
        std = _spread(design, b - design @ theta, inverse)
        ratio = float(theta[0])
        delay, drift = delay + float(theta[1] / ratio), drift + float(theta[2] / ratio)
    return (ratio, std, delay) if math.isfinite(ratio + std) else None


def _spread(design: Array, left: Array, inverse: Array) -> float:
    """Standard deviation of the first coefficient, for residuals correlated over a twentieth of the motion."""
    energy = np.cumsum((design[:, 0] - np.mean(design[:, 0])) ** 2)
    shares: Array = energy[-1] * np.arange(1, _CLUSTERS) / _CLUSTERS
    bounds: list[int] = np.searchsorted(energy, shares).tolist()
    scores = np.array([part.sum(axis=0) for part in np.split(design * left[:, None], bounds)])
    together = (inverse @ (scores.T @ scores) @ inverse)[0, 0] * _CLUSTERS / (_CLUSTERS - 1)
    return math.sqrt(max(float(together), float(np.var(left) * inverse[0, 0])))


def _solved(normal: Array, right: Array) -> tuple[Array, Array]:
    """Return solution and inverse of the normal equations, with scaled columns."""
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal * np.outer(scale, scale), rcond=1e-12) * np.outer(scale, scale)
    return inverse @ right, inverse
