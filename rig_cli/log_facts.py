"""Contents of one log as `rig log --json` prints them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from daq.catalogue.facts import counted_losses, has_end, one_line, origin_of, outcome_of, state_of
from daq.channels import EVENTS_TOPIC, HEALTH_TOPIC, RAW_PREFIX
from daq.errors import LogError
from daq.log import Log
from daq.log.content import EventContent, channel_content, event_content, events_of, last_health, raw_content
from daq.log.snapshot import identities_of, rig_of, snapshot_of
from daq.log.verdicts import digest_of, verdict_of
from daq.mcap.missing import Missing

_log = logging.getLogger(__name__)
_PHYSICAL = ("rotor", "imbalance", "pendulums", "suspension")


def log_facts(log: Log, path: Path, verified: Sequence[Missing] | None, *, all_events: bool = False) -> dict[str, Any]:
    """Return the contents of a log. Parts that cannot be read are listed under "unreadable".

    Args:
        log: open.
        path: its file.
        verified: result of `Log.verify`; None if the log was not verified.
        all_events: include every event in addition to the groups of similar ones.
    """
    unreadable: list[str] = []

    def readable(read: Callable[[], Any], otherwise: Any) -> Any:
        try:
            return read()
        except (LogError, RecursionError) as fault:  # JSON of any nesting depth can be in a file
            unreadable.append(one_line(fault, path))
            return otherwise

    run, summary = log.metadata.get("run", {}), log.metadata.get("summary", {})
    happened: EventContent = readable(lambda: event_content(events_of(log), log.start_ns), EventContent())
    raw = readable(lambda: raw_content(log, thorough=verified is not None), {})
    health = readable(lambda: last_health(log), None)
    snapshot: dict[str, Any] = readable(lambda: snapshot_of(log), {}) if "rig.json" in log.attachments else {}
    channels = {topic: readable(lambda t=topic: asdict(channel_content(log, t)), None) for topic in log}
    facts: dict[str, Any] = {
        **_file_facts(log, path, verified),
        "run": run,
        "summary": summary,
        "outcome": outcome_of(summary),
        "origin": origin_of(log),
        "recovered": log.metadata.get("recovered"),
        "verdict": readable(lambda: _verdict(path), None),
        "losses": _losses(log, happened),
        "messages": {topic: log.count(topic) for topic in log.topics},
        "channels": channels,
        "foreign_topics": {topic: log.count(topic) for topic in log.topics if _is_foreign(topic, channels)},
        "raw": {device: asdict(content) for device, content in raw.items()},
        "health": None if health is None else {**health, "time_s": (health["time_ns"] - log.start_ns) * 1e-9},
        "events": dict(sorted(happened.kinds.items())),
        "events_alike": [vars(line) for line in happened.lines],
        "events_alike_left_out": happened.more,
        "trips": happened.trips,
        "devices": readable(lambda: identities_of(log), {}),
        "rig": {"name": snapshot.get("name", run.get("rig", "")), **_physical(snapshot)},
        "sensors": _sensors(log),
        "attachments_bytes": {name: len(data) for name, data in log.attachments.items()},
    }
    if all_events:
        facts["all_events"] = readable(lambda: list(events_of(log)), [])
    return {**facts, "unreadable": unreadable}


def _is_foreign(topic: str, channels: Collection[str]) -> bool:
    """Return True for a topic that this software does not write."""
    return topic not in (*channels, EVENTS_TOPIC, HEALTH_TOPIC) and not topic.startswith(RAW_PREFIX)


def _file_facts(log: Log, path: Path, verified: Sequence[Missing] | None) -> dict[str, Any]:
    """Return state, completeness, size and time span of a log's file."""
    return {
        "log": str(path),
        "state": state_of(log, has_end(path)),
        "complete": log.complete,
        "verified": verified is not None,
        "missing": [str(missing) for missing in log.missing],
        "lost_before": [str(missing) for missing in log.lost_before],
        "unchecked": [str(place) for place in verified or () if place not in log.missing],
        "size_bytes": log.size_bytes,
        "chunks": log.chunk_count,
        "library": log.library,
        "start_ns": log.start_ns,
        "end_ns": log.end_ns,
        "duration_s": (log.end_ns - log.start_ns) * 1e-9,
    }


def _sensors(log: Log) -> dict[str, str]:
    """Return what each displacement sensor measured, in words, by device; empty if the rig file does not state it."""
    try:
        return rig_of(log).roles.duties
    except (LogError, RecursionError) as error:
        _log.info("%s: the sensors' roles are not available: %s", log.path, error)
        return {}


def _physical(snapshot: Mapping[str, Any]) -> dict[str, Any]:
    return {"physical": {name: snapshot[name] for name in _PHYSICAL if name in snapshot}}


def _losses(log: Log, happened: EventContent) -> dict[str, Any] | None:
    found = counted_losses(log)
    if found is None:
        return None
    events = {
        device: {kind: {"events": count, "span_s": span} for kind, (count, span) in kinds.items()}
        for device, kinds in happened.lost.items()
    }
    return {"total": found.total, "by_device": found.by_device, "source": found.source, "events": events}


def _verdict(path: Path) -> dict[str, Any] | None:
    kept = verdict_of(path)
    if kept is None:
        return None
    return {**kept.model_dump(), "stale": not kept.is_of(digest_of(path))}
