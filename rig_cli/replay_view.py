"""Display of a log that is replayed at its pace: a table on a terminal, otherwise lines."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from rich.table import Table

from daq.items import Batch, DeviceEvent
from daq.log import Log
from daq.log.losses import Losses
from daq.replay.pace import Paced
from rig_basics.texts import number_of
from rig_cli.console import LiveTable, notify

_REFRESH_S = 0.125
_PLAIN_S = 5.0  # between two lines of output that is not a terminal

_LAST: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "laser/x": lambda last: f"{last['displacement_m'] * 1e3:8.4f} mm",
    "laser/y": lambda last: f"{last['displacement_m'] * 1e3:8.4f} mm",
    "pendulums": lambda last: (
        f"θ3 {math.degrees(last['theta3_rad']):8.2f}°  θ4 {math.degrees(last['theta4_rad']):8.2f}°"
    ),
    "tacho": lambda last: number_of(last["revolutions"], "revolution"),
    "motor": lambda last: f"{last['speed_rpm']:.0f} rpm, target {last['target_rpm']:.0f} rpm",
}


class ReplayView(LiveTable):
    """Counts the replayed samples and shows them eight times a second."""

    def __init__(self, log: Log, replayed: Paced) -> None:
        super().__init__()
        self._start_ns, self._span_s = log.start_ns, (log.end_ns - log.start_ns) * 1e-9
        self._replayed = replayed
        self._now_ns = log.start_ns
        self._samples = dict.fromkeys(_LAST, 0)
        self._last: dict[str, Mapping[str, Any]] = {}
        self._events: dict[str, int] = {}
        self._rates = dict.fromkeys(_LAST, 0.0)
        self._shown_s, self._shown_ns, self._shown_samples = -math.inf, self._now_ns, dict(self._samples)

    def add(self, host_ns: int, items: list[Batch | DeviceEvent]) -> None:
        """Add the result of one read."""
        self._now_ns = max(self._now_ns, host_ns)
        for item in items:
            if isinstance(item, Batch):
                self._samples[item.channel.topic] += len(item.time_ns)
                self._last[item.channel.topic] = {name: values[-1] for name, values in item.columns.items()}
            else:
                self._events[item.kind] = self._events.get(item.kind, 0) + 1
        if time.monotonic() - self._shown_s > (_REFRESH_S if self._live is not None else _PLAIN_S):
            self._show()

    def totals(self) -> dict[str, Any]:
        """Return the totals, with units in the names."""
        return {
            "span_s": self._at_s,
            "samples": dict(self._samples),
            "events": dict(self._events),
            "losses": self._losses(),
            "most_late_s": self._replayed.pace.most_late_s,
        }

    @property
    def _at_s(self) -> float:
        return (self._now_ns - self._start_ns) * 1e-9

    def _losses(self) -> dict[str, dict[str, int]]:
        return {device: dict(pipeline.losses) for device, pipeline in self._replayed.pipelines.items()}

    def _show(self) -> None:
        passed = (self._now_ns - self._shown_ns) * 1e-9
        if passed > 0:
            self._rates = {topic: (n - self._shown_samples[topic]) / passed for topic, n in self._samples.items()}
        self._shown_s, self._shown_ns, self._shown_samples = time.monotonic(), self._now_ns, dict(self._samples)
        lost = Losses(self._losses(), "events").words()
        late = self._replayed.pace.late_s
        state = f"{self._at_s:.1f} s of {self._span_s:.1f} s" + (f", {late:.2f} s late" if late > 0.1 else "")
        if self._live is None:
            last = "; ".join(f"{topic} {_LAST[topic](values).strip()}" for topic, values in self._last.items())
            notify(f"{state}: {last}; {lost}")
            return
        table = Table(title=state, caption=lost)
        for name in ("channel", "samples", "Hz in the log", "last"):
            table.add_column(name, justify="left" if name in ("channel", "last") else "right")
        for topic, count in self._samples.items():
            shown = _LAST[topic](self._last[topic]) if topic in self._last else ""
            table.add_row(topic, str(count), f"{self._rates[topic]:.0f}", shown)
        self._live.update(table, refresh=True)
