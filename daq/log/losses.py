"""Losses of a log, by device: counted while recording, never estimated."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from daq.channels import EVENTS_TOPIC
from daq.errors import LogError
from daq.items import LOSS_KINDS, SILENT_MS, loss_words
from daq.log import Log

_SENSORS_OWN = ("invalid",)  # the reading arrived, but the sensor marked it as invalid
_LOG = "log"
_COUNTED = (
    *("samples", "bytes", "damaged", "radio_frames", "cable_frames", "frames", "lines", "suspect"),
    *("doubled_marks", "turns", "clock_steps"),
)
_CARRIERS = ("frames", "lines", "bytes", "damaged")  # endings of kinds: samples are transmitted in them


@dataclass(frozen=True)
class Losses:
    """Counted losses of one log.

    Attributes:
        by_device: counts by device and kind ("samples", "radio_frames", "damaged_frames", "invalid" …).
        source: where they were read: the summary of a finished log; in a cut log the last health report, which may be
            one second old, or the events; "none" if the log contains nothing that counts losses.
    """

    by_device: Mapping[str, Mapping[str, int]]
    source: Literal["summary", "health", "events", "none"]

    @property
    def total(self) -> int:
        """Sum of all counts, an indicator of the amount of loss.

        A lost frame with its samples counts as these samples. Readings that the sensor marked as invalid did arrive and
        are not included.
        """
        return sum(
            n
            for kinds in self.by_device.values()
            for kind, n in kinds.items()
            if kind not in _SENSORS_OWN and not (_carries_samples(kind) and kinds.get("samples"))
        )

    @property
    def flat(self) -> dict[str, int]:
        """Counts by "device.kind"."""
        return {f"{device}.{kind}": n for device, kinds in self.by_device.items() for kind, n in kinds.items()}

    def words(self) -> str:
        """Return the losses in one line, without zero counts."""
        found = [
            f"{device} {loss_words(n, kind)}{_carriers_words(kinds) if kind == 'samples' else ''}"
            for device, kinds in self.by_device.items()
            for kind, n in kinds.items()
            if n and not (_carries_samples(kind) and kinds.get("samples"))
        ]
        return ", ".join(found) or ("unknown: it counts none" if self.source == "none" else "nothing lost")


def _carries_samples(kind: str) -> bool:
    """Whether a count is of what samples are transmitted in; the samples of a lost frame are counted themselves."""
    return kind.endswith(_CARRIERS)


def _carriers_words(kinds: Mapping[str, int]) -> str:
    found = [loss_words(n, kind) for kind, n in kinds.items() if n and _carries_samples(kind)]
    return f" (with {', '.join(found)})" if found else ""


def losses_of(log: Log) -> Losses:
    """Return the losses of a log, finished or cut: those counted while recording, and as device "log" the messages that
    are missing in the file or were lost before its recovery.

    Raises:
        LogError: the counts in the log are invalid: it is damaged or was written by another program.
    """
    try:
        counted = _counted(log)
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError, RecursionError) as fault:
        raise LogError(
            f"{log.path}: expected losses as {{device: {{kind: count}}}}, got something else ({fault!r}). "
            "The log was written by another program"
        ) from fault
    messages = sum(place.messages or 0 for place in log.missing)
    if not messages:
        return counted
    of_log = {**counted.by_device.get(_LOG, {}), "missing_messages": messages}
    return Losses({**counted.by_device, _LOG: of_log}, counted.source)


def _counted(log: Log) -> Losses:
    """Return the losses counted while recording."""
    summary = log.metadata.get("summary", {})
    if "losses" in summary:
        return Losses(_counts(json.loads(summary["losses"])), "summary")
    reports = [note["losses"] for note in log.health if isinstance(note.get("losses"), dict)]
    if reports:
        return Losses(_counts(reports[-1]), "health")
    if EVENTS_TOPIC not in log.topics or not any(log.count(topic) for topic in log.topics):
        return Losses({}, "none")
    return Losses(_from_events(log.events), "events")


def _counts(found: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, int]]:
    return {device: {kind: int(n) for kind, n in kinds.items()} for device, kinds in found.items()}


def _from_events(events: list[dict[str, Any]]) -> dict[str, dict[str, int]]:
    counts: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for event in events:
        if event.get("kind") in (*LOSS_KINDS, "suspect"):
            for kind in _COUNTED:
                counts[str(event.get("device", ""))][kind] += int(event.get(kind, 0))
        elif event.get("kind") == "silence":  # the host's own event, of a device's channel
            for kind in (name for name in event if name.endswith(SILENT_MS)):
                counts[str(event.get("of", ""))][kind] += int(event[kind])
    return {device: {kind: n for kind, n in kinds.items() if n} for device, kinds in counts.items()}
