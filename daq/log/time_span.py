"""Part of a recording: a beginning and an end in seconds since its start, as exports, imports and fits take it."""

from __future__ import annotations

from dataclasses import dataclass

from daq.errors import LogError

LATEST_NS = 2**62
"""Latest time of a log, ns since 1970: in 2116. The sum of two such times is a number of 64 bits."""


@dataclass(frozen=True)
class TimeSpan:
    """A span of time: samples with begin ≤ t < end belong to it.

    Attributes:
        from_s, to_s: begin and end, s since the start; None is open.
    Raises:
        LogError: a time is not finite or beyond 146 years, or the end is not after the beginning.
    """

    from_s: float | None = None
    to_s: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("begin", self.from_s), ("end", self.to_s)):
            if value is not None and not abs(value) * 1e9 < LATEST_NS:
                raise LogError(f"{name} of the span, {value}: expected seconds since the log's start, below 146 years")
        if self.from_s is not None and self.to_s is not None and self.from_s >= self.to_s:
            raise LogError(f"expected the beginning before the end, got {self.from_s:g} s and {self.to_s:g} s")

    @property
    def is_whole(self) -> bool:
        """Whether the span contains all samples."""
        return self.from_s is None and self.to_s is None

    def ns(self, start_ns: int) -> tuple[int, int]:
        """Return both ends in ns since 1970; an open end is before or after all times."""
        begin = -LATEST_NS if self.from_s is None else start_ns + round(self.from_s * 1e9)
        return begin, 2 * LATEST_NS - 1 if self.to_s is None else start_ns + round(self.to_s * 1e9)

    def __str__(self) -> str:
        """Return for example "2 s to 5 s"."""
        begin = "the start" if self.from_s is None else f"{self.from_s:g} s"
        return f"{begin} to {'the end' if self.to_s is None else f'{self.to_s:g} s'}"
