"""What the rig's sensors can do, as far as a plan needs it: noise, rate, gain, and how well their clocks get known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.signals.run import Run
from identification.errors import NotIdentifiable
from identification.samples import white_noise
from rig_configs.schema import Rig

# A rig file does not say these; what such devices usually do stands here, and a log of the rig tells better.
_LASER_NOISE_M = 4e-6  # one unaveraged sample of a triangulation sensor on metal
_ENCODER_NOISE_STEPS = 0.42  # quantisation (1/√12) and 0.3 steps of jitter
_LASER_JITTER_S, _NODE_JITTER_S = 0.4e-3, 2e-3  # reads of a serial line; blocks over a radio
_CLOCK_BINS = 20  # a log's clock line rests on so many least delayed reads (daq.clock)


@dataclass(frozen=True)
class Sensors:
    """The rig's sensors.

    Attributes:
        laser_noise_m: white noise of one sample of laser x and y, m.
        laser_rate_Hz: their sampling rates.
        gain_std: relative standard uncertainties of their gains.
        range_m: half of each measuring range, at the disk, m.
        encoder_noise_rad: white noise of one encoder sample, quantisation included, rad.
        encoder_rate_Hz: its sampling rate.
        encoder_zero_std_rad: standard uncertainty of its zeros.
        encoder_step_rad: its quantisation.
        clock_tolerance: relative standard uncertainty of each device's rate before anything is recorded: laser x,
            laser y, encoder.
        clock_jitter_s: scatter of the least delayed reads, the same order.
        measured: whether noise and jitter were measured in a log of this rig.
    """

    laser_noise_m: tuple[float, float]
    laser_rate_Hz: tuple[float, float]
    gain_std: tuple[float, float]
    range_m: tuple[float, float]
    encoder_noise_rad: float
    encoder_rate_Hz: float
    encoder_zero_std_rad: float
    encoder_step_rad: float
    clock_tolerance: tuple[float, float, float]
    clock_jitter_s: tuple[float, float, float]
    measured: bool = False

    @classmethod
    def of(cls, rig: Rig) -> Sensors:
        """The rig file's devices, with usual noise where the file does not say.

        Raises:
            NotIdentifiable: a laser or the encoders are not there.
        """
        x, y, encoder = rig.roles.along("x"), rig.roles.along("y"), rig.roles.angles
        if x is None or y is None or encoder is None:
            raise NotIdentifiable(
                f"rig {rig.name}: a plan needs displacements along x and y and the pendulums' angles; its devices are "
                f"{', '.join(rig.devices) or 'none'}"
            )
        step = encoder.step_rad
        return cls(
            (_LASER_NOISE_M / x.lever_ratio, _LASER_NOISE_M / y.lever_ratio),
            (float(x.rate_Hz), float(y.rate_Hz)),
            (x.gain_std, y.gain_std),
            (x.reach_m, y.reach_m),
            _ENCODER_NOISE_STEPS * step,
            float(encoder.rate_Hz),
            float(np.radians(encoder.zero_std_deg)),
            step,
            (1e-6 * x.clock_tolerance_ppm, 1e-6 * y.clock_tolerance_ppm, 1e-6 * encoder.clock_tolerance_ppm),
            (_LASER_JITTER_S, _LASER_JITTER_S, _NODE_JITTER_S),
        )

    def as_in(self, runs: Sequence[Run]) -> Sensors:
        """The same with the lasers' noise, their rates and the clocks' jitter as recorded runs show them.

        Raises:
            NotIdentifiable: no run holds both lasers.
        """
        usable = [r for r in runs if len(r.x_time_s) > 1000 and len(r.y_time_s) > 1000]
        if not usable:
            raise NotIdentifiable("no log with both lasers: expected one of this rig to measure its sensors' noise in")
        noise = [float(np.median([white_noise(v) for v in seen])) for seen in _of_both(usable, "x_m", "y_m")]
        rate = [
            float(np.median([1 / np.median(np.diff(t)) for t in seen]))
            for seen in _of_both(usable, "x_time_s", "y_time_s")
        ]
        jitter = [
            float(np.median([self._jitter(r, signal, i) for r in usable]))
            for i, signal in enumerate(("x", "y", "angles"))
        ]
        return replace(
            self, laser_noise_m=(noise[0], noise[1]), laser_rate_Hz=(rate[0], rate[1]),
            clock_jitter_s=(jitter[0], jitter[1], jitter[2]), measured=True,
        )  # fmt: skip

    def _jitter(self, run: Run, signal: str, index: int) -> float:
        """The jitter that explains how well a run knows the rate of a signal's clock."""
        std, prior = run.clock_rate_std.get(signal, self.clock_tolerance[index]), self.clock_tolerance[index]
        span = float(run.x_time_s[-1] - run.x_time_s[0])
        own = (std**-2 - prior**-2) ** -0.5 if 0 < std < 0.999 * prior else prior
        return float(own) * span / np.sqrt(12 / _CLOCK_BINS) if std > 0 else 0.0

    def clock_rate_std(self, device: int, record_s: float) -> float:
        """How well a record of this length knows a device's rate: its clock line and the tolerance together."""
        line = self.clock_jitter_s[device] * np.sqrt(12 / _CLOCK_BINS) / record_s
        prior = self.clock_tolerance[device]
        return float(line * prior / np.hypot(line, prior)) if line > 0 else 0.0


def _of_both(runs: Sequence[Run], x: str, y: str) -> list[list[np.ndarray]]:
    """The signals of laser x in all runs, and those of laser y."""
    return [[getattr(run, name) for run in runs] for name in (x, y)]
