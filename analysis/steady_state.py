"""What a point's run shows once the pendulums have settled: speed, angles, orbit, each with its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.errors import NotEnoughData
from analysis.order_tracking import order_track
from daq.signals.run import Run
from daq.signals.settling import Settling, settled
from daq.signals.state_type import state_type
from dynamics import RotorParameters
from rig_configs import Rig

AVERAGE_S = 6.0  # the last seconds that are averaged
DRIFTING_AVERAGE_S = 2.0  # the same while an end drift shows: a long mean would lag behind it
LOCK_TOLERANCE_RAD = math.radians(2.0)
_LEAST_AFTER_RELEASE_S = 9.0  # settling looks at nine windows of a second or a little more
_DRIFTING_RAD, _DRIFTING_M = math.radians(0.01), 0.2e-6
# The bound on what is to come is noisy, and a test ends where it is low. One that was low enough a moment ago holds for
# all that came since, unless it is now above so many tolerances: then something has moved.
_LATELY_S = (0.5, 1.0, 1.5, 2.0, 2.5)
_SLACK = 3.0
_LEAST_SPEED_TOLERANCE = 5e-4  # a revolution further off the plateau's speed belongs to the stop


@dataclass(frozen=True)
class Interval:
    """A number with its standard uncertainty, both in the unit of the field that holds it."""

    value: float
    std: float


@dataclass(frozen=True)
class SteadyMeasurement:
    """One point as measured, in sensor axes.

    Attributes:
        state: "I", "II", "III", "slipping" or "not settled".
        locked, locked_rad: whether A stood at 0° and B at 180° before release, and where they stood (2,), rad.
        settling: how the end of the run was judged.
        speed_rad_s: running speed; its deviation is the revolutions' scatter over the mean.
        theta_rad: mean θ3, θ4 over whole revolutions in [0, 2π); statistics, quantisation, drift, encoder zero.
        amplitude_x_m, amplitude_y_m: order-1 amplitudes; statistics, drift and gain.
        amplitude_m: rms radius of orders 1 to 3.
        x_m, y_m: complex order-1 amplitudes, x = Re(x_m e^{iψ}), y the same; their phase holds the unknown delay
            between laser and encoder clock.
        noise_x_m, noise_y_m: standard deviation of the real or imaginary part of x_m, y_m without the gain.
        release_s, from_s, to_s: last release, start and end of the average, s since the run's start.
    """

    state: str
    locked: bool
    locked_rad: np.ndarray
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
    release_s: float
    from_s: float
    to_s: float

    @property
    def noise_floor_m(self) -> float:
        """Rms radius that noise alone would show."""
        return math.hypot(self.noise_x_m, self.noise_y_m)


def measure(run: Run, rig: Rig) -> SteadyMeasurement:
    """The steady state at the end of a point's run.

    Args:
        run: a test "point-NAME"; what follows the plateau (the stop) is cut off by the marks' spacing.
        rig: for the first mass moments, the lasers' gain and the encoders' zero uncertainty.
    Raises:
        NotEnoughData: no release, too short a record after it, or a signal that is missing there.
    """
    release, end = _span(run)
    angles = _between(run.angle_time_s, run.angle_rad, release - 3.0, end)
    locked, locked_rad = _locked(run, angles)
    settling, start = _settling(run, release, end)
    drift_rad, drift_m = (off / math.sqrt(3) for off in _mean_off(settling))
    speed = _speed(run, start, end)
    theta = _angles(run, rig, drift_rad, start, end)
    x = _orders(run, run.x_time_s, run.x_m, start, end, "x")
    y = _orders(run, run.y_time_s, run.y_m, start, end, "y")
    noise_x, noise_y = (math.hypot(std[0], drift_m) for _, std in (x, y))
    gain_x, gain_y = rig.roles.gain_stds
    amplitude_x = Interval(abs(x[0][0]), math.hypot(noise_x, gain_x * abs(x[0][0])))
    amplitude_y = Interval(abs(y[0][0]), math.hypot(noise_y, gain_y * abs(y[0][0])))
    return SteadyMeasurement(
        state=_state(settling, (theta[0].value, theta[1].value), rig.physics),
        locked=locked,
        locked_rad=locked_rad,
        settling=settling,
        speed_rad_s=speed,
        theta_rad=theta,
        amplitude_x_m=amplitude_x,
        amplitude_y_m=amplitude_y,
        amplitude_m=_rms_radius(x[0], y[0], amplitude_x.std, amplitude_y.std),
        x_m=complex(x[0][0]),
        y_m=complex(y[0][0]),
        noise_x_m=noise_x,
        noise_y_m=noise_y,
        release_s=release,
        from_s=start,
        to_s=end,
    )


def plateau_end(mark_time_s: np.ndarray, mark_phase_rad: np.ndarray, from_s: float) -> float:
    """Time of the last mark still at the plateau's speed, s; what follows is the stop."""
    after = mark_time_s >= from_s
    times, phases = mark_time_s[after], mark_phase_rad[after]
    if len(times) < 3:
        raise NotEnoughData(f"only {len(times)} tachometer marks after the release at {from_s:.1f} s")
    speeds = np.diff(phases) / np.diff(times)
    plateau = np.median(speeds)
    off = np.abs(speeds / plateau - 1)
    on = np.flatnonzero(off <= max(_LEAST_SPEED_TOLERANCE, 8 * float(np.median(off))))
    return float(times[max(on[-1] - 1, 1)])  # a revolution's margin: the stop may have begun within the last one


def _span(run: Run) -> tuple[float, float]:
    """Last release and end of the plateau."""
    if not run.releases:
        raise NotEnoughData("the log holds no release of a pendulum")
    if {r.pendulum for r in run.releases} != {0, 1}:
        raise NotEnoughData("only one of the two pendulums was released")
    release = max(r.time_s for r in run.releases)
    end = plateau_end(run.mark_time_s, run.mark_phase_rad, release)
    if end - release < _LEAST_AFTER_RELEASE_S:
        raise NotEnoughData(
            f"{end - release:.1f} s at speed after release, at least {_LEAST_AFTER_RELEASE_S:g} s needed"
        )
    return release, end


def _between(time: np.ndarray, values: np.ndarray, start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Finite samples in a span."""
    finite = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
    inside = (time >= start) & (time <= end) & finite
    return time[inside], values[inside]


def _locked(run: Run, angles: tuple[np.ndarray, np.ndarray]) -> tuple[bool, np.ndarray]:
    """Whether both stood at their locks in the seconds before the first release, and where."""
    first = min(r.time_s for r in run.releases)
    before = angles[1][angles[0] < first - 0.02]
    if len(before) < 20:
        raise NotEnoughData("no pendulum angles before the release")
    mean = before.mean(axis=0)
    off = np.abs(np.angle(np.exp(1j * (mean - [0.0, np.pi]))))
    moved = np.ptp(before, axis=0) - 6 * run.angle_step_rad
    return bool(np.all(off < LOCK_TOLERANCE_RAD) and np.all(moved < LOCK_TOLERANCE_RAD)), mean


def _settling(run: Run, release: float, end: float) -> tuple[Settling, float]:
    """How the end of the run is judged, and where the average begins: later while a long mean would lag behind."""
    late = end - 40.0  # enough for any window; the locked part is needed to see whether the gap has changed
    angles = run.angle_time_s >= min(release - 1.0, late)
    x, y = run.x_time_s >= late, run.y_time_s >= late

    def judged(average_s: float = AVERAGE_S, at: float = end, slack: float = 1.0) -> Settling:
        marks = (run.mark_time_s >= release) & (run.mark_time_s <= at)
        return settled(
            run.angle_time_s[angles], run.angle_rad[angles], run.mark_time_s[marks], run.mark_phase_rad[marks],
            run.x_time_s[x], run.x_m[x], run.y_time_s[y], run.y_m[y], release_time_s=release,
            angle_step_rad=run.angle_step_rad, average_s=average_s, slack=slack,
        )  # fmt: skip

    def was_settled() -> bool:
        return judged(slack=_SLACK).settled and any(judged(at=end - since).settled for since in _LATELY_S)

    found, start = judged(), end - AVERAGE_S
    if found.span_s == 0.0:
        raise NotEnoughData(found.why)
    off_rad, off_m = _mean_off(found)
    if off_rad > _DRIFTING_RAD or off_m > _DRIFTING_M:
        short = judged(DRIFTING_AVERAGE_S)
        short_rad, short_m = _mean_off(short)
        if short_rad < 0.5 * off_rad or short_m < 0.5 * off_m:
            found, start = short, end - DRIFTING_AVERAGE_S
    if not found.settled and was_settled():
        found = replace(found, settled=True, why=f"steady a moment ago; {found.why}", more_s=0.0)
    return found, start


def _mean_off(settling: Settling) -> tuple[float, float]:
    """Bounds on how far the means may be from where they will end, rad and m; the last change where there is none."""
    angle = settling.mean_off_rad if math.isfinite(settling.mean_off_rad) else settling.drift_rad
    orbit = settling.mean_off_m if math.isfinite(settling.mean_off_m) else settling.drift_m
    return angle, orbit


def _speed(run: Run, start: float, end: float) -> Interval:
    inside = (run.mark_time_s >= start) & (run.mark_time_s <= end)
    times, phases = run.mark_time_s[inside], run.mark_phase_rad[inside]
    if len(times) < 4:
        raise NotEnoughData(f"only {len(times)} tachometer marks in the last {end - start:.1f} s")
    slope, offset = np.polyfit(times - times[0], phases - phases[0], 1)
    rest = phases - phases[0] - offset - slope * (times - times[0])
    spread = float(np.std(rest) / (np.std(times) * math.sqrt(len(times))))
    rate = run.clock_rate_std.get("phase", 0.0) * slope
    return Interval(float(slope), math.hypot(spread, rate))


def _angles(run: Run, rig: Rig, drift: float, start: float, end: float) -> tuple[Interval, Interval]:
    """Means over whole revolutions with everything that makes them uncertain."""
    time, angles = _between(run.angle_time_s, run.angle_rad, start, end)
    psi = np.interp(time, run.mark_time_s, run.mark_phase_rad)
    if len(time) < 200 or psi[-1] - psi[0] < 4 * np.pi:
        raise NotEnoughData(f"only {len(time)} pendulum samples in the last {end - start:.1f} s")
    whole = psi >= psi[-1] - 2 * np.pi * math.floor((psi[-1] - psi[0]) / (2 * np.pi))
    basis = np.stack([f(k * psi[whole]) for k in (1, 2) for f in (np.cos, np.sin)] + [np.ones(whole.sum())], axis=1)
    fit = np.linalg.lstsq(basis, angles[whole], rcond=None)[0]
    rest = angles[whole] - basis @ fit
    zero = math.radians(rig.roles.zero_std_deg)
    result = []
    for j in (0, 1):
        statistics = rest[:, j].std() / math.sqrt(len(rest))
        quantisation = _quantisation(angles[whole][:, j], run.angle_step_rad)
        std = math.sqrt(statistics**2 + quantisation**2 + drift**2 + zero**2)
        result.append(Interval(float(fit[-1, j] % (2 * np.pi)), std))
    return result[0], result[1]


def _quantisation(angle: np.ndarray, step: float) -> float:
    """Standard error a rounded code leaves in its mean: a step/√12 when it stands, less as noise dithers it."""
    dither = max(0.0, float(np.var(angle)) / step**2 - 1 / 12)
    return step / math.sqrt(12) * math.exp(-2 * math.pi**2 * dither)


def _orders(
    run: Run, time: np.ndarray, values: np.ndarray, start: float, end: float, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Complex amplitudes of orders 1 to 3 over a span and their standard deviations, shape (3,) each."""
    inside = (time >= start) & (time <= end)
    psi = np.interp(time[inside], run.mark_time_s, run.mark_phase_rad)
    speed = (psi[-1] - psi[0]) / (end - start) if inside.sum() > 1 else 0.0
    turns = max(1, int((end - start) * speed / (2 * np.pi) / 6))
    if np.isfinite(values[inside]).sum() < 0.3 * max(inside.sum(), 200):
        raise NotEnoughData(f"laser {name}: too few valid samples in the last {end - start:.1f} s")
    try:
        track = order_track(time[inside], values[inside], psi, (1, 2, 3), revolutions=turns)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise NotEnoughData(f"laser {name}: {error}") from error
    means = [track.mean(k) for k in (1, 2, 3)]
    return np.array([m[0] for m in means]), np.array([m[1] for m in means])


def _rms_radius(x: np.ndarray, y: np.ndarray, std_x: float, std_y: float) -> Interval:
    """Rms radius of the motion from its order amplitudes; gains and noise of x and y are independent."""
    value = math.sqrt(0.5 * float(np.sum(np.abs(x) ** 2 + np.abs(y) ** 2)))
    std = math.hypot(abs(x[0]) * std_x, abs(y[0]) * std_y) / (2 * value) if value > 0 else math.hypot(std_x, std_y)
    return Interval(value, std)


def _state(settling: Settling, theta: tuple[float, float], physics: RotorParameters) -> str:
    if settling.slipping:
        return "slipping"
    return state_type(theta, physics) if settling.settled else "not settled"
