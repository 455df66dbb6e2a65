"""Rate at which a sensor's results arrive: a sensor that lost power may measure with another period than it was set to.

Its packets have no time and are numbered modulo 4 only. Results at another rate are therefore taken for losses, or for
results that arrive early, and their times are wrong.
"""

from __future__ import annotations

from daq.drivers.riftek import wire

_WINDOW_NS = 3_000_000_000
_MAX_PAUSE_NS = 500_000_000  # between reads; after a longer pause the host reads what has accumulated
_MAX_DEVIATION = 0.25  # of the rate
_WINDOWS = 2  # in succession: a host that was suspended reads several reads' worth at once


class ResultRate:
    """Counts the results of one sensor by the host's time.

    Args:
        period_ns: sampling period to which the sensor was set, ns.

    Attributes:
        sign: what shows that the sensor is set otherwise, a clause; empty without such a sign. The request that starts
            the stream resets it.
    """

    def __init__(self, period_ns: int) -> None:
        self.sign: str = ""
        self._nominal_Hz = 1e9 / period_ns
        self._begun_ns: int | None = None
        self._newest_ns = 0
        self._results = 0
        self._wrong = 0  # windows in succession with a wrong rate: negative if it is too low

    def sent(self, data: bytes) -> None:
        """Take bytes sent to the sensor."""
        if len(data) >= 2 and data[1] == 0x80 | wire.START:
            self.sign, self._begun_ns, self._wrong = "", None, 0

    def received(self, results: int, host_ns: int, *, damaged: bool) -> None:
        """Take the results of one read.

        Args:
            results: their number.
            host_ns: host time of the read, ns since 1970.
            damaged: whether bytes were skipped; the number of results is then unknown.
        """
        pause, self._newest_ns = host_ns - self._newest_ns > _MAX_PAUSE_NS, host_ns
        if self._begun_ns is None or pause or damaged:
            self._begun_ns, self._results = host_ns, 0
            return
        self._results += results
        passed_ns = host_ns - self._begun_ns
        if passed_ns < _WINDOW_NS:
            return
        rate_Hz = self._results * 1e9 / passed_ns
        self._begun_ns, self._results = host_ns, 0
        ratio = rate_Hz / self._nominal_Hz
        if abs(ratio - 1.0) <= _MAX_DEVIATION:
            self._wrong = 0
            return
        direction = 1 if ratio > 1.0 else -1
        self._wrong = self._wrong + direction if self._wrong * direction > 0 else direction
        if abs(self._wrong) >= _WINDOWS and not self.sign:
            self.sign = (
                f"its results arrive {rate_Hz:.0f} times a second and it was set to {self._nominal_Hz:.0f}, so it may "
                "have lost power and its settings, and its times and losses since then are wrong"
            )
