"""Read a file's catalogue entry: the facts of a log, or the reason why the file is not a log."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from daq.catalogue.entry import Entry, State
from daq.errors import LogError
from daq.log import Log, open_log
from daq.log.losses import Losses, losses_of
from daq.mcap.writer import LIBRARY, MAGIC

_log = logging.getLogger(__name__)

_NO_OUTCOME = ("losses", "stalled", "disk")  # bookkeeping of the recording, not results of the test
_MOST_SENTENCES = 5
_MOST_CHARACTERS = 2000
_MOST_LOST = 2**63 - 1


def read_entry(file: Path, path: str, size_bytes: int) -> Entry:
    """Return the facts of one file without its verdict. Files that are not MCAP logs yield an entry with `why` set.

    Args:
        file: path of the file.
        path: path of the file in the catalogue.
        size_bytes: size of the file.
    """
    try:
        if not file.is_file():  # reading a named pipe would block
            why = "expected a file, got something else"
            return Entry(path=path, size_bytes=size_bytes, state="unreadable", why=why)
        with open_log(file) as log:
            return _facts(log, path, size_bytes, has_end(file))
    except LogError as fault:
        return Entry(path=path, size_bytes=size_bytes, state="unreadable", why=one_line(fault, file))
    except OSError as fault:
        return Entry(path=path, size_bytes=size_bytes, state="unreadable", why=f"cannot be read ({fault.strerror})")


def one_line(fault: object, file: Path) -> str:
    """Return a message about a file as one line, without the file's path, which the catalogue shows already."""
    return " ".join(str(fault).replace(f"{file}: ", "").split())


def outcome_of(summary: Mapping[str, str]) -> dict[str, Any]:
    """Return the result of a test from its log's summary metadata, where values are JSON texts."""
    return {key: _value(text) for key, text in summary.items() if key not in _NO_OUTCOME}


def origin_of(log: Log) -> str:
    """Return the source of a log that was decoded again, imported or recovered; empty for a recording."""
    origin = log.metadata.get("run", {}).get("origin", "")
    if origin or "recovered" not in log.metadata:
        return origin
    recovered = log.metadata["recovered"]
    return f"recovered from {recovered.get('origin') or recovered.get('file') or 'a cut log'}"


def counted_losses(log: Log) -> Losses | None:
    """Return the losses of a log; None if losses were not counted or the stored counts are invalid."""
    try:
        found = losses_of(log)
        by_device = {
            _short(str(device)): {_short(str(kind)): max(0, min(int(n), _MOST_LOST)) for kind, n in kinds.items()}
            for device, kinds in found.by_device.items()
        }
    except (LogError, ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as fault:
        # a foreign or hostile file may contain any value here
        _log.info("%s: the stored losses are invalid and are not shown: %s", log.path, fault)
        return None
    return None if found.source == "none" and not found.total else Losses(by_device, found.source)


def state_of(log: Log, ends: bool) -> State:
    """Return the state of a log's file; `ends` is the result of `has_end`."""
    library = log.metadata.get("recovered", {}).get("origin_library", log.library)
    if "run" not in log.metadata and library != LIBRARY:
        return "foreign"
    if len(log.missing) > len(log.lost_before):
        return "damaged" if ends else "unfinished"
    return "recovered" if "recovered" in log.metadata else "finished"


def _facts(log: Log, path: str, size_bytes: int, ends: bool) -> Entry:
    run = log.metadata.get("run", {})
    state = state_of(log, ends)
    started_ns = _started(run.get("started", ""), log.start_ns)
    losses = None if state == "foreign" else counted_losses(log)
    outcome = outcome_of(log.metadata.get("summary", {}))
    return Entry(
        path=path,
        size_bytes=size_bytes,
        state=state,
        complete=log.complete,
        why=_short(_why(log, state)),
        rig=_short(run.get("rig", "")),
        test=_short(run.get("test", "")),
        point=_short(run.get("point", "")),
        note=_short(run.get("note", "")),
        software=_short(run.get("software", "")),
        parameters=_short(run.get("parameters", "")),
        started="" if started_ns is None else _iso(started_ns),
        started_ns=started_ns,
        duration_s=(log.end_ns - log.start_ns) * 1e-9,
        origin=_short(origin_of(log)),
        messages=sum(log.count(topic) for topic in log.topics),
        lost=None if losses is None else losses.total,
        losses={} if losses is None else {device: dict(kinds) for device, kinds in losses.by_device.items()},
        losses_from="" if losses is None else losses.source,
        outcome=outcome,
    )


def _why(log: Log, state: State) -> str:
    if state == "foreign":
        return f"an MCAP file of {log.library or 'some other program'}, without the facts of a run"
    sentences = [one_line(missing, log.path) for missing in log.missing[:_MOST_SENTENCES]]
    more = len(log.missing) - len(sentences)
    return "; ".join([*sentences, *([f"and {more} more"] if more else [])])


def has_end(file: Path) -> bool:
    """Return True if a file ends as a finished one does; otherwise it was cut or is still being written."""
    with open(file, "rb") as opened:
        opened.seek(-len(MAGIC), 2)
        return opened.read() == MAGIC


def _started(text: str, start_ns: int) -> int | None:
    """Start of the recording from the run's metadata (a simulated rig's clock runs ahead), else from its messages."""
    try:
        started = datetime.fromisoformat(text)
        return int((started if started.tzinfo else started.replace(tzinfo=UTC)).timestamp()) * 10**9
    except (ValueError, OverflowError, OSError):  # usual: files of other programs lack this time
        return start_ns or None


def _iso(time_ns: int) -> str:
    try:
        return datetime.fromtimestamp(time_ns // 10**9, UTC).isoformat().replace("+00:00", "Z")
    except (ValueError, OverflowError, OSError):  # usual: a time outside the calendar, in a foreign file
        return f"{time_ns} ns since 1970"


def _value(text: str) -> Any:
    """Decode a number, a truth value or a text; any other value stays JSON text."""
    try:
        value = json.loads(text, parse_constant=lambda _: None)
    except (ValueError, RecursionError):  # usual: plain text
        return _short(text)
    if isinstance(value, str):
        return _short(value)
    return value if value is None or isinstance(value, bool | int | float) else _short(text)


def _short(text: str) -> str:
    """Return text of any origin, shortened and encodable as UTF-8."""
    return text[:_MOST_CHARACTERS].encode("utf-8", "replace").decode()
