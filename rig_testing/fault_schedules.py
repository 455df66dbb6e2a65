"""Randomised faults on simulated time: reaction of a whole session, and whether it was right.

A schedule is drawn from its seed: the operator's actions, which faults of which device and line begin when and how long
they last, when the host is busy. The session, drivers and recorder of a real rig run it in lockstep. Afterwards the
log, the simulated rig's true motion and the drive are checked, for any rig file and any driver: this module names no
device.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.session import Session
from daq.drivers.contract import SampleClock
from daq.drivers.devices import devices_of
from daq.errors import AcquisitionError
from daq.lockstep.rig import LockstepRig
from daq.log import Log, open_log
from daq.replay import check
from daq.virtual_rig.faults import LINE_FAULTS
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import DeviceClock, World
from rig_basics.ignoring import ignoring
from rig_basics.texts import number_of
from rig_basics.units import RPM
from rig_configs import load_rig
from rig_configs.schema import Rig
from rig_testing.stages import AFTER_S, LockstepStage, RealTimeStage, Stage, TrueMotion

_log = logging.getLogger(__name__)

Array = NDArray[np.floating[Any]]
Fields = list[tuple[str, int, float]]
"""Of a channel: a field, its column of the truth, and the tolerance."""

STOP_WITHIN_S = 0.5
"""Longest time from the limit of a needed channel to the order to stop, s."""
_EARLY_S = 2e-3
_SPREAD_SHARE = 0.6  # share of the samples, the nearest ones, that enter a fit's spread
_SAME_SPREAD = 1.01  # ratio up to which two spreads are equal: the random difference if nothing moves
_MAX_SPREAD_RATIO = 0.3  # of a fit's spread to the motion's: above it the readings are mostly of another motion
_OTHER_CLOCK_S = 1.0  # difference above which a clock is the pipeline's own count
_HOST_COUNTS_AFTER_S = 1.5  # from the start of the log; before, a host that counts samples finds no loss
_TURNS_RPM = 20.0  # speed above which a rotor turns with certainty
_SPOILING = ("garbage", "bit errors", "lost bytes")  # line faults after which a line without a checksum is not checked
_TURNS_S = (
    (0.002, 0.008),
    (0.004, 0.016),
    (0.012, 0.020),
)  # quick adapters, others, those that buffer for 16 ms
_CALM = ["virtual.sensors.axis_angle_deg=0", "virtual.sensors.draw_calibration=false"]


@dataclass(frozen=True)
class ScheduledFault:
    """One fault of a schedule.

    Attributes:
        at_s, seconds: start and duration; duration 0: it happens once.
        device: name of the device; empty: the host.
        what: its kind: one of the far end's, of the line's, "unplug", or "busy" for the host.
        value: magnitude, in the unit of the kind.
    """

    at_s: float
    seconds: float
    device: str
    what: str
    value: float = 1.0


@dataclass(frozen=True)
class Schedule:
    """Events of one run.

    Attributes:
        seed: of all that is random in it.
        rpm: speed of the rotor; 0: it is not turned.
        seconds: duration of the recording.
        turn_s: range of the random intervals at which the adapters deliver received data, s.
        faults: in order of time; s since the recording began.
    """

    seed: int
    rpm: float
    seconds: float
    turn_s: tuple[float, float]
    faults: tuple[ScheduledFault, ...]


@dataclass
class Result:
    """Result of a schedule.

    Attributes:
        schedule: the schedule.
        wrong: violated conditions, as sentences; empty if there are none.
        ended: error that ended the run; empty if it was completed.
        digest: of the log's bytes.
        rig_s: simulated duration of the run, s.
        stop_s: from the fault to the order to stop, s; NaN if no stop was needed.
    """

    schedule: Schedule
    wrong: list[str] = field(default_factory=list[str])
    ended: str = ""
    digest: str = ""
    rig_s: float = 0.0
    stop_s: float = math.nan


def draw(rig: Rig, seed: int, calm: bool = False) -> Schedule:
    """Draw a schedule from its seed.

    Args:
        rig: with far ends; its faults are drawn from those that they can have.
        seed: any.
        calm: without faults.
    """
    dice = np.random.default_rng([seed, 4711])
    rpm = float(dice.choice([0.0, dice.uniform(150, 450)])) if rig.roles.speed is not None else 0.0
    seconds = float(dice.uniform(5.0, 9.0))
    count = 0 if calm else int(dice.choice([0, 1, 1, 2, 3]))
    faults = tuple(sorted((_fault(rig, dice, seconds) for _ in range(count)), key=lambda fault: fault.at_s))
    turn_s = _TURNS_S[int(dice.integers(len(_TURNS_S)))]
    return Schedule(seed, rpm, seconds, turn_s, faults)


def _fault(rig: Rig, dice: np.random.Generator, seconds: float) -> ScheduledFault:
    at_s, lasts_s = float(dice.uniform(0.2, seconds - 0.5)), float(10 ** dice.uniform(-1.7, 0.8))
    device = str(dice.choice([*rig.devices, ""]))
    if not device:
        return ScheduledFault(at_s, float(10 ** dice.uniform(-2.5, 0.0)), "", "busy")
    own = LockstepRig(rig).far.far_ends[device].fault_kinds
    kinds = {**LINE_FAULTS, **own}
    what = str(dice.choice([*kinds, "unplug"]))
    if what == "unplug":
        return ScheduledFault(at_s, lasts_s, device, what)
    kind = kinds[what]
    low, high = kind.limits
    values = [kind.value, kind.value, low, high] if kind.meaning and high < 1e5 else [kind.value]
    return ScheduledFault(at_s, 0.0 if kind.end is None else lasts_s, device, what, float(dice.choice(values)))


def run(
    rig_name: str, schedule: Schedule, folder: Path, settings: tuple[str, ...] = (), *, real_time: bool = False
) -> Result:
    """Run a schedule and check the result.

    Args:
        rig_name: a rig file, or a shipped rig.
        schedule: for that rig.
        folder: folder of the log.
        settings: "key=value" texts over the rig file.
        real_time: on ptys, with threads and real time; else in lockstep, where a schedule is repeatable.
    """
    changes = [f"virtual.seed={schedule.seed}", *_CALM, *settings]
    rig = load_rig(rig_name, settings=changes)
    stage: Stage = RealTimeStage(rig) if real_time else LockstepStage(rig, schedule.turn_s)
    try:
        return _run(load_rig(rig_name, settings=[*changes, *stage.port_settings()]), schedule, folder, stage)
    finally:
        stage.close()


def _run(rig: Rig, schedule: Schedule, folder: Path, stage: Stage) -> Result:
    result = Result(schedule)
    path = folder / f"schedule-{schedule.seed}.mcap"
    begun_s = stage.clock.now_s()
    session = Session(rig, stage.clock, edge=stage.edge)
    over = threading.Event()  # faults after the end of the session are not observed by any host
    try:
        with session:
            session.start_recording(path, {"test": "record"})
            for fault in schedule.faults:
                stage.after(fault.at_s, partial(_begin, stage, fault, over))
            _operate(session, schedule)
            session.stop_recording({})
    except AcquisitionError as error:
        result.ended = str(error)
    except Exception as error:
        result.wrong.append(f"ended with {type(error).__name__}: {error}")
        result.ended = str(error)
    over.set()
    result.rig_s = stage.clock.now_s() - begun_s
    truth = stage.end()
    if path.exists():
        result.digest = hashlib.sha256(path.read_bytes()).hexdigest()
        result.wrong += _judged(path, truth, rig, schedule, result)
    else:
        result.wrong.append("there is no finished log")
    result.wrong += _left_behind(truth, session)
    return result


def _begin(stage: Stage, fault: ScheduledFault, over: threading.Event) -> None:
    if over.is_set():
        return
    match fault.what:
        case "busy":
            stage.busy(fault.seconds)
        case "unplug":
            stage.ask("unplug", device=fault.device)
            stage.after(fault.seconds, lambda: stage.ask("plug", device=fault.device))
        case _:
            lasts: dict[str, Any] = {"seconds": fault.seconds} if fault.seconds else {}
            with ignoring(_log, "setting a fault that may be present already", ValueError):
                stage.ask("fail", device=fault.device, what=fault.what, value=fault.value, **lasts)


def _operate(session: Session, schedule: Schedule) -> None:
    """Turn the rotor, if the schedule has a speed, and wait for its end."""
    end = session.clock.now_s() + schedule.seconds
    if schedule.rpm:
        session.drive.enable()
        session.drive.set_ramp(300.0)
        session.drive.set_speed(schedule.rpm)
    while session.clock.now_s() < end:
        session.check()
        session.clock.wait(0.05)


# --- what must hold ----------------------------------------------------------------------------------------------


def _judged(path: Path, truth: TrueMotion, rig: Rig, schedule: Schedule, result: Result) -> Iterator[str]:
    """Compare the log with the truth."""
    with open_log(path) as log:
        if not log.complete:
            yield "the log is not complete"
        yield from _replays(path, schedule)
        yield from _samples_right(log, rig, schedule, truth)
        yield from _stopped_in_time(log, rig, schedule, result, truth)
    if not schedule.faults and result.ended:
        yield f"without a fault it ended: {result.ended}"


def _replays(path: Path, schedule: Schedule) -> Iterator[str]:
    for row in check(path):
        if row.difference:
            yield f"decoded again, {row.topic} differs: {row.difference}"


def _spoilt(schedule: Schedule) -> set[str]:
    """Return the devices whose bytes were damaged."""
    return {fault.device for fault in schedule.faults if fault.what in _SPOILING}


def _restarted(schedule: Schedule) -> set[str]:
    """Return the devices whose clock and counter may have restarted."""
    return {fault.device for fault in schedule.faults if fault.what in ("power", "restart", "stale", "lost", "range")}


def _device_times(log: Log, clock: SampleClock, own: DeviceClock, zero_ns: int) -> Array:
    """Return when the samples of a channel were made, by the device's own ticks, s."""
    samples = log[clock.topic]
    period_s = 2.0**32 * clock.tick_ns * 1e-9
    ticks = np.unwrap(samples[clock.field].astype(np.float64), period=2.0**32)
    at_s = (ticks * clock.tick_ns * 1e-9 - own.offset_s) / (1 + own.drift)
    logged_s = float(samples.time_ns[0] - zero_ns) * 1e-9
    return at_s + period_s * round((logged_s - float(at_s[0])) / period_s)


def _aligned(
    at_s: Array, late: Array, log: Log, topic: str, fields: Mapping[str, Fields], truth: TrueMotion
) -> tuple[Array, Array]:
    """Return times of a device whose wire carries no time, from the time shift with the best fit to the truth.

    Some samples after a gap may have times that are early by the gap, as the driver's page states. If the motion is too
    small to distinguish shifts, the smallest of the equally good ones is used. If no shift explains the readings by the
    truth, none is applied: during a whirl of 9 mm a laser across it reads more of the whirl, through its mounting, than
    of its own axis' 0.05 mm.
    """
    at_s, late = at_s + np.median(late), late - np.median(late)
    if topic not in fields:
        return at_s, late
    name, column, _ = fields[topic][0]
    some = slice(None, None, max(1, len(at_s) // 4000))
    value = log[topic][name].astype(np.float64)[some]
    shifts = np.arange(-0.012, 0.006, 1e-4)
    was = truth.rows[:, column]
    spread = np.array([_spread(value - np.interp(at_s[some] + shift, truth.time_s, was)) for shift in shifts])
    alike = shifts[spread <= _SAME_SPREAD * np.min(spread, where=np.isfinite(spread), initial=np.inf)]
    moves = _spread(np.interp(at_s[some], truth.time_s, was))
    if not len(alike) or np.nanmin(spread) > _MAX_SPREAD_RATIO * moves:  # no valid sample, or another motion
        return at_s, late
    shift = float(alike[np.argmin(np.abs(alike))])
    return at_s + shift, late - shift


def _spread(values: Array) -> float:
    """Return the root mean square distance of the nearest values from their median.

    The median distance is not used: readings are rounded, and their median changes in steps.
    """
    away = np.sort(np.abs(values - np.nanmedian(values)))
    near = away[: int(_SPREAD_SHARE * np.count_nonzero(np.isfinite(away)))]
    return float(np.sqrt(np.mean(near**2))) if len(near) else math.nan


def _trusted(rig: Rig, schedule: Schedule) -> Iterator[tuple[str, SampleClock, bool]]:
    """Yield channels on a device's own clock whose samples must be right in spite of the faults.

    The third value is whether the device counts missing samples itself. Otherwise its clock is the host's count, which
    shows no loss before the usual lateness of the reads is known.
    """
    early = {fault.device for fault in schedule.faults if fault.at_s < _HOST_COUNTS_AFTER_S}
    for name, device in devices_of(rig.devices).items():
        checked, exact = ("checksum" in device.driver.claims), "counts exactly" in device.driver.claims
        sound = (checked or name not in _spoilt(schedule)) and (exact or name not in early)
        if name not in _restarted(schedule) and sound:
            yield from ((name, clock, exact) for clock in device.clocks)


def _samples_right(log: Log, rig: Rig, schedule: Schedule, truth: TrueMotion) -> Iterator[str]:
    """Check that every valid displacement and angle is the truth at its time, and every missing sample counted."""
    virtual = rig.virtual
    assert virtual is not None
    world, zero_ns = World(virtual, SimulatedMotion(rig.true_physics, 0.0, 0.1)), truth.zero_ns
    fields = {
        sensor.topic: [("displacement_m", "xy".index(sensor.axis), 8 * virtual.sensors.laser_noise_m + 8e-6)]
        for sensor in rig.roles.displacements
    }
    if rig.roles.angles is not None:
        step = 4 * rig.roles.angles.step_rad
        fields[rig.roles.angles.topic] = [("theta3_rad", 2, step), ("theta4_rad", 3, step)]
    counted = json.loads(log.metadata["summary"]["losses"])
    for name, clock, exact in _trusted(rig, schedule):
        if clock.topic not in log or log.count(clock.topic) < 2:
            continue
        own = world.clock(name)
        at_s = _device_times(log, clock, own, zero_ns)
        late = (log[clock.topic].time_ns - zero_ns) * 1e-9 - at_s
        counted_by_host = not exact or abs(float(np.median(late))) > _OTHER_CLOCK_S
        if counted_by_host:
            at_s, late = _aligned(at_s, late, log, clock.topic, fields, truth)

        if np.min(late) < -_EARLY_S or np.median(late) > 0.05:
            yield f"{clock.topic}: times are {late.min() * 1e3:.1f} to {late.max() * 1e3:.1f} ms off"
        lost = round(float(at_s[-1] - at_s[0]) * (1 + own.drift) * clock.rate_Hz) + 1 - len(at_s)
        if lost != counted[name].get("samples", 0):
            yield f"{name}: {number_of(counted[name].get('samples', 0), 'sample')} counted as lost, {lost} were"
        if counted_by_host and any(fault.device == name for fault in schedule.faults):
            continue  # behind a gap its samples have the host's time, good to some ms
        for field_name, column, tolerance in fields.get(clock.topic, ()):
            off = log[clock.topic][field_name].astype(np.float64) - np.interp(at_s, truth.time_s, truth.rows[:, column])
            off -= np.nanmedian(off) if np.isfinite(off).any() else 0.0
            if len(far := np.flatnonzero(np.abs(off) > tolerance)):  # NaN is no sample
                yield (
                    f"{clock.topic} {field_name}: {number_of(len(far), 'sample is', 'samples are')} wrong, the first "
                    f"by {off[far[0]]:.3g}"
                )


def _stopped_in_time(log: Log, rig: Rig, schedule: Schedule, result: Result, truth: TrueMotion) -> Iterator[str]:
    """Check that the rotor was stopped in time if a guarding channel was silent while it turned."""
    stops = [event["time_ns"] for event in log.events if event["kind"] == "stop"]
    stop_ns = stops[0] if stops else None
    zero_ns = truth.zero_ns
    speed = np.abs(truth.rows[:, 9]) / RPM
    turning = truth.time_s[speed > _TURNS_RPM]
    if not len(turning):
        return
    begin_ns, end_ns = zero_ns + int(turning[0] * 1e9), zero_ns + int(turning[-1] * 1e9)
    guards = {sensor.topic: 0.3 for sensor in rig.roles.displacements}
    if rig.roles.angles is not None:
        guards[rig.roles.angles.topic] = 1.0
    if rig.roles.speed is not None:
        guards[rig.roles.speed.topic] = 0.3
    busy_s = sum(fault.seconds for fault in schedule.faults if fault.what == "busy")
    for topic, limit_s in guards.items():
        times = log[topic].time_ns if topic in log and log.count(topic) else np.zeros(0, np.int64)
        if topic in log and log.count(topic) and "displacement_m" in log.channel(topic).names:
            times = times[np.isfinite(log[topic]["displacement_m"])]
        until_ns = min(end_ns, log.end_ns, stop_ns if stop_ns is not None else end_ns)
        edges = np.concatenate([[begin_ns], times[(times > begin_ns) & (times < until_ns)], [until_ns]])
        longest = float(np.max(np.diff(edges))) * 1e-9 if len(edges) > 1 else 0.0
        allowed = limit_s + 0.3 + STOP_WITHIN_S + busy_s
        if longest > allowed:
            yield f"{topic}: blind for {longest:.2f} s while the rotor turned; a stop was due within {allowed:.2f} s"
        result.stop_s = longest if math.isnan(result.stop_s) else max(result.stop_s, longest)


def _left_behind(truth: TrueMotion, session: Session) -> Iterator[str]:
    """Check that the rotor is at rest in the end, or that the operator was warned."""
    speed_rpm = float(truth.rows[-1, 9]) / RPM
    warned = any("keep away" in notice for notice in session.notices)
    if abs(speed_rpm) > 10.0 and not warned:
        yield f"the rotor turns at {speed_rpm:.0f} rpm {AFTER_S:g} s after the end, without a warning"
    if abs(truth.target_rad_s) > 0:
        yield f"the drive was left with a target of {truth.target_rad_s / RPM:.0f} rpm"
