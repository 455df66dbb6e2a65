# pyright: strict
"""One picture as bytes: `RIG1`, the length of a JSON header, the header, float32 columns one after the other.

All is little-endian; the header is padded so that columns begin at a multiple of four. `page/frames.js` reads it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"RIG1"
_HEAD = struct.Struct("<4sI")
_COLUMNS = "columns"


def encode(header: Mapping[str, Any], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """A picture.

    Args:
        header: facts as JSON holds them; the key "columns" is the picture's own.
        columns: by name, each of shape (n,); they lose all beyond float32.
    """
    sizes = {name: len(values) for name, values in columns.items()}
    text = json.dumps({**header, _COLUMNS: sizes}, ensure_ascii=False, allow_nan=False).encode()
    text += b" " * (-(_HEAD.size + len(text)) % 4)
    parts = [np.ascontiguousarray(values, "<f4").tobytes() for values in columns.values()]
    return b"".join([_HEAD.pack(MAGIC, len(text)), text, *parts])


def decode(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[np.float32]]]:
    """Header and columns of a picture.

    Raises:
        ValueError: it is none, or is cut.
    """
    if len(data) < _HEAD.size or data[:4] != MAGIC:
        raise ValueError(f"expected a picture that begins with {MAGIC!r}, got {data[:8]!r}")
    _, length = _HEAD.unpack_from(data)
    header: dict[str, Any] = json.loads(data[_HEAD.size : _HEAD.size + length])
    columns: dict[str, NDArray[np.float32]] = {}
    place = _HEAD.size + length
    for name, size in header.pop(_COLUMNS).items():
        if place + 4 * size > len(data):
            raise ValueError(f"expected {size} numbers of column {name!r}, the picture ends before")
        columns[name] = np.frombuffer(data, "<f4", size, place)
        place += 4 * size
    return header, columns
