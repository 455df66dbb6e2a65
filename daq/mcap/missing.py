"""A damaged or missing place of a log."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from rig_basics.texts import number_of


@dataclass(frozen=True)
class Missing:
    """One damaged or missing part of a log; unknown facts are None or empty.

    Attributes:
        text: description of the damage.
        byte_start, byte_end: position in the file, bytes; the end is exclusive.
        start_ns, end_ns: log times between which messages are missing, ns since 1970.
        topics: channels with missing messages, sorted.
        messages: number of missing messages; 0 if the damage costs none.
    """

    text: str
    byte_start: int | None = None
    byte_end: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    topics: tuple[str, ...] = ()
    messages: int | None = None

    def __str__(self) -> str:
        """Return the complete sentence."""
        place = "" if self.byte_start is None else f"from byte {self.byte_start} on: "
        if self.byte_start is not None and self.byte_end is not None:
            place = f"bytes {self.byte_start} … {self.byte_end}: "
        parts: list[str] = []
        if self.messages is not None:
            parts.append("no message is lost" if self.messages == 0 else number_of(self.messages, "message"))
        if self.topics:
            parts.append(f"of {', '.join(self.topics)}")
        if self.start_ns is not None:
            parts.append(f"{'from' if self.end_ns is not None else 'after'} {_utc(self.start_ns)}")
        if self.end_ns is not None:
            parts.append(f"{'to' if self.start_ns is not None else 'before'} {_utc(self.end_ns)}")
        return place + self.text + (f" ({' '.join(parts)})" if parts else "")


def _utc(time_ns: int) -> str:
    """Return the time of day as text; the number of ns if it is outside the calendar's range."""
    try:
        return f"{datetime.fromtimestamp(time_ns // 10**6 / 1000, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3] + " UTC"
    except (OverflowError, ValueError, OSError):  # usual: a time outside the calendar, in a damaged file
        return f"{time_ns} ns"
