"""Online tracker of states and pendulum damping: it takes readings as they arrive and gives an estimate at any time.

The filter linearises at every reading and takes the rig's other parameters as exact, so its intervals are for display
only. They are stretched by the excess of the innovations and by a factor measured over simulated runs
(docs/theory/tracking.md). Values to be quoted come from fits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters
from dynamics.motions.integrate import fastest_rate
from identification.tracking.phase_clock import PhaseClock
from identification.tracking.process_noise import AT_REST_RAD_S, process_noise
from identification.tracking.run_out import without_run_out
from identification.tracking.unscented import STATES, TALLY, filter_readings
from rig_basics.arrays import Array

Nanoseconds = NDArray[np.int64]

STATE_NAMES = (
    "x_m",
    "y_m",
    "theta3_rad",
    "theta4_rad",
    "x_rate_m_per_s",
    "y_rate_m_per_s",
    "theta3_rate_rad_per_s",
    "theta4_rate_rad_per_s",
)
CAUTION = 2.5
"""Factor on the standard deviations of ln c; docs/theory/tracking.md states the resulting coverage."""
_GATE = 6.0  # standard deviations of an innovation above which a reading is refused
_MAX_REFUSED_IN_ROW = 60  # refused readings in a row, after which a component restarts
_MAX_REFUSED_SHARE = 0.25  # refused share of the last 2000 readings above which the estimate is not trusted
_STEP_SHARE = 0.25  # step as a share of the inverse of the fastest rate
_FLICK_RAD_S = 20.0  # standard deviation of a pendulum's speed after a flick by hand
# speed relative to the rotor below which a pendulum counts as still, while the rotor turns and while it is at rest
_STILL_RAD_S, _STILL_AT_REST_RAD_S = 0.003, 0.03
_GAP_S, _BACK_S, _SHORTEST_STEP_S = 1.0, 1.0, 5e-5
_MAX_WAITING = 400_000  # number of waiting readings; the oldest of more are dropped


@dataclass(frozen=True)
class SensorNoise:
    """Noise of the readings.

    Attributes:
        laser_std_m: standard deviation of a laser sample, m.
        encoder_step_rad: quantisation step of the encoders, rad.
        encoder_std_rad: standard deviation of an encoder reading by zeros and bearings, without its rounding, rad.
    """

    laser_std_m: float = 3e-5
    encoder_step_rad: float = 2 * np.pi / 4096
    encoder_std_rad: float = 1e-3


@dataclass(frozen=True)
class Tracked:
    """Estimate of the tracker at one instant.

    Attributes:
        time_ns: instant on the readings' clock, ns; None before the first reading.
        states, state_std: states and standard deviations by STATE_NAMES, SI.
        values, std: c3_Nms_per_rad and c4_Nms_per_rad, and their standard deviations.
        intervals: 95 % intervals of the values.
        trusted: whether the filter follows the readings; False right after a start and while many are refused.
        counts: numbers of readings used, refused and late, of restarts, and of repairs of the covariance.
    """

    time_ns: int | None
    states: dict[str, float]
    state_std: dict[str, float]
    values: dict[str, float]
    std: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    trusted: bool
    counts: dict[str, int]


@dataclass
class Tracker:
    """Online tracker.

    Readings and marks are fed in batches of any size, late or out of order within `lag_s`. `estimate` returns the
    current estimate.

    Attributes:
        physics: parameters; c3 and c4 are the start values.
        sensors: noise of the readings.
        damping_std: standard deviation of ln c3, ln c4 at the start. The filter finds values within three of it.
        released: whether A and B swing freely at the start; changed by `release` and `lock`.
        lag_s: time for which readings wait for earlier ones, s. Readings that arrive later are dropped.
        tick_s: readings within one tick have one prediction, which bounds the cost, s.
        imbalance_std: relative standard deviation of S_P: 0.05 for a rig file, 0.001 after a run-up.
        run_out_m: complex r_x, r_y of the surfaces that the lasers measure, m. Laser readings contain Re(r_x e^{iψ})
            and Im(r_y e^{iψ}) in addition to the disk's motion.
        filtering: function that processes readings, with the arguments of `filter_readings`.
    """

    physics: RotorParameters
    sensors: SensorNoise = field(default_factory=SensorNoise)
    damping_std: float = 1.0
    released: tuple[bool, bool] = (True, True)
    lag_s: float = 0.05
    tick_s: float = 1e-3
    imbalance_std: float = 0.05
    run_out_m: tuple[complex, complex] = (0j, 0j)
    filtering: Callable[..., None] = field(default_factory=lambda: filter_readings)

    def __post_init__(self) -> None:
        self._origin_ns: int | None = None
        self._phase, self._packed = PhaseClock(), self.physics.packed()
        self._switches: list[tuple[float, int, bool]] = []
        self._waiting = np.empty((0, 4))  # time, component, reading, variance
        self._mean, self._cov = np.zeros(STATES), np.eye(STATES)
        self._tally = np.array([-np.inf, *np.zeros(TALLY - 1)])
        self._excess, self._refusing, self._newest, self._since_start = 1.0, 0.0, -np.inf, 0
        self._counts: dict[str, int] = {"used": 0, "refused": 0, "late": 0, "restarts": 0, "repairs": 0}
        ln_c = np.log([max(p.damping_Nms_per_rad, 1e-7) for p in (self.physics.a, self.physics.b)])
        self._ln_c, self._ln_c_var = ln_c, np.full(2, self.damping_std**2)
        self._followed = self._ln_c, self._ln_c_var

    def feed_lasers(
        self,
        x_time_ns: Nanoseconds | None = None,
        x_m: Array | None = None,
        y_time_ns: Nanoseconds | None = None,
        y_m: Array | None = None,
    ) -> None:
        """Add disk displacements along the stiffness axes, shapes (n,), (m,); NaN marks a missing reading."""
        for component, time, value in ((0, x_time_ns, x_m), (1, y_time_ns, y_m)):
            if time is not None and value is not None:
                self._add(np.asarray(time), np.asarray(value, float), component, self.sensors.laser_std_m**2)
        self._run()

    def feed_encoders(self, time_ns: Nanoseconds, angle_rad: Array) -> None:
        """Add unwrapped pendulum angles relative to the rotor, shapes (n,), (n, 2); NaN marks a missing reading."""
        variance = self.sensors.encoder_step_rad**2 / 12 + self.sensors.encoder_std_rad**2
        angle = np.asarray(angle_rad, float).reshape(-1, 2)
        for i in range(2):
            self._add(np.asarray(time_ns), angle[:, i], 2 + i, variance)
        self._run()

    def feed_marks(self, time_ns: Nanoseconds, phase_rad: Array) -> None:
        """Add index marks and the rotor's phase at them, shapes (n,)."""
        self._phase.feed(self._seconds(np.asarray(time_ns)), np.asarray(phase_rad, float))

    def release(self, pendulum: int, time_ns: int) -> None:
        """Set a pendulum free from an instant on; 0 is A, 1 is B."""
        self._switch(pendulum, time_ns, True)

    def lock(self, pendulum: int, time_ns: int) -> None:
        """Set a pendulum locked from an instant on; 0 is A, 1 is B."""
        self._switch(pendulum, time_ns, False)

    def phase_at(self, time_ns: int) -> tuple[float, float]:
        """Return ψ in rad and its rate in rad/s at an instant, from the marks so far; zeros without marks."""
        psi, speed, _ = self._phase.at(self._seconds(np.array([time_ns])))[0].tolist()
        return psi, speed

    def estimate(self) -> Tracked:
        """Return the current estimate without changing the state of the filter."""
        std = np.sqrt(np.maximum(np.diag(self._cov), 0.0) * self._excess)
        ln_c, ln_std = self._mean[8:], CAUTION * std[8:]
        started = self._origin_ns is not None and np.isfinite(self._tally[0])
        if not started:
            ln_c, ln_std = self._ln_c, np.sqrt(self._ln_c_var)
        reach = np.exp(np.minimum(1.96 * ln_std, 50.0))
        names, c = ("c3_Nms_per_rad", "c4_Nms_per_rad"), np.exp(ln_c)
        following = self._tally[3] < _MAX_REFUSED_IN_ROW / 2 and self._refusing < _MAX_REFUSED_SHARE
        trusted = started and following and self._excess < 9.0 and self._since_start > 200
        return Tracked(
            (self._origin_ns or 0) + round(1e9 * self._tally[0]) if started else None,
            dict(zip(STATE_NAMES, self._mean[:8].tolist(), strict=True)),
            dict(zip(STATE_NAMES, std[:8].tolist(), strict=True)),
            dict(zip(names, c.tolist(), strict=True)),
            dict(zip(names, (c * ln_std).tolist(), strict=True)),
            {n: (float(v / r), float(v * r)) for n, v, r in zip(names, c, reach, strict=True)},
            bool(trusted),
            dict(self._counts),
        )

    def _seconds(self, time_ns: Nanoseconds) -> Array:
        time_ns = np.atleast_1d(time_ns)
        if self._origin_ns is None and len(time_ns):
            self._origin_ns = int(time_ns[0])
        return np.asarray((time_ns.astype(np.int64) - (self._origin_ns or 0)) * 1e-9, np.float64)

    def _switch(self, pendulum: int, time_ns: int, free: bool) -> None:
        self._switches.append((float(self._seconds(np.array([time_ns]))[0]), pendulum, free))
        self._switches.sort()

    def _add(self, time_ns: Nanoseconds, value: Array, component: int, variance: float) -> None:
        if len(time_ns) == 0:
            return
        rows = np.empty((len(time_ns), 4))
        rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = self._seconds(time_ns), component, value, variance
        rows = rows[np.isfinite(value)]
        if len(rows) == 0:
            return
        if np.isfinite(self._newest) and np.max(rows[:, 0]) < self._newest - _BACK_S:
            self._restart()  # the clock has jumped back because a device restarted
        self._newest = max(self._newest, float(np.max(rows[:, 0])))
        self._waiting = np.vstack([self._waiting, rows])[-_MAX_WAITING:]

    def _restart(self) -> None:
        """Restart at the next reading, with the damping from the time when the filter last followed the readings."""
        if np.isfinite(self._tally[0]):
            self._ln_c, found = np.clip(self._followed[0], -16.0, 2.0), self._followed[1]
            self._ln_c_var = np.clip(4 * found, 0.01, self.damping_std**2)
            self._counts["restarts"] += 1
        self._tally[0], self._tally[3:] = -np.inf, 0.0
        self._waiting, self._newest, self._excess, self._since_start = np.empty((0, 4)), -np.inf, 1.0, 0

    def _run(self) -> None:
        """Filter the readings that have waited long enough for earlier ones."""
        ready = self._waiting[:, 0] <= self._newest - self.lag_s
        rows, self._waiting = self._waiting[ready], self._waiting[~ready]
        if len(rows) == 0:
            return
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        late = rows[:, 0] < self._tally[0] - self.tick_s
        self._counts["late"] += int(np.count_nonzero(late))
        rows = rows[~late]
        if len(rows) == 0:
            return
        edges = np.flatnonzero(np.diff(rows[:, 0], prepend=rows[0, 0]) > _GAP_S)
        for part in np.split(rows, edges):
            if len(part):
                self._filter(part)

    def _filter(self, rows: Array) -> None:
        if any(self.run_out_m):
            rows = without_run_out(rows, self._phase, self.run_out_m)
        if not self._tally[0] > rows[0, 0] - _GAP_S:
            self._begin(rows)
        ticks = np.maximum(np.round(rows[:, 0] / self.tick_s) * self.tick_s, self._tally[0])
        previous = np.r_[self._tally[0], ticks[:-1]]
        z, before = np.empty(len(rows)), self._tally.copy()
        speed = abs(float(self._phase.at(ticks[-1:])[0, 1]))
        noise = process_noise(self.physics, speed, self._mean[6:8], self.imbalance_std)
        longest = float(np.clip(_STEP_SHARE / fastest_rate(self.physics, speed), _SHORTEST_STEP_S, 1e-3))
        self.filtering(
            self._mean,
            self._cov,
            ticks,
            rows[:, 0] - ticks,
            rows[:, 1].astype(np.int64),
            rows[:, 2],
            rows[:, 3],
            self._phase.at(previous),
            self._free(ticks),
            self._packed,
            noise,
            longest,
            _GATE,
            _STILL_AT_REST_RAD_S if speed < AT_REST_RAD_S else _STILL_RAD_S,
            self._tally,
            z,
        )
        refused, repairs = (self._tally - before)[[1, 2]]
        self._counts["refused"] += int(refused)
        self._counts["repairs"] += int(repairs)
        self._counts["used"] += len(rows) - int(refused)
        self._since_start += len(rows)
        taken = z[np.abs(z) <= _GATE]
        share = min(1.0, len(rows) / 2000.0)
        self._refusing = (1 - share) * self._refusing + share * refused / len(rows)
        level = float(np.mean(taken**2)) if len(taken) else 4.0
        self._excess = max(1.0, (1 - share) * self._excess + share * level)
        finite = np.all(np.isfinite(self._mean)) and np.all(np.isfinite(self._cov))
        if not finite:
            self._restart()
        elif self._tally[3] > _MAX_REFUSED_IN_ROW:
            for component in np.flatnonzero(self._tally[4:] > _MAX_REFUSED_IN_ROW):
                self._restart_component(int(component), rows)
        elif self._tally[3] == 0:
            self._followed = self._mean[8:].copy(), np.diag(self._cov)[8:].copy()

    def _begin(self, rows: Array) -> None:
        """Set the state from the first readings: their positions with unknown rates."""
        if np.isfinite(self._tally[0]):
            waiting, newest = self._waiting, self._newest
            self._restart()
            self._waiting, self._newest = waiting, newest
        for component in range(4):
            own = rows[rows[:, 1] == component, 2]
            self._mean[component] = float(np.median(own[:9])) if len(own) else (np.pi if component == 3 else 0.0)
        self._mean[4:8], self._mean[8:] = 0.0, self._ln_c
        self._cov[:] = np.diag(np.r_[self._spread(rows[0, 0]) ** 2, self._ln_c_var])
        self._tally[0], self._tally[3:] = rows[0, 0], 0.0

    def _restart_component(self, component: int, rows: Array) -> None:
        """Restart position and rate of one component, for example after a flick by hand; the others continue."""
        spread = self._spread(self._tally[0])
        own = rows[rows[:, 1] == component, 2]
        for i in (component, component + 4):
            self._cov[i], self._cov[:, i], self._mean[i] = 0.0, 0.0, 0.0
            self._cov[i, i] = spread[i] ** 2
        self._mean[component] = own[-1] if len(own) else 0.0
        self._tally[4 + component] = 0.0
        self._tally[3] = np.max(self._tally[4:])
        self._counts["restarts"] += 1

    def _spread(self, time_s: float) -> Array:
        """Return the standard deviations of positions and rates at a start, shape (8,)."""
        speed = float(np.abs(self._phase.at(np.array([time_s]))[0, 1]))
        wide = 1e-3 * max(speed, *self.physics.natural_frequencies_rad_s)
        return np.array([1e-3, 1e-3, 0.02, 0.02, wide, wide, _FLICK_RAD_S, _FLICK_RAD_S])

    def _free(self, time_s: Array) -> Array:
        free = np.tile(np.array(self.released, float), (len(time_s), 1))
        for at, pendulum, state in self._switches:
            free[time_s > at, pendulum] = float(state)
        return free
