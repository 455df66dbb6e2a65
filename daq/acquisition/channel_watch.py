# pyright: strict
"""Which channels are silent, and for how long: judged channel by channel, counted while it lasts.

A device may go on sending bytes (a dongle reports its own health each second) while the channel it carries has died;
so a channel is heard when samples of it come, and not otherwise. A silence is measured against the other channels: a
host that was asleep heard none of them, and when it wakes up all are there at once. No clock and no I/O here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from daq.drivers.items import Event

HOST = "host"
"""The device of an event the host itself makes: no bytes of a device hold it, so a replay does not look for it."""


_NEVER_S = 9e8


@dataclass
class _Channel:
    device: str
    deadline_ns: int
    heard_ns: int | None = None  # newest samples
    suspect_ns: int | None = None  # first look that found it late
    since_ns: int | None = None  # its silence in this log began here
    counted_ns: int = 0  # silences of this log that are over


class ChannelWatch:
    """Deadlines of the channels.

    Args:
        deadlines_s: by topic: device and rig seconds without a sample after which the channel counts as silent;
            infinite where only `miss` can tell.
        patience: rig seconds of a time-out given in wall seconds (`HostClock.patience`).
    """

    def __init__(self, deadlines_s: Mapping[str, tuple[str, float]], patience: Callable[[float], float]) -> None:
        self._channels = {topic: _Channel(device, _ns(min(s, _NEVER_S))) for topic, (device, s) in deadlines_s.items()}
        self._all_ns = _ns(patience(1.5))  # all silent at once: the host may be asleep, so longer
        self._again_ns = _ns(patience(0.05))  # a second look must find the same
        self._begun_ns = 0
        self._newest_ns = 0

    def begin(self, now_ns: int, expected: bool) -> None:
        """A log begins: counts start at zero, a silence that lasts is one of the new log too.

        Args:
            expected: every channel is due from now on; else each from its first sample.
        """
        self._begun_ns = now_ns
        for channel in self._channels.values():
            channel.counted_ns, channel.since_ns = 0, None
            if expected and channel.heard_ns is None:
                channel.heard_ns = now_ns
        self._newest_ns = max(self._newest_ns, now_ns if expected else 0)

    def heard(self, topic: str, host_ns: int) -> Event | None:
        """Samples of a channel came; returns the end of its silence where there was one."""
        channel = self._channels.get(topic)
        if channel is None:
            return None
        self._newest_ns = max(self._newest_ns, host_ns)
        channel.heard_ns, channel.suspect_ns = host_ns, None
        return self._over(topic, channel, host_ns, "came back after")

    def tick(self, now_ns: int) -> list[Event]:
        """Look at the deadlines; returns the silences that were found to have begun."""
        out: list[Event] = []
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

    def miss(self, topic: str, since_ns: int, why: str) -> list[Event]:
        """A channel is silent since an instant; returns the beginning of its silence unless that is known."""
        channel = self._channels[topic]
        if channel.since_ns is not None:
            return []
        channel.since_ns = max(since_ns, self._begun_ns)
        facts = {"of": channel.device, "channel": topic, "since_ns": channel.since_ns}
        return [Event("silence", HOST, f"{topic}: silent, {why}", facts)]

    def excuse(self, topic: str, now_ns: int) -> list[Event]:
        """A channel is not due any more; returns the end of its silence where there was one."""
        event = self._over(topic, self._channels[topic], now_ns, "not due any more, after")
        return [] if event is None else [event]

    def end(self, now_ns: int) -> list[Event]:
        """The log ends: silences that last end with it."""
        ended = [self._over(t, c, now_ns, "still silent as the log ends, after") for t, c in self._channels.items()]
        return [event for event in ended if event is not None]

    def silent(self, topic: str) -> bool:
        """Whether a channel is found silent now."""
        return self._channels[topic].since_ns is not None

    def silent_s(self, topic: str, now_ns: int) -> float:
        """How long a channel has not been heard, as far as others were, s; 0 for one that is not due yet."""
        return self._late_ns(self._channels[topic], now_ns) * 1e-9

    def losses(self, now_ns: int) -> dict[str, dict[str, int]]:
        """Silence of this log so far by device, ms; devices and channels without any are left out."""
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

    def _over(self, topic: str, channel: _Channel, now_ns: int, how: str) -> Event | None:
        if channel.since_ns is None:
            return None
        lasted_ns = max(0, now_ns - channel.since_ns)
        channel.counted_ns += lasted_ns
        channel.since_ns = None
        kind = f"{topic.replace('/', '_')}_silent_ms"
        facts = {"of": channel.device, "channel": topic, kind: lasted_ns // 1_000_000, "span_s": lasted_ns * 1e-9}
        return Event("silence", HOST, f"{topic}: {how} {lasted_ns * 1e-9:.1f} s without a sample", facts)


def _ns(seconds: float) -> int:
    return int(seconds * 1e9)
