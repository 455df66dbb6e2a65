"""Search conditions for logs and the order of the results."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from typing import Any, Literal

from daq.catalogue.entry import Entry

Sort = Literal["started", "path", "rig", "test", "point", "duration", "size", "lost", "verdict"]

_AGO = re.compile(r"(\d+(?:\.\d+)?)\s*(min|h|d|w)")
_SECONDS = {"min": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}
_ORDERS: dict[str, tuple[Callable[[Entry], Any], bool]] = {  # key, largest first
    "started": (lambda entry: entry.started_ns or 0, True),
    "path": (lambda entry: entry.path, False),
    "rig": (lambda entry: entry.rig.casefold(), False),
    "test": (lambda entry: entry.test.casefold(), False),
    "point": (lambda entry: entry.point.casefold(), False),
    "duration": (lambda entry: entry.duration_s, True),
    "size": (lambda entry: entry.size_bytes, True),
    "lost": (lambda entry: entry.lost or 0, True),
    "verdict": (lambda entry: entry.verdict.casefold(), False),
}


@dataclass(frozen=True)
class Query:
    """Search conditions. An omitted condition admits every log. Texts match any part of the fact, ignoring case.

    Attributes:
        words: each must be part of the rig's name, test, point, note or path.
        rig, test, note, parameters: must be part of the fact of that name.
        point: must equal the point's name.
        verdict: must be part of the verdict; "none" for logs without a verdict.
        since_ns, until_ns: bounds of the recording's start, since ≤ t < until, ns since 1970.
        lost: True for logs with losses, False for logs without.
        complete: True for complete files, False for cut, damaged and unreadable ones.
        sort: sort key; times, sizes and counts largest first, names from A to Z.
        reverse: reverse the order.
    """

    words: tuple[str, ...] = ()
    rig: str = ""
    test: str = ""
    point: str = ""
    note: str = ""
    parameters: str = ""
    verdict: str = ""
    since_ns: int | None = None
    until_ns: int | None = None
    lost: bool | None = None
    complete: bool | None = None
    sort: Sort = "started"
    reverse: bool = False

    def admits(self, entry: Entry) -> bool:
        """Return True if an entry meets all conditions."""
        everywhere = " ".join((entry.rig, entry.test, entry.point, entry.note, entry.path)).casefold()
        return (
            all(word.casefold() in everywhere for word in self.words)
            and all(
                wanted.casefold() in fact.casefold()
                for wanted, fact in (
                    (self.rig, entry.rig),
                    (self.test, entry.test),
                    (self.note, entry.note),
                    (self.parameters, entry.parameters),
                    (self.verdict, entry.verdict or "none"),
                )
            )
            and self.point.casefold() in ("", entry.point.casefold())
            and self._admits_start(entry.started_ns)
            and self.lost in (None, bool(entry.lost))
            and self.complete in (None, entry.complete)
        )

    def _admits_start(self, started_ns: int | None) -> bool:
        if self.since_ns is None and self.until_ns is None:
            return True
        return started_ns is not None and (self.since_ns or 0) <= started_ns < (self.until_ns or 2**63)

    def sorted(self, entries: Iterable[Entry]) -> list[Entry]:
        """Return the entries in the requested order; equal entries are sorted by path."""
        key, largest_first = _ORDERS[self.sort]
        by_path = sorted(entries, key=lambda entry: entry.path)
        return sorted(by_path, key=key, reverse=largest_first is not self.reverse)


def _since_1970_ns(instant: datetime) -> int:
    """Convert to ns since 1970. An instant without a zone is local time, or UTC in years without local time."""
    try:
        seconds = instant.timestamp()
    except (ValueError, OverflowError, OSError):  # usual: a year without local time
        seconds = instant.replace(tzinfo=UTC).timestamp()
    return round(seconds * 1e6) * 1000


def parse_instant(text: str, now: datetime, end: bool = False) -> int:
    """Convert an instant as people write it to ns since 1970.

    Args:
        text: "2026-03-01", "2026-03-01T10:00", with a zone if it is not the local one; "today", "yesterday"; or a
            time before now: "30min", "12h", "3d", "2w".
        now: present time, local.
        end: True if a day means its end, False if it means its beginning.

    Raises:
        ValueError: the text has none of these forms.
    """
    word = text.strip().casefold()
    try:
        if found := _AGO.fullmatch(word):
            instant = now.astimezone() - timedelta(seconds=float(found[1]) * _SECONDS[found[2]])
        else:
            day = {"today": now.date(), "yesterday": now.date() - timedelta(days=1)}.get(word)
            whole_day = day is not None or re.fullmatch(r"\d{4}-?\d{2}-?\d{2}", word) is not None
            instant = datetime.combine(day, time()) if day is not None else datetime.fromisoformat(word.upper())
            if whole_day and end:
                instant = instant + timedelta(days=1) if instant.date() < date.max else datetime.max
        return _since_1970_ns(instant)
    except (ValueError, OverflowError, OSError) as fault:
        raise ValueError(
            f"expected a date like 2026-03-01, an instant like 2026-03-01T10:00, today, yesterday, or how long ago "
            f"like 3d, 12h, 30min, 2w; got {text!r}"
        ) from fault
