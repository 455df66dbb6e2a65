"""Terminal page of a recording: every channel's rate and size, the losses, the disk."""

from __future__ import annotations

import math
import time

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from daq.acquisition.recorder import DiskState
from daq.acquisition.session import Session
from daq.log.losses import Losses
from rig_cli.console import LiveTable, notify

_EVERY_S, _LINE_EVERY_S = 0.25, 10.0
_ROWS = (
    ("laser/x", "displacement_m", 1e3, "mm"),
    ("laser/y", "displacement_m", 1e3, "mm"),
    ("pendulums", "theta3_rad", 180 / math.pi, "°"),
    ("pendulums", "theta4_rad", 180 / math.pi, "°"),
    ("motor", "speed_rpm", 1.0, "rpm"),
)


class RecordingStatus(LiveTable):
    """A table of a recording on a terminal; otherwise a line every ten seconds."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self._session = session
        self._started = self._shown = time.monotonic()

    def show(self) -> None:
        """Update the display if an update is due."""
        now = time.monotonic()
        if now - self._shown < (_EVERY_S if self._live is not None else _LINE_EVERY_S):
            return
        self._shown = now
        if self._live is not None:
            self._live.update(self._table(), refresh=True)
        else:
            parts = (self._losses(), self._session.channels.rates.now(), _disk(self._session.recording.disk()))
            notify(f"{self._elapsed()}  {'; '.join(part for part in parts if part)}")

    def _elapsed(self) -> str:
        return f"[{time.monotonic() - self._started:7.1f} s]"

    def _losses(self) -> str:
        return Losses(self._session.recording.losses(), "health").words()

    def _table(self) -> Group:
        table = Table(box=None, pad_edge=False)
        for title in ("channel", "rate", "now", "peak to peak"):
            table.add_column(title, justify="left" if title == "channel" else "right")
        since = self._session.clock.now_ns() - 1_000_000_000
        for topic, field, scale, unit in _ROWS:
            times, (values,) = self._session.channels.recent.last(topic, (field,), since)
            table.add_row(f"{topic} {field}", *_figures(times, values * scale, unit))
        losses, rates, disk = self._losses(), self._session.channels.rates.now(), self._session.recording.disk()
        return Group(
            table,
            Text(f"{self._elapsed()} recording; Ctrl-C ends it"),
            Text(losses, style="" if losses == "nothing lost" else "yellow"),
            *([Text(rates, style="bold red")] if rates else []),
            Text(_disk(disk), style="bold red" if disk is not None and disk.slow else ""),
        )


def _figures(times: np.ndarray, values: np.ndarray, unit: str) -> tuple[str, str, str]:
    """Return rate, newest value and peak to peak of the last second."""
    known = values[np.isfinite(values)]
    if len(times) < 2 or not len(known):
        return "silent" if len(times) < 2 else f"{len(times)} Hz", "—", "—"
    rate = (len(times) - 1) / max(1e-9, (times[-1] - times[0]) * 1e-9)
    return f"{rate:.0f} Hz", f"{known[-1]:.3f} {unit}", f"{np.ptp(known):.3f} {unit}"


def _disk(state: DiskState | None) -> str:
    if state is None:
        return "not recording"
    room = "" if not math.isfinite(state.seconds_left) else f", room for {_span(state.seconds_left)}"
    slow = f"; SLOW: {state.backlog_bytes / 1e6:.1f} MB wait, {state.unsynced_s:.1f} s behind" if state.slow else ""
    return f"{state.written_bytes / 1e6:.1f} MB written{room}{slow}"


def _span(seconds: float) -> str:
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {name}"
    return f"{seconds:.0f} s"
