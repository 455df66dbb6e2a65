# pyright: strict
"""What a short look at an open rig shows, held against its rig file: a verdict per device and per check.

Pure: fed with what was seen (`Look`), it does no I/O and reads no clock. A short look is honest about what it can
show: rates come with how far they may be off, and a quantity that was not seen is a failed check, not a passed one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.lock_positions import flagged, lock_positions, lock_tolerance_deg, misplaced
from daq.acquisition.rate_watch import Rate
from daq.drivers.checks import Check, Checks
from daq.drivers.contract import FOREIGN
from daq.drivers.items import Event
from rig_configs.roles import Displacement, PendulumAngles
from rig_configs.schema import Limits, Rig

_INVALID_SHARE = 0.01  # of a laser's samples at rest; a flash of light is none
_RADIO_SHARE = 0.05  # of the samples that come by radio; more, and angles are missing for long
_SPEED_REPORTS_HZ = 10.0  # least that tells of a drive's speed in time


@dataclass(frozen=True)
class AnglesSeen:
    """The pendulums' samples of the look.

    Attributes:
        theta_rad: newest angles, shape (n, 2).
        flags: of all samples.
    """

    theta_rad: NDArray[np.floating]
    flags: NDArray[np.integer]


@dataclass(frozen=True)
class SpeedSeen:
    """The speed source's reports of the look: how many a second, and the newest speed."""

    reports_Hz: float
    speed_rpm: float


@dataclass(frozen=True)
class Look:
    """What was seen of a rig.

    Attributes:
        seconds: how long was looked.
        rates: of the channels with a device's clock, by topic.
        losses: counted while looking, by device and kind.
        events: of all devices.
        displacement_m: of the disk centre, by axis; NaN where invalid.
        angles, speed: None where the rig has no such device.
        own: what the devices' drivers looked at, by device.
    """

    seconds: float
    rates: Mapping[str, Rate | None]
    losses: Mapping[str, Mapping[str, int]]
    events: Sequence[Event]
    displacement_m: Mapping[str, NDArray[np.floating]]
    angles: AnglesSeen | None = None
    speed: SpeedSeen | None = None
    own: Mapping[str, Checks] = field(default_factory=dict[str, Checks])


def device_checks(rig: Rig, look: Look) -> dict[str, Checks]:
    """Every check of every device, by the device's name in the rig file."""
    out: dict[str, Checks] = {name: {} for name in rig.devices}
    roles = rig.roles
    for sensor in roles.displacements:
        out[sensor.device] |= _rate_checks(look.rates.get(sensor.topic), sensor.rate_Hz)
        out[sensor.device] |= _displacement(sensor, rig.limits, look.displacement_m[sensor.axis])
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
    """A device's verdict: all of its checks."""
    return all(check.passed for check in checks.values())


def common_factor(look: Look) -> float | None:
    """By what factor all clocks are off alike; None when they are not. Then it is the host's time that is wrong."""
    factors = [rate.clock_ppm * 1e-6 + 1.0 for rate in look.rates.values() if rate is not None]
    if len(factors) < 2 or any(abs(f - 1.0) < 0.01 for f in factors):
        return None
    return float(np.mean(factors)) if max(factors) < 1.02 * min(factors) else None


def _rate_checks(rate: Rate | None, nominal_Hz: float) -> Checks:
    if rate is None:
        return {"rate_Hz": Check(None, nominal_Hz, False, "too few samples to tell")}
    sure = f"± {rate.bound_ppm:.0f} ppm in {rate.span_s:.1f} s"
    tolerance = f"± {rate.tolerance_ppm:.0f} ppm of the host's"
    unsure = "" if rate.certain else "; a longer look (--seconds 30) knows it better"
    return {
        "rate_Hz": Check(round(rate.rate_Hz, 2), nominal_Hz, rate.rate_ok, sure),
        "clock_ppm": Check(round(rate.clock_ppm, 1), tolerance, rate.clock_ok, sure + unsure),
    }


def _displacement(sensor: Displacement, limits: Limits, x: NDArray[np.floating]) -> Checks:
    if not len(x):
        return {"samples": Check(0, "some", False, "no sample came")}
    invalid = float(np.mean(np.isnan(x)))
    few = invalid <= _INVALID_SHARE
    note = "" if few else "it sees no target: look at beam, distance and surface"
    out = {"invalid_samples": Check(f"{invalid:.1%}", f"at most {_INVALID_SHARE:.0%}", few, note)}
    if invalid == 1.0:
        return out
    at_mm = float(np.nanmedian(x)) * sensor.lever_ratio * 1e3
    room_mm = (0.5 * sensor.range_m - limits.amplitude_m * sensor.lever_ratio) * 1e3
    ok = abs(at_mm) <= room_mm
    note = "" if ok else "move the sensor: from here limits.amplitude_m is out of its range"
    out["from_mid_range_mm"] = Check(round(at_mm, 3), f"within ± {room_mm:.3g}", ok, note)
    out["peak_to_peak_mm"] = Check(round(float(np.nanmax(x) - np.nanmin(x)) * 1e3, 4), None, True)
    return out


def _encoders(seen: AnglesSeen) -> Checks:
    faults = flagged(seen.flags)
    return {"encoder_faults": Check(len(faults), 0, not faults, ". ".join(faults))}


def _locks(angles: PendulumAngles, seen: AnglesSeen) -> Checks:
    out: Checks = {}
    if not len(seen.flags):
        return out
    flags = seen.flags[-len(seen.theta_rad) :]
    known = {p.pendulum: p for p in lock_positions(seen.theta_rad, flags, angles.zero_std_deg)}
    tolerance = lock_tolerance_deg(angles.zero_std_deg)
    for name, expected in (("A", 0), ("B", 180)):
        place = known.get(name)
        note = "" if place is not None else "its position says nothing until the lock is closed"
        out[f"lock_{name}"] = Check("closed" if place is not None else "open", None, True, note)
        if place is not None:
            advice = "" if place.plausible else misplaced(tuple(known.values()))
            angle = round(expected + place.off_deg, 2)
            out[f"locked_{name}_deg"] = Check(angle, f"{expected} ± {tolerance:.2g}", place.plausible, advice)
    return out


def _speed(seen: SpeedSeen, rest_rpm: float) -> Checks:
    enough = seen.reports_Hz >= _SPEED_REPORTS_HZ
    still = abs(seen.speed_rpm) <= rest_rpm
    note = "" if still else "its speed is not known" if math.isnan(seen.speed_rpm) else "the rotor turns"
    return {
        "speed_reports_Hz": Check(round(seen.reports_Hz, 1), f"at least {_SPEED_REPORTS_HZ:g}", enough),
        "speed_rpm": Check(None if math.isnan(seen.speed_rpm) else round(seen.speed_rpm, 1), 0, still, note),
    }


def _losses(lost: Mapping[str, int], on_air: float) -> Checks:
    """Counted losses, none of them allowed but a radio's now and then.

    Args:
        on_air: how many samples a radio should have brought; 0 for a device on a cable.
    """
    out: Checks = {}
    few = on_air > 0 and lost.get("samples", 0) <= _RADIO_SHARE * on_air
    for kind, count in lost.items():
        if kind == "invalid":  # judged as a share of the samples
            continue
        if kind.startswith(FOREIGN):
            out[kind] = Check(count, None, True, "of others, passed over" if count else "")
            continue
        by_air = on_air > 0 and kind in ("radio_frames", "samples")
        expected = f"at most {_RADIO_SHARE:.0%} of the samples" if by_air else 0
        out[f"lost_{kind}"] = Check(count, expected, few if by_air else count == 0)
    return out


def _restarts(events: Sequence[Event]) -> Checks:
    times = sum(e.kind == "restart" for e in events)
    return {"restarts": Check(times, 0, not times, "its counters began anew while it was looked at" if times else "")}
