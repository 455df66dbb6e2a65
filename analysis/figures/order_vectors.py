"""Once-per-revolution vectors of a run over speed, measured and simulated, for Bode and polar plots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.errors import NotEnoughData
from analysis.figures.recorded import LEAST_MARKS, displacements, marks_words, need_vectors
from analysis.figures.steady_part import SteadyPart, steady_part
from analysis.quantities.amplification import amplification_factors
from analysis.quantities.order_tracking import order_track
from analysis.quantities.rotor_phase import phase_at
from analysis.quantities.stamp_lag import StampLag, fitted_lag, unknown_lag
from analysis.rig_model import RigModel
from analysis.rounding import with_std
from analysis.simulated_run import SimulatedRun, locked_angles, simulate_run
from daq.signals.run import Run
from rig_basics.arrays import Array, Complex
from rig_basics.units import TO_RPM

_MAX_SPREAD = 0.05  # of the speed, relative to its median: below it a run has one speed
_STEADY_POINTS = 1500
_WINDOW_TURNS = 4  # revolutions per window of the average at one speed
_MIN_PHASE_STDS = 3.0  # amplitude in standard deviations above which a vector has a phase


@dataclass(frozen=True)
class OrderVectors:
    """Complex 1× amplitudes of one displacement over speed.

    Attributes:
        speed_rad_s: speeds, shape (n,).
        amplitude_m: complex amplitudes, shape (n,), x = Re(X e^{iψ}).
        std_m: standard deviation of real and imaginary part each, shape (n,); 0 for a model's.
        lag_std_s: standard uncertainty of the stamps' lag behind the rotor's phase, s, which turns all vectors in
            proportion to the speed.
    """

    speed_rad_s: Array
    amplitude_m: Complex
    std_m: Array
    lag_std_s: float = 0.0

    @property
    def phase_std_rad(self) -> Array:
        """Standard deviation of the phase, shape (n,)."""
        own = self.std_m / np.maximum(np.abs(self.amplitude_m), 1e-300)
        return np.hypot(own, np.abs(self.speed_rad_s) * self.lag_std_s)

    def at(self, speed_rad_s: Array) -> Complex:
        """Return vectors interpolated at other speeds."""
        order = np.argsort(self.speed_rad_s)
        known, values = self.speed_rad_s[order], self.amplitude_m[order]
        return np.interp(speed_rad_s, known, values.real) + 1j * np.interp(speed_rad_s, known, values.imag)

    def phase_deg(self, near: OrderVectors | None = None) -> Array:
        """Return the phase, unwrapped along the speed; NaN where the amplitude is lost in its noise.

        Args:
            near: vectors whose phase determines the turn, so that both phases lie in the same turn.
        """
        phase = np.degrees(np.unwrap(np.angle(self.amplitude_m)))
        if near is not None and len(near.speed_rad_s):
            level = np.interp(self.speed_rad_s, near.speed_rad_s, near.phase_deg())
            phase = level + (np.degrees(np.angle(self.amplitude_m)) - level + 180.0) % 360.0 - 180.0
        else:
            phase -= 360.0 * np.round(phase[np.isfinite(phase)][:1] / 360.0) if np.isfinite(phase).any() else 0.0
        return np.where(np.abs(self.amplitude_m) > _MIN_PHASE_STDS * self.std_m, phase, np.nan)


ByName = dict[str, OrderVectors]


@dataclass(frozen=True)
class PassedVectors:
    """Vectors of the recorded displacements ("x", "y") of one run: over its speeds, or one in its last seconds.

    Attributes:
        measured: measured vectors, with the phases of their stamps.
        simulated: vectors of the simulated run; empty without simulation.
        steady: vectors of the model's steady motion at each speed; empty without.
        lags: lags of the stamps behind the rotor's phase, estimated with the simulated run where it allows this.
        corrected: measured vectors without the estimated lags, with the uncertainty of these or of unknown ones.
    """

    measured: ByName
    simulated: ByName
    steady: ByName
    lags: Mapping[str, StampLag] = field(default_factory=dict[str, StampLag])
    corrected: ByName = field(default_factory=dict[str, OrderVectors])


def cut_words(found: PassedVectors, tops_m: Mapping[str, float]) -> list[str]:
    """Describe in a sentence where the steady response exceeds its plot.

    Args:
        found: vectors of the plot.
        tops_m: upper limit of each displacement's plot, m.
    """
    cut = [
        f"{name} reaches {1e3 * float(size.max()):.3g} mm at "
        f"{TO_RPM * steady.speed_rad_s[int(np.argmax(size))]:.1f} rpm"
        for name, steady in found.steady.items()
        if name in tops_m and len(size := np.abs(steady.amplitude_m)) and float(size.max()) > tops_m[name]
    ]
    return [f"The steady response leaves the plot: {', '.join(cut)}."] if cut else []


def amplification_words(run: Run) -> list[str]:
    """Return the amplification factors on the suspension's principal axes as a sentence.

    The result is empty if no resonance is complete, or if only one displacement was recorded.
    """
    seen = displacements(run)
    if len(seen) < 2:
        return []
    x, y = (order_track(time, values, phase_at(run, time)) for time, values in seen.values())
    try:
        found = [each for each in amplification_factors(x, y) if each is not None]
    except ValueError:  # usual: too few rows of common speeds
        return []
    if not found:
        return []
    factors = ", ".join(
        f"{with_std(each.factor, each.std)} at {TO_RPM * each.peak_rad_s:.1f} rpm, {math.degrees(each.axis_rad):.1f}°"
        for each in sorted(found, key=lambda one: one.peak_rad_s)
    ).replace("-", "−")
    return [
        f"Amplification factors on the principal axes (at their angle from x towards y), as run through: {factors}."
    ]


def speed_range(run: Run) -> tuple[float, float]:
    """Return the least and the largest speed between marks, rad/s.

    Raises:
        NotEnoughData: fewer than three marks.
    """
    if len(run.mark_time_s) < LEAST_MARKS:
        raise NotEnoughData(
            f"{run.source} ({run.test}): expected index marks of a turning rotor, the log has {marks_words(run)}; give "
            "the log of a run-up or of a point"
        )
    speeds = np.diff(run.mark_phase_rad) / np.diff(run.mark_time_s)
    return float(np.min(speeds)), float(np.max(speeds))


def changes_speed(run: Run) -> bool:
    """Whether a run passes through speeds rather than staying at one; a stop at its end does not count."""
    speed_range(run)
    time = np.linspace(float(run.mark_time_s[0]), float(run.mark_time_s[-1]), 400)
    speeds = np.diff(np.interp(time, run.mark_time_s, run.mark_phase_rad))
    low, middle, high = np.quantile(speeds, [0.1, 0.5, 0.9]).tolist()
    return high - low > _MAX_SPREAD * middle


def need_speeds(run: Run, what: str) -> None:
    """Check that a run passes through speeds.

    Raises:
        NotEnoughData: it stays at one speed, or does not turn.
    """
    low, high = speed_range(run)
    if not changes_speed(run):
        raise NotEnoughData(
            f"{run.source}: expected a run through speeds for {what}, its speed stays between {low * TO_RPM:.1f} and "
            f"{high * TO_RPM:.1f} rpm; give the log of a run-up"
        )


def vectors_of(run: Run) -> ByName:
    """Return the measured 1× vectors of the recorded displacements, one per revolution.

    Raises:
        NotEnoughData: no displacement, no marks, or too few samples between them.
    """
    seen = displacements(run)
    if not seen:
        raise NotEnoughData(f"{run.source}: expected displacements, the log has none")
    return {name: _tracked(run.source, time, values, phase_at(run, time)) for name, (time, values) in seen.items()}


def simulated_vectors(simulated: SimulatedRun) -> ByName:
    """Return the 1× vectors of a simulated run, tracked in the same way."""
    return {
        name: _tracked("simulated run", simulated.time_s, values, simulated.phase_rad)
        for name, values in (("x", simulated.x_m), ("y", simulated.y_m))
    }


def _tracked(source: str, time: Array, values: Array, phase: Array) -> OrderVectors:
    try:
        track = order_track(time, values, phase)
    except ValueError as error:
        raise NotEnoughData(f"{source}: {error}") from error
    return OrderVectors(track.speed_rad_s, *track.of(1))


def steady_vectors(model: RigModel, run: Run) -> ByName:
    """Return the model's steady 1× vectors with the pendulums at the run's lock angles, over the run's speeds."""
    low, high = speed_range(run)
    speed = np.linspace(max(low, 1e-3 * high), high, _STEADY_POINTS)
    x, y = model.locked(speed, locked_angles(run))
    there = np.isfinite(x)
    nothing = np.zeros(int(there.sum()))
    return {name: OrderVectors(speed[there], values[there], nothing) for name, values in (("x", x), ("y", y))}


def vectors_at_end(run: Run, part: SteadyPart) -> ByName:
    """Return the measured 1× vectors of the recorded displacements in a part at one speed, one row each.

    Raises:
        NotEnoughData: too few samples or revolutions.
    """
    found: ByName = {}
    for name, (time, values) in displacements(run).items():
        at, seen = part.cut(time, values)
        mean = _mean(run.source, at, seen, phase_at(run, at), part.speed_rad_s)
        found[name] = replace(mean, lag_std_s=unknown_lag(run.clocks, name).std_s)
    return found


def compared_vectors(run: Run, simulated: SimulatedRun | None) -> PassedVectors | None:
    """Return measured and simulated vectors of a run: over the speeds it passes through, or at its end.

    Returns:
        None if the run was not simulated, or has no displacement or too few revolutions.
    """
    if simulated is None:
        return None
    try:
        if changes_speed(run):
            return _with_lags(run, vectors_of(run), simulated_vectors(simulated), {})
        part = steady_part(run)
        predicted = {
            name: _mean(
                "simulated run",
                *part.cut(simulated.time_s, values),
                part.cut(simulated.time_s, simulated.phase_rad)[1],
                part.speed_rad_s,
            )
            for name, values in (("x", simulated.x_m), ("y", simulated.y_m))
        }
        return PassedVectors(vectors_at_end(run, part), predicted, {})
    except NotEnoughData:  # usual: a short steady part
        return None


def _mean(source: str, time: Array, values: Array, phase: Array, speed_rad_s: float) -> OrderVectors:
    try:
        track = order_track(time, values, phase, revolutions=_WINDOW_TURNS)
    except ValueError as error:
        raise NotEnoughData(f"{source}: {error}") from error
    amplitude, std = track.mean(1)
    return OrderVectors(np.array([speed_rad_s]), np.array([amplitude]), np.array([std]))


def passed_vectors(run: Run, model: RigModel | None) -> PassedVectors:
    """Return all vectors of a Bode or polar plot of one run.

    Raises:
        NotEnoughData: the run does not pass through speeds, or has no displacements or index marks.
    """
    need_vectors(run, "a plot of 1× vectors")
    need_speeds(run, "1× vectors over speed")
    measured = vectors_of(run)
    simulated = None if model is None else simulate_run(run, model)
    predicted = {} if simulated is None else simulated_vectors(simulated)
    steady = {} if model is None else steady_vectors(model, run)
    return _with_lags(run, measured, predicted, steady)


def _with_lags(run: Run, measured: ByName, predicted: ByName, steady: ByName) -> PassedVectors:
    lags: dict[str, StampLag] = {}
    corrected: ByName = {}
    for name, seen in measured.items():
        corrected[name], lags[name] = _without_lag(run, name, seen, predicted.get(name))
    return PassedVectors(measured, predicted, steady, lags, corrected)


def _without_lag(
    run: Run, name: str, measured: OrderVectors, simulated: OrderVectors | None
) -> tuple[OrderVectors, StampLag]:
    """Return a displacement's vectors without its lag by the simulated run; with an unknown one where this is no line.

    Free vibration turns with its own frequency. The vectors are therefore tracked again at the corrected times, and the
    lag that these still have is added.
    """
    first = None if simulated is None else _lag_of(measured, simulated)
    if simulated is None or first is None or not first.is_line:
        unknown = unknown_lag(run.clocks, name)
        return replace(measured, lag_std_s=unknown.std_s), unknown
    time, values = displacements(run)[name]
    again = _tracked(run.source, time - first.lag_s, values, phase_at(run, time - first.lag_s))
    rest = _lag_of(again, simulated) or replace(first, lag_s=0.0)
    lag = replace(first, lag_s=first.lag_s + rest.lag_s, std_s=rest.std_s)
    amplitude = rest.without(again.speed_rad_s, again.amplitude_m)
    return replace(again, amplitude_m=amplitude, lag_std_s=lag.std_s), lag


def _lag_of(measured: OrderVectors, simulated: OrderVectors) -> StampLag | None:
    return fitted_lag(measured.speed_rad_s, measured.amplitude_m, simulated.at(measured.speed_rad_s))
