"""Numbers of frames, from the counters of the packets that contain them."""

from __future__ import annotations

from typing import Literal

from rig_basics.texts import number_of
from rig_drivers.optoncdt_ethernet.wire import COUNTER_WRAP

Counts = Literal["frames", "packets"]

_SHORT_WRAP = 2**24
_CERTAIN_STEPS = 3
"""Steps of the counter that show what it counts; a loss has the same size in fewer."""


class FrameNumbers:
    """Numbers the frames of consecutive packets.

    The manual does not state whether the counter is that of the packet's first frame or the number of frames up to its
    end. In the first case it steps by the number of frames of the packet before, in the second by that of its own. The
    meaning that explains the steps is taken. The counter may have 24 bits, as the one that can be selected for frames.

    Args:
        counts: what the counter counts.

    Attributes:
        frames: number of frames of the newest packet.
        of_end: whether the counter is that of the packet's end.
    """

    def __init__(self, counts: Counts) -> None:
        self.frames: int = 0
        self.of_end: bool = False
        self._of_frames = counts == "frames"
        self._counter: int | None = None
        self._next = 0
        self._steps = [0, 0]  # that fit only the counter of the first frame, and of the end
        self._others = 0  # consecutive steps that fit the other setting of `counts`

    def first(self, counter: int, frames: int) -> int:
        """Return the number of a packet's first frame, modulo COUNTER_WRAP."""
        if self._counter is None:
            missing = counter if self._of_frames else 0
        else:
            step = (counter - self._counter + COUNTER_WRAP // 2) % COUNTER_WRAP - COUNTER_WRAP // 2
            missing = self._missing(step, frames)
        self._counter, self.frames = counter, frames
        number = self._next + missing
        self._next = number + frames
        return number % COUNTER_WRAP

    def _missing(self, step: int, frames: int) -> int:
        """Return the number of frames missing before a packet; negative if the counter steps back."""
        previous = self.frames
        fits_other = min(previous, frames) > 1 and (step == 1 if self._of_frames else step in (previous, frames))
        self._others = self._others + 1 if fits_other else 0
        if not self._of_frames:
            return (step - 1) * frames
        if self._others:
            return 0  # no restart: `contradiction` states it
        is_end = step == frames
        if previous != frames and step in (previous, frames) and self._steps[not is_end] < _CERTAIN_STEPS:
            self._steps[is_end] += 1
            self.of_end = is_end
        missing = step - (frames if self.of_end else previous)
        is_wrap = missing == -_SHORT_WRAP
        return 0 if is_wrap else missing

    @property
    def contradiction(self) -> str:
        """What contradicts the setting `counts`, from consecutive steps of the counter; empty otherwise."""
        if self._others < _CERTAIN_STEPS:
            return ""
        if self._of_frames:
            packet = f"each packet of about {number_of(self.frames, 'frame')}"
            return f'its counter steps by 1 with {packet}: set counts = "packets"'
        return f'its counter steps by the number of frames of each packet, about {self.frames}: set counts = "frames"'
