"""States and pendulum damping while the rig runs: readings in as they come, an estimate out at any time.

What it is and is not: a filter linearises at every reading and takes the rig's other parameters for exact, so its
intervals are a guide for the eye. They are stretched by the innovations' own excess and by a factor measured over
simulated runs (docs/theory/tracking.md); quoted numbers come from fits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from dynamics.equations.parameters import RotorParameters
from dynamics.motions.integrate import fastest_rate
from identification.tracking.phase_clock import PhaseClock
from identification.tracking.process_noise import AT_REST_RAD_S, process_noise
from identification.tracking.run_out import without_run_out
from identification.tracking.unscented import STATES, TALLY, filter_readings

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
"""Stretch of the standard deviations of ln c: see docs/theory/tracking.md for the coverage it was chosen for."""
_GATE, _LOST_REFUSALS, _MANY_REFUSED = 6.0, 60, 0.25  # standard deviations, in a row, of the last two thousand
_STEP_SHARE = 0.25  # of the fastest rate's inverse
_FLICK_RAD_S = 20.0  # a hand gives a pendulum such speeds
_STILL_RAD_S, _STILL_AT_REST_RAD_S = 0.003, 0.03  # of a pendulum, while the rotor turns and while it stands
_GAP_S, _BACK_S, _SHORTEST_STEP_S = 1.0, 1.0, 5e-5
_MOST_KEPT = 400_000  # readings that wait; more are dropped, oldest first


@dataclass(frozen=True)
class Sensors:
    """What a reading is worth.

    Attributes:
        laser_std_m, encoder_step_rad: noise of a laser sample; the encoders' step.
        encoder_std_rad: of one reading beside its rounding: what zeros and bearings leave.
    """

    laser_std_m: float = 3e-5
    encoder_step_rad: float = 2 * np.pi / 4096
    encoder_std_rad: float = 1e-3


@dataclass(frozen=True)
class Tracked:
    """What the tracker holds true at one instant.

    Attributes:
        time_ns: the instant, on the readings' clock; None before the first reading.
        states, state_std: by STATE_NAMES, SI.
        values, std: c3_Nms_per_rad, c4_Nms_per_rad.
        intervals: 95 % of the values.
        trusted: the filter follows the readings; False right after a start or while most of them are refused.
        counts: readings used, refused, late, restarts, repairs of the covariance.
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
    """Feed it readings and marks in batches of any size, late or out of order within `lag_s`; ask `estimate()`.

    Attributes:
        physics: the rig; its c3, c4 are the start values.
        sensors: the readings' noise.
        damping_std: standard deviation of ln c3, ln c4 at the start; the filter finds what is three of it away.
        released: whether A and B swing freely at the start; `release` and `lock` change it.
        lag_s: readings wait so long for earlier ones, and what comes later than that is dropped.
        tick_s: readings within one tick are taken together; at most one prediction each, which bounds the cost.
        imbalance_std: relative standard deviation of the rig's S_P: 0.05 of a rig file's, 0.001 after a run-up.
        run_out_m: complex r_x, r_y of the surfaces that lasers read: they show Re(r_x e^{iψ}) and Im(r_y e^{iψ}) beside
            the disk's motion.
        filtering: what runs through readings, with the arguments of `filter_readings`.
    """

    physics: RotorParameters
    sensors: Sensors = field(default_factory=Sensors)
    damping_std: float = 1.0
    released: tuple[bool, bool] = (True, True)
    lag_s: float = 0.05
    tick_s: float = 1e-3
    imbalance_std: float = 0.05
    run_out_m: tuple[complex, complex] = (0j, 0j)
    filtering: Callable[..., None] = filter_readings

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
        x_time_ns: np.ndarray | None = None,
        x_m: np.ndarray | None = None,
        y_time_ns: np.ndarray | None = None,
        y_m: np.ndarray | None = None,
    ) -> None:
        """Disk displacements along the stiffness axes, shapes (n,), (m,); NaN is a reading that is not there."""
        for component, time, value in ((0, x_time_ns, x_m), (1, y_time_ns, y_m)):
            if time is not None and value is not None:
                self._add(np.asarray(time), np.asarray(value, float), component, self.sensors.laser_std_m**2)
        self._run()

    def feed_encoders(self, time_ns: np.ndarray, angle_rad: np.ndarray) -> None:
        """Pendulum angles relative to the rotor, shapes (n,), (n, 2), unwrapped; NaN is a reading that is not there."""
        variance = self.sensors.encoder_step_rad**2 / 12 + self.sensors.encoder_std_rad**2
        angle = np.asarray(angle_rad, float).reshape(-1, 2)
        for i in range(2):
            self._add(np.asarray(time_ns), angle[:, i], 2 + i, variance)
        self._run()

    def feed_marks(self, time_ns: np.ndarray, phase_rad: np.ndarray) -> None:
        """Index marks and the rotor's phase at them, shapes (n,)."""
        self._phase.feed(self._seconds(np.asarray(time_ns)), np.asarray(phase_rad, float))

    def release(self, pendulum: int, time_ns: int) -> None:
        """A pendulum is free from an instant on (0 is A)."""
        self._switch(pendulum, time_ns, True)

    def lock(self, pendulum: int, time_ns: int) -> None:
        """A pendulum is locked from an instant on."""
        self._switch(pendulum, time_ns, False)

    def phase_at(self, time_ns: int) -> tuple[float, float]:
        """ψ in rad and its rate in rad/s at an instant, from the marks fed so far; zeros without marks."""
        psi, speed, _ = self._phase.at(self._seconds(np.array([time_ns])))[0].tolist()
        return psi, speed

    def estimate(self) -> Tracked:
        """What is known now; it costs nothing and changes nothing."""
        std = np.sqrt(np.maximum(np.diag(self._cov), 0.0) * self._excess)
        ln_c, ln_std = self._mean[8:], CAUTION * std[8:]
        started = self._origin_ns is not None and np.isfinite(self._tally[0])
        if not started:
            ln_c, ln_std = self._ln_c, np.sqrt(self._ln_c_var)
        reach = np.exp(np.minimum(1.96 * ln_std, 50.0))
        names, c = ("c3_Nms_per_rad", "c4_Nms_per_rad"), np.exp(ln_c)
        following = self._tally[3] < _LOST_REFUSALS / 2 and self._refusing < _MANY_REFUSED
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

    def _seconds(self, time_ns: np.ndarray) -> np.ndarray:
        time_ns = np.atleast_1d(time_ns)
        if self._origin_ns is None and len(time_ns):
            self._origin_ns = int(time_ns[0])
        return (time_ns.astype(np.int64) - (self._origin_ns or 0)) * 1e-9

    def _switch(self, pendulum: int, time_ns: int, free: bool) -> None:
        self._switches.append((float(self._seconds(np.array([time_ns]))[0]), pendulum, free))
        self._switches.sort()

    def _add(self, time_ns: np.ndarray, value: np.ndarray, component: int, variance: float) -> None:
        if len(time_ns) == 0:
            return
        rows = np.empty((len(time_ns), 4))
        rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = self._seconds(time_ns), component, value, variance
        rows = rows[np.isfinite(value)]
        if len(rows) == 0:
            return
        if np.isfinite(self._newest) and np.max(rows[:, 0]) < self._newest - _BACK_S:
            self._forget()  # the clock has gone back: a device restarted
        self._newest = max(self._newest, float(np.max(rows[:, 0])))
        self._waiting = np.vstack([self._waiting, rows])[-_MOST_KEPT:]

    def _forget(self) -> None:
        """Start anew at the next reading, with the damping known when the filter last followed."""
        if np.isfinite(self._tally[0]):
            self._ln_c, found = np.clip(self._followed[0], -16.0, 2.0), self._followed[1]
            self._ln_c_var = np.clip(4 * found, 0.01, self.damping_std**2)
            self._counts["restarts"] += 1
        self._tally[0], self._tally[3:] = -np.inf, 0.0
        self._waiting, self._newest, self._excess, self._since_start = np.empty((0, 4)), -np.inf, 1.0, 0

    def _run(self) -> None:
        """Filter what no earlier reading can precede any more."""
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

    def _filter(self, rows: np.ndarray) -> None:
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
            self._forget()
        elif self._tally[3] > _LOST_REFUSALS:
            for component in np.flatnonzero(self._tally[4:] > _LOST_REFUSALS):
                self._pick_up(int(component), rows)
        elif self._tally[3] == 0:
            self._followed = self._mean[8:].copy(), np.diag(self._cov)[8:].copy()

    def _begin(self, rows: np.ndarray) -> None:
        """A state from the first readings: where they are, at an unknown speed."""
        if np.isfinite(self._tally[0]):
            waiting, newest = self._waiting, self._newest
            self._forget()
            self._waiting, self._newest = waiting, newest
        for component in range(4):
            own = rows[rows[:, 1] == component, 2]
            self._mean[component] = float(np.median(own[:9])) if len(own) else (np.pi if component == 3 else 0.0)
        self._mean[4:8], self._mean[8:] = 0.0, self._ln_c
        self._cov[:] = np.diag(np.r_[self._spread(rows[0, 0]) ** 2, self._ln_c_var])
        self._tally[0], self._tally[3:] = rows[0, 0], 0.0

    def _pick_up(self, component: int, rows: np.ndarray) -> None:
        """Begin anew with one reading's position and rate: a hand has been there; the others go on."""
        spread = self._spread(self._tally[0])
        own = rows[rows[:, 1] == component, 2]
        for i in (component, component + 4):
            self._cov[i], self._cov[:, i], self._mean[i] = 0.0, 0.0, 0.0
            self._cov[i, i] = spread[i] ** 2
        self._mean[component] = own[-1] if len(own) else 0.0
        self._tally[4 + component] = 0.0
        self._tally[3] = np.max(self._tally[4:])
        self._counts["restarts"] += 1

    def _spread(self, time_s: float) -> np.ndarray:
        """Standard deviations of positions and rates at a begin, shape (8,)."""
        speed = float(np.abs(self._phase.at(np.array([time_s]))[0, 1]))
        wide = 1e-3 * max(speed, *self.physics.natural_frequencies_rad_s)
        return np.array([1e-3, 1e-3, 0.02, 0.02, wide, wide, _FLICK_RAD_S, _FLICK_RAD_S])

    def _free(self, time_s: np.ndarray) -> np.ndarray:
        free = np.tile(np.array(self.released, float), (len(time_s), 1))
        for at, pendulum, state in self._switches:
            free[time_s > at, pendulum] = float(state)
        return free
