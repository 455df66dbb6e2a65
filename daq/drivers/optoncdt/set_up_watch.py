"""Signs in a sensor's stream that the sensor is no longer set up as its driver has set it up.

A sensor whose power was cut starts again with the settings that are stored in it: it may send other words or at another
rate, with averaging or with a shifted zero, and another sensor on the same cable has another range. Such a stream can
look healthy. Therefore a restart of counter and timestamp, and bytes without a sample, are signs of a lost set-up.
"""

from __future__ import annotations

from collections.abc import Sequence

from daq.items import Batch, DeviceEvent

_START = b"OUTPUT RS422"
_MAX_BARREN_NS = 2_000_000_000  # bytes without a sample: as long as the session waits for a silent device
_MAX_PAUSE_NS = 500_000_000  # longest silence in a stream; answers of a sensor that does not stream are farther apart


class SetUpWatch:
    """Watches what is sent to and received from one sensor.

    Attributes:
        lost: the sign of a lost set-up, a clause; empty without one. The command that starts the stream resets it.
    """

    def __init__(self) -> None:
        self.lost: str = ""
        self._is_starting = False  # the set-up itself may restart counter and timestamp
        self._barren_ns: tuple[int, int] | None = None  # first and newest read of a stream without samples

    def sent(self, data: bytes) -> None:
        """Take bytes sent to the sensor."""
        if _START in data:
            self.lost, self._is_starting, self._barren_ns = "", True, None

    def received(self, data: bytes, items: Sequence[Batch | DeviceEvent], host_ns: int) -> None:
        """Take bytes of the sensor and the items that they gave.

        Args:
            host_ns: host time of the read, ns since 1970.
        """
        has_samples = False
        for item in items:
            if isinstance(item, Batch):
                has_samples, self._is_starting = True, False
            elif item.kind == "restart" and not self._is_starting:
                self.lost = "its counter and timestamp started again, so it may have lost power and its settings"
        if has_samples:
            self._barren_ns = None
        elif data:
            first_ns, newest_ns = self._barren_ns or (host_ns, host_ns)
            if host_ns - newest_ns > _MAX_PAUSE_NS:
                first_ns = host_ns
            self._barren_ns = first_ns, host_ns
            if host_ns - first_ns > _MAX_BARREN_NS and not self.lost:
                self.lost = "it sends bytes that give no samples, so it may have other settings"
