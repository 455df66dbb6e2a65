# pyright: strict
"""Once-per-revolution vectors of a run over speed, measured and of the model, for Bode and polar plots."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.errors import NotEnoughData
from analysis.quantities.amplification import amplification_factors
from analysis.quantities.order_tracking import order_track
from analysis.quantities.rotor_phase import phase_at
from analysis.rig_model import RigModel
from analysis.rounding import with_std
from analysis.simulated_run import SimulatedRun, locked_angles, simulate_run
from daq.signals.run import Run

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

RPM = 30 / math.pi
_SPREAD = 0.05  # of the mean speed: below it a run has one speed
_STEADY_POINTS = 1500
_STRAIGHT_RAD, _SHARE = math.radians(1.5), 0.25  # left beside a line: little, or little of what there was
_SEEN = 3.0  # standard deviations above which a vector has a phase


@dataclass(frozen=True)
class Vectors:
    """Complex 1× amplitudes of one displacement over speed.

    Attributes:
        speed_rad_s: shape (n,).
        amplitude_m: complex, shape (n,), x = Re(X e^{iψ}).
        std_m: of real and imaginary part each, shape (n,); 0 for a model's.
    """

    speed_rad_s: Array
    amplitude_m: Complex
    std_m: Array

    def phase_deg(self, near: Vectors | None = None) -> Array:
        """Phase, unwrapped along the speed; nan where the amplitude is lost in its noise.

        Args:
            near: vectors whose turn is taken, so that both lie in the same turn.
        """
        phase = np.degrees(np.unwrap(np.angle(self.amplitude_m)))
        if near is not None and len(near.speed_rad_s):
            level = np.interp(self.speed_rad_s, near.speed_rad_s, near.phase_deg())
            phase = level + (np.degrees(np.angle(self.amplitude_m)) - level + 180.0) % 360.0 - 180.0
        else:
            phase -= 360.0 * np.round(phase[np.isfinite(phase)][:1] / 360.0) if np.isfinite(phase).any() else 0.0
        return np.where(np.abs(self.amplitude_m) > _SEEN * self.std_m, phase, np.nan)


ByName = dict[str, Vectors]


@dataclass(frozen=True)
class PassedVectors:
    """Vectors of "x" and "y" in one run, of those that were recorded.

    Attributes:
        measured: as the sensors saw them.
        simulated: of the same run simulated; empty without.
        steady: of the model's steady motion at each speed; empty without.
    """

    measured: ByName
    simulated: ByName
    steady: ByName


def lag_words(found: PassedVectors) -> list[str]:
    """How much later or earlier than the rotor's phase each displacement is stamped, by the simulated run, a sentence.

    A lag is a straight line through the origin of phase against speed, weighted by the amplitudes; its ± is half the
    difference of the lags of slow and fast half of the weight. Where no line fits, something else differs.
    """
    if not found.simulated:
        return []
    words = [_lag_word(name, found.simulated[name], seen) for name, seen in found.measured.items()]
    lags = [word for word, is_line in words if is_line and word]
    others = [word for word, is_line in words if not is_line and word]
    told: list[str] = []
    if lags:
        told.append(
            "Measured less simulated phase is a straight line through 0 at standstill, as of stamps that are shifted "
            f"against the rotor's phase: {', '.join(lags)}. Every fit leaves this shift between the devices free."
        )
    if others:
        told.append(f"No lag of the stamps explains measured less simulated phase: {', '.join(others)}.")
    return told


def _lag_word(name: str, model: Vectors, measured: Vectors) -> tuple[str, bool]:
    """A displacement's lag in words, and whether it is one; else what a line leaves. No words of too few vectors."""
    speed, beside = measured.speed_rad_s, _complex_interp(measured.speed_rad_s, model)
    ahead = np.angle(measured.amplitude_m * np.conj(beside))
    weight = np.abs(beside) * np.abs(measured.amplitude_m)
    good = np.isfinite(ahead) & np.isfinite(weight)
    speed, ahead, weight = speed[good], ahead[good], weight[good]

    def lag_of(part: NDArray[np.bool_] | slice) -> float:
        return -float((weight * speed * ahead)[part].sum() / (weight * speed**2)[part].sum())

    passed = np.cumsum(weight * speed**2)
    slow = passed <= 0.5 * passed[-1:]
    if not 0 < np.count_nonzero(slow) < len(slow) or not passed[slow][-1] > 0:
        return "", False
    lag, std = lag_of(slice(None)), 0.5 * abs(lag_of(slow) - lag_of(~slow))
    rest = math.sqrt(float(np.average((ahead + lag * speed) ** 2, weights=weight)))
    if rest > _STRAIGHT_RAD and rest > _SHARE * math.sqrt(float(np.average(ahead**2, weights=weight))):
        return f"a line leaves {math.degrees(rest):.0f}° rms in {name}", False
    return f"{name} {1e3 * abs(lag):.2f} ± {max(1e3 * std, 0.01):.2f} ms {'late' if lag > 0 else 'early'}", True


def amplification_words(run: Run) -> list[str]:
    """Amplification factors on the suspension's principal axes, as a sentence.

    None where a resonance is not whole, and where only one displacement was recorded.
    """
    seen = _recorded(run)
    if len(seen) < 2:
        return []
    x, y = (order_track(time, values, phase_at(run, time)) for time, values in seen.values())
    try:
        found = [each for each in amplification_factors(x, y) if each is not None]
    except ValueError:  # too few rows of speeds that both have
        return []
    if not found:
        return []
    told = ", ".join(
        f"{with_std(each.factor, each.std)} at {RPM * each.peak_rad_s:.1f} rpm, {math.degrees(each.axis_rad):.1f}°"
        for each in sorted(found, key=lambda one: one.peak_rad_s)
    ).replace("-", "−")
    return [f"Amplification factors on the principal axes (at their angle from x towards y), as run through: {told}."]


def _complex_interp(speed: Array, found: Vectors) -> Complex:
    order = np.argsort(found.speed_rad_s)
    at, values = found.speed_rad_s[order], found.amplitude_m[order]
    return np.interp(speed, at, values.real) + 1j * np.interp(speed, at, values.imag)


def speed_range(run: Run) -> tuple[float, float]:
    """Least and largest speed between marks, rad/s.

    Raises:
        NotEnoughData: fewer than three marks.
    """
    if len(run.mark_time_s) < 3:
        raise NotEnoughData(
            f"{run.source}: expected a run with the rotor turning, its index passed {len(run.mark_time_s)} times; give "
            "the log of a run-up or of a point"
        )
    speeds = np.diff(run.mark_phase_rad) / np.diff(run.mark_time_s)
    return float(np.min(speeds)), float(np.max(speeds))


def changes_speed(run: Run) -> bool:
    """Whether a run goes through speeds rather than staying at one; a stop at its end is none."""
    speed_range(run)
    time = np.linspace(float(run.mark_time_s[0]), float(run.mark_time_s[-1]), 400)
    speeds = np.diff(np.interp(time, run.mark_time_s, run.mark_phase_rad))
    low, middle, high = np.quantile(speeds, [0.1, 0.5, 0.9]).tolist()
    return high - low > _SPREAD * middle


def need_speeds(run: Run, what: str) -> None:
    """Refuse a run at one speed.

    Raises:
        NotEnoughData: it stays at one speed, or does not turn.
    """
    low, high = speed_range(run)
    if not changes_speed(run):
        raise NotEnoughData(
            f"{run.source}: expected a run through speeds for {what}, its speed stays between {low * RPM:.1f} and "
            f"{high * RPM:.1f} rpm; give the log of a run-up"
        )


def vectors_of(run: Run) -> ByName:
    """Measured 1× vectors of those of x and y that were recorded, one a revolution.

    Raises:
        NotEnoughData: no displacement, no marks, or too few samples between them.
    """
    seen = _recorded(run)
    if not seen:
        raise NotEnoughData(f"{run.source}: expected displacements, the log has none")
    return {name: _tracked(run.source, time, values, phase_at(run, time)) for name, (time, values) in seen.items()}


def _recorded(run: Run) -> dict[str, tuple[Array, Array]]:
    """Times and values of the displacements there are."""
    both = {"x": (run.x_time_s, run.x_m), "y": (run.y_time_s, run.y_m)}
    return {name: pair for name, pair in both.items() if np.isfinite(pair[1]).any()}


def simulated_vectors(simulated: SimulatedRun) -> ByName:
    """The same of a simulated run, tracked in the same way."""
    return {
        name: _tracked("simulated run", simulated.time_s, values, simulated.phase_rad)
        for name, values in (("x", simulated.x_m), ("y", simulated.y_m))
    }


def _tracked(source: str, time: Array, values: Array, phase: Array) -> Vectors:
    try:
        track = order_track(time, values, phase)
    except ValueError as error:
        raise NotEnoughData(f"{source}: {error}") from error
    return Vectors(track.speed_rad_s, *track.of(1))


def steady_vectors(model: RigModel, run: Run) -> ByName:
    """The model's steady 1× vectors with the pendulums where the run's locks hold them, over the run's speeds."""
    low, high = speed_range(run)
    speed = np.linspace(max(low, 1e-3 * high), high, _STEADY_POINTS)
    x, y = model.locked(speed, locked_angles(run))
    there = np.isfinite(x)
    nothing = np.zeros(int(there.sum()))
    return {name: Vectors(speed[there], values[there], nothing) for name, values in (("x", x), ("y", y))}


def passed_vectors(run: Run, model: RigModel | None) -> PassedVectors:
    """All vectors that a Bode or polar plot of one run shows.

    Raises:
        NotEnoughData: the run does not go through speeds.
    """
    need_speeds(run, "1× vectors over speed")
    measured = vectors_of(run)
    if model is None:
        return PassedVectors(measured, {}, {})
    simulated = simulate_run(run, model)
    return PassedVectors(
        measured, {} if simulated is None else simulated_vectors(simulated), steady_vectors(model, run)
    )
