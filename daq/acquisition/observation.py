"""Observation of an open rig for `rig check`: newest samples, rates, losses, events and the drive's time-out."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping

import numpy as np

from daq.acquisition.device_check import ObservedAngles, ObservedSpeed, RigObservation
from daq.acquisition.displacement_check import ObservedDisplacement
from daq.acquisition.recent_speed import recent_agreement
from daq.acquisition.session import Session
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import TimeOut
from daq.drivers.devices import devices_of
from daq.errors import DeviceError, LinkLost
from daq.items import DeviceEvent
from rig_basics.ignoring import ignoring
from rig_configs.roles import PendulumAngles, Roles, SpeedSource

_log = logging.getLogger(__name__)

_LOCKED_S = 0.1  # duration of the newest pendulum angles that are checked
_STATUS_WAIT_S = 3.0  # devices that report their status do so each second; longest wait for one report
_STEP_S = 0.1  # s between two calls of `progress`

Progress = Callable[[float], None]
"""Called with the completed share, 0 … 1."""


def observe(session: Session, seconds: float, progress: Progress = lambda share: None) -> RigObservation:
    """Observe an open rig.

    Args:
        session: the open session; `lenient`, so that devices that could not be opened are reported.
        seconds: duration, s. It is longer only for status reports, which devices send each second, and for the
            drive's time-out; it is short if no device is open.
        progress: see `Progress`.
    """
    events: list[DeviceEvent] = []
    session.device_event_observers.append(events.append)
    before, started = session.recording.losses(), session.clock.now_ns()
    begun_s = session.clock.now_s()
    if not session.rig.devices.keys() - session.devices.unopened.keys():
        seconds = min(seconds, _STEP_S)  # nothing can arrive
    stds: dict[str, list[float]] = {}
    while (passed := session.clock.now_s() - begun_s) < seconds:
        progress(passed / seconds)
        session.clock.wait(min(_STEP_S, seconds - passed))
        for name, std_ns in session.devices.clock_stds_ns().items():
            stds.setdefault(name, []).append(std_ns)
    wait = session.clock.now_ns() + int(_STATUS_WAIT_S * 1e9)
    while not session.devices.all_identified() and session.clock.now_ns() < wait:
        session.clock.wait(_STEP_S)
    session.device_event_observers.remove(events.append)
    roles, plain, unopened = session.rig.roles, plain_rates(session, started), session.devices.unopened
    speed, lasers = roles.speed, (*roles.displacements, *roles.witnesses)
    return RigObservation(
        seconds=(session.clock.now_ns() - started) * 1e-9,
        rates=session.channels.rates.rates(),
        host_rates_Hz=plain,
        losses={name: _more(lost, before[name]) for name, lost in session.recording.losses().items()},
        events=events,
        displacements={sensor.topic: _displacement(session, sensor.topic, started) for sensor in lasers},
        angles=roles.angles and _angles(session, roles.angles, started),
        speed=speed and ObservedSpeed(plain[speed.topic], session.drive.actual_rpm),
        time_out=None if speed is None or speed.device in unopened else _time_out(session, speed),
        own=_with_duties(session.devices.own_checks(events, session.rotor), roles),
        clock_stds_ns={name: float(np.median(found[len(found) // 2 :])) for name, found in stds.items()},
        unopened=unopened,
        complaints={name: text for name in session.rig.devices if (text := session.devices.identification_of(name)[1])},
        by_radio=frozenset(name for name, each in devices_of(session.rig.devices).items() if each.driver.by_radio),
        rotor_rpm=session.rotor.rpm(),
        speeds=recent_agreement(session.channels.recent, roles, started),
        round_trip_s=None if roles.phase is None else _round_trip(session, roles.phase.device),
    )


def _displacement(session: Session, topic: str, started_ns: int) -> ObservedDisplacement:
    time_ns, (value,) = session.channels.recent.last(topic, ("displacement_m",), started_ns)
    return ObservedDisplacement.since(started_ns, time_ns, value)


def _angles(session: Session, role: PendulumAngles, started_ns: int) -> ObservedAngles:
    _, (a, b, flags) = session.channels.recent.last(role.topic, ("theta3_rad", "theta4_rad", "flags"), started_ns)
    return ObservedAngles(np.column_stack([a, b])[-max(1, round(_LOCKED_S * role.rate_Hz)) :], flags)


def _time_out(session: Session, speed: SpeedSource) -> TimeOut | str:
    """Measure the time-out of the speed source, or return why it was not measured."""
    drive = session.drive
    try:
        return drive.measure_time_out() or "such a device does not report a missing host while the rotor stands"
    except (DeviceError, LinkLost) as error:
        return str(error)


def _round_trip(session: Session, device: str) -> float | None:
    """Measure the round trip of a device; None if it is not open, cannot measure it, or does not answer."""
    if device in session.devices.unopened:
        return None
    with ignoring(_log, "measuring the round trip of a device without a link", LinkLost):
        return session.rotor.measure_round_trip(device)
    return None


def _with_duties(own: Mapping[str, Checks], roles: Roles) -> dict[str, Checks]:
    """Return the checks of the devices' drivers, with what each displacement sensor measures for the rig."""
    out = {name: dict(checks) for name, checks in own.items()}
    for device, words in roles.duties.items():
        out.setdefault(device, {})["measures"] = DeviceCheck(words, None, True)
    return out


def _more(now: Mapping[str, int], before: Mapping[str, int]) -> dict[str, int]:
    return {kind: count - before.get(kind, 0) for kind, count in now.items()}


def plain_rates(session: Session, started_ns: int) -> dict[str, float]:
    """Return the samples per second of every channel since an instant, without lost ones."""
    rates: dict[str, float] = {}
    for topic in session.channels.topics:
        times, _ = session.channels.recent.last(topic, (), started_ns)
        span = float(times[-1] - times[0]) * 1e-9 if len(times) > 1 else 0.0
        rates[topic] = (len(times) - 1) / span if span > 0 else math.nan
    return rates
