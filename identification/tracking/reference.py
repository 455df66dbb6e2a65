# pyright: strict
"""The tracker's filter by filterpy, with its Rauch–Tung–Striebel smoother: the same motion, noise and readings.

`FilterpyFilter` takes the place of `filter_readings` in a `Tracker`, which goes on to decide about gates, gaps and new
starts. It keeps every step, so that `smoothed` can run backwards over them. filterpy's own smoother has one process
noise and one motion for all steps; here both change with the rotor's phase, so it is called for one step at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray

from identification.errors import FitFailed
from identification.tracking import unscented
from identification.tracking.unscented import LN_C3, LN_C4, STATES

Array = NDArray[np.float64]
_move: Any = unscented.move  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]

MOST_STEPS = 600_000
"""Steps that are kept: 1.5 GB with the smoother's, ten minutes at one a millisecond."""
_RATES = 4  # index of a component's rate behind its own
# A smoothed variance over the filter's: up to there it is what linearising, and gains of zero on a damping, leave, and
# is cut to the filter's.
_FAR_WORSE = 2.0


@dataclass(frozen=True)
class _Motion:
    """What carries sigma points over one prediction.

    Attributes:
        steps: Runge–Kutta steps.
        phase: ψ, ω, α at its begin, shape (3,).
        packed: parameters, shape (20,).
        free: 1.0 for a released pendulum, shape (2,).
    """

    steps: int
    phase: Array
    packed: Array
    free: Array

    def __call__(self, state: Array, dt: float) -> Array:
        points = np.array(state, np.float64).reshape(1, STATES)
        _move(points, dt / self.steps, self.steps, self.phase, self.packed, self.free)
        return points[0]


@dataclass(frozen=True)
class _Begun:
    """A state that the tracker began anew, the whole or a pendulum's angle and rate.

    Attributes:
        mean, cov: shapes (10,), (10, 10).
        same: components that go on as they were, on which the new ones do not depend, shape (10,).
    """

    mean: Array
    cov: Array
    same: NDArray[np.bool_]


@dataclass
class _Step:
    """One prediction with all readings of its tick.

    Attributes:
        span_s: predicted over.
        motion, noise: of the prediction that led here.
        mean, cov: after the readings, shapes (10,), (10, 10).
        begun: where the prediction began, if not at the step before; None for all others.
    """

    span_s: float
    motion: _Motion
    noise: Array
    mean: Array
    cov: Array
    begun: _Begun | None = None


@dataclass(frozen=True)
class Smoothed:
    """Means and covariances from all readings of a stretch, those after an instant too.

    Attributes:
        mean, cov: shapes (n, 10), (n, 10, 10), one for each step.
        stretches: runs of steps that no new start interrupts.
        kept: steps at which the filter's own estimate stands, because the smoother's was less certain.
    """

    mean: Array
    cov: Array
    stretches: int
    kept: int


class FilterpyFilter:
    """filterpy's unscented filter with the signature of `identification.tracking.unscented.filter_readings`.

    Args:
        source: the record's name, for messages.
    Raises:
        FitFailed: a covariance is not positive definite any more, or the record has more than MOST_STEPS steps.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._points: Any = JulierSigmaPoints(STATES, kappa=0.0)
        self._peer: Any = UnscentedKalmanFilter(STATES, 1, 1e-3, None, None, self._points)
        self._steps: list[_Step] = []

    @property
    def steps(self) -> int:
        """How many steps are kept."""
        return len(self._steps)

    def variances(self, steps: NDArray[np.int64]) -> Array:
        """The filter's own variances at some of its steps, shape (n, 10)."""
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
        """Run through readings in time order; see `filter_readings`."""
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
        """What the tracker began anew since the last call; None where the state is as this filter left it."""
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
                f"{self._source}: the reference setting keeps at most {MOST_STEPS} steps of the filter, this record "
                "has more; use --setting fast, or cut the record"
            )
        peer = self._peer
        if span > 1e-9:
            motion = replace(motion, steps=max(1, math.ceil(span / longest - 1e-9)))
            peer.fx, peer.Q = motion, np.diag(noise) * span
            self._guarded(lambda: peer.predict(dt=span))
        self._steps.append(_Step(span, motion, noise, peer.x, peer.P, begun))

    def _update(self, index: int, reading: float, late: float, variance: float, gate: float, still: float) -> float:
        """One reading; as `identification.tracking.unscented.update`."""
        peer = self._peer
        if not math.isfinite(reading):
            return math.nan
        total = float(peer.P[index, index]) + variance
        arrived = reading - late * float(peer.x[index + _RATES])
        z = (arrived - float(peer.x[index])) / math.sqrt(total) if total > 0.0 else math.nan
        if not abs(z) <= gate:
            return z
        taught_nothing = [
            own
            for own, rate in ((LN_C3, 6), (LN_C4, 7))
            if still >= 0.0 and peer.x[rate] ** 2 < still**2 + 9.0 * peer.P[rate, rate]
        ]
        before, own_cov = peer.x.copy(), peer.P.copy()
        # a second reading of a tick needs sigma points of the state after the first
        self._guarded(lambda: setattr(peer, "sigmas_f", self._points.sigma_points(peer.x, peer.P)))

        def read(state: Array) -> Array:
            return state[index : index + 1]

        peer.update(np.array([arrived]), R=variance, hx=read)
        for a in taught_nothing:  # a gain of zero: own value and variance stay, all else is as with the full gain
            peer.x[a] = before[a]
            for b in taught_nothing:
                peer.P[a, b] = own_cov[a, b]
        peer.P = 0.5 * (peer.P + peer.P.T)
        return z

    def _guarded(self, action: Callable[[], object]) -> None:
        try:
            action()
        except np.linalg.LinAlgError as fault:
            raise FitFailed(
                f"{self._source}: filterpy's filter ended after {len(self._steps)} steps: its covariance is not "
                f"positive definite any more ({fault}). Use --setting fast, whose filter repairs it"
            ) from fault

    def smoothed(self, tell: Callable[[float], None] | None = None) -> Smoothed:
        """filterpy's smoother over all steps, from the last one back.

        Args:
            tell: told the share done, 0 … 1.
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
            if tell is not None and k % 500 == 0:
                tell(1.0 - k / len(steps))
        return Smoothed(mean, cov, stretches, kept)

    def _one_back(
        self, filtered: tuple[Array, Array], later: tuple[Array, Array], after: _Step
    ) -> tuple[Array, Array] | None:
        """Mean and covariance at the begin of a step whose end is smoothed already; None where that is no better."""
        peer = self._peer
        peer.fx, peer.Q = after.motion, np.diag(after.noise) * after.span_s
        means, covs = np.array([filtered[0], later[0]]), np.array([filtered[1], later[1]])
        found: list[Any] = []
        self._guarded(lambda: found.extend(peer.rts_smoother(means, covs, dts=after.span_s)))
        return _at_most(np.asarray(found[0][0], np.float64), np.asarray(found[1][0], np.float64), filtered[1])


def _before_begun(last: _Step, same: NDArray[np.bool_], smoothed: tuple[Array, Array]) -> tuple[Array, Array] | None:
    """The last step before a pendulum was begun anew: what goes on carries later readings back to it.

    With o the components that go on, K = P[:, o] P[o, o]⁻¹: the rest follows from them as the filter's covariance
    has it, since nothing later depends on the rest.
    """
    inner = np.ix_(same, same)
    gain = np.linalg.solve(last.cov[inner], last.cov[same]).T
    mean = last.mean + gain @ (smoothed[0][same] - last.mean[same])
    cov = last.cov + gain @ (smoothed[1][inner] - last.cov[inner]) @ gain.T
    return _at_most(mean, cov, last.cov)


def _at_most(mean: Array, cov: Array, filtered: Array) -> tuple[Array, Array] | None:
    """A smoothed state with no variance above the filter's; None where it is far above, or no variance at all."""
    cov = 0.5 * (cov + cov.T)
    own, most = np.diag(cov), np.diag(filtered)
    if not bool(np.all(own > 0.0) and np.all(own <= _FAR_WORSE * most)):
        return None
    shrink = np.sqrt(np.minimum(1.0, most / own))
    return mean, cov * np.outer(shrink, shrink)
