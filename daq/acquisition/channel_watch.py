"""Detection and duration of silent channels, for each channel separately.

A device may continue to send bytes (a dongle reports its own health every second) although its channel has failed.
Therefore only samples end a silence. A silence is measured relative to the other channels: if the host was suspended,
all channels were silent, and all of them return together. The module has no clock and no I/O.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from daq.items import DeviceEvent

HOST = "host"
"""Device name in events of the host. A replay does not expect these events, since no device's bytes contain them."""
HOST_S = 0.3
"""Largest delay that the threads of the host usually cause, s; the shortest watchdogs of drives are about as long."""


_MAX_DEADLINE_S = 9e8  # stands for infinity in integer ns


@dataclass
class _Channel:
    device: str
    deadline_ns: int
    heard_ns: int | None = None  # host time of the newest samples; None before the channel is due
    suspect_ns: int | None = None  # time of the first tick that found the channel late
    since_ns: int | None = None  # start of the present silence in this log
    counted_ns: int = 0  # duration of the silences of this log that have ended


class ChannelWatch:
    """Deadlines of the channels.

    Args:
        deadlines_s: device and maximum time without a sample, s, by topic. The time is infinite if only `miss`
            reports silences.
    """

    def __init__(self, deadlines_s: Mapping[str, tuple[str, float]]) -> None:
        self._channels = {
            topic: _Channel(device, _ns(min(s, _MAX_DEADLINE_S))) for topic, (device, s) in deadlines_s.items()
        }
        self._all_ns = _ns(1.5)  # additional time if all channels are silent: the host may be suspended
        self._again_ns = _ns(0.05)  # least time between two ticks that must find the same channel late
        self._begun_ns = 0
        self._newest_ns = 0

    def begin(self, now_ns: int, expected: bool) -> None:
        """Begin a log: reset the counts. A silence that has not ended is reported again in the new log.

        Args:
            now_ns: host time, ns since 1970.
            expected: whether every channel is due from now on; otherwise each is due from its first sample.
        """
        self._begun_ns = now_ns
        for channel in self._channels.values():
            channel.counted_ns, channel.since_ns = 0, None
            if expected and channel.heard_ns is None:
                channel.heard_ns = now_ns
        self._newest_ns = max(self._newest_ns, now_ns if expected else 0)

    def heard(self, topic: str, host_ns: int) -> DeviceEvent | None:
        """Register samples of a channel. Return the event that ends its silence, or None if it was not silent."""
        channel = self._channels.get(topic)
        if channel is None:
            return None
        self._newest_ns = max(self._newest_ns, host_ns)
        channel.heard_ns, channel.suspect_ns = host_ns, None
        return self._over(topic, channel, host_ns, "samples again after")

    def tick(self, now_ns: int) -> list[DeviceEvent]:
        """Check the deadlines. Return an event for each silence that has begun."""
        out: list[DeviceEvent] = []
        for topic, channel in self._channels.items():
            if channel.since_ns is not None or self._late_ns(channel, now_ns) <= channel.deadline_ns:
                continue
            if channel.suspect_ns is None:
                channel.suspect_ns = now_ns
            if now_ns - channel.suspect_ns < self._again_ns:
                continue
            assert channel.heard_ns is not None
            out += self.miss(topic, channel.heard_ns, f"no sample for {(now_ns - channel.heard_ns) * 1e-9:.1f} s")
        return out

    def miss(self, topic: str, since_ns: int, why: str) -> list[DeviceEvent]:
        """Register a silence since an instant. Return its event, or nothing if the channel is silent already."""
        channel = self._channels[topic]
        if channel.since_ns is not None:
            return []
        channel.since_ns = max(since_ns, self._begun_ns)
        facts = {"of": channel.device, "channel": topic, "since_ns": channel.since_ns}
        return [DeviceEvent("silence", HOST, f"{topic}: silent, {why}", facts)]

    def excuse(self, topic: str, now_ns: int) -> list[DeviceEvent]:
        """End the silence of a channel that is no longer due. Return its event, if there was a silence."""
        event = self._over(topic, self._channels[topic], now_ns, "no longer due, after")
        return [] if event is None else [event]

    def end(self, now_ns: int) -> list[DeviceEvent]:
        """End the silences with the log. Return their events."""
        ended = [self._over(t, c, now_ns, "still silent as the log ends, after") for t, c in self._channels.items()]
        return [event for event in ended if event is not None]

    def silent(self, topic: str) -> bool:
        """Return whether a channel is silent now."""
        return self._channels[topic].since_ns is not None

    def silent_s(self, topic: str, now_ns: int) -> float:
        """Return the time since the last sample of a channel, relative to the other channels, s; 0 if it is not due."""
        return self._late_ns(self._channels[topic], now_ns) * 1e-9

    def sampleless_s(self, topic: str, now_ns: int) -> float:
        """Return the time since the last sample of a channel, s; 0 if it is not due."""
        heard_ns = self._channels[topic].heard_ns
        return 0.0 if heard_ns is None else (now_ns - heard_ns) * 1e-9

    def losses(self, now_ns: int) -> dict[str, dict[str, int]]:
        """Return the silence in this log so far by device and channel, ms. Values of 0 are omitted."""
        out: dict[str, dict[str, int]] = {}
        for topic, channel in self._channels.items():
            lasting = 0 if channel.since_ns is None else max(0, now_ns - channel.since_ns)
            if counted := (channel.counted_ns + lasting) // 1_000_000:
                out.setdefault(channel.device, {})[f"{topic.replace('/', '_')}_silent_ms"] = counted
        return out

    def _late_ns(self, channel: _Channel, now_ns: int) -> int:
        if channel.heard_ns is None:
            return 0
        return max(self._newest_ns, now_ns - self._all_ns) - channel.heard_ns

    def _over(self, topic: str, channel: _Channel, now_ns: int, how: str) -> DeviceEvent | None:
        if channel.since_ns is None:
            return None
        lasted_ns = max(0, now_ns - channel.since_ns)
        channel.counted_ns += lasted_ns
        channel.since_ns = None
        kind = f"{topic.replace('/', '_')}_silent_ms"
        facts = {"of": channel.device, "channel": topic, kind: lasted_ns // 1_000_000, "span_s": lasted_ns * 1e-9}
        return DeviceEvent("silence", HOST, f"{topic}: {how} {lasted_ns * 1e-9:.1f} s without a sample", facts)


def _ns(seconds: float) -> int:
    return int(seconds * 1e9)
