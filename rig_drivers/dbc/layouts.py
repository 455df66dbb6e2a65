"""Messages and signals of a DBC file, and the values of signals in many frames at once.

The file is parsed by cantools. Decoding one frame by cantools takes about 10 µs; the layouts here take the bits of all
frames of a read together. The tests compare both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_TEXT = 1_000_000
"""Largest length of a DBC file, characters."""
FRAME_BYTES = 8
_FLOAT_BITS = {16: np.float16, 32: np.float32, 64: np.float64}


@dataclass(frozen=True)
class Bits:
    """Place of a number in a frame.

    Attributes:
        shift: number of bits behind it in the word of 64 bits that the frame is.
        length: number of its bits.
        big_endian: whether the frame's first byte is the most significant one of that word (Motorola format).
    """

    shift: int
    length: int
    big_endian: bool

    def raw(self, data: NDArray[np.uint8]) -> NDArray[np.uint64]:
        """Return the number without sign, shape (n,), of frames of shape (n, 8)."""
        words = np.ascontiguousarray(data).view(">u8" if self.big_endian else "<u8")[:, 0].astype(np.uint64)
        return words >> np.uint64(self.shift) & np.uint64(2**self.length - 1)


@dataclass(frozen=True)
class SignalLayout:
    """A signal of a message.

    Attributes:
        name: its name.
        bits: its place.
        signed, is_float: kind of its raw number.
        scale, offset: value = offset + scale · raw number.
        unit: unit of the value, as in the file.
        choices: names of raw numbers (value table).
        when: it is in a frame only if each of these numbers is one of the given ones (multiplexing).
    """

    name: str
    bits: Bits
    signed: bool
    is_float: bool
    scale: float
    offset: float
    unit: str
    choices: Mapping[str, int]
    when: tuple[tuple[Bits, frozenset[int]], ...]

    def present(self, data: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return in which frames, shape (n, 8), it is; shape (n,)."""
        there = np.ones(len(data), np.bool_)
        for selector, numbers in self.when:
            there &= np.isin(selector.raw(data), np.array(sorted(numbers), np.uint64))
        return there

    def raw(self, data: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Return its raw number in each frame, shape (n,); of a signal of 64 bits without sign modulo 2⁶⁴."""
        raw, length = self.bits.raw(data).view(np.int64), self.bits.length
        if not self.signed or length == 64:
            return raw
        return (raw ^ 1 << length - 1) - (1 << length - 1)

    def values(self, data: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return its value in each frame, in its unit, shape (n,)."""
        if self.is_float:
            number = self.bits.raw(data).astype(f"u{self.bits.length // 8}").view(_FLOAT_BITS[self.bits.length])
        else:
            number = self.raw(data) if self.signed else self.bits.raw(data)
        with np.errstate(over="ignore", invalid="ignore"):  # a float may be any number
            return number.astype(np.float64) * self.scale + self.offset


@dataclass(frozen=True)
class MessageLayout:
    """A message.

    Attributes:
        name: its name.
        frame_id: identifier of its frames.
        extended: whether the identifier has 29 bits.
        size: number of data bytes.
        signals: its signals by name.
    """

    name: str
    frame_id: int
    extended: bool
    size: int
    signals: Mapping[str, SignalLayout]


@lru_cache(8)
def database(text: str) -> Any:
    """Return the cantools database of a DBC file's text.

    Raises:
        ValueError: it is not a DBC file.
    """
    if len(text) > MOST_TEXT:
        raise ValueError(f"expected at most {MOST_TEXT} characters of a DBC file, got {len(text)}")
    try:
        return import_module("cantools.database").load_string(text, "dbc")  # slow to import
    except Exception as error:  # a parser raises many kinds of errors at text from outside
        raise ValueError(f"not a DBC file: {error!s:.200}") from error


@lru_cache(64)
def message(text: str, name: str) -> MessageLayout:
    """Return a message of a DBC file.

    Args:
        text: text of the file.
        name: name of the message.

    Raises:
        ValueError: not a DBC file, or a message that does not exist or is not one of classic CAN.
    """
    found = next((each for each in database(text).messages if each.name == name), None)
    if found is None:
        names = ", ".join(sorted(each.name for each in database(text).messages))
        raise ValueError(f"the DBC file has no message {name!r:.60}, only {names:.200}")
    if not 0 < found.length <= FRAME_BYTES or found.is_container:
        raise ValueError(f"message {name}: expected 1 to 8 bytes of classic CAN, got {found.length}")
    by_name = {signal.name: signal for signal in found.signals}
    layouts = {signal.name: _layout(signal, by_name) for signal in found.signals}
    return MessageLayout(name, found.frame_id, found.is_extended_frame, found.length, layouts)


def _layout(signal: Any, others: Mapping[str, Any]) -> SignalLayout:
    length, conversion = signal.length, signal.conversion
    whole = signal.conversion.is_float and length not in _FLOAT_BITS
    if not 0 < length <= 8 * FRAME_BYTES or whole:
        raise ValueError(f"signal {signal.name}: expected 1 to 64 bits (a float 16, 32 or 64), got {length}")
    scale, offset = float(conversion.scale), float(conversion.offset)
    if not (math.isfinite(scale) and scale and math.isfinite(offset)):
        raise ValueError(f"signal {signal.name}: expected a finite scale that is not 0, got {scale} and {offset}")
    named: Mapping[int, Any] = signal.choices or {}
    choices = {str(name): int(raw) for raw, name in named.items()}
    when: list[tuple[Bits, frozenset[int]]] = []
    inner = signal
    while inner.multiplexer_signal is not None and len(when) < len(others):
        outer = others[inner.multiplexer_signal]
        when.append((_bits(outer), frozenset(int(number) for number in inner.multiplexer_ids)))
        inner = outer
    return SignalLayout(
        signal.name,
        _bits(signal),
        bool(signal.is_signed),
        bool(conversion.is_float),
        scale,
        offset,
        signal.unit or "",
        choices,
        tuple(when),
    )


def _bits(signal: Any) -> Bits:
    """Return the place of a signal. A DBC file counts bits from the lowest of each byte.

    `start` is the lowest bit of an Intel signal, and the highest one of a Motorola signal.
    """
    if signal.byte_order == "little_endian":
        return Bits(signal.start, signal.length, False)
    from_first = 8 * (signal.start // 8) + 7 - signal.start % 8
    return Bits(8 * FRAME_BYTES - from_first - signal.length, signal.length, True)
