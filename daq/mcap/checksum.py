"""CRC-32 as MCAP uses it, with types; zlib-ng computes it several times faster than zlib."""

from __future__ import annotations

from typing import Any, Protocol, cast

from zlib_ng import zlib_ng


class _Crc32(Protocol):
    def __call__(self, data: bytes | bytearray | memoryview, value: int = 0, /) -> int: ...


crc32: _Crc32 = cast("Any", zlib_ng).crc32
"""CRC-32 of `data`, continued from `value`."""
