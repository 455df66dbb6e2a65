"""Rejection of small files that would fill the memory when they are read."""

from __future__ import annotations

import math
import os
import struct
import zlib
from pathlib import Path
from typing import BinaryIO, Literal, Protocol

from daq.exchange.errors import ExchangeError

_MAX_BYTES = 2**32  # memory that one file may need
_PLAIN_BYTES = 2**28  # memory that any file may need, for any compression ratio
_MAX_RATIO = 100  # of memory to file size: noise shrinks to a third, a constant column a thousandfold, not all columns
_PIECE_BYTES = 2**20
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15  # element types of MAT version 5
_TYPES = frozenset((*range(1, 8), 9, *range(12, 19)))  # all defined types; scipy looks up others beyond its table
_TAG_BYTES = 8  # before each element
_MAX_DEPTH = 64  # of nested cells and structs
_MAX_DIMENSIONS = 32


def refuse_bomb(path: Path, what: str, size: int) -> None:
    """Raise if a file would take more memory than a recording of this file size can need.

    Args:
        path: the file.
        what: part of the file, for the message; empty for the whole file.
        size: size in memory according to the file, bytes.

    Raises:
        ExchangeError: the file is too large.
    """
    where = f"{path}: {what}" if what else f"{path}"
    if size > _MAX_BYTES:
        raise ExchangeError(f"{where}: expected at most 4 GB of numbers, got {size / 1e9:.3g} GB; split it")
    on_disk = os.stat(path).st_size
    if size > _PLAIN_BYTES and size > _MAX_RATIO * on_disk:
        raise ExchangeError(
            f"{where}: expected numbers, got {size / 1e6:.0f} MB in a file of {on_disk / 1e6:.3g} MB, a ratio that no "
            "recording reaches; if it is a recording, save it without compression"
        )


def refuse_mat_bomb(path: Path) -> None:
    """Raise for a MAT file of version 5 or 7 that unpacks to too much, claims too much or is nested too deeply.

    Readers of such files call themselves for every nested cell; with enough levels the process crashes.

    Raises:
        ExchangeError: the file has one of these properties.
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
                claimed += _claims(path, source, order, _MAX_BYTES)
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
    """Unpacked content of a compressed element, read forward in pieces.

    Args:
        path, file: the file.
        size: packed size of the element, bytes.
        before: unpacked size of the elements before it, bytes.
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
        """Skip forward from the present position; other modes are not needed."""
        assert whence == os.SEEK_CUR
        while offset > 0 and self._filled():
            passed = min(offset, len(self._piece) - self._at)
            self._at += passed
            offset -= passed

    def finish(self) -> int:
        """Skip the rest; return the total unpacked size, bytes."""
        self.seek(2 * _MAX_BYTES, os.SEEK_CUR)
        return self._total

    def _filled(self) -> bool:
        while self._at >= len(self._piece):
            if not self._packed:
                self._packed = self._file.read(min(self._left, _PIECE_BYTES))
                self._left -= len(self._packed)
                if not self._packed:
                    return False
            self._piece, self._at = self._stream.decompress(self._packed, _PIECE_BYTES), 0
            self._packed = self._stream.unconsumed_tail
            self._total += len(self._piece)
            refuse_bomb(self._path, "", self._total)
        return True


def _claims(path: Path, source: _Source, order: Literal["little", "big"], size: int) -> int:
    """Return the memory that a matrix and its contents need according to their heads, bytes.

    Args:
        path, source, order: the file, its content and its byte order.
        size: largest remaining size, bytes.

    Raises:
        ExchangeError: cells are nested too deeply, or a part exceeds its container or has an unknown type.
    """
    claimed, sign = 0, "<" if order == "little" else ">"
    inside = [[size, 0]]  # of each open matrix: remaining bytes, number of elements
    while inside:
        if inside[-1][0] < _TAG_BYTES or len(tag := source.read(_TAG_BYTES)) < _TAG_BYTES:
            inside.pop()
            continue
        kind, long = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
        if kind >> 16:  # a short element holds its data in the tag
            kind, long, padded = kind & 0xFFFF, 0, 0
        else:
            padded = long + -long % 8
        here = inside[-1]
        here[0] -= _TAG_BYTES + padded
        here[1] += 1
        if kind not in _TYPES or here[0] < -8:
            raise ExchangeError(f"{path}: expected a whole MAT file, a part is invalid or exceeds its end: damaged?")
        if kind == _MATRIX:
            if len(inside) > _MAX_DEPTH:
                raise ExchangeError(
                    f"{path}: expected columns of numbers, got more than {_MAX_DEPTH} nested cells or structs; "
                    "save the columns separately"
                )
            inside.append([long, 0])
        elif kind == _INT32 and here[1] == 2 and len(inside) > 1 and long <= 4 * _MAX_DIMENSIONS:
            dimensions = source.read(padded)[: long - long % 4]
            claimed += 8 * math.prod(max(0, each) for (each,) in struct.iter_unpack(f"{sign}i", dimensions))
        else:
            source.seek(padded, os.SEEK_CUR)
    return claimed
