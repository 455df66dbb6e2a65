"""Standard output and standard error of a command: where they cannot be written, only the printed text is lost.

Messages and progress go to standard error while a rig is recorded. They are written by a thread of its own: a terminal
that is held or gone, a full pipe and a full disk neither delay nor end what the command does. Text that cannot be
written is dropped.

Results go to standard output, at the end of a command. If they cannot be written, the command ends with `OutputLost`.
"""

from __future__ import annotations

import atexit
import io
import os
import queue
import select
import shutil
import sys
import threading
import time
from typing import TYPE_CHECKING, TextIO

from rig_basics.errors import RigError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_MOST_TEXTS = 20_000  # texts that wait for a held terminal: at 2 kB for a page of a recording, 40 MB
_FINISH_S = 5.0  # the program waits so long for a held terminal at its end
_LEAST_WIDTH, _MOST_WIDTH = 20, 1000  # of tables and frames, characters
_MOST_DIGITS = 9  # digits of COLUMNS that are read
_RETRY_S = 1.0  # between two attempts on a descriptor that another program made non-blocking


_last_output = [0.0]  # time of the last text, monotonic, s


def last_output_s() -> float:
    """Return when a text was last written to standard output or standard error: monotonic time, s; 0: never."""
    return _last_output[0]


class OutputLost(RigError, OSError):
    """Standard output cannot be written: it is closed, its disk is full, or its reader is gone (errno EPIPE)."""


class MessageStream(io.TextIOBase):
    """Text stream that a thread writes to a file descriptor; no call waits or raises an error of the descriptor.

    Args:
        descriptor: of the file, which stays open.
        encoding: of the text. Characters that it lacks are written as question marks.
    """

    def __init__(self, descriptor: int, encoding: str) -> None:
        self._descriptor, self._encoding = descriptor, encoding
        self._texts: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._writer = threading.Thread(target=self._write_texts, name="standard error", daemon=True)
        self._writer.start()

    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] (the base has a property too)
        """Encoding of the text."""
        return self._encoding

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Return whether the descriptor is a terminal."""
        return os.isatty(self._descriptor)

    def write(self, text: str, /) -> int:
        """Queue a text and return its length."""
        _last_output[0] = time.monotonic()
        if self._texts.qsize() < _MOST_TEXTS:
            self._texts.put(text)
        return len(text)

    def finish(self) -> None:
        """Wait until all texts are written, for five seconds at the most, and end the thread."""
        self._texts.put(None)
        self._writer.join(_FINISH_S)

    def _write_texts(self) -> None:
        """Write to the descriptor itself: a lock of another stream would be held with the terminal."""
        while (text := self._texts.get()) is not None:
            tail = memoryview(text.encode(self._encoding, errors="replace"))
            while tail:
                try:
                    tail = tail[os.write(self._descriptor, tail) :]
                except BlockingIOError:  # usual: the descriptor is non-blocking and full
                    select.select([], [self._descriptor], [], _RETRY_S)
                except OSError:  # usual: the disk is full, or the terminal or the reader is gone
                    break


class _Results(io.FileIO):
    """Standard output whose errors are `OutputLost`."""

    def write(self, data: ReadableBuffer, /) -> int | None:
        _last_output[0] = time.monotonic()
        try:
            return super().write(data)
        except OSError as error:
            raise OutputLost(
                error.errno,
                f"standard output cannot be written ({error.strerror}), what the command prints is lost; make room, or "
                "direct it to another file",
            ) from error


def open_streams() -> None:
    """Replace `sys.stdout` and `sys.stderr` by streams of this module. The end of the program waits for the messages.

    Standard descriptors that are closed are opened on the null device, the output only for reading. Otherwise the
    command's own files would get their numbers, and text meant for a terminal would be written into a log.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:  # usual: open
            os.open(os.devnull, os.O_WRONLY if descriptor == 2 else os.O_RDONLY)
    results = io.BufferedWriter(_Results(1, "w", closefd=False))
    at_once = os.isatty(1) or bool(os.environ.get("PYTHONUNBUFFERED"))
    sys.stdout = io.TextIOWrapper(results, _encoding(sys.stdout, 1), "replace", line_buffering=at_once)
    messages = MessageStream(2, _encoding(sys.stderr, 2))
    sys.stderr = messages
    _limit_width()
    atexit.register(messages.finish)


def _limit_width() -> None:
    """Limit the width of tables and frames, which is that of the terminal or `COLUMNS`.

    Their layout takes minutes for a width that does not hold a word with its indentation, and the memory of a line for
    each row of a frame.
    """
    given = os.environ.get("COLUMNS", "")
    width = int(given[:_MOST_DIGITS]) if given.isdecimal() else shutil.get_terminal_size().columns
    if given or not _LEAST_WIDTH <= width <= _MOST_WIDTH:
        os.environ["COLUMNS"] = str(min(max(width, _LEAST_WIDTH), _MOST_WIDTH))


def discard_results() -> None:
    """Write what is printed from now on, and what waits to be written, to the null device."""
    with open(os.devnull, "wb") as null:
        os.dup2(null.fileno(), 1)


def _encoding(stream: TextIO | None, descriptor: int) -> str:
    return os.device_encoding(descriptor) or (stream.encoding if stream is not None else "utf-8")
