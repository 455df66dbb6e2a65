"""End of worker processes with the process that started them."""

from __future__ import annotations

import contextlib
import os
import threading
from multiprocessing.connection import Connection


def end_with_parent(lifeline: Connection) -> None:
    """End this process as soon as its parent has ended in any way.

    Args:
        lifeline: one end of a pipe whose other end only the parent has. When it is closed, the results of this process
            are not needed any more.
    """

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):  # usual: the parent has ended
            lifeline.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait, name="lifeline", daemon=True).start()
