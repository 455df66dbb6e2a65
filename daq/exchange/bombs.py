"""Rejection of small files that would fill the memory when they are read."""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

from daq.exchange.errors import ExchangeError

_MAX_BYTES = 2**32  # memory that one file may need
_PLAIN_BYTES = 2**28  # memory that any file may need, for any compression ratio
_MAX_RATIO = 100  # of memory to file size: noise shrinks to a third, a constant column a thousandfold, not all columns
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15  # element types of MAT version 5
_TYPES = frozenset((*range(1, 8), 9, *range(12, 19)))  # all defined types; scipy looks up others beyond its table
_MAX_DEPTH = 64  # of nested cells and structs
_MAX_DIMENSIONS = 32
_PIECE_BYTES = 2**20

_Read = Callable[[int, int], bytes]
"""Returns some bytes from a place on, or fewer at the end."""


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
    with open(path, "rb") as file:  # not mapped: a file that is cut meanwhile would end the process

        def read(at: int, size: int) -> bytes:
            file.seek(at)
            return file.read(size)

        sign = {b"IM": "<", b"MI": ">"}.get(read(126, 2))
        if sign is None:
            return  # version 4 has neither cells nor compression
        at = 128
        while len(tag := read(at, 8)) == 8:
            kind, size = struct.unpack(f"{sign}II", tag)
            if kind == _COMPRESSED:
                content = _unpacked(path, read, at + 8, size, unpacked)
                unpacked += len(content)
                claimed += _claims(path, lambda at, size, of=content: bytes(of[at : at + size]), sign, 0, _MAX_BYTES)
            elif kind == _MATRIX:
                claimed += _claims(path, read, sign, at, at + 8 + size)
            refuse_bomb(path, "", claimed)
            at += 8 + size


def _unpacked(path: Path, read: _Read, at: int, size: int, before: int) -> bytearray:
    """Return the content of a compressed element at a place, after `before` bytes of other elements.

    Raises:
        ExchangeError: the file unpacks to too much; no more than the permitted size was unpacked.
    """
    most = min(_MAX_BYTES, max(_PLAIN_BYTES, _MAX_RATIO * os.stat(path).st_size))
    stream, content = zlib.decompressobj(), bytearray()
    for start in range(at, at + size, _PIECE_BYTES):
        piece = read(start, min(_PIECE_BYTES, at + size - start))
        content += stream.decompress(piece, most - before - len(content) + 1)
        refuse_bomb(path, "", before + len(content))
        if not piece or stream.eof:
            break
    return content


def _claims(path: Path, read: _Read, sign: str, at: int, end: int) -> int:
    """Return the memory that a matrix and its contents need according to their heads, bytes.

    Args:
        path: the file, for messages.
        read, sign: reads the bytes with the matrix; sign of their byte order.
        at, end: place of the matrix and its largest end.

    Raises:
        ExchangeError: cells are nested too deeply, or a part exceeds its container or has an unknown type.
    """
    claimed = 0
    inside = [[end, 0]]  # of each open matrix: its end, number of elements
    while inside:
        here = inside[-1]
        if at + 8 > here[0] or len(tag := read(at, 8)) < 8:
            inside.pop()
            continue
        kind, size = struct.unpack(f"{sign}II", tag)
        at += 8
        if kind >> 16:  # a short element holds its data in the tag
            kind, size = kind & 0xFFFF, 0
        padded = size + -size % 8
        here[1] += 1
        if kind not in _TYPES or at + padded > here[0] + 8:
            raise ExchangeError(f"{path}: expected a whole MAT file, a part is invalid or exceeds its end: damaged?")
        if kind == _MATRIX:
            if len(inside) > _MAX_DEPTH:
                raise ExchangeError(
                    f"{path}: expected columns of numbers, got more than {_MAX_DEPTH} nested cells or structs; "
                    "save the columns separately"
                )
            inside.append([at + size, 0])
            continue
        if kind == _INT32 and here[1] == 2 and len(inside) > 1 and size <= 4 * _MAX_DIMENSIONS:
            dimensions = read(at, size)
            whole = dimensions[: len(dimensions) // 4 * 4]
            claimed += 8 * math.prod(max(0, each) for (each,) in struct.iter_unpack(f"{sign}i", whole))
        at += padded
    return claimed
