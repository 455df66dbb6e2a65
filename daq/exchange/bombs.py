# pyright: strict
"""Files that are small on the disk and fill the memory when they are read."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

from daq.exchange.errors import ExchangeError

_LARGEST = 2**32  # bytes that one reading may take
_PLAIN = 2**28  # bytes that any file may hold
_RATIO = 100  # noise shrinks to a third, a constant column a thousandfold: but not all columns are constant
_PIECE = 2**20
_COMPRESSED = 15  # element type of MAT version 5


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
    """Refuse a MAT file of version 5 or 7 whose compressed parts unpack to too much.

    Raises:
        ExchangeError: they do.
        OSError: the file cannot be read.
        zlib.error: they are damaged.
    """
    unpacked = 0
    with open(path, "rb") as file:
        head = file.read(128)
        if head[126:128] not in (b"IM", b"MI"):
            return  # version 4 has no compression
        order = "little" if head[126:128] == b"IM" else "big"
        while len(tag := file.read(8)) == 8:
            kind, size = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            if kind != _COMPRESSED:
                file.seek(size, os.SEEK_CUR)
                continue
            stream = zlib.decompressobj()
            while size > 0 and (packed := file.read(min(size, _PIECE))):
                size -= len(packed)
                while packed:
                    unpacked += len(stream.decompress(packed, _PIECE))
                    packed = stream.unconsumed_tail
                    refuse_bomb(path, "", unpacked)
