"""The tracker's filter by filterpy, with its Rauch–Tung–Striebel smoother: the same motion, noise and readings.

`FilterpyFilter` replaces `filter_readings` in a `Tracker`, which still handles gates, gaps and restarts. It stores
every step, so that `smoothed` can process them backwards. filterpy's smoother has one process noise and one motion for
all steps. Here both change with the rotor's phase, so the smoother is called for one step at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from identification.errors import FitFailed
from identification.tracking import unscented
from identification.tracking.unscented import LN_C3, LN_C4, STATES
from rig_basics.arrays import Array
from rig_basics.texts import number_of

MOST_STEPS = 600_000
"""Largest number of stored steps: 1.5 GB including the smoothed ones, ten minutes at one step per millisecond."""
_RATES = 4  # offset from the index of a component to that of its rate
# Ratio of a smoothed variance to that of the filter. Ratios between 1 and this bound come from the linearisation and
# from gains of zero on a damping; such a variance is reduced to that of the filter.
_MAX_VARIANCE_RATIO = 2.0


@dataclass(frozen=True)
class _Motion:
    """Motion of the sigma points over one prediction.

    Attributes:
        steps: number of Runge–Kutta steps.
        phase: ψ, ω, α at the begin, shape (3,).
        packed: parameters, shape (20,).
        free: 1.0 for a released pendulum, shape (2,).
    """

    steps: int
    phase: Array
    packed: Array
    free: Array

    def __call__(self, state: Array, dt: float) -> Array:
        points = np.array(state, np.float64).reshape(1, STATES)
        unscented.move(points, dt / self.steps, self.steps, self.phase, self.packed, self.free)
        return points[0]


@dataclass(frozen=True)
class _Begun:
    """State after a restart by the tracker, of the whole state or of one pendulum's angle and rate.

    Attributes:
        mean, cov: mean and covariance, shapes (10,), (10, 10).
        same: whether a component continues unchanged, shape (10,). The restarted components are independent of these.
    """

    mean: Array
    cov: Array
    same: NDArray[np.bool_]


@dataclass
class _Step:
    """One prediction with all readings of its tick.

    Attributes:
        span_s: duration of the prediction, s.
        motion, noise: motion and process noise of the prediction.
        mean, cov: state after the readings, shapes (10,), (10, 10).
        begun: start of the prediction after a restart; None if it starts at the step before.
    """

    span_s: float
    motion: _Motion
    noise: Array
    mean: Array
    cov: Array
    begun: _Begun | None = None


@dataclass(frozen=True)
class Smoothed:
    """Means and covariances from all readings of a stretch, later ones included.

    Attributes:
        mean, cov: shapes (n, 10), (n, 10, 10), one for each step.
        stretches: number of sequences of steps without a restart.
        kept: number of steps with the filter's estimate, because the smoothed one was less certain.
    """

    mean: Array
    cov: Array
    stretches: int
    kept: int


class FilterpyFilter:
    """filterpy's unscented filter with the signature of `identification.tracking.unscented.filter_readings`.

    Args:
        source: name of the record, for messages.
    Raises:
        FitFailed: a covariance is not positive definite, or the record has more than MOST_STEPS steps.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._points: Any = JulierSigmaPoints(STATES, kappa=0.0)
        self._peer: Any = UnscentedKalmanFilter(STATES, 1, 1e-3, None, None, self._points)
        self._steps: list[_Step] = []

    @property
    def steps(self) -> int:
        """Number of stored steps."""
        return len(self._steps)

    def variances(self, steps: NDArray[np.int64]) -> Array:
        """Return the filter's variances at given steps, shape (n, 10)."""
        chosen: list[int] = steps.tolist()
        return np.array([np.diag(self._steps[k].cov) for k in chosen], np.float64).reshape(-1, STATES)

    def __call__(
        self,
        mean: Array,
        cov: Array,
        times: Array,
        late: Array,
        indices: NDArray[np.int64],
        readings: Array,
        variances: Array,
        phases: Array,
        released: Array,
        p: Array,
        noise: Array,
        longest: float,
        gate: float,
        still: float,
        tally: Array,
        z: Array,
    ) -> None:
        """Process readings in time order; see `filter_readings`."""
        peer, begun = self._peer, self._begun(mean, cov)
        peer.x, peer.P = mean.copy(), cov.copy()
        for i in range(len(times)):
            span = float(times[i] - tally[0])
            if span > 1e-9 or begun is not None:
                self._predict(span, _Motion(1, phases[i], p, released[i]), noise, longest, begun)
                begun = None
                tally[0] = times[i]
            z[i] = self._update(int(indices[i]), float(readings[i]), float(late[i]), float(variances[i]), gate, still)
            own_row = 4 + int(indices[i])
            if abs(z[i]) <= gate:
                tally[own_row] = 0.0
            else:
                tally[1] += 1.0
                tally[own_row] += 1.0 if math.isfinite(readings[i]) else 0.0
            tally[3] = float(np.max(tally[4:]))
            self._steps[-1].mean, self._steps[-1].cov = peer.x.copy(), peer.P.copy()
        mean[:], cov[:] = peer.x, peer.P

    def _begun(self, mean: Array, cov: Array) -> _Begun | None:
        """Return the state after a restart since the last call; None if the state is that of the last call."""
        if not self._steps:
            return _Begun(mean.copy(), cov.copy(), np.zeros(STATES, np.bool_))
        last = self._steps[-1]
        same = (mean == last.mean) & (np.diag(cov) == np.diag(last.cov))
        kept = np.ix_(same, same)
        if not np.array_equal(cov[kept], last.cov[kept]):
            same[:] = False
        return None if same.all() else _Begun(mean.copy(), cov.copy(), same)

    def _predict(self, span: float, motion: _Motion, noise: Array, longest: float, begun: _Begun | None) -> None:
        if len(self._steps) >= MOST_STEPS:
            raise FitFailed(
                f"{self._source}: the reference setting stores at most {MOST_STEPS} steps of the filter, this record "
                "has more; use the fast setting, or cut the record"
            )
        peer = self._peer
        if span > 1e-9:
            motion = replace(motion, steps=max(1, math.ceil(span / longest - 1e-9)))
            peer.fx, peer.Q = motion, np.diag(noise) * span
            self._guarded(lambda: peer.predict(dt=span))
        self._steps.append(_Step(span, motion, noise, peer.x, peer.P, begun))

    def _update(self, index: int, reading: float, late: float, variance: float, gate: float, still: float) -> float:
        """Process one reading, as `identification.tracking.unscented.update`."""
        peer = self._peer
        if not math.isfinite(reading):
            return math.nan
        total = float(peer.P[index, index]) + variance
        arrived = reading - late * float(peer.x[index + _RATES])
        z = (arrived - float(peer.x[index])) / math.sqrt(total) if total > 0.0 else math.nan
        if not abs(z) <= gate:
            return z
        at_rest = [
            own
            for own, rate in ((LN_C3, 6), (LN_C4, 7))
            if still >= 0.0 and peer.x[rate] ** 2 < still**2 + 9.0 * peer.P[rate, rate]
        ]
        before, own_cov = peer.x.copy(), peer.P.copy()
        # the second reading of a tick requires sigma points of the state after the first
        self._guarded(lambda: setattr(peer, "sigmas_f", self._points.sigma_points(peer.x, peer.P)))

        def read(state: Array) -> Array:
            return state[index : index + 1]

        peer.update(np.array([arrived]), R=variance, hx=read)
        for a in at_rest:  # zero gain: value and variance are unchanged, all else is as with the full gain
            peer.x[a] = before[a]
            for b in at_rest:
                peer.P[a, b] = own_cov[a, b]
        peer.P = 0.5 * (peer.P + peer.P.T)
        return z

    def _guarded(self, action: Callable[[], object]) -> None:
        try:
            action()
        except np.linalg.LinAlgError as fault:
            raise FitFailed(
                f"{self._source}: filterpy's filter ended after {number_of(len(self._steps), 'step')}: its "
                f"covariance is not "
                f"positive definite ({fault}). Use the fast setting, whose filter repairs the covariance"
            ) from fault

    def smoothed(self, progress: Callable[[float], None] | None = None) -> Smoothed:
        """Run filterpy's smoother over all steps, from the last one back.

        Args:
            progress: called with the completed share, 0 … 1.
        Raises:
            FitFailed: a covariance is not positive definite.
        """
        steps = self._steps
        mean = np.array([s.mean for s in steps])
        cov = np.array([s.cov for s in steps])
        stretches, kept = min(1, len(steps)), 0
        for k in range(len(steps) - 2, -1, -1):
            after, begun = steps[k + 1], steps[k + 1].begun
            if begun is not None and (after.span_s <= 1e-9 or not begun.same.any()):
                stretches += 1
                continue
            start = (mean[k], cov[k]) if begun is None else (begun.mean, begun.cov)
            own = self._one_back(start, (mean[k + 1], cov[k + 1]), after)
            if own is not None and begun is not None:
                own = _before_begun(steps[k], begun.same, own)
            if own is None:
                kept += 1
            else:
                mean[k], cov[k] = own
            if progress is not None and k % 500 == 0:
                progress(1.0 - k / len(steps))
        return Smoothed(mean, cov, stretches, kept)

    def _one_back(
        self, filtered: tuple[Array, Array], later: tuple[Array, Array], after: _Step
    ) -> tuple[Array, Array] | None:
        """Return mean and covariance at the begin of a step whose end is smoothed; None if the filter's are better."""
        peer = self._peer
        peer.fx, peer.Q = after.motion, np.diag(after.noise) * after.span_s
        means, covs = np.array([filtered[0], later[0]]), np.array([filtered[1], later[1]])
        found: list[Any] = []
        self._guarded(lambda: found.extend(peer.rts_smoother(means, covs, dts=after.span_s)))
        return _at_most(np.asarray(found[0][0], np.float64), np.asarray(found[1][0], np.float64), filtered[1])


def _before_begun(last: _Step, same: NDArray[np.bool_], smoothed: tuple[Array, Array]) -> tuple[Array, Array] | None:
    """Return the smoothed state of the last step before a restart of one pendulum; None if the filter's is better.

    The components o that continue carry later readings back: K = P[:, o] P[o, o]⁻¹. The other components follow from
    them by the filter's covariance, since later readings are independent of the others.
    """
    inner = np.ix_(same, same)
    gain = np.linalg.solve(last.cov[inner], last.cov[same]).T
    mean = last.mean + gain @ (smoothed[0][same] - last.mean[same])
    cov = last.cov + gain @ (smoothed[1][inner] - last.cov[inner]) @ gain.T
    return _at_most(mean, cov, last.cov)


def _at_most(mean: Array, cov: Array, filtered: Array) -> tuple[Array, Array] | None:
    """Return a smoothed state with variances limited to the filter's; None if one is not positive or far too large."""
    cov = 0.5 * (cov + cov.T)
    own, most = np.diag(cov), np.diag(filtered)
    if not bool(np.all(own > 0.0) and np.all(own <= _MAX_VARIANCE_RATIO * most)):
        return None
    shrink = np.sqrt(np.minimum(1.0, most / own))
    return mean, cov * np.outer(shrink, shrink)
