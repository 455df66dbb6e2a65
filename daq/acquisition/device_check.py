"""Comparison of a short observation of an open rig with its rig file: a verdict for each device and check.

The input is the observation (`RigObservation`); the module has no I/O and no clock. Rates are given with their
uncertainty. A quantity that was not observed is a failed check.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.lock_positions import flagged, lock_positions, lock_tolerance_deg, misplaced
from daq.acquisition.rate_watch import Rate
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import FOREIGN
from daq.items import DeviceEvent
from rig_configs.roles import DisplacementSensor, PendulumAngles
from rig_configs.schema import Limits, Rig

_MAX_INVALID_SHARE = 0.01  # of a laser's samples at rest; single flashes of light are allowed
_MAX_RADIO_LOSS_SHARE = 0.05  # of the samples sent by radio; larger losses make long gaps in the angles
_MIN_SPEED_REPORTS_HZ = 10.0  # for the interlocks of the drive's speed


@dataclass(frozen=True)
class ObservedAngles:
    """Pendulum samples of the observation.

    Attributes:
        theta_rad: newest angles, rad, shape (n, 2).
        flags: flags of all samples, shape (m,), m ≥ n.
    """

    theta_rad: NDArray[np.floating]
    flags: NDArray[np.integer]


@dataclass(frozen=True)
class ObservedSpeed:
    """Reports of the speed source in the observation.

    Attributes:
        reports_Hz: reports per second.
        speed_rpm: newest speed; NaN if unknown.
    """

    reports_Hz: float
    speed_rpm: float


@dataclass(frozen=True)
class RigObservation:
    """Observation of a rig.

    Attributes:
        seconds: duration, s.
        rates: rates of the channels with a device clock, by topic; None if unknown.
        losses: losses during the observation, by device and kind.
        events: events of all devices.
        displacement_m: displacement of the disk centre, m, by axis; NaN for invalid samples.
        angles, speed: None if the rig has no such device.
        own: checks of the devices' drivers, by device.
    """

    seconds: float
    rates: Mapping[str, Rate | None]
    losses: Mapping[str, Mapping[str, int]]
    events: Sequence[DeviceEvent]
    displacement_m: Mapping[str, NDArray[np.floating]]
    angles: ObservedAngles | None = None
    speed: ObservedSpeed | None = None
    own: Mapping[str, Checks] = field(default_factory=dict[str, Checks])


def device_checks(rig: Rig, look: RigObservation) -> dict[str, Checks]:
    """Return all checks by the device's name in the rig file."""
    out: dict[str, Checks] = {name: {} for name in rig.devices}
    roles = rig.roles
    for sensor in roles.displacements:
        found = _rate_checks(look.rates.get(sensor.topic), sensor.rate_Hz)
        found |= _displacement(sensor, rig.limits, look.displacement_m[sensor.axis])
        several = sum(other.device == sensor.device for other in roles.displacements) > 1
        out[sensor.device] |= {f"{sensor.axis} {name}": check for name, check in found.items()} if several else found
    if roles.angles is not None and look.angles is not None:
        out[roles.angles.device] |= _rate_checks(look.rates.get(roles.angles.topic), roles.angles.rate_Hz)
        out[roles.angles.device] |= _encoders(look.angles)
    if roles.speed is not None and look.speed is not None:
        out[roles.speed.device] |= _speed(look.speed, roles.rest_rpm)
    for name, checks in look.own.items():
        out[name] |= checks
    if roles.angles is not None and roles.locks is not None and look.angles is not None:
        out[roles.locks.device] |= _locks(roles.angles, look.angles)
    for name in out:
        lost = look.losses.get(name, {})
        by_air = "radio_frames" in lost and roles.angles is not None
        out[name] |= _losses(lost, roles.angles.rate_Hz * look.seconds if by_air and roles.angles is not None else 0.0)
        out[name] |= _restarts([e for e in look.events if e.device == name])
    return out


def passed(checks: Checks) -> bool:
    """Return whether a device has passed all of its checks."""
    return all(check.passed for check in checks.values())


def common_factor(look: RigObservation) -> float | None:
    """Return the factor by which all device clocks deviate alike, or None if they do not.

    A common factor shows that the host's clock is wrong.
    """
    factors = [rate.clock_ppm * 1e-6 + 1.0 for rate in look.rates.values() if rate is not None]
    if len(factors) < 2 or any(abs(f - 1.0) < 0.01 for f in factors):
        return None
    return float(np.mean(factors)) if max(factors) < 1.02 * min(factors) else None


def _rate_checks(rate: Rate | None, nominal_Hz: float) -> Checks:
    if rate is None:
        return {"rate_Hz": DeviceCheck(None, nominal_Hz, False, "too few samples")}
    bound = f"± {rate.bound_ppm:.0f} ppm in {rate.span_s:.1f} s"
    tolerance = f"± {rate.tolerance_ppm:.0f} ppm of the host's"
    advice = "" if rate.certain else "; a longer check (30 s) reduces the uncertainty"
    return {
        "rate_Hz": DeviceCheck(round(rate.rate_Hz, 2), nominal_Hz, rate.rate_ok, bound),
        "clock_ppm": DeviceCheck(round(rate.clock_ppm, 1), tolerance, rate.clock_ok, bound + advice),
    }


def _displacement(sensor: DisplacementSensor, limits: Limits, x: NDArray[np.floating]) -> Checks:
    if not len(x):
        return {"samples": DeviceCheck(0, "some", False, "no samples received")}
    invalid = float(np.mean(np.isnan(x)))
    few = invalid <= _MAX_INVALID_SHARE
    note = "" if few else "the sensor detects no target: check beam, distance and surface"
    out = {"invalid_samples": DeviceCheck(f"{invalid:.1%}", f"at most {_MAX_INVALID_SHARE:.0%}", few, note)}
    if invalid == 1.0:
        return out
    at_mm = float(np.nanmedian(x)) * sensor.lever_ratio * 1e3
    room_mm = (0.5 * sensor.range_m - limits.amplitude_m * sensor.lever_ratio) * 1e3
    ok = abs(at_mm) <= room_mm
    note = "" if ok else "move the sensor: limits.amplitude_m exceeds its range at this position"
    out["from_mid_range_mm"] = DeviceCheck(round(at_mm, 3), f"within ± {room_mm:.3g}", ok, note)
    out["peak_to_peak_mm"] = DeviceCheck(round(float(np.nanmax(x) - np.nanmin(x)) * 1e3, 4), None, True)
    return out


def _encoders(seen: ObservedAngles) -> Checks:
    faults = flagged(seen.flags)
    return {"encoder_faults": DeviceCheck(len(faults), 0, not faults, ". ".join(faults))}


def _locks(angles: PendulumAngles, seen: ObservedAngles) -> Checks:
    out: Checks = {}
    if not len(seen.flags):
        return out
    flags = seen.flags[-len(seen.theta_rad) :]
    known = {p.pendulum: p for p in lock_positions(seen.theta_rad, flags, angles.zero_std_deg)}
    tolerance = lock_tolerance_deg(angles.zero_std_deg)
    for name, expected in (("A", 0), ("B", 180)):
        place = known.get(name)
        note = "" if place is not None else "the counter can be checked only with the lock closed"
        out[f"lock_{name}"] = DeviceCheck("closed" if place is not None else "open", None, True, note)
        if place is not None:
            advice = "" if place.plausible else misplaced(tuple(known.values()))
            angle = round(expected + place.off_deg, 2)
            out[f"locked_{name}_deg"] = DeviceCheck(angle, f"{expected} ± {tolerance:.2g}", place.plausible, advice)
    return out


def _speed(seen: ObservedSpeed, rest_rpm: float) -> Checks:
    frequent = seen.reports_Hz >= _MIN_SPEED_REPORTS_HZ
    at_rest = abs(seen.speed_rpm) <= rest_rpm
    note = "" if at_rest else "its speed is unknown" if math.isnan(seen.speed_rpm) else "the rotor turns"
    return {
        "speed_reports_Hz": DeviceCheck(round(seen.reports_Hz, 1), f"at least {_MIN_SPEED_REPORTS_HZ:g}", frequent),
        "speed_rpm": DeviceCheck(None if math.isnan(seen.speed_rpm) else round(seen.speed_rpm, 1), 0, at_rest, note),
    }


def _losses(lost: Mapping[str, int], on_air: float) -> Checks:
    """Check the losses. None are allowed, except for a small share of the samples sent by radio.

    Args:
        lost: losses by kind.
        on_air: expected number of samples sent by radio; 0 for a device on a cable.
    """
    out: Checks = {}
    few = on_air > 0 and lost.get("samples", 0) <= _MAX_RADIO_LOSS_SHARE * on_air
    for kind, count in lost.items():
        if kind == "invalid":  # judged as a share of the samples
            continue
        if kind.startswith(FOREIGN):
            out[kind] = DeviceCheck(count, None, True, "from other devices, ignored" if count else "")
            continue
        by_air = on_air > 0 and kind in ("radio_frames", "samples")
        expected = f"at most {_MAX_RADIO_LOSS_SHARE:.0%} of the samples" if by_air else 0
        out[f"lost_{kind}"] = DeviceCheck(count, expected, few if by_air else count == 0)
    return out


def _restarts(events: Sequence[DeviceEvent]) -> Checks:
    times = sum(e.kind == "restart" for e in events)
    return {"restarts": DeviceCheck(times, 0, not times, "its counters restarted during the check" if times else "")}
