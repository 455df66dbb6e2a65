"""A file read at any offset, without mapping it: a bad disk or a file cut by someone else is an error, no crash.

Reads carry their own offset (pread), so threads share one file.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

from zlib_ng.zlib_ng import crc32

from daq.errors import LogError
from rig_configs.regular_file import need_regular

PIECE_BYTES = 2**20
"""What is read at once where a long stretch is gone through."""


class FileBytes:
    """An open file; its size is what it was when opened.

    Args:
        path: the file.
    Raises:
        OSError: it cannot be opened, or is no file but a pipe, a folder or a device.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        need_regular(path)
        self._stream = open(path, "rb", buffering=0)  # noqa: SIM115 (lives as long as the log)
        try:
            self.size = self._stream.seek(0, os.SEEK_END)
        except OSError:
            self._stream.close()
            raise
        self._lock = threading.Lock()

    @property
    def closed(self) -> bool:
        """Nothing can be read any more."""
        return self._stream.closed

    def read(self, start: int, length: int) -> bytes:
        """Exactly `length` bytes from `start`.

        Raises:
            LogError: the file is closed, has fewer bytes, or the disk refuses them.
        """
        if self.closed:
            raise LogError(f"{self.path}: expected an open log, it was closed: read what you need before close()")
        if start < 0 or length < 0 or start + length > self.size:
            raise LogError(f"expected {length} bytes at byte {start}, the file has {self.size}")
        try:
            data = self._at(start, length)
            while len(data) < length:
                more = self._at(start + len(data), length - len(data))
                if not more:
                    raise LogError(
                        f"expected {length} bytes at byte {start}, got {len(data)}: the file was cut meanwhile"
                    )
                data += more
        except OSError as fault:
            raise LogError(
                f"expected {length} bytes at byte {start}, the disk refuses them ({fault.strerror})"
            ) from fault
        return data

    def crc(self, start: int, end: int, crc: int = 0) -> int:
        """CRC-32 of a stretch, continued from `crc`, in bounded memory.

        Raises:
            LogError: as `read`.
        """
        for at in range(start, end, PIECE_BYTES):
            crc = crc32(self.read(at, min(PIECE_BYTES, end - at)), crc)
        return crc

    def close(self) -> None:
        """Let go of the file."""
        self._stream.close()

    def __del__(self) -> None:
        if hasattr(self, "_stream"):  # a log that was only looked at need not be closed by hand
            self._stream.close()

    if hasattr(os, "pread"):

        def _at(self, start: int, length: int) -> bytes:
            return os.pread(self._stream.fileno(), length, start)

    else:  # Windows

        def _at(self, start: int, length: int) -> bytes:
            with self._lock:
                self._stream.seek(start)
                return self._stream.read(length) or b""
