"""Measurement of a point's steady state: speed, angles and orbit, each with its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from analysis.errors import NotEnoughData
from analysis.laser_remarks import laser_remarks
from analysis.prediction import QUANTITIES_SI
from analysis.quantities.order_tracking import order_track
from analysis.to_come import ToCome, to_come
from daq.signals.phase_noise import phase_remarks
from daq.signals.run import Run
from daq.signals.settling import DISPLACEMENTS_S, RotorSignals, Settling, SettlingLimits, settled
from daq.signals.state_type import state_type
from dynamics import RotorParameters
from dynamics.steady.singular_points import bow_moment
from rig_basics.arrays import Array, Complex
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import distinct, number_of
from rig_configs import Rig

AVERAGE_S = 6.0  # averaged interval at the end of the plateau
_LOCKED_S = 2.0  # interval before the release
_STOOD_S = 2.5  # without a mark before a release: the rotor is below 24 rpm; a radio may lose single marks
LOCK_TOLERANCE_RAD = math.radians(2.0)
_MIN_AFTER_RELEASE_S = 9.0  # settling needs nine windows of at least one second
# The bound on the remaining approach is noisy, and a test ends when the bound is low. A bound of a moment ago holds for
# all that follows, unless the means have moved by more than a tolerance: then something else has moved them.
_RECENT_S = (0.5, 1.0, 1.5, 2.0, 2.5)
_LIMITS = SettlingLimits(average_s=AVERAGE_S)
_MIN_SPEED_TOLERANCE = 5e-4  # relative to the plateau's speed; a larger deviation belongs to the stop


@dataclass(frozen=True)
class Interval:
    """A number with its standard uncertainty, both in the unit of the field that holds it."""

    value: float
    std: float


@dataclass(frozen=True)
class SteadyMeasurement(Tabular):
    """One measured point in sensor axes: the limit of its approach (analysis.to_come).

    Attributes:
        state: "I", "II", "III", "slipping" or "not settled".
        locked, locked_rad: whether A stood at 0° and B at 180° before release, and the measured angles (2,), rad.
        settling: verdict on the end of the run.
        speed_rad_s: running speed; its deviation is the scatter of the revolutions over the mean.
        theta_rad: θ3, θ4, means over whole revolutions, in [0, 2π), with the uncertainty of statistics, quantisation,
            remaining approach and encoder zero.
        amplitude_x_m, amplitude_y_m: order-1 amplitudes with that of statistics, remaining approach and gain.
        amplitude_m: rms radius of orders 1 to 3.
        x_m, y_m: complex order-1 amplitudes, x = Re(x_m e^{iψ}), y alike; their phase contains the unknown delay
            between laser and encoder clock.
        noise_x_m, noise_y_m: standard deviation of the real or imaginary part of x_m, y_m without the gain.
        to_come: extrapolation of the means of the last seconds to their limits.
        own: joint covariance of (θ3, θ4, x amplitude, y amplitude, rms amplitude) from statistics, quantisation and
            remaining approach, without the sensors' common errors (gain, encoder zero), shape (5, 5).
        creeps: whether it is compared although it has not settled, because dry friction lets it creep.
        release_s, from_s, to_s: last release (if the pendulums were released at rest: time at which the speed was
            reached), start and end of the averaged interval, s since the run's start.
        remarks: sentences on effects other than the rotor's motion in lasers and rotor phase. Lasers are left out for
            a slipping pendulum, because the rotor's motion then has lines of its own.
    """

    state: str
    locked: bool
    locked_rad: Array
    settling: Settling
    speed_rad_s: Interval
    theta_rad: tuple[Interval, Interval]
    amplitude_x_m: Interval
    amplitude_y_m: Interval
    amplitude_m: Interval
    x_m: complex
    y_m: complex
    noise_x_m: float
    noise_y_m: float
    to_come: ToCome
    own: Array
    release_s: float
    from_s: float
    to_s: float
    remarks: tuple[str, ...] = ()  # pyright: ignore[reportIncompatibleMethodOverride] (the base has a property)
    creeps: bool = False

    @property
    def heading(self) -> str:
        """State and averaged interval."""
        return f"SteadyMeasurement: {self.state}, mean from {self.from_s:.4g} to {self.to_s:.4g} s"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each quantity."""
        amplitudes = self.amplitude_x_m, self.amplitude_y_m, self.amplitude_m
        values = *self.theta_rad, *amplitudes, self.speed_rad_s
        return {
            "quantity": [*QUANTITIES_SI, "speed_rad_s"],
            "value": [each.value for each in values],
            "std": [each.std for each in values],
        }

    @property
    def noise_floor_m(self) -> float:
        """Rms radius of noise alone, m."""
        return math.hypot(self.noise_x_m, self.noise_y_m)


def measure(run: Run, rig: Rig, bow_m: complex = 0j, creep_rad: float = 0.0) -> SteadyMeasurement:
    """Measure the steady state at the end of a point's run.

    Args:
        run: a test "point-NAME" or "start-ups". The marks' spacing shows the end of the plateau; the stop is cut off.
            If the pendulums were released at rest, the run-up before the plateau is cut off too.
        rig: rig file with the first mass moments and the uncertainties of gains and zeros.
        bow_m: bow of the shaft in the rotor's frame; the pendulums balance it as well.
        creep_rad: distance within which dry friction turns an approach into a creep that ends late. If no more than
            this remains, the point is measured as it stands, with the remaining approach in its uncertainty: a creep
            slows down so gradually that nearly all of its bound is reached.
    Raises:
        NotEnoughData: no release, too short a record after it, or a missing signal.
    """
    release, end, free = _span(run)
    remarks = laser_remarks(run, release, end)
    run = remarks.without_lines(run)
    locked, locked_rad = _locked(run)
    settling, start = _settling(run, release, end, free), end - AVERAGE_S
    speed = _speed(run, start, end)
    theta, theta_std = _angles(run, start, end)
    x, x_std = _orders(run, run.x_time_s, run.x_m, start, end, "x")
    y, y_std = _orders(run, run.y_time_s, run.y_m, start, end, "y")
    drift_rad, drift_m = (off / math.sqrt(3) for off in _mean_off(settling))
    stds = np.hypot([*theta_std, x_std, x_std, y_std, y_std], [drift_rad] * 2 + [drift_m] * 4)
    means = np.array([*theta, x[0].real, x[0].imag, y[0].real, y[0].imag])
    ends = to_come(run, release, end, means, stds)
    creeps = not settling.settled and settling.approaching and settling.remaining_rad <= creep_rad
    if creeps:
        left = np.r_[np.full(2, settling.remaining_rad), np.full(4, settling.remaining_m)]
        ends = replace(ends, covariance=ends.covariance + np.diag(left**2))
    theta = (theta + ends.shift[:2]) % (2 * math.pi)
    x[0] += complex(*ends.shift[2:4])
    y[0] += complex(*ends.shift[4:])
    own, stated = _stated(theta, (x, y), ends.covariance, rig)
    bow = bow_moment(replace(rig.physics, bow_x_m=bow_m.real, bow_y_m=bow_m.imag), speed.value)
    noise_x, noise_y = (math.sqrt(0.5 * np.trace(ends.covariance[j : j + 2, j : j + 2])) for j in (2, 4))
    return SteadyMeasurement(
        state=_state(settling, (float(theta[0]), float(theta[1])), rig.physics, bow, creeps),
        locked=locked,
        locked_rad=locked_rad,
        settling=settling,
        speed_rad_s=speed,
        theta_rad=(stated[0], stated[1]),
        amplitude_x_m=stated[2],
        amplitude_y_m=stated[3],
        amplitude_m=stated[4],
        x_m=complex(x[0]),
        y_m=complex(y[0]),
        noise_x_m=noise_x,
        noise_y_m=noise_y,
        to_come=ends,
        own=own,
        release_s=release,
        from_s=start,
        to_s=end,
        remarks=(*(() if settling.slipping else remarks.sentences), *phase_remarks(run, turns=True)),
        creeps=creeps,
    )


def locked_radius_m(run: Run) -> float:
    """Return the rms radius of order 1 with locked pendulums before the release, m; NaN if it was not recorded."""
    if not run.releases or len(run.mark_time_s) < 2:
        return math.nan
    go = min(r.time_s for r in run.releases)
    start, end = go - _LOCKED_S, go - 0.02
    try:
        x, _ = _orders(run, run.x_time_s, run.x_m, start, end, "x")
        y, _ = _orders(run, run.y_time_s, run.y_m, start, end, "y")
    except (NotEnoughData, IndexError):  # usual: the log begins shortly before the release
        return math.nan
    return math.sqrt(0.5 * (abs(x[0]) ** 2 + abs(y[0]) ** 2))


def _stated(theta: Array, orbit: tuple[Complex, Complex], covariance: Array, rig: Rig) -> tuple[Array, list[Interval]]:
    """Return the covariance without the sensors' common errors (5, 5), and the values with their full uncertainty."""
    x, y = orbit
    own, radius = _own(x, y, covariance)
    zero, gain = math.radians(rig.roles.zero_std_deg), rig.roles.gain_stds
    values = [*theta, abs(x[0]), abs(y[0]), radius]
    common = [zero, zero, gain[0] * abs(x[0]), gain[1] * abs(y[0]), _of_radius(x, y, radius, gain)]
    stds = [math.hypot(math.sqrt(own[j, j]), common[j]) for j in range(len(values))]
    return own, [Interval(float(value), std) for value, std in zip(values, stds, strict=True)]


def _own(x: Complex, y: Complex, covariance: Array) -> tuple[Array, float]:
    """Return covariance (5, 5) of angles, amplitudes and rms radius from that of the complex amplitudes; the radius."""
    radius = math.sqrt(0.5 * float(np.sum(np.abs(x) ** 2 + np.abs(y) ** 2)))
    slope = np.zeros((5, 6))
    slope[0, 0] = slope[1, 1] = 1.0
    for row, j, first in ((2, 2, x[0]), (3, 4, y[0])):
        slope[row, j : j + 2] = np.array([first.real, first.imag]) / max(abs(first), 1e-300)
        slope[4, j : j + 2] = np.array([first.real, first.imag]) / (2 * max(radius, 1e-300))
    return slope @ covariance @ slope.T, radius


def _of_radius(x: Complex, y: Complex, radius: float, gain: tuple[float, float]) -> float:
    """Return the standard uncertainty of the rms radius due to the gains of x and y."""
    return math.hypot(gain[0] * abs(x[0]) ** 2, gain[1] * abs(y[0]) ** 2) / (2 * max(radius, 1e-300))


def plateau_end(mark_time_s: Array, mark_phase_rad: Array, from_s: float) -> float:
    """Return the time of the last mark at the plateau's speed, s; the stop follows."""
    after = mark_time_s >= from_s
    times, phases = mark_time_s[after], mark_phase_rad[after]
    if len(times) < 3:
        raise NotEnoughData(f"only {number_of(len(times), 'tachometer mark')} after the release at {from_s:.1f} s")
    speeds = np.diff(phases) / np.diff(times)
    plateau = np.median(speeds)
    off = np.abs(speeds / plateau - 1)
    on = np.flatnonzero(off <= max(_MIN_SPEED_TOLERANCE, 8 * float(np.median(off))))
    return float(times[max(on[-1] - 1, 1)])  # margin of one revolution: the stop may have begun within the last one


def plateau_start(mark_time_s: Array, mark_phase_rad: Array, from_s: float, end_s: float) -> float:
    """Return the time of the first mark of the plateau before `end_s`, s."""
    inside = (mark_time_s >= from_s) & (mark_time_s <= end_s)
    times, phases = mark_time_s[inside], mark_phase_rad[inside]
    if len(times) < 3:
        raise NotEnoughData(f"only {number_of(len(times), 'tachometer mark')} between {from_s:.1f} and {end_s:.1f} s")
    speeds = np.diff(phases) / np.diff(times)
    off = np.abs(speeds / np.median(speeds[-max(1, len(speeds) // 4) :]) - 1)
    ramp = np.flatnonzero(off > max(2 * _MIN_SPEED_TOLERANCE, 8 * float(np.median(off))))
    return float(times[min(ramp[-1] + 2, len(times) - 1)] if len(ramp) else times[0])


def _span(run: Run) -> tuple[float, float, bool]:
    """Return last release (of a standing rotor: start of the plateau), end of the plateau, whether it stood."""
    if not run.releases:
        raise NotEnoughData("the log holds no release of a pendulum")
    if {r.pendulum for r in run.releases} != {0, 1}:
        raise NotEnoughData("only one of the two pendulums was released")
    release = max(r.time_s for r in run.releases)
    end = plateau_end(run.mark_time_s, run.mark_phase_rad, release)
    stood = not np.any((run.mark_time_s > release - _STOOD_S) & (run.mark_time_s < release))
    if stood and np.any(run.mark_time_s > release):
        release = plateau_start(run.mark_time_s, run.mark_phase_rad, release, end)
    if end - release < _MIN_AFTER_RELEASE_S:
        found, needed = distinct(end - release, _MIN_AFTER_RELEASE_S)
        raise NotEnoughData(f"{found} s at speed after release, at least {needed} s needed")
    return release, end, stood


def _between(time: Array, values: Array, start: float, end: float) -> tuple[Array, Array]:
    """Return the finite samples in an interval."""
    finite = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
    inside = (time >= start) & (time <= end) & finite
    return time[inside], values[inside]


def _locked(run: Run) -> tuple[bool, Array]:
    """Whether both pendulums stood at their locks before the first release, and their mean angles."""
    first = min(r.time_s for r in run.releases)
    _, before = _between(run.angle_time_s, run.angle_rad, first - 3.0, first - 0.02)
    if len(before) < 20:
        raise NotEnoughData("no pendulum angles before the release")
    mean = before.mean(axis=0)
    off = np.abs(np.angle(np.exp(1j * (mean - [0.0, np.pi]))))
    moved = np.ptp(before, axis=0) - 6 * run.angle_step_rad
    return bool(np.all(off < LOCK_TOLERANCE_RAD) and np.all(moved < LOCK_TOLERANCE_RAD)), mean


def _settling(run: Run, release: float, end: float, free: bool) -> Settling:
    """Judge the end of the run; for pendulums released at rest the release time is not used as a resting place."""
    late = end - DISPLACEMENTS_S  # the locked part shows whether the gap has changed
    angles = run.angle_time_s >= min(release - 1.0, late)
    x, y = run.x_time_s >= late, run.y_time_s >= late

    def judged(at: float) -> Settling:
        marks = (run.mark_time_s >= release) & (run.mark_time_s <= at)
        signals = RotorSignals(
            run.angle_time_s[angles],
            run.angle_rad[angles],
            run.mark_time_s[marks],
            run.mark_phase_rad[marks],
            run.x_time_s[x],
            run.x_m[x],
            run.y_time_s[y],
            run.y_m[y],
        )
        since = None if free else release
        return settled(signals, _LIMITS, release_time_s=since, angle_step_rad=run.angle_step_rad)

    found = judged(end)
    if found.span_s == 0.0:
        raise NotEnoughData(found.why)
    if found.is_level and any(judged(end - since).settled for since in _RECENT_S):
        found = replace(found, settled=True, why=f"steady a moment ago; {found.why}", more_s=0.0)
    return found


def _mean_off(settling: Settling) -> tuple[float, float]:
    """Return bounds on the distance of the means from their limits, rad and m; without a bound the last change."""
    angle = settling.mean_off_rad if math.isfinite(settling.mean_off_rad) else settling.drift_rad
    orbit = settling.mean_off_m if math.isfinite(settling.mean_off_m) else settling.drift_m
    return angle, orbit


def _speed(run: Run, start: float, end: float) -> Interval:
    inside = (run.mark_time_s >= start) & (run.mark_time_s <= end)
    times, phases = run.mark_time_s[inside], run.mark_phase_rad[inside]
    if len(times) < 4:
        raise NotEnoughData(f"only {number_of(len(times), 'tachometer mark')} in the last {end - start:.1f} s")
    line: Array = np.asarray(np.polyfit(times - times[0], phases - phases[0], 1), np.float64)
    slope, offset = line.tolist()
    rest = phases - phases[0] - offset - slope * (times - times[0])
    spread = float(np.std(rest) / (np.std(times) * math.sqrt(len(times))))
    rate = run.clock_rate_std.get("phase", 0.0) * slope
    return Interval(slope, math.hypot(spread, rate))


def _angles(run: Run, start: float, end: float) -> tuple[Array, Array]:
    """Return means over whole revolutions and their standard uncertainty without calibration, shape (2,) each."""
    time, angles = _between(run.angle_time_s, run.angle_rad, start, end)
    psi = np.interp(time, run.mark_time_s, run.mark_phase_rad)
    if len(time) < 200 or psi[-1] - psi[0] < 4 * np.pi:
        raise NotEnoughData(f"only {number_of(len(time), 'pendulum sample')} in the last {end - start:.1f} s")
    whole = psi >= psi[-1] - 2 * np.pi * math.floor((psi[-1] - psi[0]) / (2 * np.pi))
    basis = np.stack([f(k * psi[whole]) for k in (1, 2) for f in (np.cos, np.sin)] + [np.ones(whole.sum())], axis=1)
    fit = np.linalg.lstsq(basis, angles[whole], rcond=None)[0]
    statistics = (angles[whole] - basis @ fit).std(axis=0) / math.sqrt(whole.sum())
    quantisation = [_quantisation(column, run.angle_step_rad) for column in angles[whole].T]
    return fit[-1], np.hypot(statistics, quantisation)


def _quantisation(angle: Array, step: float) -> float:
    """Return the standard error of the mean of a rounded code: step/√12 at rest, less if noise dithers it."""
    dither = max(0.0, float(np.var(angle)) / step**2 - 1 / 12)
    return step / math.sqrt(12) * math.exp(-2 * math.pi**2 * dither)


def _orders(run: Run, time: Array, values: Array, start: float, end: float, name: str) -> tuple[Complex, float]:
    """Return complex amplitudes of orders 1 to 3 in an interval, shape (3,), and the standard deviation of order 1."""
    inside = (time >= start) & (time <= end)
    if np.isfinite(values[inside]).sum() < 0.3 * max(inside.sum(), 200):
        raise NotEnoughData(f"laser {name}: too few valid samples in the last {end - start:.1f} s")
    psi = np.interp(time[inside], run.mark_time_s, run.mark_phase_rad)
    speed = (psi[-1] - psi[0]) / (end - start)
    turns = max(1, int((end - start) * speed / (2 * np.pi) / 6))
    try:
        track = order_track(time[inside], values[inside], psi, (1, 2, 3), revolutions=turns)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise NotEnoughData(f"laser {name}: {error}") from error
    return np.array([track.mean(k)[0] for k in (1, 2, 3)]), track.mean(1)[1]


def _state(
    settling: Settling, theta: tuple[float, float], physics: RotorParameters, bow_kg_m: complex, creeps: bool
) -> str:
    if settling.slipping:
        return "slipping"
    return state_type(theta, physics, bow_kg_m) if settling.settled or creeps else "not settled"
