"""Encoding of one picture: `RIG1`, the length of a JSON header, the header, and float32 columns.

All numbers are little-endian. The header is padded so that the columns begin at a multiple of four bytes.
`page/frames.js` decodes it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig_basics.texts import number_of, storable

MAGIC = b"RIG1"
_HEAD = struct.Struct("<4sI")
_COLUMNS = "columns"


def encode(header: Mapping[str, Any], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Encode a picture.

    Args:
        header: facts as JSON values; the key "columns" is reserved.
        columns: columns by name, each of shape (n,); converted to float32.
    """
    sizes = {name: len(values) for name, values in columns.items()}
    text = storable(json.dumps({**header, _COLUMNS: sizes}, ensure_ascii=False, allow_nan=False)).encode()
    text += b" " * (-(_HEAD.size + len(text)) % 4)
    parts = [np.ascontiguousarray(values, "<f4").tobytes() for values in columns.values()]
    return b"".join([_HEAD.pack(MAGIC, len(text)), text, *parts])


def decode(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[np.float32]]]:
    """Decode the header and the columns of a picture.

    Raises:
        ValueError: the data are not a picture, or are incomplete.
    """
    if len(data) < _HEAD.size or data[:4] != MAGIC:
        raise ValueError(f"expected a picture that begins with {MAGIC!r}, got {data[:8]!r}")
    _, length = _HEAD.unpack_from(data)
    header: dict[str, Any] = json.loads(data[_HEAD.size : _HEAD.size + length])
    columns: dict[str, NDArray[np.float32]] = {}
    place = _HEAD.size + length
    for name, size in header.pop(_COLUMNS).items():
        if place + 4 * size > len(data):
            raise ValueError(f"expected {number_of(size, 'number')} of column {name!r}, the picture ends before")
        columns[name] = np.frombuffer(data, "<f4", size, place)
        place += 4 * size
    return header, columns
