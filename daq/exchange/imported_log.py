"""Readings as the channels and events of a log, written on one time axis in order of time.

The channels have no device counters: the time is that of the message.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import Channel
from daq.exchange.errors import ExchangeError
from daq.exchange.readings import SensorReadings, find_gaps, unwrapped
from daq.exchange.recipe import Recipe
from daq.exchange.rotor_phase import phase_of_angle, phase_of_speed, revolutions_of_marks
from daq.guided_test_kinds import CHANNELS
from daq.items import Batch, DeviceEvent
from daq.log.file import LogFile
from daq.log.time_span import LATEST_NS
from rig_basics.texts import number_of

DISPLACEMENT_X = Channel("laser/x", "rig.Displacement", (("displacement_m", "double"),))
DISPLACEMENT_Y = Channel("laser/y", "rig.Displacement", (("displacement_m", "double"),))
PENDULUM_ANGLES = Channel("pendulums", "rig.PendulumAngles", (("theta3_rad", "double"), ("theta4_rad", "double")))
ROTOR_PHASE = Channel("tacho", "rig.RotorPhase", (("phase_rad", "double"),))
ROTOR_MARK = Channel("tacho", "rig.RotorMark", (("revolutions", "fixed32"),))


_ROWS_PER_STEP = 8192


@dataclass(frozen=True)
class Part:
    """Samples of one channel.

    Attributes:
        channel: channel in the log.
        time_ns: sample times, ns since 1970, ascending, shape (n,).
        columns: fields of the channel, each (n,).
    """

    channel: Channel
    time_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]]


def write_log(
    path: Path,
    parts: Sequence[Part],
    events: Sequence[DeviceEvent],
    metadata: Mapping[str, str],
    attachments: Mapping[str, bytes],
    summary: Mapping[str, Any],
    progress: Callable[[float], None],
) -> Path:
    """Write a log of parts and events, sorted by their own times; an unfinished log is removed.

    Raises:
        LogError: the name is taken or does not end in .mcap.
        RecordingError, OSError: the disk failed.
    """
    log = LogFile(path, metadata, attachments, (), time.time_ns(), [part.channel for part in parts])
    with log.or_nothing():
        _write(log, parts, events, progress)
        return log.finish(summary)


def _write(
    log: LogFile, parts: Sequence[Part], events: Sequence[DeviceEvent], progress: Callable[[float], None]
) -> None:
    start = min(int(part.time_ns[0]) for part in parts)
    end = max(int(part.time_ns[-1]) for part in parts) + 1
    steps = max(1, sum(len(part.time_ns) for part in parts) // _ROWS_PER_STEP)
    done = [0] * len(parts)
    waiting = deque(events)
    for i in range(1, steps + 1):
        until = start + (end - start) * i // steps
        for number, part in enumerate(parts):
            stop = int(np.searchsorted(part.time_ns, until))
            rows = slice(done[number], stop)
            if stop > done[number]:
                columns = {name: values[rows] for name, values in part.columns.items()}
                sequence = np.arange(done[number], stop).astype(np.uint32)
                log.batch(Batch(part.channel, part.time_ns[rows], sequence, columns), part.time_ns[rows])
            done[number] = stop
        while waiting and (waiting[0].facts["time_ns"] < until or i == steps):
            event = waiting.popleft()
            log.event(event, event.facts["time_ns"])
        progress(i / steps)


_SIGNALS = {topic: signal for signal, topic in CHANNELS.items()}
_MIN_RELEASE_STD_S = 1e-4


@dataclass
class ImportFindings:
    """Findings of an import.

    Attributes:
        warnings: warnings, as sentences.
        invalid: number of readings that the recording marks as invalid, by device.
        gaps: number of samples missing in a uniformly sampled recording, by device; absent if it is not uniform.
        devices: devices of the rig, by the channel each fills.
    """

    warnings: list[str] = field(default_factory=list[str])
    invalid: dict[str, int] = field(default_factory=dict[str, int])
    gaps: dict[str, int] = field(default_factory=dict[str, int])
    devices: dict[str, str] = field(default_factory=dict[str, str])

    def device(self, topic: str) -> str:
        """Return the source of a channel: the rig's own device, or the name of the signal if the rig has none."""
        return self.devices.get(topic, _SIGNALS[topic])


def make_parts(readings: Mapping[str, SensorReadings], recipe: Recipe, noticed: ImportFindings) -> list[Part]:
    """Return the channels of a log; times since 1970.

    Raises:
        ExchangeError: angles at different times, a decreasing phase, too few marks.
    """
    parts: list[Part] = []
    for axis, channel in (("x", DISPLACEMENT_X), ("y", DISPLACEMENT_Y)):
        if axis in readings:
            found = readings[axis]
            parts.append(Part(channel, found.time_ns, {"displacement_m": found.value}))
            noticed.invalid[noticed.device(channel.topic)] = found.invalid
    if "theta3" in readings or "theta4" in readings:
        parts.append(_pendulums(readings, recipe, noticed))
    if "marks" in readings:
        time = readings["marks"].time_ns
        revolutions, warnings = revolutions_of_marks(time)
        noticed.warnings += warnings
        parts.append(Part(ROTOR_MARK, time, {"revolutions": revolutions}))
    for name, phase_of in (("phase", phase_of_angle), ("speed", phase_of_speed)):
        if name in readings:
            time, phase, warnings = phase_of(readings[name])
            noticed.warnings += warnings
            device = noticed.device("tacho")
            noticed.invalid[device] = noticed.invalid.get(device, 0) + readings[name].invalid
            parts.append(Part(ROTOR_PHASE, time, {"phase_rad": phase}))
    return parts


def _pendulums(readings: Mapping[str, SensorReadings], recipe: Recipe, noticed: ImportFindings) -> Part:
    names = [name for name in ("theta3", "theta4") if name in readings]
    own = {choice.name if choice else "" for choice in (recipe.choices[name].time for name in names)}
    if len(own) > 1:
        raise ExchangeError("theta3, theta4: expected both angles at the same times, got two columns of times")
    time = np.unique(np.concatenate([readings[name].time_ns for name in names]))
    columns: dict[str, NDArray[np.float64]] = {}
    for name in ("theta3", "theta4"):
        angle = np.full(len(time), np.nan)
        if name in readings:
            angle[np.searchsorted(time, readings[name].time_ns)] = unwrapped(readings[name].value)
        columns[f"{name}_rad"] = angle
    noticed.invalid[noticed.device("pendulums")] = sum(int(np.isnan(columns[f"{name}_rad"]).sum()) for name in names)
    return Part(PENDULUM_ANGLES, time, columns)


def gap_events(parts: list[Part], noticed: ImportFindings) -> list[DeviceEvent]:
    """Return one event per gap of the sensors; index marks and phases are omitted: the speed is not uniform."""
    found: list[DeviceEvent] = []
    for part in parts:
        topic, device = part.channel.topic, noticed.device(part.channel.topic)
        if topic == "tacho":
            continue
        gaps = find_gaps(part.time_ns)
        if gaps is None:
            noticed.warnings.append(f"{topic}: not uniformly sampled, so missing samples cannot be counted")
            continue
        for gap in gaps:
            facts = {"samples": gap.samples, "span_s": gap.span_s, "time_ns": gap.after_ns}
            found.append(
                DeviceEvent(
                    "gap", device, f"{number_of(gap.samples, 'sample')} missing ({gap.span_s * 1e3:.2f} ms)", facts
                )
            )
        noticed.gaps[device] = sum(gap.samples for gap in gaps)
    return found


def release_events(parts: list[Part], release_s: tuple[float, ...], zero_ns: int, device: str) -> list[DeviceEvent]:
    """Return one event per released pendulum; a single time applies to both.

    Args:
        parts: channels of the log.
        release_s: times of the releases, s.
        zero_ns: origin of these times, ns since 1970.
        device: device that measures the pendulums' angles.

    Raises:
        ExchangeError: a release outside the recording.
    """
    start, end = min(int(part.time_ns[0]) for part in parts), max(int(part.time_ns[-1]) for part in parts)
    steps = [float(np.median(np.diff(p.time_ns))) * 1e-9 for p in parts if p.channel.topic == "pendulums"]
    std_s = max([_MIN_RELEASE_STD_S, *(step / math.sqrt(12) for step in steps)])
    found: list[DeviceEvent] = []
    for pendulum, at_s in enumerate(release_s * 2 if len(release_s) == 1 else release_s):
        time_ns = zero_ns + round(max(-LATEST_NS, min(at_s * 1e9, LATEST_NS)))
        if not start <= time_ns <= end:
            raise ExchangeError(
                f"release {at_s:g}: expected a time within the recording, {(start - zero_ns) / 1e9:g} s to "
                f"{(end - zero_ns) / 1e9:g} s"
            )
        facts = {"pendulum": pendulum, "state": "released", "time_ns": time_ns, "time_std_s": std_s}
        found.append(DeviceEvent("lock", device, f"pendulum {'AB'[pendulum]} released, as stated at import", facts))
    return found
