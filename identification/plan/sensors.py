"""Properties of the rig's sensors for planning: noise, rate, gain, and uncertainty of their clocks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.signals.run import Run
from identification.clocks import clock_label
from identification.errors import NotIdentifiable
from identification.samples import white_noise
from rig_basics.texts import number_of
from rig_configs.error_label import ErrorLabel
from rig_configs.roles import USUAL_RELEASE_STD_S
from rig_configs.schema import Rig

# A rig file does not contain these values. They are usual ones; a log of the rig gives better ones.
_LASER_NOISE_M = 4e-6  # one unaveraged sample of a triangulation sensor on metal
_ENCODER_NOISE_STEPS = 0.42  # quantisation (1/√12) and 0.3 steps of jitter
_JITTER_S = {"x": 0.4e-3, "y": 0.4e-3, "angles": 2e-3, "phase": 2e-3}  # reads of a serial line; blocks over a radio
_CLOCK_BINS = 20  # number of least delayed reads that determine a log's clock line (daq.clock)
_FEWEST_SAMPLES = 1000  # smallest number of samples for an estimate of a sensor's noise


@dataclass(frozen=True)
class SensorProperties:
    """Properties of the rig's sensors; a missing sensor has infinite noise.

    Attributes:
        laser_noise_m: white noise of one sample of the displacements along x and y, m; inf for a missing sensor.
        laser_rate_Hz: sampling rates of the displacements, Hz; 0 for a missing sensor.
        gain_std: relative standard uncertainties of the displacement gains.
        range_m: half of each measuring range, at the disk, m.
        encoder_noise_rad: white noise of one sample of an angle, quantisation included, rad.
        encoder_rate_Hz: sampling rate of the angles, Hz.
        encoder_zero_std_rad: standard uncertainty of the encoders' zeros, rad.
        encoder_step_rad: quantisation step of the angles, rad.
        clock_tolerance: relative standard uncertainty of the rate of each signal's clock without a recording, for the
            signals "x", "y", "angles" and "phase".
        clock_jitter_s: scatter of the least delayed reads by signal, s.
        clocks: name of the clock of each signal, which is that of its device. Signals with the same clock have the same
            clock error.
        measured: whether noise and jitter were measured in a log of this rig.
        release_std_s: standard uncertainty of the instant at which a lock opens after its message, s.
    """

    laser_noise_m: tuple[float, float]
    laser_rate_Hz: tuple[float, float]
    gain_std: tuple[float, float]
    range_m: tuple[float, float]
    encoder_noise_rad: float
    encoder_rate_Hz: float
    encoder_zero_std_rad: float
    encoder_step_rad: float
    clock_tolerance: Mapping[str, float]
    clock_jitter_s: Mapping[str, float]
    clocks: Mapping[str, str]
    measured: bool = False
    release_std_s: float = USUAL_RELEASE_STD_S

    @classmethod
    def of(cls, rig: Rig) -> SensorProperties:
        """Return the sensors of a rig file, with usual values for noise and jitter."""
        roles = rig.roles
        axes = [roles.along(axis) for axis in "xy"]
        signals = {"x": axes[0], "y": axes[1], "angles": roles.angles, "phase": roles.phase}
        there = {name: role for name, role in signals.items() if role is not None}
        step = roles.angles.step_rad if roles.angles else math.inf
        noise = [_LASER_NOISE_M / d.lever_ratio if d else math.inf for d in axes]
        rate = [d.rate_Hz if d else 0.0 for d in axes]
        reach = [d.reach_m if d else math.inf for d in axes]
        return cls(
            (noise[0], noise[1]),
            (rate[0], rate[1]),
            roles.gain_stds,
            (reach[0], reach[1]),
            _ENCODER_NOISE_STEPS * step,
            roles.angles.rate_Hz if roles.angles else 0.0,
            math.radians(roles.zero_std_deg),
            step,
            {name: 1e-6 * role.clock_tolerance_ppm for name, role in there.items()},
            {name: _JITTER_S[name] for name in there},
            {name: role.device for name, role in there.items()},
            release_std_s=rig.pendulums.release_std_s,
        )

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes that have a displacement sensor."""
        return tuple(axis for axis in "xy" if axis in self.clocks)

    def as_in(self, runs: Sequence[Run]) -> SensorProperties:
        """Return the sensors with noise and rates of the displacements and jitter of the clocks from recorded runs.

        Raises:
            NotIdentifiable: no run contains all displacements that the rig measures.
        """
        usable = [r for r in runs if all(len(_signal(r, axis)[0]) > _FEWEST_SAMPLES for axis in self.axes)]
        if not usable:
            raise NotIdentifiable(
                f"expected a log of this rig with displacements along {' and '.join(self.axes)} for the sensors' "
                f"noise, got {number_of(len(runs), 'log')} without them; add one"
            )
        noise, rate = list(self.laser_noise_m), list(self.laser_rate_Hz)
        for axis in self.axes:
            seen = [_signal(run, axis) for run in usable]
            noise["xy".index(axis)] = float(np.median([white_noise(value) for _, value in seen]))
            rate["xy".index(axis)] = float(np.median([1 / np.median(np.diff(time)) for time, _ in seen]))
        jitter = {name: float(np.median([self._jitter(r, name) for r in usable])) for name in self.clocks}
        return replace(
            self,
            laser_noise_m=(noise[0], noise[1]),
            laser_rate_Hz=(rate[0], rate[1]),
            clock_jitter_s=jitter,
            measured=True,
        )

    def _jitter(self, run: Run, signal: str) -> float:
        """Return the jitter that explains the uncertainty of a clock's rate in a run, s."""
        prior = self.clock_tolerance[signal]
        std = run.clock_rate_std.get(signal, prior)
        time_s = _signal(run, self.axes[0])[0]
        span = float(time_s[-1] - time_s[0])
        own = (std**-2 - prior**-2) ** -0.5 if 0 < std < 0.999 * prior else prior
        return float(own) * span / math.sqrt(12 / _CLOCK_BINS) if std > 0 else 0.0

    def clock_rate_std(self, signal: str, record_s: float) -> float:
        """Return the relative standard uncertainty of a clock's rate in a record, from clock line and tolerance."""
        line = self.clock_jitter_s[signal] * math.sqrt(12 / _CLOCK_BINS) / record_s
        prior = self.clock_tolerance[signal]
        return line * prior / math.hypot(line, prior) if line > 0 else 0.0

    def clock_error(self, signal: str, shift: NDArray[np.float64]) -> dict[ErrorLabel, NDArray[np.float64]]:
        """Return a shared error under the label that `identification.clocks` gives it in a recorded test."""
        return {clock_label(self.clocks[signal]): shift}


def _signal(run: Run, axis: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return (run.x_time_s, run.x_m) if axis == "x" else (run.y_time_s, run.y_m)
