"""`rig replay LOG --interlocks`: table of all interlocks, and when each would have tripped in a log."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from daq.acquisition.interlock_table import INTERLOCKS, Interlock
from daq.log import open_log
from daq.replay.interlocked import InterlockReplay, WouldTrip, replay_interlocks
from rig_basics.texts import number_of
from rig_cli.console import notify, print_json, show
from rig_cli.options import what_if_words
from rig_cli.share_progress import share_progress
from rig_cli.words import stdout_console

_HEAD = ("interlock", "in this log", "threshold", "deadline", "reaction", "guards", "threshold from", "role")
_GAP = "  "


def show_interlocks(path: Path, settings: Sequence[str], *, all_trips: bool, json: bool) -> int:
    """Print when interlocks would have tripped.

    Args:
        path: the log.
        settings: "key=value" texts over its rig file.
        all_trips: continue after the first trip.
        json: print one object instead of a table.

    Returns:
        Exit code: 1 if one would have tripped.
    """
    with open_log(path) as log, share_progress("applying the interlocks") as progress:
        found = replay_interlocks(log, settings, all_trips=all_trips, progress=progress)
    if json:
        print_json(_facts(path, found, settings))
    else:
        _print(path, found, settings)
    return 1 if found.trips else 0


def _facts(path: Path, found: InterlockReplay, settings: Sequence[str]) -> dict[str, Any]:
    return {
        "log": str(path),
        "what_if": list(settings),
        "tripped": bool(found.trips),
        "trips": [_trip_facts(trip, found.start_ns) for trip in found.trips],
        "interlocks": [
            {**asdict(row), "threshold": row.threshold_of(found.limits), "in_this_log": _state(row, found)}
            for row in INTERLOCKS
        ],
        "limits": found.limits.model_dump(),
        "judged_s": _s(found.until_ns, found.start_ns),
        "session_stops": [
            {"time_s": _s(stop["time_ns"], found.start_ns), "time_ns": stop["time_ns"], "text": str(stop.get("text"))}
            for stop in found.stops
        ],
        "notes": list(found.notes),
    }


def _trip_facts(trip: WouldTrip, start_ns: int) -> dict[str, Any]:
    return {
        "time_s": _s(trip.time_ns, start_ns),
        "until_s": _s(trip.last_ns, start_ns),
        **asdict(trip),
    }


def _print(path: Path, found: InterlockReplay, settings: Sequence[str]) -> None:
    for line in _table([_HEAD, *(_row(row, found) for row in INTERLOCKS)]):
        show(line)
    show("")
    for trip in found.trips:
        for line in _trip_lines(trip, found.start_ns):
            show(line)
    for stop in found.stops:
        show(f"the session itself stopped at {_s(stop['time_ns'], found.start_ns):.3f} s: {stop.get('text')}")
    for note in found.notes:
        show(f"note: {note}")
    what_if = what_if_words(settings, ", ")
    judged = f"{path}: {_s(found.until_ns, found.start_ns):.1f} s judged{what_if}"
    if not found.trips:
        notify(f"{judged}: nothing would have tripped")
        return
    names = ", ".join(dict.fromkeys(trip.interlock for trip in found.trips))
    notify(f"{judged}: would have tripped at {_s(found.trips[0].time_ns, found.start_ns):.3f} s: {names}")


def _row(row: Interlock, found: InterlockReplay) -> tuple[str, ...]:
    threshold = row.threshold_of(found.limits)
    return (row.name, _state(row, found), threshold, row.deadline, row.reaction, row.guards, row.source, row.role)


def _state(row: Interlock, found: InterlockReplay) -> str:
    """Return what an interlock did in the log."""
    if row.judge == "session":
        return "judged in a session only"
    if not row.has_role(found.roles):
        return f"not judged: no {'second ' if row.name == 'stuck sensor' else ''}{row.role or row.guards}"
    times = [_s(trip.time_ns, found.start_ns) for trip in found.trips if trip.interlock == row.name]
    if not times:
        return "quiet"
    return f"trips at {times[0]:.3f} s" + (f", {number_of(len(times), 'time')}" if len(times) > 1 else "")


def _trip_lines(trip: WouldTrip, start_ns: int) -> Iterable[str]:
    lasted_s = _s(trip.last_ns, trip.time_ns)
    again = f" (until {_s(trip.last_ns, start_ns):.3f} s)" if lasted_s else ""
    yield f"{_s(trip.time_ns, start_ns):.3f} s  {trip.interlock}: {trip.text}{again}"
    commanded = "orders unknown" if trip.told_rpm is None else f"commanded {trip.told_rpm:.0f} rpm"
    speed = "speed unknown" if trip.speed_rpm is None else f"{trip.speed_rpm:.0f} rpm"
    values = [
        f"{topic} " + ", ".join(f"{name} {value:.6g}" for name, value in newest.items())
        for topic, newest in trip.newest.items()
        if newest
    ]
    yield f"           rotor {speed}, {commanded}; newest: {'; '.join(values)}"


def _table(rows: Sequence[tuple[str, ...]]) -> Iterable[str]:
    """Return rows in columns as wide as their widest cell, without columns that do not fit the terminal."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    room = stdout_console().width
    while sum(widths) + len(_GAP) * (len(widths) - 1) > room and len(widths) > 2:
        widths.pop()
    for row in rows:
        yield _GAP.join(cell.ljust(width) for cell, width in zip(row, widths, strict=False)).rstrip()
    if left_out := _HEAD[len(widths) :]:
        yield f"left out on a terminal of {number_of(room, 'column')}: {', '.join(left_out)}. --json has them"


def _s(time_ns: int, start_ns: int) -> float:
    return (time_ns - start_ns) * 1e-9
