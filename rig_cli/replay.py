"""`rig replay`: a log decoded again: compared, corrected, checked by interlocks, watched, or played to programs."""

from __future__ import annotations

import json as json_text
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from daq.errors import LogError
from daq.log import Log, open_log
from daq.playback import Playback, PlaybackState, open_outlets, played_devices
from daq.replay import ReplayCheck, check
from daq.replay.calibration import Calibration
from daq.replay.compare import ChannelCheck
from daq.replay.decoded_again import DecodedLog, decode_again
from daq.replay.pace import paced
from rig_basics.texts import number_of
from rig_cli.console import STDERR, notify, print_json, show
from rig_cli.numbers import SecondsOrNone
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Json, Settings
from rig_cli.replay_interlocks import show_interlocks
from rig_cli.replay_view import ReplayView
from rig_cli.share_progress import share_progress

_PLAIN_S = 5.0  # between two lines of output that is not a terminal


@Parameter(name="*")
@dataclass(frozen=True)
class ReplayJob:
    """What is done with a log. Without any option it is compared.

    Attributes:
        check: whether a difference is exit code 1.
        calibration: numbers for a new log.
        output: the new log.
        speed: pace.
        to: where the bytes are played.
        linger: how long the ports stay open at the end, s.
        interlocks: whether the interlocks are applied.
        all_trips: whether they are applied after the first trip.
    """

    check: bool = False
    calibration: Annotated[Path | None, Parameter(help="TOML with [devices.…] calibration; needs -o")] = None
    output: Annotated[Path | None, Parameter(name=["--output", "-o"], group=OUTPUT, help="new log, decoded again")] = (
        None
    )
    speed: Annotated[str | None, Parameter(help="watch it at this pace: 1, a number, or max")] = None
    to: Annotated[str | None, Parameter(help="play the bytes to pty, tcp, or device=port,device=port")] = None
    linger: Annotated[SecondsOrNone | None, Parameter(help="with --to: keep ports open at the end, s at most")] = None
    interlocks: Annotated[bool, Parameter(negative="", help="when interlocks would have tripped")] = False
    all_trips: Annotated[
        bool, Parameter(name="--all", negative="", help="with --interlocks: go on after the first trip")
    ] = False


_COMPARE = ReplayJob()


def replay(
    log: Annotated[Path, Parameter(help="finished or cut")],
    *,
    job: ReplayJob = _COMPARE,
    settings: Annotated[
        Settings, Parameter(help="with --interlocks: other limits, e.g. limits.amplitude_m=0.004")
    ] = None,
    json: Json = False,
) -> int:
    """Decode a log's raw bytes again through the same pipelines.

    Without options it compares the result with what was decoded live and prints it; with --check a difference is exit
    code 1. With -o it writes a new log, with --calibration with corrected numbers. With --speed it shows the log at
    that pace. With --to it plays the bytes to other programs, at --speed (default 1); a program that configures its
    devices first gets the devices' replies. With --interlocks it shows when they would have tripped, exit code 1 when
    one would.

    Example: `rig replay run.mcap --check`
    """
    _refuse_contradictions(job)
    if job.interlocks:
        return show_interlocks(log, settings or [], all_trips=job.all_trips, json=json)
    if settings or job.all_trips:
        raise LogError(
            f"{'--set' if settings else '--all'}: expected --interlocks with it; no other job takes this option"
        )
    if job.output is not None:
        return _write_new(log, job.output, job.calibration, json)
    if job.to is not None:
        return _play(log, job.to, _factor(job.speed or "1"), job.linger, json)
    if job.speed is not None:
        return _watch(log, _factor(job.speed), json)
    return _check(log, job.check, json)


def _refuse_contradictions(job: ReplayJob) -> None:
    if job.calibration is not None and job.output is None:
        raise LogError("--calibration: expected -o NEW.mcap with it; a log is never changed, a new one is written")
    if job.linger is not None and job.to is None:
        raise LogError("--linger: expected --to with it; there are no ports to keep open")
    flags = {
        "--interlocks": job.interlocks,
        "--check": job.check,
        "-o": job.output is not None,
        "--to": job.to is not None,
    }
    given = [name for name, there in flags.items() if there]
    if len(given) > 1 or (job.speed is not None and given and given != ["--to"]):
        named = [*given, *(["--speed"] if job.speed is not None else [])]
        raise LogError(f"{' and '.join(named)}: expected one job at a time; give the commands one after the other")


def _factor(text: str) -> float:
    """Return seconds of the log per second."""
    try:
        factor = math.inf if text == "max" else float(text)
    except ValueError:  # usual: reported below
        factor = math.nan
    if not factor > 0:
        raise LogError(f"--speed {text}: expected max or a number above 0, for example 1 or 8")
    return factor


# --- compared ----------------------------------------------------------------------------------------------------


def _check(path: Path, wanted: bool, json: bool) -> int:
    with share_progress("decoding again") as progress:
        found = check(path, progress)
    if json:
        print_json({"log": str(path), **_check_json(found)})
    else:
        _print_check(found)
    return 1 if wanted and not found.identical else 0


def _check_json(found: ReplayCheck) -> dict[str, Any]:
    rows = [
        {key: value for key, value in vars(row).items() if key not in ("first", "fields")}
        | {"difference": row.difference, "fields": _fields_json(row), "first": vars(row.first) if row.first else None}
        for row in found
    ]
    return {
        "identical": found.identical,
        "until_ns": found.until_ns,
        "recorded_by_decoder": found.recorded_by,
        "decoded_by_decoder": found.decoded_by,
        "notes": list(found.notes),
        "channels": rows,
    }


def _fields_json(row: ChannelCheck) -> dict[str, Any]:
    return {
        name: {"samples": apart.samples, "largest": apart.largest, "rms": apart.rms}
        for name, apart in row.fields.items()
    }


def _print_check(found: ReplayCheck) -> None:
    for row in found:
        same = "identical" if row.live == row.again else "identical as far as compared"
        show(f"{row.topic:10} {row.live:9d} live {row.again:9d} again   {row.difference or same}")
    differing = [row for row in found if row.first is not None]
    if differing:
        head = ("channel", "differing", "first", "time since 1970, ns", "field", "in the log", "decoded again")
        lines = [head, *(_first_difference(row) for row in differing)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
        print()
        for line in lines:
            show("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
    for note in found.notes:
        show(f"note: {note}")
    show(replay_sentence(found))


def replay_sentence(found: ReplayCheck) -> str:
    """Return whether all that was compared is as it was recorded, or which channels are not."""
    differing = [row.topic for row in found if row.difference]
    channels = number_of(len(found.channels), "channel")
    if differing:
        verb = "differs" if len(differing) == 1 else "differ"
        return f"{len(differing)} of {channels} {verb}: {', '.join(differing)}."
    part = "" if found.until_ns is None else ", as far as raw bytes were compared"
    return f"All {channels} are decoded as they were recorded{part}."


def _first_difference(row: ChannelCheck) -> tuple[str, ...]:
    first = row.first
    assert first is not None
    sides = ("nothing" if side is None else repr(side) for side in (first.stored, first.decoded))
    return (row.topic, str(row.differing), str(first.index), str(first.time_ns), first.field, *sides)


# --- into a new log ----------------------------------------------------------------------------------------------


def _write_new(path: Path, output: Path, calibration: Path | None, json: bool) -> int:
    loaded = None if calibration is None else Calibration.load(calibration)
    with share_progress("decoding again") as progress:
        made = decode_again(path, output, loaded, progress)
    if json:
        rows = {row.topic: {"origin": row.live, "anew": row.again, "moved": _fields_json(row)} for row in made.moved}
        print_json(
            {
                "log": str(made.path),
                "origin": str(path),
                "channels": rows,
                "losses": made.losses,
                "missing": list(made.missing),
            }
        )
        return 0
    for line in _moved_lines(made):
        show(line)
    notify(f"written to {made.path}")
    return 0


def _moved_lines(made: DecodedLog) -> list[str]:
    lines: list[str] = []
    for row in made.moved:
        if row.live != row.again:
            lines.append(f"{row.topic:10} {number_of(row.again, 'sample')}, the origin has {row.live}")
        for name, apart in row.fields.items():
            lines.append(
                f"{row.topic:10} {name:16} {apart.samples} of {row.compared} moved, "
                f"at most {apart.largest:.4g}, rms {apart.rms:.4g}"
            )
        if row.live == row.again and not row.fields:
            lines.append(f"{row.topic:10} {number_of(row.again, 'sample')}, all as they were")
    return lines + [f"missing in the origin: {text}" for text in made.missing]


# --- watched -----------------------------------------------------------------------------------------------------


def _watch(path: Path, speed: float, json: bool) -> int:
    started = time.monotonic()
    ended = "end of the log"
    with open_log(path) as log:
        replayed = paced(log, speed)
        view = ReplayView(log, replayed)
        try:
            with view:
                for _, chunk, items in replayed:
                    view.add(chunk.host_ns, items)
        except KeyboardInterrupt:  # usual: Ctrl-C ends it
            ended = "Ctrl-C"
        result: dict[str, Any] = {
            "log": str(path),
            "ended": ended,
            "seconds": time.monotonic() - started,
            **view.totals(),
        }
    if json:
        print_json(result)
    else:
        notify(
            f"{path}: {result['span_s']:.1f} s of the log shown, ended by {ended}, at most "
            f"{result['most_late_s'] * 1e3:.0f} ms late"
        )
    return 0


# --- played to other programs ------------------------------------------------------------------------------------


def _play(path: Path, to: str, speed: float, linger: float | None, json: bool) -> int:
    with open_log(path) as log:
        devices = played_devices(log)
        outlets = open_outlets(log, to)
        playback = Playback(outlets, devices, speed)
        try:
            ports = {device: outlet.port for device, outlet in outlets.items()}
            _announce(ports, path, speed)
            ended = _carry_out(playback, log, speed, linger)
        finally:
            playback.close()
        state = playback.state
        played_s = max(0.0, (state.log_ns - log.start_ns) * 1e-9)
        span = f"{played_s:.1f} s of {(log.end_ns - log.start_ns) * 1e-9:.1f} s"
    for line in _lost_lines(state):
        notify(line)
    if json:
        print_json(
            {
                "ended": ended,
                "configured": playback.configured,
                "played_s": played_s,
                "delivered_bytes": state.delivered,
                "undelivered_bytes": state.undelivered,
                "withheld_bytes": state.withheld,
                "unfollowed_commands": state.unfollowed,
                "most_late_s": state.most_late_s,
            }
        )
    else:
        notify(
            f"{path}: {number_of(sum(state.delivered.values()), 'byte')} played, {span}, ended by {ended}, at most "
            f"{state.most_late_s * 1e3:.0f} ms late"
        )
    left_early = state.cut_short or any(state.undelivered.values())
    return 3 if left_early and not state.stopped else 0


def _announce(ports: dict[str, str], path: Path, speed: float) -> None:
    """Print the ports in the form of `rig virtual`."""
    scale = speed if math.isfinite(speed) else 1.0
    print(json_text.dumps({"ports": ports, "log": str(path), "speed": scale}), flush=True)
    settings = " ".join(f"--set devices.{device}.port={port}" for device, port in ports.items())
    notify(f"for example: rig record {path} --listen --until-silent 2 -o again.mcap {settings}")


def _carry_out(playback: Playback, log: Log, speed: float, linger: float | None) -> str:
    def report_ports(devices: list[str]) -> None:
        notify(f"waiting for a program to open {', '.join(devices)}" if devices else "every port is open")

    def report_setup(waiting: Mapping[str, str]) -> None:
        wanted = ", ".join(f"{device} ({expects})" for device, expects in waiting.items())
        notify(f"the host configures its devices; not started: {wanted}" if waiting else "all devices are started")

    try:
        playback.wait_for_readers(report_ports)
        playback.wait_for_setup(report_setup)
        if playback.configured and math.isinf(speed):
            notify(
                "warning: the host begins to record after its first bytes are past, and at --speed max these are most; "
                "--speed 1 plays at the log's own pace"
            )
        notify("playing")
        state = playback.play(log.raw_in_order(), _PlayedLines(log).report)
        if state.cut_short:
            return "the host, which stopped its devices and left" if state.stopped else "the readers, who left"
        notify("all bytes are delivered; the ports stay open until their readers close them")
        playback.hold(linger)
    except KeyboardInterrupt:  # usual: Ctrl-C ends it
        return "Ctrl-C"
    return "end of the log"


class _PlayedLines:
    """Progress lines of playing, and a line at once when a reader disconnects."""

    def __init__(self, log: Log) -> None:
        self._start_ns, self._span_s = log.start_ns, (log.end_ns - log.start_ns) * 1e-9
        self._line_s = time.monotonic()
        self._gone: set[str] = set()

    def report(self, state: PlaybackState) -> None:
        """See Playback.play."""
        for device in state.gone.keys() - self._gone:
            self._gone.add(device)
            if not state.stopped:
                at_s = (state.gone[device] - self._start_ns) * 1e-9
                notify(f"{device}: its reader disconnected {at_s:.1f} s into the log")
        if time.monotonic() - self._line_s > _PLAIN_S:
            self._line_s = time.monotonic()
            late = f", {state.late_s:.2f} s late: a reader is slow" if state.late_s > 0.1 else ""
            at_s = max(0.0, (state.log_ns - self._start_ns) * 1e-9)
            STDERR.print(f"{at_s:.1f} s of {self._span_s:.1f} s played{late}")


def _lost_lines(state: PlaybackState) -> list[str]:
    undelivered: Mapping[str, int] = {} if state.stopped else state.undelivered
    return [
        *(
            f"{device}: {number_of(count, 'byte was', 'bytes were')} not played: no program read them"
            for device, count in undelivered.items()
            if count
        ),
        *(
            f"{device}: {number_of(count, 'command')} had no effect: a log plays the recorded answers"
            for device, count in state.unfollowed.items()
            if count
        ),
    ]
