# pyright: strict
"""Worker processes that end with the one that started them."""

from __future__ import annotations

import contextlib
import os
import threading
from multiprocessing.connection import Connection


def end_with_parent(lifeline: Connection) -> None:
    """End this process as soon as the one that started it is gone, however it went.

    Args:
        lifeline: one end of a pipe whose other end is the parent's alone: when that is closed, nobody waits for what
            is being worked out.
    """

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):
            lifeline.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait, name="lifeline", daemon=True).start()
