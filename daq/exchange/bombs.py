# pyright: strict
"""Files that are small on the disk and fill the memory when they are read."""

from __future__ import annotations

import math
import os
import struct
import zlib
from pathlib import Path
from typing import BinaryIO, Literal, Protocol

from daq.exchange.errors import ExchangeError

_LARGEST = 2**32  # bytes that one reading may take
_PLAIN = 2**28  # bytes that any file may hold
_RATIO = 100  # noise shrinks to a third, a constant column a thousandfold: but not all columns are constant
_PIECE = 2**20
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15  # element types of MAT version 5
_TYPES = frozenset((*range(1, 8), 9, *range(12, 19)))  # all there are; scipy looks others up beyond its table
_TAG = 8  # bytes before each element
_DEEPEST = 64  # of cells and structs in each other
_MOST_DIMENSIONS = 32


def refuse_bomb(path: Path, what: str, size: int) -> None:
    """Refuse what would take more memory than any recording in a file of this size.

    Args:
        what: of the file, for the message; empty for all of it.
        size: bytes in memory, by the file's own word.

    Raises:
        ExchangeError: it is too large.
    """
    where = f"{path}: {what}" if what else f"{path}"
    if size > _LARGEST:
        raise ExchangeError(f"{where}: expected at most 4 GB of numbers, got {size / 1e9:.3g} GB; cut it up")
    on_disk = os.stat(path).st_size
    if size > _PLAIN and size > _RATIO * on_disk:
        raise ExchangeError(
            f"{where}: expected numbers, got {size / 1e6:.0f} MB in a file of {on_disk / 1e6:.3g} MB, which no "
            "recording shrinks to; if it is one, save it without compression"
        )


def refuse_mat_bomb(path: Path) -> None:
    """Refuse a MAT file of version 5 or 7 that unpacks to too much, claims too much or is nested too deep.

    Whatever reads such a file calls itself for every cell in a cell: deep enough, and the process dies of it.

    Raises:
        ExchangeError: it is one.
        OSError: the file cannot be read.
        zlib.error: its compressed parts are damaged.
    """
    unpacked = claimed = 0
    with open(path, "rb") as file:
        head = file.read(128)
        if head[126:128] not in (b"IM", b"MI"):
            return  # version 4 has neither cells nor compression
        order: Literal["little", "big"] = "little" if head[126:128] == b"IM" else "big"
        while len(tag := file.read(8)) == 8:
            kind, size = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            end = file.tell() + size
            if kind == _COMPRESSED:
                source = _Unpacked(path, file, size, unpacked)
                claimed += _claims(path, source, order, _LARGEST)
                unpacked = source.finish()
            elif kind == _MATRIX:
                file.seek(-8, os.SEEK_CUR)
                claimed += _claims(path, file, order, size + 8)
            refuse_bomb(path, "", claimed)
            file.seek(end)


class _Source(Protocol):
    def read(self, size: int, /) -> bytes: ...
    def seek(self, offset: int, whence: int, /) -> object: ...


class _Unpacked:
    """What a compressed element unpacks to, in order and in pieces.

    Args:
        size: bytes of the element, packed.
        before: bytes that the elements before it unpacked to.
    """

    def __init__(self, path: Path, file: BinaryIO, size: int, before: int) -> None:
        self._path, self._file, self._left, self._total = path, file, size, before
        self._stream = zlib.decompressobj()
        self._packed = self._piece = b""
        self._at = 0

    def read(self, size: int) -> bytes:
        taken = b""
        while len(taken) < size and self._filled():
            part = self._piece[self._at : self._at + size - len(taken)]
            self._at += len(part)
            taken += part
        return taken

    def seek(self, offset: int, whence: int) -> None:
        """Forward from here, which is all that is asked for."""
        assert whence == os.SEEK_CUR
        while offset > 0 and self._filled():
            passed = min(offset, len(self._piece) - self._at)
            self._at += passed
            offset -= passed

    def finish(self) -> int:
        """Pass over the rest; how much has been unpacked in all."""
        self.seek(2 * _LARGEST, os.SEEK_CUR)
        return self._total

    def _filled(self) -> bool:
        while self._at >= len(self._piece):
            if not self._packed:
                self._packed = self._file.read(min(self._left, _PIECE))
                self._left -= len(self._packed)
                if not self._packed:
                    return False
            self._piece, self._at = self._stream.decompress(self._packed, _PIECE), 0
            self._packed = self._stream.unconsumed_tail
            self._total += len(self._piece)
            refuse_bomb(self._path, "", self._total)
        return True


def _claims(path: Path, source: _Source, order: Literal["little", "big"], size: int) -> int:
    """What a matrix and all in it take in memory, by their own words, bytes.

    Args:
        size: bytes to come, at most.

    Raises:
        ExchangeError: a cell in a cell in a cell …, a part that passes the end of what it is in, or is of no type.
    """
    claimed, sign = 0, "<" if order == "little" else ">"
    inside = [[size, 0]]  # of each open matrix: bytes to come, elements seen
    while inside:
        if inside[-1][0] < _TAG or len(tag := source.read(_TAG)) < _TAG:
            inside.pop()
            continue
        kind, long = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
        if kind >> 16:  # a short element holds its data in the tag
            kind, long, padded = kind & 0xFFFF, 0, 0
        else:
            padded = long + -long % 8
        here = inside[-1]
        here[0] -= _TAG + padded
        here[1] += 1
        if kind not in _TYPES or here[0] < -8:
            raise ExchangeError(f"{path}: expected a whole MAT file, a part of it is none or passes its end: damaged?")
        if kind == _MATRIX:
            if len(inside) > _DEEPEST:
                raise ExchangeError(
                    f"{path}: expected columns of numbers, got more than {_DEEPEST} cells or structs in each other; "
                    "save the columns by themselves"
                )
            inside.append([long, 0])
        elif kind == _INT32 and here[1] == 2 and len(inside) > 1 and long <= 4 * _MOST_DIMENSIONS:
            told = source.read(padded)[: long - long % 4]
            claimed += 8 * math.prod(max(0, each) for (each,) in struct.iter_unpack(f"{sign}i", told))
        else:
            source.seek(padded, os.SEEK_CUR)
    return claimed
