"""Random access to a file without mapping it: a disk fault or a shortened file raises an error and does not crash.

Reads have their own offset (pread), so threads can share one file.
"""

from __future__ import annotations

import io
import os
import threading
from pathlib import Path

from daq.errors import LogError
from daq.mcap.checksum import crc32
from rig_basics.texts import number_of
from rig_configs.regular_file import need_regular

PIECE_BYTES = 2**20
"""Size of one read when a long range is read, bytes."""


class FileBytes:
    """An open file; its size is the size at opening.

    Args:
        path: path of the file.

    Raises:
        OSError: the file cannot be opened, or is a pipe, a folder or a device.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        need_regular(path)
        self._stream = io.FileIO(path)  # closed together with the log
        try:
            self.size: int = self._stream.seek(0, os.SEEK_END)
        except OSError:
            self._stream.close()
            raise
        self._lock = threading.Lock()

    @property
    def closed(self) -> bool:
        """True after `close`."""
        return self._stream.closed

    def read(self, start: int, length: int) -> bytes:
        """Read exactly `length` bytes from `start`.

        Raises:
            LogError: the file is closed or shorter, or the disk fails.
        """
        if self.closed:
            raise LogError(f"{self.path}: expected an open log, it was closed: read what you need before close()")
        if start < 0 or length < 0 or start + length > self.size:
            raise LogError(f"expected {number_of(length, 'byte')} at byte {start}, the file has {self.size}")
        try:
            data = self._at(start, length)
            while len(data) < length:
                more = self._at(start + len(data), length - len(data))
                if not more:
                    raise LogError(
                        f"expected {number_of(length, 'byte')} at byte {start}, got {len(data)}: the file was cut "
                        f"meanwhile"
                    )
                data += more
        except OSError as fault:
            raise LogError(
                f"expected {number_of(length, 'byte')} at byte {start}, the disk cannot read them ({fault.strerror})"
            ) from fault
        return data

    def crc(self, start: int, end: int, crc: int = 0) -> int:
        """Return the CRC-32 of a range, continued from `crc`, in bounded memory.

        Raises:
            LogError: as `read`.
        """
        for at in range(start, end, PIECE_BYTES):
            crc = crc32(self.read(at, min(PIECE_BYTES, end - at)), crc)
        return crc

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def __del__(self) -> None:
        if hasattr(self, "_stream"):  # a log that was only read need not be closed explicitly
            self._stream.close()

    if hasattr(os, "pread"):

        def _at(self, start: int, length: int) -> bytes:
            return os.pread(self._stream.fileno(), length, start)

    else:  # Windows

        def _at(self, start: int, length: int) -> bytes:
            with self._lock:
                self._stream.seek(start)
                return self._stream.read(length) or b""
