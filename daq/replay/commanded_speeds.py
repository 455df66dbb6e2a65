"""Speeds that were commanded in a log; the interlocks compare the rotor's motion with them.

A session reports every speed to its interlocks before it sends it to the drive. In the log the same speeds are the
field `target_rpm` of the speed source's channel. Its pipeline decodes them from the bytes sent to the device, or from
those on the bus if the session only received. Four cases need additional rules:

- A log of a point or a run-down begins at a speed, and contains it among its facts. This is the valid command.
- Any other log that begins while the rotor turns, and the part of a log after a hole, do not contain the valid command.
  Until the next one the drive's reported speed is used instead. A runaway is not judged during this time, everything
  else is. A commanded 0 cannot be distinguished from a missing command before the first one of a log; a drive that
  slows down to rest is always allowed.
- A log of a session that only received on a line without commands is such a log from its beginning to its end.
- A rotor driven by hand follows spoken instructions. A speed counts as commanded from the log's beginning if the test
  turns the rotor, and a stop counts as commanded if the test is a run-down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from daq.guided_test_kinds import KINDS, kind_of
from daq.items import Batch
from rig_configs.roles import AT_REST_RPM

_FIELD = "target_rpm"


class LoggedSpeeds:
    """Follows the commands of a log.

    Args:
        notify: called with every speed, rpm, before the following samples are judged (`Interlocks.commanded`).
        whole: True if nothing is missing before: a device at rest that is sent bytes has no unseen command.
        standing: command that was valid before the log began, rpm; None if unknown.
        rest_rpm: largest reported speed of a rotor at rest, rpm.

    Attributes:
        rpm: last commanded speed, rpm; None while it is unknown.
    """

    def __init__(
        self,
        notify: Callable[[float], None],
        *,
        whole: bool,
        standing: float | None = None,
        rest_rpm: float = AT_REST_RPM,
    ) -> None:
        self._notify, self._whole, self._rest_rpm = notify, whole, rest_rpm
        self._sent = self._changed = False
        self._stood = True
        self._first: float | None = None
        self.rpm: float | None = None
        if standing is not None:
            self._report(standing)

    def sent(self) -> None:
        """Note that bytes were sent to the speed source, so its commands are in the log."""
        self._sent = True

    def follow(self, batch: Batch) -> None:
        """Report the commands in the speed source's samples; call it before the samples are judged."""
        speeds: NDArray[np.float64] = batch.columns["speed_rpm"]
        targets: NDArray[np.float64] = batch.columns.get(_FIELD, np.full(len(speeds), np.nan))
        for target in _changes(targets):
            if self._first is None:
                self._first = target
            self._changed = self._changed or target != self._first
            if self._changed:
                self._report(target)
        if self.rpm is not None:
            return
        self._stood = self._stood and bool(np.all(np.abs(speeds) <= self._rest_rpm))
        if self._whole and self._sent and self._stood and self._first is not None:
            self._report(self._first)
            return
        for rpm in (float(speeds.min()), float(speeds.max()), float(speeds[-1])):
            self._notify(rpm if abs(rpm) > self._rest_rpm else 0.0)

    def _report(self, rpm: float) -> None:
        if rpm != self.rpm:
            self.rpm = rpm
            self._notify(rpm)


def standing_speed(run: Mapping[str, str]) -> float | None:
    """Return the command that was valid before a log began, rpm: of a test that begins at a speed; None for any other.

    Args:
        run: facts of the log.
    """
    test = run.get("test", "")
    fact = {"point": "speed_rpm", "run-down": "top_rpm"}.get("point" if kind_of(test) is KINDS["point"] else test, "")
    return _number(run.get(fact))


def report_hand_speeds(notify: Callable[[float], None], run: Mapping[str, str], limit_rpm: float) -> None:
    """Report the commands in a log whose rotor is turned by hand.

    Args:
        notify: see LoggedSpeeds.
        run: facts of the log: its test, and the speed if it has one.
        limit_rpm: used for a speed that is not in the log; only its presence matters.
    """
    test = run.get("test", "")
    kind = kind_of(test)
    if kind is None or not kind.turns:
        return
    notify(_number(run.get("speed_rpm") or run.get("top_rpm")) or limit_rpm)
    if kind is KINDS["run-down"]:
        notify(0.0)


def _changes(values: NDArray[np.float64]) -> list[float]:
    """Return each value that differs from the one before it, without NaN."""
    present = values[~np.isnan(values)]
    new = np.flatnonzero(np.diff(present, prepend=np.nan) != 0)
    return present[new].tolist()


def _number(text: str | None) -> float | None:
    try:
        found = abs(float(text or 0.0))
    except ValueError:  # usual: a text without a number
        return None
    return found if 0 < found < float("inf") else None
