# pyright: strict
"""Which speeds the rotor was told in a log; the interlocks hold what it does against them.

A session tells its interlocks every speed before the drive is told. In the log the same speeds are the field
`target_rpm` of the speed source's channel, which its pipeline reads from the bytes that went to the device, or, for
one who only listened, from those on the bus. Three things are not in it, and are decided here:

- A log of a point or a run-down begins at a speed, and names it among its facts: that is the order that stands.
- Any other log that begins while the rotor turns, and the log behind a hole, do not hold the order that stands. Until
  the next one the drive's own word is taken for it: a runaway is not judged so long, everything else is. An order of 0
  looks like none before the first one of a log; a drive on its way to rest is always allowed.
- A log of someone who only listened to a line that carries no orders is one such log from its beginning to its end.
- A hand is told its speeds by word of mouth. It counts as told from the log's beginning where its test turns the
  rotor, and as told to stop where the test is a run-down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from daq.drivers.items import Batch
from daq.guided_tests.kinds import KINDS, kind_of
from rig_configs.roles import AT_REST_RPM

_FIELD = "target_rpm"


class Orders:
    """Follows the orders of a log.

    Args:
        tell: called with every speed, rpm, before the samples that follow it are judged (`Interlocks.told`).
        whole: nothing is missing before: a device that is sent bytes and stands has no order that is not seen.
        standing: what the rotor was told before the log began, rpm; None where that is not known.
        rest_rpm: the speed source's word on a standing rotor is up to this.

    Attributes:
        rpm: what the rotor was last told; None as long as nobody can tell.
    """

    def __init__(
        self,
        tell: Callable[[float], None],
        *,
        whole: bool,
        standing: float | None = None,
        rest_rpm: float = AT_REST_RPM,
    ) -> None:
        self._tell, self._whole, self._rest_rpm = tell, whole, rest_rpm
        self._sent = self._ordered = False
        self._stood = True
        self._first: float | None = None
        self.rpm: float | None = None
        if standing is not None:
            self._told(standing)

    def sent(self) -> None:
        """Bytes went to the speed source: its orders are in the log."""
        self._sent = True

    def follow(self, batch: Batch) -> None:
        """Tell what the speed source's samples show; call it before they are judged."""
        said: NDArray[np.float64] = batch.columns["speed_rpm"]
        targets: NDArray[np.float64] = batch.columns.get(_FIELD, np.full(len(said), np.nan))
        for target in _changes(targets):
            if self._first is None:
                self._first = target
            self._ordered = self._ordered or target != self._first
            if self._ordered:
                self._told(target)
        if self.rpm is not None:
            return
        self._stood = self._stood and bool(np.all(np.abs(said) <= self._rest_rpm))
        if self._whole and self._sent and self._stood and self._first is not None:
            self._told(self._first)
            return
        for rpm in (float(said.min()), float(said.max()), float(said[-1])):
            self._tell(rpm if abs(rpm) > self._rest_rpm else 0.0)

    def _told(self, rpm: float) -> None:
        if rpm != self.rpm:
            self.rpm = rpm
            self._tell(rpm)


def standing_order(run: Mapping[str, str]) -> float | None:
    """What the rotor was told before a log began, rpm: of a test that begins at a speed; None of any other.

    Args:
        run: the log's own facts.
    """
    test = run.get("test", "")
    fact = {"point": "speed_rpm", "run-down": "top_rpm"}.get("point" if kind_of(test) is KINDS["point"] else test, "")
    return _number(run.get(fact))


def tell_hand(tell: Callable[[float], None], run: Mapping[str, str], limit_rpm: float) -> None:
    """Tell what a hand was told in a log whose rotor no device turns.

    Args:
        tell: see Orders.
        run: the log's own facts: its test, and the speed of it where there is one.
        limit_rpm: stands for a speed that the log does not name; only whether it is one matters.
    """
    test = run.get("test", "")
    kind = kind_of(test)
    if kind is None or not kind.turns:
        return
    tell(_number(run.get("speed_rpm") or run.get("top_rpm")) or limit_rpm)
    if kind is KINDS["run-down"]:
        tell(0.0)


def _changes(values: NDArray[np.float64]) -> list[float]:
    """Each value that differs from the one before it; those that are none left out."""
    there = values[~np.isnan(values)]
    new = np.flatnonzero(np.diff(there, prepend=np.nan) != 0)
    return there[new].tolist()


def _number(text: str | None) -> float | None:
    try:
        found = abs(float(text or 0.0))
    except ValueError:
        return None
    return found if 0 < found < float("inf") else None
