"""Control port of the virtual rig: manual actions of a person at the rig, faults, and the state of the simulation.

The protocol is one JSON object per line over TCP on loopback. The first request must contain the token that the rig
printed at its start. Each request has one answer line.
Requests: {"do": "pluck", "x_mm": …, "y_mm": …, "hold_s": …}, {"do": "flick", "pendulum": 0|1, "speed_rad_s": …},
{"do": "lock"}, {"do": "release"}, {"do": "turn", "rpm": …, "ramp_rpm_per_s": …} where no device does these,
{"do": "place", "device": …, "mm": …} holds the target of a displacement sensor, null releases it,
{"do": "set", "key": "suspension.k2_N_per_m", "value": …}, {"do": "truth"}, {"do": "state"}, {"do": "faults"},
{"do": "fail", "device": …, "what": …, "value": …, "seconds": …} or with "end": true,
{"do": "unplug", "device": …}, {"do": "plug", "device": …}, {"do": "quit"}.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import logging
import queue
import socket
import threading
from typing import Any, cast

from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_LINE_LIMIT = 65536


class ControlServer:
    """Accepts connections of the simulated operator. The loop of the rig carries out the requests.

    Args:
        token: token that every connection must present.

    Attributes:
        port: TCP port on loopback.
        requests: requests with the queues for their answers.
    """

    def __init__(self, token: str) -> None:
        self._token = token
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.requests: queue.Queue[tuple[dict[str, Any], queue.Queue[dict[str, Any]]]] = queue.Queue(100)
        self._unfetched = 0
        self._peers: set[socket.socket] = set()
        self._fetched = threading.Condition()
        threading.Thread(target=self._accept, name="control", daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                peer, _ = self._listener.accept()
            except OSError:  # usual: `close` has closed the port
                return
            threading.Thread(target=self._serve, args=(peer,), name="operator", daemon=True).start()

    def _serve(self, peer: socket.socket) -> None:
        self._peers.add(peer)
        try:
            with ignoring(_log, "serving an operator", OSError):  # the peer closed the connection
                self._converse(peer)
        finally:
            self._peers.discard(peer)
            peer.close()

    def _converse(self, peer: socket.socket) -> None:
        with peer.makefile("rwb") as stream:
            allowed = False
            while line := stream.readline(_LINE_LIMIT):
                request = _json_object(line)
                if request is None:
                    stream.write(b'{"error": "expected one JSON object a line"}\n')
                    return
                allowed = allowed or hmac.compare_digest(
                    str(request.get("token", "")).encode(errors="replace"), self._token.encode()
                )
                if not allowed:
                    stream.write(b'{"error": "expected the token the rig printed"}\n')
                    return
                answer: queue.Queue[dict[str, Any]] = queue.Queue(1)
                with self._fetched:
                    self._unfetched += 1
                self.requests.put((request, answer))
                try:
                    stream.write(json.dumps(answer.get()).encode() + b"\n")
                    stream.flush()
                finally:
                    with self._fetched:
                        self._unfetched -= 1
                        self._fetched.notify_all()

    def close(self, patience_s: float = 0.0) -> None:
        """Stop listening and close the connections.

        Args:
            patience_s: longest wait until pending answers have been sent, s.
        """
        self._listener.close()
        with self._fetched:
            self._fetched.wait_for(lambda: self._unfetched == 0, patience_s)
        for peer in list(self._peers):
            with ignoring(_log, "closing an operator's connection", OSError):
                peer.shutdown(socket.SHUT_RDWR)


def _json_object(line: bytes) -> dict[str, Any] | None:
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):  # usual: not JSON, which the peer gets as an error
        return None
    return cast("dict[str, Any]", value) if isinstance(value, dict) else None


class OperatorLine:
    """Connection of the simulated operator to the control port.

    Args:
        port, token: as printed by the rig.
    """

    def __init__(self, port: int, token: str) -> None:
        self._token = token
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        self._stream = self._socket.makefile("rwb")
        self._lock = threading.Lock()

    def ask(self, do: str, **what: Any) -> dict[str, Any]:
        """Send one request and wait for its answer.

        Raises:
            ConnectionError: the rig closed the connection.
            ValueError: the rig refused the request; the message contains the reason.
        """
        with self._lock:
            self._stream.write(json.dumps({"token": self._token, "do": do, **what}).encode() + b"\n")
            self._stream.flush()
            line = self._stream.readline(16 * 1024 * 1024)
        if not line:
            raise ConnectionError("the virtual rig closed its control port")
        answer = json.loads(line)
        if "error" in answer:
            raise ValueError(f"virtual rig: {answer['error']}")
        return answer

    def wait_for_end(self) -> None:
        """Wait until the rig has ended after the request "quit".

        Raises:
            TimeoutError: the rig has not ended within ten seconds.
        """
        with contextlib.suppress(ConnectionError):  # usual: the end of the rig may reset the connection
            while self._socket.recv(1):
                pass

    def close(self) -> None:
        """Close the connection."""
        self._stream.close()
        self._socket.close()
