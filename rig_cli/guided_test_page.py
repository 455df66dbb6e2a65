"""Terminal page of a running guided test: readings, shares of their limits, losses, state of the test.

On a terminal the page is updated in place; otherwise a line is printed at each change of state and every few seconds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.console import Group
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from daq.acquisition.session import Session
from daq.guided_tests.controls import Controls
from daq.log.losses import Losses
from rig_cli.console import LiveTable, harmless, notify
from rig_cli.keyboard import KEYS, Keys

_LINE_EVERY_S, _STATE_EVERY_S = 5.0, 1.0  # s between two lines; shorter states get no line
_SPAN_S = 1.0  # of the extremes, s
_NEAR = 0.8  # share of a limit above which it is shown in red


@dataclass(frozen=True)
class Reading:
    """Present value of one quantity.

    Attributes:
        name, unit: name and unit of the quantity.
        value: newest value; NaN without one.
        span: peak to peak over the last second; NaN if it has no meaning.
        used: share of its limit, 0 …; NaN without a limit.
    """

    name: str
    unit: str
    value: float
    span: float = math.nan
    used: float = math.nan

    def words(self) -> str:
        """Return the reading as part of a line."""
        used = "" if math.isnan(self.used) else f" ({100 * self.used:.0f} % of its limit)"
        return f"{self.name} {_figure(self.value, self.unit)}{used}"


def readings(session: Session) -> list[Reading]:
    """Return the present readings of the sensors that the rig has."""
    roles, limits = session.rig.roles, session.rig.limits
    found: list[Reading] = []
    for sensor in roles.displacements:
        values = _newest(session, sensor.topic, "displacement_m")
        largest = float(np.max(np.abs(values))) if len(values) else math.nan
        span = float(np.ptp(values)) if len(values) else math.nan
        found.append(Reading(sensor.axis, "mm", 1e3 * _last(values), 1e3 * span, largest / limits.amplitude_m))
    if roles.angles is not None:
        for name, field in (("θ3", "theta3_rad"), ("θ4", "theta4_rad")):
            values = _newest(session, roles.angles.topic, field)
            span = math.degrees(float(np.ptp(values))) if len(values) else math.nan
            found.append(Reading(name, "°", math.degrees(_last(values)) % 360, span))
    if roles.speed is not None or roles.phase is not None:
        rpm = session.rotor.rpm()
        found.append(Reading("speed", "rpm", rpm, used=abs(rpm) / limits.speed_rpm))
    return found


class TestPage(LiveTable):
    """Page of the tests of one session.

    Args:
        session: open.
        controls: of its tests.
        keys: the terminal's; None without a keyboard.
        more: returns a further line; empty for none.
    """

    __test__ = False  # not a pytest class

    def __init__(self, session: Session, controls: Controls, keys: Keys | None, more: Callable[[], str]) -> None:
        self._session, self._controls, self._keys, self._more = session, controls, keys, more
        self._started = time.monotonic()
        self._line_s, self._line_state = -math.inf, ("", "")
        super().__init__(self._page)

    def update(self, text: str, share: float | None) -> None:
        """Print a line if one is due; a terminal updates itself."""
        if self._live is not None:
            return
        now, at = time.monotonic() - self._started, (self._controls.status.test, self._controls.status.state)
        if now - self._line_s < (_LINE_EVERY_S if at == self._line_state else _STATE_EVERY_S):
            return
        changed, self._line_state, self._line_s = at != self._line_state, at, now
        words = text if changed else "; ".join([text, *(reading.words() for reading in readings(self._session))])
        parts = [words, *([more] if (more := self._more()) else []), *([] if changed else [self._losses()])]
        notify(f"[{now:6.1f} s] {'; '.join(parts)}")

    def _losses(self) -> str:
        return Losses(self._session.recording.losses(), "health").words()

    def _page(self) -> Group:
        status = self._controls.status
        table = Table(box=None, pad_edge=False)
        for title in ("", "now", "peak to peak", "of its limit"):
            table.add_column(title, justify="right" if title else "left")
        for reading in readings(self._session):
            used = "" if math.isnan(reading.used) else f"{100 * reading.used:.0f} %"
            style = "bold red" if reading.used > _NEAR else ""
            span = "" if math.isnan(reading.span) else _figure(reading.span, reading.unit)
            table.add_row(reading.name, _figure(reading.value, reading.unit), span, Text(used, style=style))
        losses, at = self._losses(), f"{status.test}: {status.state}" if status.test else "opening the rig"
        head = Text(
            f"[{time.monotonic() - self._started:6.1f} s] {at}", style="bold yellow" if status.paused else "bold"
        )
        lines = [head, Text(harmless(status.words))]
        if (more := self._more()) or status.answer:
            lines.append(Text(harmless("   ".join(part for part in (more, status.answer) if part)), style="cyan"))
        lines.append(Text(losses, style="" if losses == "nothing lost" else "yellow"))
        if self._keys is not None:
            typed = self._keys.typed
            lines.append(Text(KEYS if typed is None else f"note (Enter writes it, Esc drops it): {typed}", style="dim"))
        bar = [] if status.share is None else [ProgressBar(total=1.0, completed=status.share, width=40), Text()]
        return Group(table, *lines[:2], *bar, *lines[2:])


def _newest(session: Session, topic: str, field: str) -> NDArray[np.float64]:
    """Return the valid values of the last second."""
    _, (values,) = session.channels.newest(topic, (field,), _SPAN_S)
    known: NDArray[np.float64] = np.asarray(values, np.float64)
    return known[np.isfinite(known)]


def _last(values: NDArray[np.float64]) -> float:
    return float(values[-1]) if len(values) else math.nan


def _figure(value: float, unit: str) -> str:
    digits = 0 if unit == "rpm" else 2 if unit == "°" else 3
    return "—" if math.isnan(value) else f"{value:.{digits}f} {unit}"
