# pyright: strict
"""What a short look at an open rig shows, held against its rig file: a verdict per device and per check.

Pure: fed with what was seen (`Look`), it does no I/O and reads no clock. A short look is honest about what it can
show: rates come with how far they may be off, and a quantity that was not seen is a failed check, not a passed one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.lock_positions import battery_low, flagged, lock_positions, lock_tolerance_deg, misplaced
from daq.acquisition.rate_watch import Rate
from daq.drivers.cia402 import wire as cia402
from daq.drivers.items import Event
from daq.drivers.rotorlink import wire as rotorlink
from rig_configs.schema import Drive, EncoderNode, Laser, Limits, Rig

_INVALID_SHARE = 0.01  # of a laser's samples at rest; a flash of light is none
_RADIO_SHARE = 0.05  # of the node's frames; more, and angles are missing for long
_SPEED_REPORTS_HZ = 10.0  # least that tells of a drive's speed in time
_WEAK_DBM = -90


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    Attributes:
        value: what was seen; None when nothing was.
        expected: what the rig file says, or what a healthy device does; None where any value will do.
        passed: the verdict.
        note: what to know or to do.
    """

    value: Any
    expected: Any
    passed: bool
    note: str = ""

    def facts(self) -> dict[str, Any]:
        """For JSON."""
        note = {"note": self.note} if self.note else {}
        return {"value": self.value, "expected": self.expected, "verdict": "pass" if self.passed else "fail", **note}


Checks = dict[str, Check]


@dataclass(frozen=True)
class LaserSeen:
    """A laser's samples of the look: displacement of the disk centre, m, NaN where invalid."""

    displacement_m: NDArray[np.floating]


@dataclass(frozen=True)
class NodeSeen:
    """The encoder node's samples of the look, its newest word of itself, and how strong its frames came in.

    Attributes:
        theta_rad: newest angles, shape (n, 2).
        flags: of all encoder blocks.
    """

    theta_rad: NDArray[np.floating]
    flags: NDArray[np.integer]
    status: rotorlink.Status | None
    rssi_dBm: int | None


@dataclass(frozen=True)
class DriveSeen:
    """The drive's reports of the look: how many a second, the newest state and speed, why it is in FAULT if it is."""

    reports_Hz: float
    state: str
    speed_rpm: float
    fault_code: int | None = None


@dataclass(frozen=True)
class Look:
    """What was seen of a rig.

    Attributes:
        seconds: how long was looked.
        rates: of the channels with a device's clock.
        losses: counted while looking, by device and kind.
        events: of all devices.
    """

    seconds: float
    rates: Mapping[str, Rate | None]
    losses: Mapping[str, Mapping[str, int]]
    events: Sequence[Event]
    lasers: Mapping[str, LaserSeen]
    node: NodeSeen
    drive: DriveSeen


def device_checks(rig: Rig, look: Look) -> dict[str, Checks]:
    """Every check of every device, by the device's name in the rig file."""
    d = rig.devices
    out: dict[str, Checks] = {}
    for name, config in (("laser_x", d.laser_x), ("laser_y", d.laser_y)):
        rate = look.rates.get(f"laser/{config.axis}")
        out[name] = _rate_checks(rate, config.rate_Hz) | _laser(config, rig.limits, look.lasers[name])
    out["encoder"] = _rate_checks(look.rates.get("pendulums"), d.encoder.rate_Hz) | _node(d.encoder, look.node)
    out["drive"] = _drive(d.drive, look.drive, [e for e in look.events if e.device == "drive"])
    for name in out:
        on_air = d.encoder.rate_Hz * look.seconds if name == "encoder" else 0.0
        out[name] |= _losses(look.losses.get(name, {}), on_air)
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


def _laser(config: Laser, limits: Limits, seen: LaserSeen) -> Checks:
    x = seen.displacement_m
    if not len(x):
        return {"samples": Check(0, "some", False, "no sample came")}
    invalid = float(np.mean(np.isnan(x)))
    few = invalid <= _INVALID_SHARE
    note = "" if few else "it sees no target: look at beam, distance and surface"
    out = {"invalid_samples": Check(f"{invalid:.1%}", f"at most {_INVALID_SHARE:.0%}", few, note)}
    if invalid == 1.0:
        return out
    at_mm = float(np.nanmedian(x)) * config.lever_ratio * 1e3
    room_mm = (0.5 * config.range_m - limits.amplitude_m * config.lever_ratio) * 1e3
    ok = abs(at_mm) <= room_mm
    note = "" if ok else "move the sensor: from here limits.amplitude_m is out of its range"
    out["from_mid_range_mm"] = Check(round(at_mm, 3), f"within ± {room_mm:.3g}", ok, note)
    out["peak_to_peak_mm"] = Check(round(float(np.nanmax(x) - np.nanmin(x)) * 1e3, 4), None, True)
    return out


def _node(config: EncoderNode, seen: NodeSeen) -> Checks:
    faults = flagged(seen.flags)
    out = {"encoder_faults": Check(len(faults), 0, not faults, ". ".join(faults))}
    status = seen.status
    if status is None:
        out["status"] = Check(None, "each second", False, "the node's own word did not come; look at its radio")
    else:
        counts = config.counts_per_revolution
        ok = status.counts_per_revolution == counts
        note = "" if ok else "every angle would be scaled wrongly: correct the rig file"
        out["counts_per_revolution"] = Check(status.counts_per_revolution, counts, ok, note)
        low = battery_low(seen.flags)
        note = "the node says it is low: change it" if low else ""
        out["battery_mV"] = Check(status.battery_mv, "not low", not low, note)
        out["firmware"] = Check(f"{status.firmware_major}.{status.firmware_minor}", None, True)
        out["temperature_degC"] = Check(status.temperature_decidegc / 10, None, True)
        out["overruns"] = Check(status.overruns, None, True, "" if not status.overruns else "samples lost in the node")
    if seen.rssi_dBm is not None:
        weak = seen.rssi_dBm < _WEAK_DBM
        note = "weak: move the dongle nearer" if weak else ""
        out["signal_dBm"] = Check(seen.rssi_dBm, f"at least {_WEAK_DBM}", not weak, note)
    return out | _locks(config, seen)


def _locks(config: EncoderNode, seen: NodeSeen) -> Checks:
    out: Checks = {}
    if not len(seen.flags):
        return out
    flags = seen.flags[-len(seen.theta_rad) :]
    known = {p.pendulum: p for p in lock_positions(seen.theta_rad, flags, config.zero_std_deg)}
    tolerance = lock_tolerance_deg(config.zero_std_deg)
    for name, expected in (("A", 0), ("B", 180)):
        place = known.get(name)
        note = "" if place is not None else "its position says nothing until the lock is closed"
        out[f"lock_{name}"] = Check("closed" if place is not None else "open", None, True, note)
        if place is not None:
            advice = "" if place.plausible else misplaced(tuple(known.values()))
            angle = round(expected + place.off_deg, 2)
            out[f"locked_{name}_deg"] = Check(angle, f"{expected} ± {tolerance:.2g}", place.plausible, advice)
    return out


def _drive(config: Drive, seen: DriveSeen, events: Sequence[Event]) -> Checks:
    enough = seen.reports_Hz >= _SPEED_REPORTS_HZ
    out = {"speed_reports_Hz": Check(round(seen.reports_Hz, 1), f"at least {_SPEED_REPORTS_HZ:g}", enough)}
    faulty = seen.state in (cia402.FAULT, cia402.FAULT_REACTION, cia402.UNKNOWN)
    beat = seen.fault_code == cia402.HEARTBEAT_ERROR
    note = ""
    if faulty:
        code = "it does not tell why" if seen.fault_code is None else f"error 0x{seen.fault_code:04X}"
        note = f"{code}{': a host was gone; the next test resets it' if beat else '; mend the cause, reset the drive'}"
    out["state"] = Check(seen.state, "no fault", not faulty or beat, note)
    still = seen.speed_rpm == 0
    out["speed_rpm"] = Check(seen.speed_rpm, 0, still, "" if still else "the rotor turns")
    codes = [int(e.facts.get("error_code", 0)) for e in events if e.kind == "emergency"]
    bad = [code for code in codes if code not in (0, cia402.HEARTBEAT_ERROR)]
    words = ", ".join(f"0x{code:04X}" for code in codes) or "none"
    out["emergencies"] = Check(words, "none", not bad, "" if not bad else "look them up in the drive's manual")
    return out


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
        by_air = on_air > 0 and kind in ("radio_frames", "samples")
        expected = f"at most {_RADIO_SHARE:.0%} of the samples" if by_air else 0
        out[f"lost_{kind}"] = Check(count, expected, few if by_air else count == 0)
    return out


def _restarts(events: Sequence[Event]) -> Checks:
    times = sum(e.kind == "restart" for e in events)
    return {"restarts": Check(times, 0, not times, "its counters began anew while it was looked at" if times else "")}
