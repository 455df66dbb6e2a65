"""Pace of a LabJack's scans on the host's clock: whether they still come at the rate of the set-up."""

from __future__ import annotations

_WINDOW_NS = 1_000_000_000
_WINDOWS = 4  # in a row whose rate is wrong in the same sense; a network that becomes slower does it for a shorter time
_SHARE = 0.05  # least deviation of the rate in each of them


class PaceWatch:
    """Recognises a stream whose scans come at another rate, as one that another program has set up again.

    Args:
        rate_Hz: scans per second of the set-up.

    Attributes:
        wrong: what shows another rate, a clause for the operator; empty if the rate is that of the set-up.
    """

    def __init__(self, rate_Hz: float) -> None:
        self._rate_Hz = rate_Hz
        self.wrong: str = ""
        self.pause()

    def begin(self) -> None:
        """Begin with a new stream."""
        self.wrong = ""
        self.pause()

    def pause(self) -> None:
        """Note that the number of scans is unknown, or their age: the windows before do not count."""
        self._since: tuple[int, int] | None = None  # host time and number of the newest scan, of the present window
        self._off = 0  # windows in a row that deviate, negative if they are slow

    def add(self, number: int, host_ns: int) -> None:
        """Note an answer.

        Args:
            number: of the newest scan that the device has measured, those that wait included.
            host_ns: host time of the answer.
        """
        if self._since is None:
            self._since = host_ns, number
        span_s = (host_ns - self._since[0]) * 1e-9
        if span_s * 1e9 < _WINDOW_NS:
            return
        rate_Hz = (number - self._since[1]) / span_s
        deviation = rate_Hz / self._rate_Hz - 1.0
        sense = 0 if abs(deviation) < _SHARE else 1 if deviation > 0 else -1
        self._off = self._off + sense if self._off * sense > 0 else sense
        self._since = host_ns, number
        if abs(self._off) >= _WINDOWS:
            self.wrong = (
                f"its scans come at about {rate_Hz:.0f} Hz instead of {self._rate_Hz:.0f} Hz, so that their times are "
                "wrong: another program has set up its stream. End that program"
            )
