# pyright: strict
"""Whether and how fast the rotor turns, from two witnesses: the drive's word and the index marks.

Both have an age. A word that is too old counts for nothing; then the index marks alone decide, and where nobody has
seen anything the answer is "unknown", never "at rest". No clock and no I/O here: every time is given, rig ns.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from rig_configs.roles import AT_REST_RPM

_RPM_PER_TURN_NS = 60e9
_MARKLESS_S = 3.0  # a rotor that gave no index mark for so long, and for three of its last turns, stands
TURNS_UNSEEN = 2.5
"""Turns of the drive without an index mark."""
RADIO_S = 1.0
"""How long the radio may hold index marks back, wall s."""
RUNAWAY = (0.10, 20.0)
"""Share and rpm beyond what was commanded …"""
OVERSPEED = (0.05, 10.0)
"""… beyond the limit …"""
DISAGREE = (0.20, 15.0)
"""… and between drive and marks: surely wrong, not slip or lag."""
ROWS_BEYOND = 3
"""So many reports of the drive in a row beyond the limit."""
_FALL_RPM = 100.0  # no brake takes so much between two reports: a word that falls to rest from there is no witness
_HISTORY_S = 12.0
_MARKS_S = 1.0  # least time, and …
_MARKS = 5  # … least index marks over which their rate is compared with the drive's word


@dataclass(frozen=True)
class Finding:
    """What is surely wrong with the rotor's speed.

    Attributes:
        interlock: name of its row in `daq.acquisition.interlock_table`.
        text: with the speeds, for the operator.
    """

    interlock: str
    text: str


class RotorWatch:
    """What the rotor does.

    Args:
        limit_rpm: fastest speed allowed.
        patience: rig seconds of a time-out given in wall seconds (`HostClock.patience`).
        driven: whether a device turns the rotor and tells how fast.
        rest_rpm: its word on a rotor that stands is up to this.

    Attributes:
        target_rpm: what the drive was last told.
    """

    def __init__(
        self,
        limit_rpm: float,
        patience: Callable[[float], float],
        *,
        driven: bool = True,
        rest_rpm: float = AT_REST_RPM,
    ) -> None:
        self._limit_rpm, self._driven, self._rest_rpm = limit_rpm, driven, rest_rpm
        self._word_age_ns = _ns(patience(0.5))
        self._late_ns = _ns(patience(0.3))  # how late a host may notice something
        self._settled_ns = _ns(patience(0.1))
        self._radio_s = patience(RADIO_S)
        self._word: float | None = None
        self._word_ns = 0
        self._zero_since_ns: int | None = None
        self._fell = False  # its word fell to rest at once, as that of a drive that does not measure when it is off
        self._words: deque[tuple[int, float, float]] = deque()  # host ns, least and greatest rpm of a read
        self.target_rpm = 0.0
        self._highest = self._lowest = 0.0  # what the drive may show of what it was told
        self._beyond = 0
        self._marks: deque[tuple[int, int, int]] = deque(maxlen=4096)  # time ns, by the node's own clock, revolutions
        self._mark_host_ns: int | None = None
        self._marks_after_zero = 0
        self._turns_unseen = 0.0
        self._marks_since_told = 0
        self._node_ns: int | None = None
        self._off_since_ns: int | None = None

    # --- the witnesses -----------------------------------------------------------------------------------------

    def told(self, rpm: float) -> None:
        """The drive, or the operator's hand, is about to be told a speed."""
        if not self.target_rpm:
            self._marks_since_told = 0
        self.target_rpm = rpm
        self._highest, self._lowest = max(self._highest, rpm), min(self._lowest, rpm)

    def drive_said(self, host_ns: int, rpm: NDArray[np.float64]) -> Finding | None:
        """The drive's reports of one read, actual speeds, shape (n,), n ≥ 1; returns what is surely wrong with them."""
        said: list[float] = rpm.tolist()  # a handful: quicker than arrays
        least, greatest, last = min(said), max(said), said[-1]
        if self._word is None:
            self._highest, self._lowest = max(self.target_rpm, greatest), min(self.target_rpm, least)
        else:
            passed = min(host_ns - self._word_ns, self._word_age_ns) * 1e-9
            self._turns_unseen += max(0.0, passed) * abs(last) / 60.0
        if abs(last) > (AT_REST_RPM if self.target_rpm else self._rest_rpm):  # what is told to turn may turn slowly
            self._zero_since_ns = None
        elif self._zero_since_ns is None:  # found at rest, or just come to it
            self._fell = self._falls([self._word or 0.0, *said])
            self._zero_since_ns = host_ns - (self._settled_ns if self._word is None else 0)
            self._marks_after_zero = 0
        self._word, self._word_ns = last, host_ns
        self._words.append((host_ns, least, greatest))
        while self._words[0][0] < host_ns - _ns(_HISTORY_S) - 3 * self._late_ns:
            self._words.popleft()
        return self._too_fast(max(abs(least), abs(greatest)), len(said)) or self._ran_away(least, greatest, last)

    def _falls(self, said: list[float]) -> bool:
        """Whether the word before the last ones, which are of rest, is of a speed too high for that."""
        before = next((abs(rpm) for rpm in reversed(said) if abs(rpm) > self._rest_rpm), 0.0)
        return before > _FALL_RPM

    def drive_unknown(self) -> None:
        """The drive's last word counts for nothing any more: it restarted, or left operation."""
        self._word = self._zero_since_ns = None
        self._words.clear()

    def node_heard(self, host_ns: int) -> None:
        """The node that sends the index marks is alive."""
        self._node_ns = host_ns

    def marks_came(
        self, host_ns: int, time_ns: NDArray[np.int64], node_ns: NDArray[np.int64], revolutions: NDArray[np.integer]
    ) -> Finding | None:
        """Index marks of one read; returns what is surely wrong with them.

        Args:
            time_ns: on the common clock, whose map may still be making good a read that came late, shape (n,).
            node_ns: by the clock that stamped them, which alone tells how fast they come, shape (n,).
            revolutions: counted by the node, shape (n,).
        """
        self._turns_unseen = 0.0
        self._marks_since_told += len(time_ns)
        self._node_ns = host_ns
        for at, own, turn in zip(time_ns.tolist(), node_ns.tolist(), revolutions.tolist(), strict=True):
            if self._marks and not (0 < turn - self._marks[-1][2] < 1_000_000 and own > self._marks[-1][1]):
                self._marks.clear()  # counted anew
            self._marks.append((at, own, turn))
            if self._zero_since_ns is not None and at > self._zero_since_ns + self._late_ns:
                self._marks_after_zero += 1
        self._mark_host_ns = host_ns
        newest = self._marks[-1][0]
        while self._marks[0][0] < newest - _ns(_HISTORY_S):
            self._marks.popleft()
        return self._marks_too_fast() or self._disagree(host_ns)

    def turns_begin(self) -> None:
        """The rotor stands: turns without an index mark count from here."""
        self._turns_unseen = 0.0

    # --- what they say -----------------------------------------------------------------------------------------

    def word_rpm(self, now_ns: int) -> float:
        """The drive's word, rpm; NaN when it has none or it is too old."""
        fresh = self._word is not None and now_ns - self._word_ns <= self._word_age_ns
        return self._word if fresh and self._word is not None else math.nan

    def mark_rpm(self, now_ns: int) -> float:
        """Speed by the last two index marks, at most what the time since the last one allows; NaN without two."""
        turn_ns = self._last_turn_ns()
        if turn_ns is None or self._mark_host_ns is None:
            return math.nan
        return _RPM_PER_TURN_NS / max(turn_ns, now_ns - self._mark_host_ns, 1.0)

    def speed_rpm(self, now_ns: int) -> float:
        """The faster of both witnesses, rpm; NaN when neither tells."""
        known = [abs(rpm) for rpm in (self.word_rpm(now_ns), self.mark_rpm(now_ns)) if not math.isnan(rpm)]
        return max(known, default=math.nan)

    def at_rest(self, now_ns: int) -> bool | None:
        """Whether the rotor stands: by the drive's fresh word, unless index marks go on; without one by the marks.

        A rotor that stood when a drive fell silent stands until a mark comes, as long as the node is heard.

        None when neither is there; without a drive also when the marks of a rotor that is to turn have ceased: that the
        index sensor has died is more likely than that the rotor stands.
        """
        word = self.word_rpm(now_ns)
        if not math.isnan(word):
            if self._zero_since_ns is None or now_ns - self._zero_since_ns < self._settled_ns:
                return False
            return not self.coasts(now_ns)
        if self._node_ns is None or now_ns - self._node_ns > _ns(self._radio_s):
            return None
        if self._stood and self.target_rpm == 0:
            return True
        seen_ns = max(self._mark_host_ns or 0, self._word_ns)
        ceased = now_ns - seen_ns > max(_ns(_MARKLESS_S), 3 * (self._last_turn_ns() or 0.0)) + self._late_ns
        return None if ceased and self._alone else ceased

    @property
    def _stood(self) -> bool:
        """Whether the rotor stood by the drive's last word, and no index mark has come since it came to rest."""
        settled = self._zero_since_ns is not None and self._word_ns - self._zero_since_ns >= self._settled_ns
        return self._word is not None and settled and self._marks_after_zero == 0

    @property
    def _alone(self) -> bool:
        """Whether the index marks are the only witness of a rotor that is to turn, and does."""
        return not self._driven and self.target_rpm != 0 and self._marks_since_told >= _MARKS

    def coasts(self, now_ns: int) -> bool:
        """Whether index marks go on although the drive says that nothing turns."""
        turn_ns = self._last_turn_ns()
        if self._zero_since_ns is None or turn_ns is None or self._mark_host_ns is None:
            return False
        if self._fell and self._marks_after_zero < 2:  # they may be on the air still
            return now_ns - self._mark_host_ns < 2.5 * turn_ns + self._late_ns + _ns(self._radio_s)
        return self._marks_after_zero >= 2 and now_ns - self._mark_host_ns < 2.5 * turn_ns + self._late_ns

    def unseen(self, now_ns: int) -> str | None:
        """Whether the rotor turned on and on without an index mark: the deadline is short at speed, long near rest."""
        if not self._driven:
            return self._ceased(now_ns)
        rpm = self.word_rpm(now_ns)
        if math.isnan(rpm):
            return None
        on_air = takewhile(lambda word: now_ns - word[0] <= _ns(self._radio_s), reversed(self._words))
        fastest = max((max(-least, greatest) for _, least, greatest in on_air), default=abs(rpm))  # before it braked
        if self._turns_unseen <= TURNS_UNSEEN + fastest / 60.0 * self._radio_s:
            return None
        return (
            f"tacho: no index mark for {self._turns_unseen:.0f} turns of the drive ({rpm:.0f} rpm). Look at the index "
            "sensor, the node's battery and radio, and whether the rotor turns with the drive"
        )

    def _ceased(self, now_ns: int) -> str | None:
        """Whether the marks of a rotor that a hand is to turn have ceased."""
        turn_ns = self._last_turn_ns()
        if not self._alone or turn_ns is None or self._mark_host_ns is None:
            return None
        silent_ns = now_ns - self._mark_host_ns
        if silent_ns <= TURNS_UNSEEN * turn_ns + _ns(self._radio_s):
            return None
        return (
            f"tacho: no index mark for {silent_ns * 1e-9:.1f} s, the last came at {_RPM_PER_TURN_NS / turn_ns:.0f} "
            "rpm, and nothing else shows whether the rotor turns. Look at the index sensor, the node and its radio"
        )

    def words(self, now_ns: int) -> str:
        """What is known of the speed, for a message."""
        word, marks = self.word_rpm(now_ns), self.mark_rpm(now_ns)
        said = "the drive says nothing" if math.isnan(word) else f"the drive says {word:.0f} rpm"
        said = said if self._driven else "the rotor is turned by hand"
        if self._node_ns is None:
            return f"{said}, nothing else tells of the rotor"
        if now_ns - self._node_ns > _ns(self._radio_s):
            return f"{said}, the node that sends the index marks is silent"
        if math.isnan(marks) or self._mark_host_ns is None:
            return f"{said}, no index marks"
        ago = (now_ns - self._mark_host_ns) * 1e-9
        then = _RPM_PER_TURN_NS / (self._last_turn_ns() or math.inf)
        return f"{said}, the last index mark came {ago:.1f} s ago at {then:.0f} rpm"

    # --- what cannot be right ----------------------------------------------------------------------------------

    def _last_turn_ns(self) -> float | None:
        if len(self._marks) < 2:
            return None
        (_, before, first), (_, after, last) = self._marks[-2], self._marks[-1]
        return (after - before) / (last - first)

    def _too_fast(self, rpm: float, rows: int) -> Finding | None:
        share, more = OVERSPEED
        self._beyond = self._beyond + rows if rpm > (1 + share) * self._limit_rpm + more else 0
        if self._beyond < ROWS_BEYOND:
            return None
        return Finding("overspeed", f"the drive reports {rpm:.0f} rpm, limits.speed_rpm is {self._limit_rpm:.0f}")

    def _marks_too_fast(self) -> Finding | None:
        if len(self._marks) < 4:
            return None
        (_, before, first), (_, after, last) = self._marks[-4], self._marks[-1]
        rpm = _RPM_PER_TURN_NS * (last - first) / max(1, after - before)
        share, more = OVERSPEED
        if rpm <= (1 + share) * self._limit_rpm + more:
            return None
        return Finding("overspeed", f"the index marks come at {rpm:.0f} rpm, limits.speed_rpm is {self._limit_rpm:.0f}")

    def _ran_away(self, least: float, greatest: float, last: float) -> Finding | None:
        """A drive may be on its way to what it was told, or to rest; it may never run away from both."""
        highest, lowest, target = self._highest, self._lowest, self.target_rpm
        self._highest, self._lowest = max(0.0, target, min(highest, last)), min(0.0, target, max(lowest, last))
        share, more = RUNAWAY
        if greatest > highest + share * abs(highest) + more:
            return Finding("runaway", f"the drive reports {greatest:.0f} rpm, it was told {target:.0f}")
        if least < lowest - share * abs(lowest) - more:
            return Finding("runaway", f"the drive reports {least:.0f} rpm, it was told {target:.0f}")
        return None

    def _disagree(self, host_ns: int) -> Finding | None:
        """Index marks that come much faster or slower than any word of the drive around that time, twice."""
        last = self._marks[-1]
        first = next(
            (
                mark
                for number, mark in enumerate(reversed(self._marks), 1)
                if number >= _MARKS and last[1] - mark[1] >= _ns(_MARKS_S)
            ),
            None,
        )
        if first is None:
            return None
        margin = self._late_ns + _ns(0.2)
        if not self._words or self._words[0][0] > first[0]:
            return None
        recent = takewhile(lambda word: word[0] >= first[0] - margin, reversed(self._words))  # the newest come last
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
        return Finding("speed disagreement", text)


def _ns(seconds: float) -> int:
    return int(seconds * 1e9)
