"""Provenance of exported numbers: everything that a reader of the exported file alone needs."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from daq.log import Log
from daq.log.losses import losses_of
from daq.log.outcome import json_or_text
from daq.log.verdicts import digest_of
from daq.version import software_version


def iso_time(time_ns: int) -> str:
    """Format a time in ns since 1970 as ISO 8601 text in UTC, to the microsecond."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return datetime.fromtimestamp(seconds, UTC).replace(microsecond=nanoseconds // 1000).isoformat()


def log_facts(log: Log) -> dict[str, Any]:
    """Return the facts of a log as plain JSON. Missing parts are those found so far: read the samples first."""
    run = log.metadata.get("run", {})
    losses = losses_of(log)
    named = {key: run.get(key, "") for key in ("rig", "test", "point", "note", "started", "software")}
    return {
        **named,
        "run": dict(run),
        "summary": dict(log.metadata.get("summary", {})),
        "rig_snapshot": _json_attachment(log, "rig.json"),
        "identities": _json_attachment(log, "identities.json"),
        "losses": {device: dict(kinds) for device, kinds in losses.by_device.items()},
        "losses_found_in": losses.source,
        "complete": log.complete,
        "missing": [str(missing) for missing in log.missing],
    }


def source_facts(path: Path) -> dict[str, Any]:
    """Return the facts of the source file and of the exporting software."""
    return {
        "source": path.name,
        "source_sha256": digest_of(path).removeprefix("sha256:"),
        "source_bytes": path.stat().st_size,
        "exported_by": f"rig {software_version()}",
    }


def _json_attachment(log: Log, name: str) -> Any:
    """Return an attachment's content: decoded from JSON, or as text; None if the attachment is missing."""
    data = log.attachments.get(name)
    return None if data is None else json_or_text(data.decode("utf-8", "replace"))
