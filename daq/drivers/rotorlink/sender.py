"""Numbers and clock of one sender's frames: what is lost, what comes again, and whether the sender has started again.

The seq counts frames of all types and wraps at 65536. The clock has 32 bits in µs: it wraps after 71.6 min and starts
at 0 when the sender starts.

The clock of a node compared with the number of its samples: steps of the clock, and times without them.

The samples of a node are equally spaced, and their index counts them. A time stamp that contradicts index × period by
more than one period belongs to another sample. The node's clock has then stepped, and all times after it are put back
by the step. A mark between two blocks may come before the block that shows a step. It waits for this block if its time
does not fit between the blocks, for half a second at most.
"""

from __future__ import annotations

from typing import NamedTuple

_WRAP_US = 2**32
_LATE = 16
"""Frames by which a repeated one comes later; a seq that is further back shows a restart."""
_MAX_SILENCE_US = 30_000_000  # after a longer silence the seq, which wraps, does not show a restart
_MAX_LATE_US = 1_000_000  # a frame older than the newest by up to this is late, not a step back of the clock
_MAX_HOST_LATE_US = 120_000_000  # largest lateness of a host
_MAX_RADIO_LATE_US = 10_000_000  # of a frame that a radio repeats; a Zigbee module ends its tries after 4.8 s
_MAX_NEWEST_LATE_US = 2_000_000  # of the newest frame, which is seldom a repeated one


class Place(NamedTuple):
    """Place of a frame among those of its sender.

    Attributes:
        lost: number of frames missing before it, modulo 65536.
        span_s: time since the newest frame with a time, s; 0 if it is unknown.
        is_repeated: whether it has come before, or too late.
        is_restart: whether its sender has started again; a new `Sender` must take it.
    """

    lost: int = 0
    span_s: float = 0.0
    is_repeated: bool = False
    is_restart: bool = False


class Sender:
    """See the module."""

    def __init__(self) -> None:
        self._seq: int | None = None
        self._stated_us: int | None = None  # newest stated time
        self._newest: tuple[int, int] | None = None  # unwrapped time of the sender, µs; host time, ns

    def feed(self, seq: int, us: int | None, host_ns: int, *, span_us: int = 0, is_old: bool = False) -> Place:
        """Take a frame.

        Args:
            seq: its number.
            us: time of the sender in it, µs, wrapped; None without one.
            host_ns: host time of its arrival, ns since 1970.
            span_us: time from its first to its newest sample, µs. If the clock wraps between them in the first frame,
                unwrapped times begin one wrap later, so that none is negative.
            is_old: whether its content was sent before: then an old seq shows no restart.
        """
        before_us = 0 if self._newest is None else self._newest[0]
        newest_us = before_us if us is None else self._newest_us((us + span_us) % _WRAP_US, host_ns, span_us)
        if newest_us is None:
            return Place(is_restart=True)
        step = 1 if self._seq is None else (seq - self._seq) & 0xFFFF
        if newest_us - before_us <= _MAX_SILENCE_US:
            if step == 0 or step >= (0x8000 if is_old else 0x10000 - _LATE):
                return Place(is_repeated=True)
            if step >= 0x8000:
                return Place(is_restart=True)
        self._seq = seq
        return Place((step - 1) & 0xFFFF, self._passed_s(us))

    def is_behind(self, seq: int) -> bool:
        """Whether a number is before the newest one, by less than half the wrap."""
        return self._seq is not None and 0 < (self._seq - seq) & 0xFFFF < 0x8000

    def is_late(self, us: int, host_ns: int, up_us: int) -> bool:
        """Whether a frame was sent before the newest one, by up to 10 s, and not after a restart of the sender.

        A sender that has restarted since the newest frame cannot have run for longer than since then.

        Args:
            us: time of the sender in the frame, µs, wrapped.
            host_ns: host time of the frame, ns since 1970.
            up_us: time for which the sender had run when it sent the frame, µs, or less.
        """
        if self._newest is None:
            return False
        newest_us, newest_ns = self._newest
        passed_us = max(0, host_ns - newest_ns) // 1000
        behind_us = newest_us - self.unwrap(us)
        return 0 < behind_us <= _MAX_RADIO_LATE_US and up_us > passed_us + _MAX_NEWEST_LATE_US

    def unwrap(self, us: int) -> int:
        """Return the unwrapped time, µs, of a wrapped time near the newest one."""
        if self._newest is None:
            return us
        newest_us = self._newest[0]
        return newest_us + (us - newest_us + _WRAP_US // 2) % _WRAP_US - _WRAP_US // 2

    def _newest_us(self, us: int, host_ns: int, span_us: int) -> int | None:
        """Take a time; return the newest one, unwrapped. None: it has stepped back, or runs ahead of the host's."""
        if self._newest is None:
            self._newest = us + _WRAP_US * (us < span_us), host_ns
            return self._newest[0]
        newest_us, newest_ns = self._newest
        passed_us = (host_ns - newest_ns) // 1000
        ahead_us = self.unwrap(us) - newest_us
        ahead_us += _WRAP_US * max(0, round((passed_us - ahead_us) / _WRAP_US))
        if ahead_us < -_MAX_LATE_US or ahead_us - passed_us > _MAX_HOST_LATE_US:
            return None
        if ahead_us > 0:
            self._newest = newest_us + ahead_us, host_ns
        return self._newest[0]

    def _passed_s(self, us: int | None) -> float:
        """Take a stated time; return the time since the newest one, s; 0 for the wrong order."""
        if us is None:
            return 0.0
        passed_us = 0 if self._stated_us is None else (us - self._stated_us) % _WRAP_US
        if passed_us >= _WRAP_US // 2:
            return 0.0
        self._stated_us = us
        return passed_us * 1e-6


MAX_WAIT_NS = 500_000_000
"""Time for which a mark waits for the next block."""
_MAX_STEP_US = 1_000_000  # off the next block by more, a mark comes after a silence of the node
_SHARE_OFF = 0.25  # of a block, by which marks and blocks may be stamped or sent in another order
_PERIOD_ROUNDING_US = 0.5  # the period is a whole number of microseconds


class Step(NamedTuple):
    """A step of the node's clock.

    Attributes:
        us: size, µs.
        span_us: time from the sample before it to the sample after it, by the number of samples, µs.
    """

    us: int
    span_us: int


class NodeClock:
    """Time of a node without the steps of its clock.

    Attributes:
        shift_us: sum of the steps so far, µs.
    """

    def __init__(self) -> None:
        self.shift_us: int = 0
        self._due: tuple[int, int] | None = None  # time of the sample after the newest one, and span of its block, µs

    def take(self, first_us: int, due_us: int, samples: int, period_us: int, count: int) -> Step | None:
        """Take a block; return the step of the clock before it.

        Args:
            first_us: stated time of its first sample, µs.
            due_us: time that follows from the number of samples since the newest block, µs.
            samples: number of samples from the beginning of the newest block to this one; 0 if it is unknown.
            period_us, count: period and number of its samples.
        """
        self._due = first_us + count * period_us, count * period_us
        off = first_us - due_us
        if not (samples and period_us):
            return None
        if abs(off) <= period_us + _PERIOD_ROUNDING_US * samples:
            return None
        self.shift_us += off
        return Step(off, samples * period_us)

    def is_out_of_place(self, us: int) -> bool:
        """Whether a mark at a stated time does not fit between the newest block and the next one."""
        if self._due is None:
            return False
        due_us, span_us = self._due
        early_us, late_us = due_us - us, us - due_us - span_us
        return max(early_us, late_us) > _SHARE_OFF * span_us and max(early_us, late_us) < _MAX_STEP_US

    def own_us(self, us: int, before_shift_us: int, due_us: float) -> int:
        """Return the time of a mark without steps.

        Args:
            us: stated time.
            before_shift_us: sum of the steps before the block that came after the mark.
            due_us: time at which the mark is expected. The mark is before or after the step: its time is the one of
                both that is nearer.
        """
        candidates = us - before_shift_us, us - self.shift_us
        return min(candidates, key=lambda own: abs(own - due_us))
