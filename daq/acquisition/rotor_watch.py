"""Speed of the rotor from two sources: the actual speed reported by the drive, and the index marks.

A report of the drive that is too old is not used; then the index marks alone decide. Without information from either
source the state is "unknown", never "at rest". The module has no clock and no I/O; all times are arguments, rig ns.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import takewhile
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.channel_watch import HOST_S
from daq.signals.speed_agreement import SpeedAgreement, speed_agreement
from rig_configs.roles import AT_REST_RPM

_RPM_PER_TURN_NS = 60e9
_MIN_MARKLESS_S = (
    3.0  # time without an index mark after which the rotor is at rest, and at least three of its last turns
)
TURNS_UNSEEN = 2.5
"""Permitted turns of the drive without an index mark."""
RADIO_S = 1.0
"""Longest delay of index marks by the radio, s."""
RUNAWAY = (0.10, 20.0)
"""Permitted deviation from the commanded speed: share, and additional rpm."""
OVERSPEED = (0.05, 10.0)
"""Permitted excess over the speed limit: share, and additional rpm."""
DISAGREE = (0.06, 15.0)
"""Permitted difference between drive and index marks: share, and additional rpm.

The share lies between the slip of a belt or of a loaded induction motor, up to about 5 %, and the smallest error by a
wrong number of pole pairs, 15 instead of 14, 7 %. The lag of the drive's reports is covered by their range.
"""
ROWS_BEYOND = 3
"""Number of consecutive reports of the drive beyond the limit that means overspeed."""
_MAX_BRAKED_RPM = (
    100.0  # largest decrease between two reports by braking; after a larger one, 0 rpm is not a measurement
)
_HISTORY_S = 12.0  # age of reports and marks that are kept, s
_MIN_MARKS_S = 1.0  # least time, and …
_MIN_MARKS = 5  # … least number of index marks for the comparison of their rate with the drive


@dataclass(frozen=True)
class Stop:
    """Finding of an interlock that ends the run and stops the rotor.

    Attributes:
        cause: "device" if a device failed, "procedure" if the motion exceeded a limit.
        text: the finding with its values, for the operator.
        interlock: name of its row in `daq.acquisition.interlock_table`.
    """

    cause: Literal["device", "procedure"]
    text: str
    interlock: str = ""


class RotorWatch:
    """Monitors the speed of the rotor.

    Args:
        limit_rpm: speed limit.
        driven: whether a device turns the rotor and reports its speed.
        rest_rpm: largest speed that the device reports for a rotor at rest.

    Attributes:
        target_rpm: last commanded speed.
    """

    def __init__(
        self,
        limit_rpm: float,
        *,
        driven: bool = True,
        rest_rpm: float = AT_REST_RPM,
    ) -> None:
        self._limit_rpm, self._driven, self._rest_rpm = limit_rpm, driven, rest_rpm
        self._max_report_age_ns = _ns(0.5)
        self._late_ns = _ns(HOST_S)
        self._settled_ns = _ns(0.1)
        self._drive_rpm: float | None = None
        self._drive_ns = 0
        self._unmeasured_ns: int | None = None  # of the drive's newest report without a speed
        self._zero_since_ns: int | None = None
        self._fell = False  # the reported speed jumped to 0, as that of a drive that does not measure when it is off
        self._reports: deque[tuple[int, float, float]] = deque()  # host ns, least and greatest rpm of a read
        self.target_rpm: float = 0.0
        self._highest = self._lowest = 0.0  # range of speeds that the commanded speeds permit
        self._beyond = 0
        self._marks: deque[tuple[int, int, int]] = deque(maxlen=4096)  # common time ns, node time ns, revolutions
        self._mark_host_ns: int | None = None
        self._marks_after_zero = 0
        self._turns_unseen = 0.0
        self._marks_since_start = 0  # index marks since the first commanded speed after rest
        self._node_ns: int | None = None
        self._off_since_ns: int | None = None

    # --- input ---------------------------------------------------------------------------------------------------

    def commanded(self, rpm: float) -> None:
        """Register a speed that is about to be commanded to the drive or to the operator."""
        if not self.target_rpm:
            self._marks_since_start = 0
        self.target_rpm = rpm
        self._highest, self._lowest = max(self._highest, rpm), min(self._lowest, rpm)

    def drive_reported(self, host_ns: int, rpm: NDArray[np.float64]) -> Stop | None:
        """Evaluate the drive's reports of one read, actual speeds, shape (n,), n ≥ 1. Return a fault, or None.

        A report without a speed (NaN) is no evidence of rest, and the index marks decide meanwhile.
        """
        reported: list[float] = rpm.tolist()  # few values, for which lists are faster than arrays
        if math.isnan(sum(reported)):
            ends_without = math.isnan(reported[-1])
            reported = [one for one in reported if not math.isnan(one)]
            finding = self._drive_measured(host_ns, reported) if reported else None
            if ends_without:
                self._drive_rpm = None if self._drive_rpm is None else math.nan
                self._zero_since_ns, self._unmeasured_ns = None, host_ns
            return finding
        return self._drive_measured(host_ns, reported)

    def _drive_measured(self, host_ns: int, reported: list[float]) -> Stop | None:
        least, greatest, last = min(reported), max(reported), reported[-1]
        if self._drive_rpm is None:
            self._highest, self._lowest = max(self.target_rpm, greatest), min(self.target_rpm, least)
        else:
            passed = min(host_ns - self._drive_ns, self._max_report_age_ns) * 1e-9
            self._turns_unseen += max(0.0, passed) * abs(last) / 60.0
        if abs(last) > (AT_REST_RPM if self.target_rpm else self._rest_rpm):  # a commanded speed may be low
            self._zero_since_ns = None
        elif self._zero_since_ns is None:  # the first report at rest
            self._fell = self._falls([self._drive_rpm or 0.0, *reported])
            self._zero_since_ns = host_ns - (self._settled_ns if self._drive_rpm is None else 0)
            self._marks_after_zero = 0
        self._drive_rpm, self._drive_ns = last, host_ns
        self._reports.append((host_ns, least, greatest))
        while self._reports[0][0] < host_ns - _ns(_HISTORY_S) - 3 * self._late_ns:
            self._reports.popleft()
        return self._too_fast(max(abs(least), abs(greatest)), len(reported)) or self._ran_away(least, greatest, last)

    def _falls(self, reported: list[float]) -> bool:
        """Return whether the last speed before rest is too high for a rotor that comes to rest by braking."""
        before = next((abs(rpm) for rpm in reversed(reported) if abs(rpm) > self._rest_rpm), 0.0)
        return before > _MAX_BRAKED_RPM

    def discard_drive(self) -> None:
        """Discard the drive's reports, since it restarted or left operation."""
        self._drive_rpm = self._zero_since_ns = None
        self._reports.clear()

    def node_heard(self, host_ns: int) -> None:
        """Register samples of the node that sends the index marks."""
        self._node_ns = host_ns

    def marks_received(
        self, host_ns: int, time_ns: NDArray[np.int64], node_ns: NDArray[np.int64], revolutions: NDArray[np.integer]
    ) -> Stop | None:
        """Evaluate the index marks of one read. Return a fault, or None.

        Args:
            host_ns: time of the read, ns.
            time_ns: times on the common clock, shape (n,). Corrections of the clock map may distort their differences.
            node_ns: times on the clock of the node, shape (n,). Speeds are computed from these.
            revolutions: revolutions counted by the node, shape (n,).
        """
        self._turns_unseen = 0.0
        self._marks_since_start += len(time_ns)
        self._node_ns = host_ns
        for at, own, turn in zip(time_ns.tolist(), node_ns.tolist(), revolutions.tolist(), strict=True):
            if self._marks and not (0 < turn - self._marks[-1][2] < 1_000_000 and own > self._marks[-1][1]):
                self._marks.clear()  # the counter has restarted
            self._marks.append((at, own, turn))
            if self._zero_since_ns is not None and at > self._zero_since_ns + self._late_ns:
                self._marks_after_zero += 1
        self._mark_host_ns = host_ns
        newest = self._marks[-1][0]
        while self._marks[0][0] < newest - _ns(_HISTORY_S):
            self._marks.popleft()
        return self._marks_too_fast() or self._disagree(host_ns)

    def reset_turns(self) -> None:
        """Count the turns without an index mark from here, since the rotor is at rest."""
        self._turns_unseen = 0.0

    # --- state ---------------------------------------------------------------------------------------------------

    def drive_rpm(self, now_ns: int) -> float:
        """Return the speed reported by the drive, rpm; NaN if there is no report or it is too old."""
        fresh = self._drive_rpm is not None and now_ns - self._drive_ns <= self._max_report_age_ns
        return self._drive_rpm if fresh and self._drive_rpm is not None else math.nan

    def mark_rpm(self, now_ns: int) -> float:
        """Return the speed from the last two index marks, rpm, limited by the time since the last; NaN without two."""
        turn_ns = self._last_turn_ns()
        if turn_ns is None or self._mark_host_ns is None:
            return math.nan
        return _RPM_PER_TURN_NS / max(turn_ns, now_ns - self._mark_host_ns, 1.0)

    def measured_rpm(self, now_ns: int) -> float:
        """Return the speed by the index marks alone, rpm; NaN without two marks.

        The time since the last mark limits it, less the delay of the host, so that one late read is not a slow rotor.
        """
        return self.mark_rpm(now_ns - self._late_ns)

    def speed_rpm(self, now_ns: int) -> float:
        """Return the higher of both speeds, rpm; NaN if neither is available."""
        speeds = [abs(rpm) for rpm in (self.drive_rpm(now_ns), self.mark_rpm(now_ns)) if not math.isnan(rpm)]
        return max(speeds, default=math.nan)

    def at_rest(self, now_ns: int) -> bool | None:
        """Return whether the rotor is at rest, or None if its state is unknown.

        The drive's newest report decides, unless index marks continue. Without a report the index marks decide. A rotor
        that was at rest when the drive became silent remains at rest until an index mark arrives, while the node sends.

        The state is unknown if neither source is available. Without a drive it is also unknown if the index marks of a
        rotor with a commanded speed cease, since a failed index sensor is more likely than a rotor at rest.
        """
        reported = self.drive_rpm(now_ns)
        if not math.isnan(reported):
            if self._zero_since_ns is None or now_ns - self._zero_since_ns < self._settled_ns:
                return False
            return not self.coasts(now_ns)
        if self._node_ns is None or now_ns - self._node_ns > _ns(RADIO_S):
            return None
        if self._stood and self.target_rpm == 0:
            return True
        seen_ns = max(self._mark_host_ns or 0, self._drive_ns)
        ceased = now_ns - seen_ns > max(_ns(_MIN_MARKLESS_S), 3 * (self._last_turn_ns() or 0.0)) + self._late_ns
        return None if ceased and self._alone else ceased

    @property
    def _stood(self) -> bool:
        """Whether the drive's last report was "at rest" and no index mark has arrived since."""
        settled = self._zero_since_ns is not None and self._drive_ns - self._zero_since_ns >= self._settled_ns
        return self._drive_rpm is not None and settled and self._marks_after_zero == 0

    @property
    def _alone(self) -> bool:
        """Whether the index marks are the only source for a rotor with a commanded speed that has started to turn."""
        return not self._driven and self.target_rpm != 0 and self._marks_since_start >= _MIN_MARKS

    def coasts(self, now_ns: int) -> bool:
        """Return whether index marks continue although the drive reports rest."""
        turn_ns = self._last_turn_ns()
        if self._zero_since_ns is None or turn_ns is None or self._mark_host_ns is None:
            return False
        if self._fell and self._marks_after_zero < 2:  # further marks may still be delayed by the radio
            return now_ns - self._mark_host_ns < 2.5 * turn_ns + self._late_ns + _ns(RADIO_S)
        return self._marks_after_zero >= 2 and now_ns - self._mark_host_ns < 2.5 * turn_ns + self._late_ns

    def unseen(self, now_ns: int) -> str | None:
        """Return a fault text if the drive turned too far without an index mark, or None.

        The criterion is a number of turns, so the deadline is short at high speed and long near rest.
        """
        if not self._driven:
            return self._ceased(now_ns)
        rpm = self.drive_rpm(now_ns)
        if math.isnan(rpm):
            return None
        on_air = takewhile(lambda report: now_ns - report[0] <= _ns(RADIO_S), reversed(self._reports))
        fastest = max((max(-least, greatest) for _, least, greatest in on_air), default=abs(rpm))  # before braking
        if self._turns_unseen <= TURNS_UNSEEN + fastest / 60.0 * RADIO_S:
            return None
        return (
            f"tacho: no index mark for {self._turns_unseen:.0f} turns of the drive ({rpm:.0f} rpm). Look at the index "
            "sensor, the node's battery and radio, and whether the rotor turns with the drive"
        )

    def _ceased(self, now_ns: int) -> str | None:
        """Return a fault text if the index marks of a rotor that is turned by hand have ceased, or None."""
        turn_ns = self._last_turn_ns()
        if not self._alone or turn_ns is None or self._mark_host_ns is None:
            return None
        silent_ns = now_ns - self._mark_host_ns
        if silent_ns <= TURNS_UNSEEN * turn_ns + _ns(RADIO_S):
            return None
        return (
            f"tacho: no index mark for {silent_ns * 1e-9:.1f} s, the last one at {_RPM_PER_TURN_NS / turn_ns:.0f} "
            "rpm, and no other device measures the rotor. Look at the index sensor, the node and its radio"
        )

    def words(self, now_ns: int) -> str:
        """Return the available speeds as text for a message."""
        reported, marks = self.drive_rpm(now_ns), self.mark_rpm(now_ns)
        drive = f"the drive reports {reported:.0f} rpm"
        if math.isnan(reported):
            silent_ns = now_ns - (self._unmeasured_ns or 0)
            drive = "the drive is silent" if silent_ns > self._max_report_age_ns else "the drive reports no speed"
        drive = drive if self._driven else "the rotor is turned by hand"
        if self._node_ns is None:
            return f"{drive}, no other device measures the rotor"
        if now_ns - self._node_ns > _ns(RADIO_S):
            return f"{drive}, the node that sends the index marks is silent"
        if math.isnan(marks) or self._mark_host_ns is None:
            return f"{drive}, no index marks"
        ago_s = (now_ns - self._mark_host_ns) * 1e-9
        last_rpm = _RPM_PER_TURN_NS / (self._last_turn_ns() or math.inf)
        return f"{drive}, the last index mark was {ago_s:.1f} s ago at {last_rpm:.0f} rpm"

    # --- faults --------------------------------------------------------------------------------------------------

    def _last_turn_ns(self) -> float | None:
        if len(self._marks) < 2:
            return None
        (_, before, first), (_, after, last) = self._marks[-2], self._marks[-1]
        return (after - before) / (last - first)

    def _too_fast(self, rpm: float, rows: int) -> Stop | None:
        share, more = OVERSPEED
        self._beyond = self._beyond + rows if rpm > (1 + share) * self._limit_rpm + more else 0
        if self._beyond < ROWS_BEYOND:
            return None
        return Stop(
            "procedure", f"the drive reports {rpm:.0f} rpm, limits.speed_rpm is {self._limit_rpm:.0f}", "overspeed"
        )

    def _marks_too_fast(self) -> Stop | None:
        if len(self._marks) < 4:
            return None
        (_, before, first), (_, after, last) = self._marks[-4], self._marks[-1]
        rpm = _RPM_PER_TURN_NS * (last - first) / max(1, after - before)
        share, more = OVERSPEED
        if rpm <= (1 + share) * self._limit_rpm + more:
            return None
        return Stop(
            "procedure",
            f"the index marks come at {rpm:.0f} rpm, limits.speed_rpm is {self._limit_rpm:.0f}",
            "overspeed",
        )

    def _ran_away(self, least: float, greatest: float, last: float) -> Stop | None:
        """Return a fault if the speed is outside the range between rest, the last speeds and the commanded speed."""
        highest, lowest, target = self._highest, self._lowest, self.target_rpm
        self._highest, self._lowest = max(0.0, target, min(highest, last)), min(0.0, target, max(lowest, last))
        share, more = RUNAWAY
        if greatest > highest + share * abs(highest) + more:
            return Stop(
                "procedure", f"the drive reports {greatest:.0f} rpm, {target:.0f} rpm were commanded", "runaway"
            )
        if least < lowest - share * abs(lowest) - more:
            return Stop("procedure", f"the drive reports {least:.0f} rpm, {target:.0f} rpm were commanded", "runaway")
        return None

    def _disagree(self, host_ns: int) -> Stop | None:
        """Return a fault if the rate of the index marks differs from all reports of the drive around that time.

        The difference must last for 0.5 s and the delay of the host.
        """
        last = self._marks[-1]
        first = next(
            (
                mark
                for number, mark in enumerate(reversed(self._marks), 1)
                if number >= _MIN_MARKS and last[1] - mark[1] >= _ns(_MIN_MARKS_S)
            ),
            None,
        )
        if first is None:
            return None
        margin = self._late_ns + _ns(0.2)
        if not self._reports or self._reports[0][0] > first[0]:
            return None
        recent = takewhile(lambda report: report[0] >= first[0] - margin, reversed(self._reports))  # newest first
        around = [(least, greatest) for at, least, greatest in recent if at <= last[0] + margin]
        if not around:
            return None
        rpm = _RPM_PER_TURN_NS * (last[2] - first[2]) / (last[1] - first[1])
        speeds = [abs(value) for pair in around for value in pair]
        share, more = DISAGREE
        if (1 - share) * min(speeds) - more <= rpm <= (1 + share) * max(speeds) + more:
            self._off_since_ns = None
            return None
        if self._off_since_ns is None:
            self._off_since_ns = host_ns
        if host_ns - self._off_since_ns < self._late_ns + _ns(0.5):
            return None
        text = f"the index marks come at {rpm:.0f} rpm, the drive reports {min(speeds):.0f} to {max(speeds):.0f} rpm"
        if (compared := self._compared(first[0], last[0])) is not None:
            text = f"{text}: {compared.ratio_words}"
        return Stop("procedure", text, "speed disagreement")

    def _compared(self, start_ns: int, end_ns: int) -> SpeedAgreement | None:
        """Compare the marks with the drive's reports in an interval; None if they cannot be compared."""
        marks = np.array([(at, turn) for at, _, turn in self._marks if start_ns <= at <= end_ns], np.int64)
        reports = [(1e-9 * (at - start_ns), 0.5 * (least + greatest)) for at, least, greatest in self._reports]
        times_s, rpm = np.array(reports, np.float64).T
        return speed_agreement((marks[:, 0] - start_ns).astype(np.float64) * 1e-9, marks[:, 1], times_s, rpm)


def _ns(seconds: float) -> int:
    return int(seconds * 1e9)
