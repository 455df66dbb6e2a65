"""Compiled decoding of the undamaged part of a laser's stream, and compiled scaling of its distance words.

Nearly all of a stream consists of complete blocks that continue one another. They need no state machine: one loop
separates the words, checks that counter and timestamp advance by one sample, and stops at the first byte that does not
fit. The full decoder takes the rest; it gives the same samples for the same bytes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from daq.drivers.optoncdt import distance_words, sensor_answers, wire as optoncdt
from daq.drivers.spikes import compile_watch

_COUNTER_WRAP, _TIMESTAMP_WRAP = optoncdt.COUNTER_WRAP, optoncdt.TIMESTAMP_WRAP
_USUAL = distance_words.SCALINGS[distance_words.USUAL_SCALING]


class CleanBlocks(NamedTuple):
    """Complete blocks at the beginning of some bytes.

    Attributes:
        code, counter: raw words, integers, shape (n,).
        ticks: timestamps, wrapped, int64, shape (n,).
    """

    code: NDArray[np.integer]
    counter: NDArray[np.integer]
    ticks: NDArray[np.int64]


@njit(cache=True, nogil=True)
def _take(
    data: NDArray[np.uint8],
    places: tuple[int, ...],
    last_counter: int,
    last_tick: int,
    nominal_ticks: float,
    code: NDArray[np.uint32],
    counter: NDArray[np.uint32],
    ticks: NDArray[np.int64],
) -> int:  # pragma: no cover - compiled
    """Fill the columns; return the number of undamaged blocks that continue one another."""
    words, at_distance, at_counter, at_low, at_high = places
    for block in range(len(code)):
        low = high = np.int64(0)
        count = np.int64(0)
        for word in range(words):
            at = 3 * (block * words + word)
            first, second, third = np.int64(data[at]), np.int64(data[at + 1]), np.int64(data[at + 2])
            if first >> 6 != 0 or second >> 6 != 1 or third >> 6 != (2 if word == 0 else 3):
                return block
            value = first & 0x3F | (second & 0x3F) << 6 | (third & 0x3F) << 12
            if word == at_distance:
                code[block] = value
            elif word == at_counter:
                count = value
            elif word == at_low:
                low = value & 0xFFFF
            elif word == at_high:
                high = value & 0xFFFF
        tick = low | high << 16
        passed = (tick - last_tick) % _TIMESTAMP_WRAP
        if (count - last_counter) % _COUNTER_WRAP != 1 or abs(passed - nominal_ticks) > 1.0:
            return block
        counter[block] = count
        ticks[block] = tick
        last_counter, last_tick = int(count), int(tick)
    return len(code)


def take_clean_blocks(
    data: bytes, places: sensor_answers.WordPositions, last_counter: int, last_tick: int, nominal_ticks: float
) -> CleanBlocks:
    """Decode the blocks at the beginning of `data` that are complete and undamaged and continue one another.

    Args:
        data: bytes that start with a block.
        places: positions of the words in a block.
        last_counter, last_tick: counter and timestamp of the preceding block as received.
        nominal_ticks: ticks between two blocks.
    """
    most = len(data) // (3 * places.words)
    code, counter, ticks = np.empty(most, np.uint32), np.empty(most, np.uint32), np.empty(most, np.int64)
    view = np.frombuffer(data, np.uint8)
    taken = _take(view, tuple(places), last_counter, last_tick, float(nominal_ticks), code, counter, ticks)
    return CleanBlocks(code[:taken], counter[:taken], ticks[:taken])


@njit(cache=True, nogil=True)
def _measure(
    code: NDArray[np.uint32],
    formula: tuple[int, float, float, float],
    range_m: float,
    to_disk: float,
    displacement: NDArray[np.float64],
) -> int:  # pragma: no cover - compiled
    """Fill in displacements, m, by the operations of `distance_words.metres` in their order; return the NaN count."""
    most, gain, zero, whole = formula
    invalid = 0
    for i in range(len(code)):
        if code[i] <= most:
            metres = (gain * code[i] - zero) * range_m / whole
            displacement[i] = (metres - 0.5 * range_m) * to_disk
        else:
            displacement[i] = np.nan
            invalid += 1
    return invalid


def measure(
    code: NDArray[np.uint32], range_m: float, to_disk: float, scaling: distance_words.Scaling = _USUAL
) -> tuple[NDArray[np.float64], int]:
    """Convert distance words to displacements of the disk.

    Args:
        code: distance words, shape (n,).
        range_m: measuring range of the sensor, m; its middle is displacement 0.
        to_disk: ratio of the displacement of the disk to that at the sensor.
        scaling: scaling of the sensor's model.

    Returns:
        Displacement, m, shape (n,), NaN for an error code; number of error codes.
    """
    displacement = np.empty(len(code))
    formula = scaling.most, scaling.span / scaling.steps, scaling.zero, scaling.whole
    return displacement, int(_measure(code, formula, range_m, to_disk, displacement))


def compile_loop() -> None:
    """Load or compile the compiled code before the first byte arrives."""
    take_clean_blocks(bytes(12), sensor_answers.WordPositions(4, 0, 1, 2, 3), 0, 0, 25.0)
    measure(np.zeros(1, np.uint32), 1.0, 1.0)
    compile_watch()


def may_begin_block(data: bytes) -> bool:
    """Whether bytes can be the beginning of a block.

    The two highest bits mark the bytes of a word as low (0), middle (1) and high: 2 for the first word, otherwise 3.
    """
    return all(byte >> 6 == (0, 1, 2 if at == 2 else 3)[at % 3] for at, byte in enumerate(data))
