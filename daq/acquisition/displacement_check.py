"""Checks of one displacement sensor at rest: validity, position, changing values, white noise and steady lines.

Each value is compared together with the bound of its error. The bounds are those of three standard deviations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.drivers.checks import Checks, DeviceCheck, at_most, longer
from daq.signals.laser_disturbances import MIN_LENGTH_S, SteadyLine, lines_in, thinned
from rig_basics.arrays import Array
from rig_configs.roles import DisplacementSensor
from rig_configs.schema import Limits

_MAX_INVALID_SHARE = 0.01  # of a laser's samples at rest; single flashes of light are allowed
_MAX_NOISE_SHARE = 5e-4  # rms of the white noise, of the measuring range
_MAX_LINE_SHARE = 2e-4  # amplitude of a steady line, of the measuring range
_MIN_SPECTRUM = 256  # samples for a level of noise
_MIN_EQUAL = 256
"""Number of equal samples that no working sensor gives.

With noise of at least a third of its step, a sensor repeats a value with a probability of at most 0.87, the share of a
normal distribution within 1.5 standard deviations. So many equal samples then have a probability below 1e-15.
"""
_MAX_ORDER, _ORDER_TOLERANCE = 10, 0.02  # of the rotor's speed; deviation of a line from an order, of its frequency
STDS = 3.0
"""Bounds of errors, in standard deviations."""
_RMS_SCATTER = 1.8
"""Relative scatter of the rms from the median of N = n/4 ordinates, times √n: a median has 1/(ln 2 √N), the Hann window
correlates neighbours, a factor of 1.22, and the root halves it.
"""


@dataclass(frozen=True)
class ObservedDisplacement:
    """Samples of a displacement sensor in the observation.

    Attributes:
        time_s: times from the start of the observation, shape (n,), ascending, s.
        value_m: displacement of the disk centre, shape (n,), m; NaN for invalid samples.
    """

    time_s: Array
    value_m: Array

    @property
    def seconds(self) -> float:
        """Time between the first and the last sample, s."""
        return float(self.time_s[-1] - self.time_s[0]) if len(self.time_s) else 0.0

    @classmethod
    def since(cls, start_ns: int, time_ns: NDArray[np.int64], value_m: Array) -> ObservedDisplacement:
        """Make it of times on the host's clock, ns, and the start of the observation on the same clock."""
        return cls((time_ns - start_ns).astype(np.float64) * 1e-9, value_m)


def displacement_checks(
    sensor: DisplacementSensor, limits: Limits, seen: ObservedDisplacement, rotor_rpm: float
) -> Checks:
    """Return the checks of a sensor's samples; `rotor_rpm` is NaN if the speed is unknown."""
    x = seen.value_m
    if not len(x):
        return {"samples": DeviceCheck(0, "some", False, "no samples received")}
    out = {"invalid_samples": _invalid(x, seen.seconds)}
    if np.all(np.isnan(x)):
        return out
    at_mm = float(np.nanmedian(x)) * sensor.lever_ratio * 1e3
    room_mm = (0.5 * sensor.range_m - limits.amplitude_m * sensor.lever_ratio) * 1e3
    ok = abs(at_mm) <= room_mm
    note = "" if ok else "move the sensor: limits.amplitude_m exceeds its range at this position"
    out["from_mid_range_mm"] = DeviceCheck(round(at_mm, 3), f"within ± {room_mm:.3g}", ok, note)
    out["peak_to_peak_mm"] = DeviceCheck(round(float(np.nanmax(x) - np.nanmin(x)) * 1e3, 4), None, True)
    return out | {"equal_samples": _constant(x)} | _noise(sensor, seen, rotor_rpm)


def _invalid(x: Array, seconds: float) -> DeviceCheck:
    """Check the share of invalid samples; none among n are less than 3/n with a probability of 95 %."""
    share = float(np.mean(np.isnan(x)))
    bound = (3.0 + STDS * math.sqrt(len(x) * share * (1 - share))) / len(x)
    few = at_most(share, bound, _MAX_INVALID_SHARE)
    note = {
        True: "",
        False: "the sensor detects no target: check beam, distance and surface",
        None: longer(seconds, bound, _MAX_INVALID_SHARE - share),
    }[few]
    return DeviceCheck(f"{share:.1%}", f"at most {_MAX_INVALID_SHARE:.0%}", few, note)


def _constant(x: Array) -> DeviceCheck:
    """Check that the values change: a sensor that hangs repeats its last one to the last bit."""
    values = x[np.isfinite(x)]
    equal = len(values) if np.all(values == values[0]) else 0
    verdict = True if not equal else False if equal >= _MIN_EQUAL else None
    advice = "the sensor hangs: switch it off and on. One with steps above its noise must be touched during the check"
    note = {True: "", False: advice, None: f"not resolved: {_MIN_EQUAL} samples are needed"}[verdict]
    return DeviceCheck(equal, f"fewer than {_MIN_EQUAL}", verdict, note)


def _noise(sensor: DisplacementSensor, seen: ObservedDisplacement, rotor_rpm: float) -> Checks:
    """Check the noise of the readings: its white part, and steady lines.

    Slow motion of the column is neither, and orders of a rotor that turns are no disturbance.
    """
    good = np.isfinite(seen.value_m)
    time, reading = seen.time_s[good], seen.value_m[good] * sensor.lever_ratio
    most_um = _MAX_NOISE_SHARE * sensor.range_m * 1e6
    least_um = _MAX_LINE_SHARE * sensor.range_m * 1e6
    if len(time) < _MIN_SPECTRUM or time[-1] <= time[0]:
        note = f"not resolved: {_MIN_SPECTRUM} valid samples are needed"
        return {"noise_um": DeviceCheck(None, f"at most {most_um:.3g} rms", None, note)}
    noise_um = _white_rms(reading) * 1e6
    bound_um = STDS * _RMS_SCATTER / math.sqrt(len(reading)) * noise_um
    quiet = at_most(noise_um, bound_um, most_um)
    note = {
        True: "",
        False: "look at supply, shield, surface and exposure",
        None: f"± {bound_um:.2g}; " + longer(float(time[-1] - time[0]), bound_um, most_um - noise_um),
    }[quiet]
    out = {"noise_um": DeviceCheck(float(f"{noise_um:.2g}"), f"at most {most_um:.3g} rms", quiet, note)}
    found = lines_in(time, reading, thinned(time, reading))
    lines = [line for line in found if not _is_order(line.frequency_Hz, rotor_rpm)]
    orders = f"the rotor turns at {rotor_rpm:.0f} rpm: its orders are left out" if len(lines) < len(found) else ""
    strong = [line for line in lines if line.amplitude_m * 1e6 > least_um]
    advice = "look at the supply, its earth and the shield of the cable, and at machines that shake the floor"
    worst_um = max((line.amplitude_m * 1e6 for line in lines), default=0.0)
    hidden_um = 2.0 * noise_um * math.sqrt((math.log(len(reading)) + STDS) / len(reading))  # least line above the noise
    clear = False if strong else True if hidden_um <= least_um and seen.seconds >= MIN_LENGTH_S else None
    unclear = f"not resolved: observe for {math.ceil(MIN_LENGTH_S)} s or more, with less noise" if clear is None else ""
    out["steady_lines_um"] = DeviceCheck(
        round(worst_um, 1),
        f"at most {least_um:.3g}",
        clear,
        ". ".join(filter(None, [f"{_words_of(strong)}. {advice}" if strong else unclear, orders])),
    )
    return out


def _is_order(frequency_Hz: float, rotor_rpm: float) -> bool:
    """Return whether a frequency is a low order of the rotor's speed; NaN for an unknown speed."""
    if not abs(rotor_rpm) > 0:
        return False
    order = frequency_Hz * 60.0 / abs(rotor_rpm)
    return 1 <= round(order) <= _MAX_ORDER and abs(order - round(order)) <= _ORDER_TOLERANCE * order


def _words_of(lines: Sequence[SteadyLine]) -> str:
    return "; ".join(line.words for line in lines)


def _white_rms(value: Array) -> float:
    """Return the rms of the white part of evenly spaced values, from the median of the upper half of the spectrum."""
    window = np.hanning(len(value))
    power = np.abs(np.fft.rfft((value - value.mean()) * window)) ** 2
    level = float(np.median(power[len(power) // 2 :])) / math.log(2)
    return math.sqrt(level / float(window @ window))
