"""Accepted connections are handed from one process to another, each with the bytes that were already read from it."""

from __future__ import annotations

import logging
import queue
import socket
import sys
import threading
from collections.abc import Iterator
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle

from rig_basics.ignoring import ignoring

MOST_WAITING = 32
_log = logging.getLogger(__name__)


class SocketSender:
    """Sends connections from a thread of its own, so that a process that reads nothing delays no other.

    Args:
        pipe: pipe to the other process, two-way.
        pid: the other process.
    """

    def __init__(self, pipe: Connection, pid: int) -> None:
        self._pipe, self._pid, self._broken = pipe, pid, False
        self._waiting: queue.Queue[tuple[socket.socket, bytes]] = queue.Queue(MOST_WAITING)
        threading.Thread(target=self._run, name="handover", daemon=True).start()

    def offer(self, given: socket.socket, head: bytes) -> bool:
        """Take a connection; False if too many wait or the other process has ended. Any thread."""
        if self._broken:
            return False
        try:
            self._waiting.put_nowait((given, head))
        except queue.Full:  # usual: the caller answers that
            return False
        return True

    def _run(self) -> None:
        while True:
            given, head = self._waiting.get()
            try:
                if sys.platform == "win32":
                    self._pipe.send_bytes(given.share(self._pid))
                else:
                    send_handle(self._pipe, given.fileno(), self._pid)
                self._pipe.send_bytes(head)
            except OSError as fault:
                self._broken = True
                _log.info("the process of the page takes no connections any more: %s", fault)
            given.close()


def received_sockets(pipe: Connection) -> Iterator[tuple[socket.socket, bytes]]:
    """Yield the connections of a SocketSender until its process ends."""
    with ignoring(_log, "receiving connections", EOFError, OSError):
        while True:
            if sys.platform == "win32":
                given = socket.fromshare(pipe.recv_bytes())
            else:
                given = socket.socket(fileno=recv_handle(pipe))
            yield given, pipe.recv_bytes()
