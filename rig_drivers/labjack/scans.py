"""Samples of consecutive answers cut into scans.

An answer may end within a scan. The place of a sample in its scan is then known from the answers before it. Without
them (the log begins, answers are missing) it is derived from the number of samples that still wait, since the device's
buffer ends with a whole scan. Answers are dropped as long as this number contradicts answers that have whole scans.

If a device has been seen to keep this, and the number that waits contradicts the place of the samples, another program
may have read a part of a scan. A device that stores a scan while it is read disagrees once; missing samples disagree in
the same way in all further answers. The answers are held until this is decided.

Volts from the counts of a stream, by the calibration constants in the device's flash.

A T7 has for each range a slope above and one below the count of 0 V (the centre), for its high-speed converter; a T4 a
slope and an offset for each input.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.errors import DeviceError
from rig_drivers.labjack.wire import FIRST_STREAM_ID, NO_VALUE, StreamRead

_DECIDED = 20
"""Answers in a row that show how a device fills its buffer: by whole scans, or a sample at a time."""
_MOST_HELD = 3

Counts = NDArray[np.uint16]
_NONE: Counts = np.empty(0, np.uint16)


def have_no_value(scans: Counts) -> NDArray[np.bool_]:
    """Return for each scan whether it has no value at any input, like the scan that stands for skipped ones."""
    return np.all(scans == NO_VALUE, axis=1)


class CutAnswer(NamedTuple):
    """An answer to a stream read.

    Attributes:
        read: its content.
        host_ns: host time of its arrival, ns.
        scans: scans that it completes, shape (n, inputs); None if the place of its samples is unknown.
        is_after_missing: whether answers are missing before it.
        dropped: number of samples before it that were dropped because their inputs are not certain.
    """

    read: StreamRead
    host_ns: int
    scans: Counts | None = None
    is_after_missing: bool = False
    dropped: int = 0


class ScanCutter:
    """Cuts the samples of consecutive answers; see the module.

    Args:
        inputs: number of samples of a scan.
    """

    def __init__(self, inputs: int) -> None:
        self._inputs = inputs
        self._number: int | None = None  # transaction number of the newest stream read
        self._begins = False  # whether the next answer is the first one of a new stream
        self._rest: Counts | None = None  # samples of a scan that is not complete; None if their place is unknown
        self._missing = False  # whether answers are missing before the next one with scans
        self._undecided = 0  # answers of whole scans in a row whose place is contradicted
        self._agreed = 0  # answers in a row whose number of waiting samples agrees with the place of their samples
        self._surplus = 0  # samples that the held answers have beyond whole scans
        self._held: list[CutAnswer] = []

    def begin(self) -> None:
        """Begin with a new stream, whose first sample belongs to the first input."""
        self._begins, self._rest, self._missing, self._held = True, _NONE, False, []

    def refused(self, number: int) -> None:
        """Take that the device has refused a read: its scans come with the next answer."""
        self._number = number

    @property
    def begins_without_value(self) -> bool:
        """Whether the samples of a scan that is not complete are all NO_VALUE."""
        return self._rest is not None and len(self._rest) > 0 and bool(np.all(self._rest == NO_VALUE))

    def feed(self, number: int, read: StreamRead, host_ns: int) -> list[CutAnswer]:
        """Take an answer with its transaction number; return the answers whose samples are cut now."""
        before, self._number = self._number, number
        ready, dropped = [*self._held, CutAnswer(read, host_ns)], 0
        if not self._begins and before is not None and (number - before) % FIRST_STREAM_ID != 1:
            self._lose()
        elif self._is_doubted(ready):
            if len(ready) <= _MOST_HELD:
                self._held = ready
                return []
            dropped = sum(len(each.read.samples) for each in ready[:-1])
            ready = ready[-1:]
            self._lose()
        self._begins, self._held = False, []
        return [self._cut(each, dropped) for each in ready]

    def _lose(self) -> None:
        self._rest, self._undecided, self._missing = None, 0, True

    def _is_doubted(self, answers: list[CutAnswer]) -> bool:
        """Whether the newest of these answers must be held, with those that are."""
        if self._rest is None or self._begins:
            return False
        samples = sum(len(each.read.samples) for each in answers)
        surplus = (len(self._rest) + samples + answers[-1].read.waiting) % self._inputs
        if surplus and (surplus == self._surplus if len(answers) > 1 else self._agreed >= _DECIDED):
            self._surplus = surplus
            return True
        self._agreed = 0 if surplus else self._agreed + 1
        return False

    def _cut(self, answer: CutAnswer, dropped: int) -> CutAnswer:
        samples = answer.read.samples
        if self._rest is None:
            before = (len(samples) + answer.read.waiting) % self._inputs  # of the scan that began in an earlier answer
            if before and len(samples) % self._inputs == 0:
                self._undecided += 1
                before = len(samples) + 1 if self._undecided <= _DECIDED else 0
            if before > len(samples):
                return answer._replace(dropped=dropped)
            self._rest, samples = _NONE, samples[before:]
        joined = np.concatenate([self._rest, samples])
        whole = len(joined) // self._inputs * self._inputs
        self._rest, missing, self._missing = joined[whole:], self._missing, False
        scans = joined[:whole].reshape(-1, self._inputs)
        return answer._replace(scans=scans, is_after_missing=missing, dropped=dropped)


RANGES_V = (10.0, 1.0, 0.1, 0.01)
"""Ranges of a T7 input, V, in the order of their constants."""
_T7_BYTES, _T7_SET_BYTES = 164, 16
_T4_BYTES, _T4_SET_BYTES = 76, 8
CONSTANTS_BYTES = {"T7": _T7_BYTES, "T4": _T4_BYTES}
"""Size of the constants in the flash by model, bytes."""
BLANK_FLASH = b"\xff" * _T7_BYTES
"""Content of a flash without constants."""
T4_INPUTS = ("AIN0", "AIN1", "AIN2", "AIN3")
"""Inputs of a T4 for ±10 V. Its other inputs are for 0 to 2.5 V and shared with digital lines: not supported."""
T4_MISSING_LINES = ("FIO0", "FIO1", "FIO2", "FIO3")
"""Digital lines of a T7 that a T4 does not have: AIN0 … AIN3 are in their place."""
_MOST_V_PER_COUNT = 0.01


@dataclass(frozen=True)
class VoltScale:
    """Conversion of one input's counts.

    Attributes:
        zero: counts of 0 V.
        above_V, below_V: volts of one count above and below it, both positive.
    """

    zero: float
    above_V: float
    below_V: float

    def volts(self, counts: NDArray[np.uint16]) -> NDArray[np.float64]:
        """Return the volts of counts, shape (n,)."""
        off = counts.astype(np.float64) - self.zero
        return off * np.where(off < 0, self.below_V, self.above_V)

    def of_range(self, range_V: float) -> VoltScale:
        """Return the scale of another range, from that of ±10 V."""
        return VoltScale(self.zero, self.above_V * range_V / 10.0, self.below_V * range_V / 10.0)

    def facts(self, name: str) -> dict[str, float]:
        """Return the scale as entries of a device's identity."""
        return {f"{name}_zero": self.zero, f"{name}_above_V": self.above_V, f"{name}_below_V": self.below_V}

    @classmethod
    def of(cls, identity: Mapping[str, Any], name: str) -> VoltScale | None:
        """Return the scale of a device's identity; None if the identity has none.

        Raises:
            DeviceError: the scale is impossible.
        """
        keys = (f"{name}_zero", f"{name}_above_V", f"{name}_below_V")
        if not any(key in identity for key in keys):
            return None
        values = [identity.get(key) for key in keys]
        scale = cls(*(float(v) if isinstance(v, int | float) else math.nan for v in values))
        if not scale.is_possible:
            raise DeviceError(f"identities.json: expected the constants of {name}, got {values!r:.120}")
        return scale

    @property
    def is_possible(self) -> bool:
        """Whether an input can have this scale."""
        slopes = (self.above_V, self.below_V)
        return 0 <= self.zero < 2**16 and all(0 < each < _MOST_V_PER_COUNT for each in slopes)


def nominal(model: str, range_V: float) -> VoltScale:
    """Return the nominal scale of an input of a T7 or T4 (easily wrong by some millivolts).

    Args:
        range_V: range of the input, one of RANGES_V; a T4 has 10 V only.
    """
    if model == "T4":
        return VoltScale(10.532965 / 3.235316e-4, 3.235316e-4, 3.235316e-4)
    return VoltScale(33523.0, 3.15805780e-4, 3.15805800e-4).of_range(range_V)


def read_constants(model: str, name: str, range_V: float, data: bytes) -> VoltScale | None:
    """Return the scale of an input from the constants in the flash; None if they are impossible (an empty flash).

    Args:
        model: "T7" or "T4".
        name: input, AIN0, AIN1, …; a T7 has the same constants for all inputs of a range.
        range_V: range of the input.
        data: the constants, of CONSTANTS_BYTES bytes.
    """
    if model == "T7":
        above, below, zero, _ = struct.unpack_from(">4f", data, _T7_SET_BYTES * RANGES_V.index(range_V))
        scale = VoltScale(zero, above, -below)
    else:
        slope, offset = struct.unpack_from(">2f", data, _T4_SET_BYTES * T4_INPUTS.index(name))
        scale = VoltScale(-offset / slope if slope else math.nan, slope, slope)
    return scale if scale.is_possible else None


def encode_constants(model: str, scales: Mapping[float | str, VoltScale]) -> bytes:
    """Return the constants in the flash; see `read_constants`.

    Args:
        model: "T7" or "T4".
        scales: scale of each range of a T7, or of each input of a T4; those left out are nominal.
    """
    if model == "T4":
        rows = [scales.get(name, nominal("T4", 10.0)) for name in T4_INPUTS]
        return b"".join(struct.pack(">2f", row.above_V, -row.zero * row.above_V) for row in rows)
    rows = [scales.get(range_V, nominal("T7", range_V)) for range_V in RANGES_V]
    return b"".join(struct.pack(">4f", row.above_V, -row.below_V, row.zero, -row.zero * row.below_V) for row in rows)
