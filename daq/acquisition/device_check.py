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

from daq.acquisition.displacement_check import STDS, ObservedDisplacement, displacement_checks
from daq.acquisition.lock_positions import flagged, lock_positions, lock_tolerance_deg, misplaced
from daq.acquisition.rate_watch import Rate
from daq.drivers.checks import Checks, DeviceCheck, at_most, longer
from daq.drivers.contract import FOREIGN, TimeOut
from daq.items import DeviceEvent
from daq.signals.speed_agreement import SpeedAgreement
from rig_configs.roles import PendulumAngles, RotorPhase
from rig_configs.schema import Rig

_MAX_RADIO_LOSS_SHARE = 0.05  # of the samples sent by radio; larger losses make long gaps in the angles
_MAX_HOST_RATE_ERROR = 0.02  # relative, of a channel without a device clock: the host or the bus makes its period
_MIN_SPEED_REPORTS_HZ = 10.0  # for the interlocks of the drive's speed
_MAX_ANGLE_NOISE_COUNTS = 2.0  # rms, in closed locks
_MAX_TIME_OUT_SHARE, _MAX_TIME_OUT_S = 0.1, 0.03  # deviation of the time-out, of what the drive states, and in addition
_FAST_HZ = 20.0  # speed for which errors of time are stated as angles
_MAX_CLOCK_STD_NS = 1e6  # 7° of the rotor at that speed
_CLOCK_S = 5.0  # observation that is necessary for it; a shorter one is less certain


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
        host_rates_Hz: samples per second on the host's clock, of all channels, by topic; NaN if unknown.
        losses: losses during the observation, by device and kind.
        events: events of all devices.
        displacements: samples of the displacement sensors, by topic.
        angles, speed: None if the rig has no such device.
        time_out: time-out of the speed source, or the reason why it was not measured; None without a speed source.
        own: checks of the devices' drivers, by device. Those of losses (`lost_…`, `foreign_…`) replace the general
            ones, since a driver can state the likely causes on its line.
        clock_stds_ns: stated standard uncertainties of the devices' times on the common clock, ns, by device;
            medians of the second half.
        unopened: reasons why devices are not open, by device.
        by_radio: devices that send their samples by radio.
        complaints: contradictions between what devices report of themselves and the rig file, by device.
        rotor_rpm: speed of the rotor; NaN if unknown.
        speeds: agreement of drive and index marks; None if they could not be compared.
        round_trip_s: see `LockControl.measure_round_trip`, of the device with the index marks; None if it was not
            measured.
    """

    seconds: float
    rates: Mapping[str, Rate | None]
    host_rates_Hz: Mapping[str, float]
    losses: Mapping[str, Mapping[str, int]]
    events: Sequence[DeviceEvent]
    displacements: Mapping[str, ObservedDisplacement]
    angles: ObservedAngles | None = None
    speed: ObservedSpeed | None = None
    time_out: TimeOut | str | None = None
    own: Mapping[str, Checks] = field(default_factory=dict[str, Checks])
    clock_stds_ns: Mapping[str, float] = field(default_factory=dict[str, float])
    unopened: Mapping[str, str] = field(default_factory=dict[str, str])
    complaints: Mapping[str, str] = field(default_factory=dict[str, str])
    by_radio: frozenset[str] = frozenset()
    rotor_rpm: float = math.nan
    speeds: SpeedAgreement | None = None
    round_trip_s: float | None = None


def device_checks(rig: Rig, look: RigObservation) -> dict[str, Checks]:
    """Return all checks by the device's name in the rig file. A device that is not open has only the check `opened`."""
    out: dict[str, Checks] = {name: {} for name in rig.devices}
    roles = rig.roles
    lasers = (*roles.displacements, *roles.witnesses)
    for sensor in lasers:
        found = _rate_checks(look, sensor.topic, sensor.rate_Hz)
        found |= displacement_checks(sensor, rig.limits, look.displacements[sensor.topic], look.rotor_rpm)
        several = sum(other.device == sensor.device for other in lasers) > 1
        out[sensor.device] |= {f"{sensor.axis} {name}": check for name, check in found.items()} if several else found
    if roles.angles is not None and look.angles is not None:
        out[roles.angles.device] |= _rate_checks(look, roles.angles.topic, roles.angles.rate_Hz)
        out[roles.angles.device] |= _encoders(look.angles)
    if roles.speed is not None and look.speed is not None:
        out[roles.speed.device] |= _speed(look.speed, roles.rest_rpm, look.seconds) | _time_out(look.time_out)
        if roles.phase is not None:
            out[roles.speed.device]["marks_over_drive"] = _speeds(look.speeds)
    if roles.phase is not None and any((d.clock or d.device) != roles.phase.device for d in roles.displacements):
        out[roles.phase.device]["delay_ms"] = _delay(roles.phase, look.round_trip_s)
    for name, checks in look.own.items():
        out[name] |= checks
    if roles.angles is not None and roles.locks is not None and look.angles is not None:
        out[roles.locks.device] |= _locks(roles.angles, look.angles)
    for name, checks in out.items():
        lost = look.losses.get(name, {})
        by_air = name in look.by_radio and roles.angles is not None
        on_air = roles.angles.rate_Hz * look.seconds if by_air and roles.angles is not None else 0.0
        if name in look.clock_stds_ns:
            checks.update(_clock(look.clock_stds_ns[name], look.seconds))
        checks |= {kind: check for kind, check in _losses(lost, on_air).items() if kind not in checks}
        checks.update(_restarts([e for e in look.events if e.device == name]))
        if name in look.complaints and passed(checks):
            checks["identity"] = DeviceCheck("differs", "as in the rig file", False, look.complaints[name])
    return out | {name: {"opened": DeviceCheck("no", "yes", False, why)} for name, why in look.unopened.items()}


def passed(checks: Checks) -> bool:
    """Return whether a device has failed none of its checks. A limit that was not resolved is no failure."""
    return not any(check.failed for check in checks.values())


def common_factor(look: RigObservation) -> float | None:
    """Return the factor by which all device clocks deviate alike, or None if they do not.

    A common factor shows that the host's clock is wrong.
    """
    factors = [rate.clock_ppm * 1e-6 + 1.0 for rate in look.rates.values() if rate is not None]
    if len(factors) < 2 or any(abs(f - 1.0) < 0.01 for f in factors):
        return None
    return float(np.mean(factors)) if max(factors) < 1.02 * min(factors) else None


def _rate_checks(look: RigObservation, topic: str, nominal_Hz: float) -> Checks:
    """Check the rate of a channel: with a device clock by that clock, else by the host's times."""
    if topic not in look.rates:
        found, bound = look.host_rates_Hz[topic], 2.0 / (nominal_Hz * look.seconds)
        ok = at_most(abs(found / nominal_Hz - 1.0), bound, _MAX_HOST_RATE_ERROR)
        note = "by the host's clock"
        if ok is None:
            room = _MAX_HOST_RATE_ERROR - abs(found / nominal_Hz - 1.0)
            note = f"{note}, ± {bound:.1%}; {longer(look.seconds, bound, room)}"
        return {"rate_Hz": DeviceCheck(round(found, 2), f"{nominal_Hz:g} ± {_MAX_HOST_RATE_ERROR:.0%}", ok, note)}
    rate = look.rates[topic]
    if rate is None:
        return {"rate_Hz": DeviceCheck(None, nominal_Hz, False, "too few samples")}
    bound = f"± {rate.bound_ppm:.0f} ppm in {rate.span_s:.1f} s"
    coarse = False if not rate.rate_ok else at_most(abs(rate.off_ppm), rate.bound_ppm, 1e6 * _MAX_HOST_RATE_ERROR)
    fine = False if not rate.clock_ok else at_most(abs(rate.clock_ppm), rate.bound_ppm, rate.tolerance_ppm)
    advice = longer(rate.span_s, rate.bound_ppm, rate.tolerance_ppm - abs(rate.clock_ppm))
    tolerance = f"± {rate.tolerance_ppm:.0f} ppm of the host's"
    return {
        "rate_Hz": DeviceCheck(round(rate.rate_Hz, 2), nominal_Hz, coarse, bound),
        "clock_ppm": DeviceCheck(
            round(rate.clock_ppm, 1), tolerance, fine, f"{bound}; {advice}" if fine is None else bound
        ),
    }


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
            noise = float(np.std(seen.theta_rad[:, "AB".index(name)])) / angles.step_rad
            bound = STDS * noise / math.sqrt(2 * len(seen.theta_rad))
            steady = at_most(noise, bound, _MAX_ANGLE_NOISE_COUNTS)
            note = {
                True: "",
                False: "the counts of a locked encoder change: look at its supply and cable, and the lock",
                None: f"not resolved: ± {bound:.2g}; check again",
            }[steady]
            most = f"at most {_MAX_ANGLE_NOISE_COUNTS:g} rms"
            out[f"noise_{name}_counts"] = DeviceCheck(round(noise, 2), most, steady, note)
    return out


def _speed(seen: ObservedSpeed, rest_rpm: float, seconds: float) -> Checks:
    above = seen.reports_Hz - _MIN_SPEED_REPORTS_HZ  # a rate is uncertain by one report in the observation
    frequent = True if above >= 1.0 / seconds else None if above > -1.0 / seconds else False
    advice = longer(seconds, 1.0 / seconds, above) if frequent is None else ""
    at_rest = abs(seen.speed_rpm) <= rest_rpm
    note = "" if at_rest else "its speed is unknown" if math.isnan(seen.speed_rpm) else "the rotor turns"
    return {
        "speed_reports_Hz": DeviceCheck(
            round(seen.reports_Hz, 1), f"at least {_MIN_SPEED_REPORTS_HZ:g}", frequent, advice
        ),
        "speed_rpm": DeviceCheck(None if math.isnan(seen.speed_rpm) else round(seen.speed_rpm, 1), 0, at_rest, note),
    }


def _speeds(found: SpeedAgreement | None) -> DeviceCheck:
    """Check that index marks and drive agree, which needs a rotor that turns."""
    if found is None:
        advice = (
            "not resolved: the rotor did not turn five times. Turn it by hand during the check; tests compare both too"
        )
        return DeviceCheck(None, 1, None, advice)
    return DeviceCheck(float(f"{found.ratio:.4g}"), f"1 ± {found.limit:.2g}", found.agrees, found.words)


def _clock(std_ns: float, seconds: float) -> Checks:
    """Check the stated uncertainty of a device's times, without the least delay of its path."""
    excess = std_ns / _MAX_CLOCK_STD_NS  # an early map is less certain in proportion to the missing time
    fine = True if excess <= 1.0 else None if excess * seconds <= _CLOCK_S else False
    note = {
        True: "",
        False: "its bytes arrive very unevenly: look at the adapter, its latency setting, and the host's load",
        None: f"not resolved: observe for {_CLOCK_S:g} s",
    }[fine]
    most = f"at most {_MAX_CLOCK_STD_NS * 1e-3:g}"
    return {"clock_std_us": DeviceCheck(round(std_ns * 1e-3, 1), most, fine, note)}


def _delay(phase: RotorPhase, round_trip_s: float | None) -> DeviceCheck:
    """Check by how much the index marks are stamped late, from the round trip of requests.

    The least delay of the way to the host is between 0 and that of the whole way there and back, of which the round
    trip lacks the stated delay. The displacements' own delay is unknown and not part of it.
    """
    most = f"within ± {_MAX_CLOCK_STD_NS * 1e-6:g}"
    advice = "Every fit and plot leaves the shift against the displacements free"
    if round_trip_s is None:
        return DeviceCheck(None, most, None, f"not measured: the device answers no request with its time. {advice}")
    stated_s = phase.least_delay_s
    if round_trip_s + stated_s < 0:
        late = f"requests came {-1e3 * (round_trip_s + stated_s):.2g} ms before they were sent, by the device's clock"
        return DeviceCheck(
            None, most, None, f"not measured: {late}: the host reads it late. Check again with less load"
        )
    half_s = 0.5 * (round_trip_s + stated_s)
    late_s = half_s - stated_s
    fine = at_most(abs(late_s), half_s, _MAX_CLOCK_STD_NS * 1e-9)
    degrees = 360 * _FAST_HZ * max(abs(late_s - half_s), late_s + half_s)
    note = f"± {1e3 * half_s:.2g}: up to {degrees:.2g}° of the phase at {60 * _FAST_HZ:g} rpm"
    if fine is False:
        note = f"{note}. least_delay_s = {stated_s:g} exceeds the whole round trip: correct the rig file"
    elif fine is None:
        note = f"{note}. Set least_delay_s in its table from the data sheet of its radio. {advice}"
    return DeviceCheck(round(1e3 * late_s, 2), most, fine, note)


def _time_out(found: TimeOut | str | None) -> Checks:
    """Check that the speed source stops by itself when the host is silent for as long as it states."""
    if found is None:
        return {}
    if isinstance(found, str):
        return {"time_out_s": DeviceCheck(None, None, None, f"not measured: {found}")}
    if found.measured_s is None:
        note = "it did not report a missing host: it would not stop by itself. Do not turn the rotor"
        return {"time_out_s": DeviceCheck(None, found.stated_s, False, note)}
    if found.stated_s is None:
        return {"time_out_s": DeviceCheck(round(found.measured_s, 3), None, True, "the device states none")}
    most = _MAX_TIME_OUT_SHARE * found.stated_s + _MAX_TIME_OUT_S
    ok = at_most(abs(found.measured_s - found.stated_s), found.resolution_s, most)
    note = {
        True: "",
        False: "another time acts: compare the rig file with the drive's own settings and its manual",
        None: f"not resolved: ± {found.resolution_s:.2g} s by the periods of the messages",
    }[ok]
    return {"time_out_s": DeviceCheck(round(found.measured_s, 3), f"{found.stated_s:.3g} ± {most:.2g}", ok, note)}


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
