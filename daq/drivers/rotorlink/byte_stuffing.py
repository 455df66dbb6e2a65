"""COBS (consistent overhead byte stuffing): typed functions of the package cobs, which has no annotations."""

from __future__ import annotations

from typing import Final, Protocol

from cobs import cobs


class _Codec(Protocol):
    def encode(self, in_bytes: bytes, /) -> bytes: ...

    def decode(self, in_bytes: bytes, /) -> bytes: ...


_codec: _Codec = cobs

DecodeError: Final[type[Exception]] = cobs.DecodeError
"""The bytes are not a run of COBS."""


def encode(payload: bytes) -> bytes:
    """Return the payload as a run without zero bytes; the 0x00 that ends the run is not included."""
    return _codec.encode(payload)


def decode(run: bytes) -> bytes:
    """Return the payload of a run.

    Args:
        run: bytes without the 0x00 that ends the run.
    Raises:
        DecodeError: the bytes are not a run of COBS.
    """
    return _codec.decode(run)
