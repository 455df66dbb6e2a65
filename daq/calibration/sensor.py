"""Calibration of one displacement sensor against gauge blocks or a micrometer: readings, then a line through them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from daq.acquisition.session import Session
from daq.calibration.lengths import KnownPosition
from daq.calibration.line import GaugeLine, GaugeReading, fit_line
from daq.errors import ProcedureError
from daq.items import DeviceEvent
from rig_basics.arrays import Array
from rig_basics.texts import number_of
from rig_configs.device import DisplacementSettings

_PARTS = 10  # of a reading; the spread of their means is its uncertainty, also with correlated noise
_MAX_DRIFT_M = 5e-6  # between the first and the second half of a reading
_MAX_INVALID_SHARE = 0.05
_ATTEMPTS = 3
_MAX_GAIN_ERROR = 0.05  # larger deviations from the rig file are a mistyped size, a wrong range or a wrong lever


class PlacesTargets(Protocol):
    """Brings the target of a sensor to known positions: a person, or the simulated operator."""

    def place(self, device: str, mm: float | None) -> None:
        """Bring the target to a position and return when it rests there.

        Args:
            device: name of the sensor.
            mm: position, mm; None: the calibration is complete, remove the block.
        """
        ...


@dataclass(frozen=True)
class SensorSetup:
    """How the positions relate to the readings.

    Attributes:
        toward: whether a larger position moves the target toward the sensor (a thicker block): the reading falls.
        at_disk: whether the positions are displacements of the disk and not of the sensor's target. Gain and lever are
            then calibrated together.
        seconds: duration of one reading, s.
        zero_m: position that is displacement 0; None: the offset is not determined.
    """

    toward: bool = False
    at_disk: bool = False
    seconds: float = 2.0
    zero_m: float | None = None


def uncorrected(settings: DisplacementSettings) -> DisplacementSettings:
    """Return the settings of a sensor without its calibration, with which it is calibrated again."""
    return settings.model_copy(update={"gain_factor": 1.0, "offset_m": 0.0})


def there_and_back(positions: Sequence[KnownPosition]) -> list[KnownPosition]:
    """Return the positions in their order and then in the reverse order, so that each is approached from both sides."""
    return [*positions, *reversed(positions)]


def read_positions(
    session: Session,
    device: str,
    positions: Sequence[KnownPosition],
    operator: PlacesTargets,
    setup: SensorSetup,
    notify: Callable[[str], None],
) -> list[GaugeReading]:
    """Read the sensor at each position.

    Args:
        session: open, with the settings of `uncorrected`.
        notify: called with one line of text after each reading.
    Raises:
        ProcedureError: the target moves, or the sensor detects no target, at three attempts.
    """
    settings = session.rig.devices[device]
    assert isinstance(settings, DisplacementSettings), "the caller chooses a displacement sensor"
    lever = 1.0 if setup.at_disk else settings.lever_ratio
    sign = -1.0 if setup.toward else 1.0
    found: list[GaugeReading] = []
    for number, known in enumerate(positions, start=1):
        operator.place(device, 1e3 * known.position_m)
        mean, std = _steady(session, settings, setup.seconds, f"position {1e3 * known.position_m:g} mm", notify)
        reading = GaugeReading(sign * known.position_m, known.std_m, lever * mean, lever * std)
        found.append(reading)
        text = (
            f"reading {number} of {len(positions)}: position {1e3 * known.position_m:.4f} mm, "
            f"sensor {1e3 * reading.reading_m:.5f} ± {1e3 * reading.reading_std_m:.5f} mm"
        )
        facts = {
            "position_m": known.position_m,
            "position_std_m": known.std_m,
            "reading_m": reading.reading_m,
            "reading_std_m": reading.reading_std_m,
        }
        session.note(DeviceEvent("calibration", device, text, facts))
        notify(text)
    operator.place(device, None)
    return found


def _steady(
    session: Session, settings: DisplacementSettings, seconds: float, where: str, notify: Callable[[str], None]
) -> tuple[float, float]:
    """Return mean and standard uncertainty of a reading of a target at rest, m at the disk."""
    why = ""
    for _ in range(_ATTEMPTS):
        session.clock.wait(0.3)
        started = session.clock.now_ns()
        session.clock.wait(seconds)
        session.check()
        _, (x,) = session.channels.recent.last(settings.topic, ("displacement_m",), started)
        why = _why_not(x, settings.rate_Hz * seconds)
        if not why:
            return mean_with_std(x[~np.isnan(x)])
        notify(f"{where}: {why}; it is read again")
    raise ProcedureError(f"{where}: {why}, {_ATTEMPTS} times. Fix the target and the sensor, then repeat")


def _why_not(x: Array, expected: float) -> str:
    """Return why samples are not a reading; empty if they are one."""
    valid = x[~np.isnan(x)]
    if len(x) < 0.5 * expected or len(x) < 2 * _PARTS:
        return f"{number_of(len(x), 'sample')}, expected {expected:.0f}"
    if len(valid) < (1 - _MAX_INVALID_SHARE) * len(x):
        return f"the sensor detects no target in {100 * (1 - len(valid) / len(x)):.0f} % of the samples"
    half = len(valid) // 2
    drift = float(np.mean(valid[half:]) - np.mean(valid[:half]))
    if abs(drift) > _MAX_DRIFT_M:
        return f"the target moves, by {1e6 * drift:+.1f} µm between both halves of the reading"
    return ""


def mean_with_std(x: Array) -> tuple[float, float]:
    """Return the mean of samples and its standard uncertainty, from the means of ten parts."""
    parts = np.array([float(np.mean(part)) for part in np.array_split(x, _PARTS)])
    return float(np.mean(x)), float(np.std(parts, ddof=1)) / math.sqrt(_PARTS)


@dataclass(frozen=True)
class SensorCalibration:
    """Result for one sensor.

    Attributes:
        line: the fitted line.
        offset_m, offset_std_m: of the disk's displacement; None if it was not determined.
        refusals: reasons why the result must not be used, each with what to do.
        warnings: what the operator should read before the result is used.
    """

    line: GaugeLine
    offset_m: float | None
    offset_std_m: float | None
    refusals: tuple[str, ...]
    warnings: tuple[str, ...]

    def settings(self, at_disk: bool) -> dict[str, float]:
        """Return the settings for the rig file.

        Range and lever are exact factors of the calibrated gain: their uncertainty is contained in `gain_std`, that of
        the lever only if the positions were those of the disk.
        """
        found = {
            "gain_factor": float(f"{self.line.gain:.7f}"),
            "gain_std": float(f"{self.line.gain_std / self.line.gain:.3g}"),
            "range_std_m": 0.0,
        }
        if at_disk:
            found["lever_ratio_std"] = 0.0
        if self.offset_m is not None and self.offset_std_m is not None:
            found |= {"offset_m": float(f"{self.offset_m:.9f}"), "offset_std_m": float(f"{self.offset_std_m:.3g}")}
        return found


def calibrate(
    readings: Sequence[GaugeReading], settings: DisplacementSettings, gain_std: float, setup: SensorSetup
) -> SensorCalibration:
    """Return gain and offset of a sensor, with what speaks against them.

    Args:
        readings: of `read_positions`.
        settings: the rig file's table, with the calibration so far.
        gain_std: relative standard uncertainty of the gain so far.
        setup: of the readings.
    Raises:
        TooFewPositions: see `fit_line`.
    """
    line = fit_line(readings, settings.range_m if not setup.at_disk else settings.range_m / settings.lever_ratio)
    offset, offset_std = None, None
    if setup.zero_m is not None:
        zero = -setup.zero_m if setup.toward else setup.zero_m
        at_target, std = line.offset_m(zero)
        lever = 1.0 if setup.at_disk else settings.lever_ratio
        offset, offset_std = at_target / lever, std / lever
    return SensorCalibration(line, offset, offset_std, _refusals(line, setup), _warnings(line, settings, gain_std))


def _refusals(line: GaugeLine, setup: SensorSetup) -> tuple[str, ...]:
    if line.outlier is not None:
        odd, sign = line.outlier, -1.0 if setup.toward else 1.0
        names = " and ".join(str(n + 1) for n in odd.numbers)
        where = 1e3 * sign * odd.position_m
        return (
            f"reading {names} (position {where:g} mm) is {1e6 * odd.off_m:+.1f} µm off the line through the others, "
            f"{abs(odd.off_stds):.0f} standard deviations: a mistyped size, dirt, or a block not wrung. Read it again",
        )
    if line.gain < 0:
        return (f"the reading falls where it should rise (gain {line.gain:.4f}): reverse the sign of the positions",)
    if abs(line.gain - 1) > _MAX_GAIN_ERROR:
        return (
            f"the gain is {line.gain:.4f}, {100 * (line.gain - 1):+.1f} % from that of range_m and lever_ratio: "
            "compare both with the sensor, and the sizes and units with the blocks",
        )
    return ()


def _warnings(line: GaugeLine, settings: DisplacementSettings, gain_std: float) -> tuple[str, ...]:
    found: list[str] = []
    if line.freedom < 3:
        found.append(
            "few readings: neither linearity nor repeatability can be judged. Better: five positions, both ways"
        )
    if line.curved:
        found.append(
            f"the sensor is not linear: up to {1e6 * line.nonlinearity_m:.1f} µm from the line. gain_std contains the "
            "variation of the gain over the span"
        )
    if line.hysteresis_std_m > 0 and abs(line.hysteresis_m) > max(4 * line.hysteresis_std_m, 1e-6):
        found.append(f"readings from below and above differ by {1e6 * line.hysteresis_m:+.1f} µm: play or hysteresis")
    change = line.gain - settings.gain_factor
    allowed = math.hypot(gain_std, line.gain_std)
    if abs(change) > 3 * allowed:
        found.append(
            f"the gain differs from the rig file's {settings.gain_factor:.5f} by {100 * change:+.2f} %, "
            f"{abs(change) / allowed:.1f} standard deviations"
        )
    return tuple(found)
