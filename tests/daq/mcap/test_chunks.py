"""Chunks are unpacked to the size that they announce, and no further."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import lz4.frame
import pytest
import zstandard

from daq.mcap.checksum import crc32
from daq.mcap.chunks import CHUNK_LIMIT_BYTES, ChunkHead, unpack
from daq.mcap.records import DamageError

DATA = bytes(range(256)) * 40


def lz4_frame(data: bytes) -> bytes:
    return cast("Any", lz4.frame).compress(data)


PACKERS: dict[str, Callable[[bytes], bytes]] = {"": bytes, "zstd": zstandard.compress, "lz4": lz4_frame}


def head(compression: str, size: int = len(DATA), crc: int | None = None) -> ChunkHead:
    return ChunkHead(0, 0, size, crc32(DATA) if crc is None else crc, compression, 49, 0)


@pytest.mark.parametrize("compression", PACKERS)
def test_a_chunk_has_its_size_and_its_crc(compression: str) -> None:
    packed = PACKERS[compression](DATA)
    assert unpack(packed, head(compression), True) == DATA
    assert unpack(memoryview(packed), head(compression, crc=0), False) == DATA
    for wrong in (head(compression, crc=5), head(compression, len(DATA) - 1), head(compression, len(DATA) + 1)):
        with pytest.raises(DamageError, match=r"CRC|instead of"):
            unpack(packed, wrong, False)
    with pytest.raises(DamageError, match="CRC"):
        unpack(packed, head(compression, crc=0), True)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("size", [0, 1, 1000])
def test_no_more_than_announced_is_unpacked(compression: str, size: int) -> None:
    """A hundred frames of 10 MB: one byte too many shows the fault."""
    packed = PACKERS[compression](bytes(10**7)) * 100
    with pytest.raises(DamageError, match=f"a chunk of {size + 1} bytes? instead of {size}"):
        unpack(packed, head(compression, size), False)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize(("before", "cut", "after"), [(b"", 5, b""), (b"junk", 0, b""), (b"", 0, b"junk")])
def test_damaged_compression_is_damage(compression: str, before: bytes, cut: int, after: bytes) -> None:
    packed = PACKERS[compression](DATA)
    with pytest.raises(DamageError):
        unpack(before + packed[: len(packed) - cut] + after, head(compression, crc=0), False)


def test_other_compressions_and_larger_chunks_are_refused() -> None:
    with pytest.raises(DamageError, match="compressed with 'xz', not with one of zstd, lz4"):
        unpack(DATA, head("xz"), False)
    with pytest.raises(DamageError, match=f"more than the {CHUNK_LIMIT_BYTES} that are unpacked"):
        unpack(DATA, head("", CHUNK_LIMIT_BYTES + 1), False)
