"""Entrance of the page: STOP arrives with any other connections, and they are limited, timed out and counted."""

from __future__ import annotations

import json
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest

from live import entrance
from live.entrance import MOST_ANSWERED, MOST_ASKING, Connections, Entrance
from live.errors import CommandRefused
from live.guard import Access, hosts_of
from live.port import bound

TOKEN = "a-token"
WAIT_S = 20.0


@dataclass
class Served:
    """An entrance of a test, with what it did."""

    port: int
    stops: list[float] = field(default_factory=list)
    handed: list[tuple[socket.socket, bytes]] = field(default_factory=list)
    counts: Connections = field(default_factory=dict)
    taken: bool = True
    answer: Callable[[], Future[dict[str, Any]]] = field(default_factory=lambda: _done)

    def order(self) -> Future[dict[str, Any]]:
        self.stops.append(time.monotonic())
        return self.answer()

    def hand_over(self, given: socket.socket, head: bytes) -> bool:
        if self.taken:
            self.handed.append((given, head))
        return self.taken

    def report(self, counts: Connections) -> None:
        self.counts = counts

    def wait_for(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + WAIT_S
        while not condition():
            assert time.monotonic() < deadline, (self.counts, len(self.stops), len(self.handed))
            threading.Event().wait(0.01)


def _done() -> Future[dict[str, Any]]:
    answer = Future[dict[str, Any]]()
    answer.set_result({"done": True})
    return answer


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setattr(entrance, "_REPORT_S", 0.0)
    with bound("", 0) as listening:
        made = Served(int(listening.getsockname()[1]))
        access = Access(TOKEN, hosts_of("", made.port))
        one = Entrance(listening, access, made.order, made.hand_over, made.report)
        thread = threading.Thread(target=one.run)
        thread.start()
        yield made
        one.end()
        thread.join(WAIT_S)
        assert not thread.is_alive()
    for given, _ in made.handed:
        given.close()


def _connected(served: Served) -> socket.socket:
    return socket.create_connection(("127.0.0.1", served.port), timeout=WAIT_S)


def _request(served: Served, start: str = "POST /stop", token: str = TOKEN, **headers: str) -> bytes:
    ours = f"127.0.0.1:{served.port}"
    given = {"Host": ours, "Origin": f"http://{ours}", "Content-Length": "2", **headers}
    lines = [f"{start}?token={token} HTTP/1.1", *(f"{name}: {value}" for name, value in given.items() if value)]
    return ("\r\n".join(lines) + "\r\n\r\n{}").encode()


def _ask(served: Served, request: bytes) -> tuple[int, str]:
    """Status and body of the response, which ends with the connection."""
    with _connected(served) as line:
        line.sendall(request)
        whole = b""
        while data := line.recv(65536):
            whole += data
    head, _, body = whole.partition(b"\r\n\r\n")
    return int(head.split()[1]), body.decode()


@contextmanager
def _idle(served: Served, count: int) -> Iterator[list[socket.socket]]:
    """So many connections that send nothing."""
    with ExitStack() as stack:
        yield [stack.enter_context(_connected(served)) for _ in range(count)]


def test_a_stop_is_ordered_and_answered(served: Served) -> None:
    assert _ask(served, _request(served)) == (200, '{"done": true}')
    assert len(served.stops) == 1


@pytest.mark.parametrize(
    ("request_of", "status"),
    [
        (lambda s: _request(s, token="wrong"), 403),
        (lambda s: _request(s, Origin=""), 403),
        (lambda s: _request(s, Origin="http://evil.example"), 403),
        (lambda s: _request(s, Host="evil.example"), 400),
        (lambda s: b"\x16\x03\x01 no request\r\n\r\n", 400),
        (lambda s: b"POST /stop HTTP/1.1\r\n" + b"x: " + b"y" * 40_000, 400),
        (lambda s: _request(s).replace(b"Host:", b"Host: evil.example\r\nHost:"), 400),
    ],
)
def test_the_rules_of_the_page_hold_for_stop(
    served: Served, request_of: Callable[[Served], bytes], status: int
) -> None:
    assert _ask(served, request_of(served))[0] == status
    assert served.stops == []
    served.wait_for(lambda: served.counts.get("127.0.0.1", {}).get("refused") == 1)


def test_a_stop_in_single_bytes_is_one(served: Served) -> None:
    with _connected(served) as line:
        for byte in _request(served):
            line.sendall(bytes([byte]))
        assert line.recv(65536).startswith(b"HTTP/1.1 200 ")
    assert len(served.stops) == 1


def test_all_other_requests_are_handed_over_with_their_bytes(served: Served) -> None:
    request = _request(served, "POST /act")
    with _connected(served) as line:
        line.sendall(request)
        served.wait_for(lambda: bool(served.handed))
        given, head = served.handed[0]
        given.settimeout(WAIT_S)
        while len(head) < len(request):
            head += given.recv(65536)
        assert head == request
        given.sendall(b"from the page")
        assert line.recv(100) == b"from the page"


def test_a_request_for_a_busy_page_is_turned_away_and_a_stop_is_not(served: Served) -> None:
    served.taken = False
    assert _ask(served, _request(served, "POST /act"))[0] == 503
    assert _ask(served, _request(served))[0] == 200
    served.wait_for(lambda: served.counts.get("127.0.0.1") == {"busy": 1})


def test_idle_connections_are_limited_and_a_stop_passes_them(served: Served) -> None:
    with _idle(served, 3 * MOST_ASKING) as held:
        assert _ask(served, _request(served))[0] == 200
        served.wait_for(lambda: served.counts.get("127.0.0.1", {}).get("displaced", 0) >= 2 * MOST_ASKING)
        assert held[0].recv(1) == b"", "the oldest leave first"
        assert _ask(served, _request(served))[0] == 200


def test_idle_connections_and_slow_requests_are_timed_out(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entrance, "_ASKING_S", 0.2)
    with _idle(served, 2) as (silent, slow):
        slow.sendall(_request(served)[:20])
        assert (silent.recv(1), slow.recv(1)) == (b"", b"")
        served.wait_for(lambda: served.counts.get("127.0.0.1") == {"timed_out": 2})


def test_a_stop_passes_when_no_file_is_left(served: Served) -> None:
    """The clients of the test are in this process too: the limit is set once they are connected."""
    resource = pytest.importorskip("resource", reason="limits of files need POSIX")
    assert _ask(served, _request(served))[0] == 200
    with _idle(served, 20), _connected(served) as line:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (_open_files(), hard))
        try:
            line.sendall(_request(served))
            assert line.recv(65536).startswith(b"HTTP/1.1 200 ")
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def _open_files() -> int:
    with socket.socket() as probe:
        return probe.fileno()


def test_a_refused_stop_and_one_without_an_answer_are_reported(
    served: Served, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refused() -> Future[dict[str, Any]]:
        raise CommandRefused("stop: not possible for a log")

    served.answer = refused
    assert _ask(served, _request(served)) == (409, '{"error": "stop: not possible for a log"}')
    monkeypatch.setattr(entrance, "_ANSWER_S", 0.2)
    served.answer = Future
    caplog.set_level(logging.INFO, "live")
    assert _ask(served, _request(served)) == (409, '{"error": "stop: no answer from the recorder within 0.2 s"}')
    assert any("no answer from the recorder" in text for text in caplog.messages)


def test_orders_without_an_answer_are_limited(served: Served) -> None:
    answers: list[Future[dict[str, Any]]] = []

    def pending() -> Future[dict[str, Any]]:
        answers.append(Future[dict[str, Any]]())
        return answers[-1]

    served.answer = pending
    with _idle(served, MOST_ANSWERED) as held:
        for line in held:
            line.sendall(_request(served))
        served.wait_for(lambda: len(answers) == MOST_ANSWERED)
        assert _ask(served, _request(served))[0] == 503
        for answer in answers:
            answer.set_result({"done": True})
        assert all(json.loads(line.recv(65536).partition(b"\r\n\r\n")[2])["done"] for line in held)


def test_an_address_that_floods_displaces_its_own_connections(served: Served) -> None:
    with ExitStack() as stack:
        other = stack.enter_context(
            socket.create_connection(("127.0.0.1", served.port), WAIT_S, source_address=("127.0.0.2", 0))
        )
        stack.enter_context(_idle(served, MOST_ASKING + 20))
        served.wait_for(lambda: served.counts.get("127.0.0.1", {}).get("displaced", 0) >= 20)
        assert "127.0.0.2" not in served.counts
        other.sendall(_request(served))
        assert other.recv(65536).startswith(b"HTTP/1.1 200 ")
