"""Watch of a message that has stopped while the bus carries others."""

from __future__ import annotations

from daq.items import DeviceEvent


class SilenceWatch:
    """Reports once that a message has not been received for too long, and that it is received again.

    Args:
        name: name of the message, for the text.
        timeout_s: longest time between two messages, s; 0: any.
        kind: kind of the event.
    """

    def __init__(self, device: str, name: str, timeout_s: float, kind: str = "fault") -> None:
        self._device, self._name, self._timeout_ns, self._kind = device, name, round(timeout_s * 1e9), kind
        self._heard_ns: int | None = None
        self._silent = self._waited = False

    def heard(self, host_ns: int) -> list[DeviceEvent]:
        """Take the time of a message; return the event about a silence that no read has reported."""
        found = self.tick(host_ns)
        self._heard_ns, self._silent, self._waited = host_ns, False, False
        return found

    def bus_back(self, host_ns: int, since_ns: int) -> None:
        """Wait once more for the message after a time in which the bus carried no frame at all.

        Args:
            host_ns, since_ns: times of the newest frame of the bus and of the one before it.
        """
        if host_ns - since_ns > self._timeout_ns and not self._waited:
            self._heard_ns, self._waited = host_ns, True

    def tick(self, host_ns: int) -> list[DeviceEvent]:
        """Return the event if the silence has become too long."""
        self._heard_ns = host_ns if self._heard_ns is None else self._heard_ns
        if self._silent or not self._timeout_ns or host_ns - self._heard_ns <= self._timeout_ns:
            return []
        self._silent = True
        seconds = (host_ns - self._heard_ns) * 1e-9
        text = f"no frame of {self._name} for {seconds:.2f} s: look at the sensor, the bus and its bit rate"
        return [DeviceEvent(self._kind, self._device, text, {"silence_s": seconds})]
