"""The Foxglove connection over a real line: who gets in, what comes, what a hostile or a dead client costs."""

from __future__ import annotations

import base64
import json
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from playwright.sync_api import Browser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from daq.log import Log, open_log
from live.errors import PortTaken
from live.foxglove.client import LEFT_OUT, MOST_BYTES, MOST_REFUSED, Turn
from live.foxglove.played import LogMessages, LogSender
from live.foxglove.protocol import SUBPROTOCOLS, time_data
from live.foxglove.server import MOST_CLIENTS, FoxgloveServer
from live.transport import Transport

WAIT_S = 20.0
ALLOWED = "https://app.foxglove.dev"


@pytest.fixture(scope="module")
def log(point_log: Path) -> Iterator[Log]:
    with open_log(point_log) as opened:
        yield opened


@pytest.fixture(scope="module")
def played(log: Log) -> LogMessages:
    return LogMessages(log)


REFUSED: list[str] = []


@pytest.fixture
def server(played: LogMessages) -> Iterator[FoxgloveServer]:
    REFUSED.clear()
    with FoxgloveServer("a.mcap", played.offered, {"rig": "virtual"}, [ALLOWED], 0, REFUSED.append) as running:
        yield running


@contextmanager
def _client(
    server: FoxgloveServer, protocols: tuple[str, ...] = SUBPROTOCOLS, origin: str | None = None, **more: Any
) -> Iterator[ClientConnection]:
    with connect(
        server.url,
        subprotocols=[Subprotocol(each) for each in protocols] or None,
        compression=None,
        origin=Origin(origin) if origin is not None else None,
        **more,
    ) as line:
        yield line


def _next_text(line: ClientConnection) -> dict[str, Any]:
    """The next text; messages in between are passed over."""
    while True:
        data = line.recv(timeout=WAIT_S)
        if isinstance(data, str):
            return json.loads(data)


def _begun(line: ClientConnection) -> dict[str, dict[str, Any]]:
    """Channels by topic, after the first message."""
    assert _next_text(line)["op"] == "serverInfo"
    advertised = _next_text(line)
    assert advertised["op"] == "advertise"
    return {each["topic"]: each for each in advertised["channels"]}


def _synced(line: ClientConnection) -> None:
    """All that was sent before has been carried out: answers come in the order of the questions."""
    line.send('{"op": "are you there?"}')
    assert "are you there" in _next_text(line)["message"]


def _subscribed(line: ClientConnection, *topics: str) -> dict[int, str]:
    """Subscribe; topics by subscription id."""
    channels = _begun(line)
    wanted = {100 + place: topic for place, topic in enumerate(topics)}
    pairs = [{"id": own, "channelId": channels[topic]["id"]} for own, topic in wanted.items()]
    line.send(json.dumps({"op": "subscribe", "subscriptions": pairs}))
    _synced(line)
    return wanted


def _messages(line: ClientConnection, until_ns: int) -> list[tuple[int, int, bytes, int]]:
    """Subscription id, time, payload, clock before it; until the clock is there."""
    found: list[tuple[int, int, bytes, int]] = []
    clock_ns = 0
    while clock_ns < until_ns:
        data = line.recv(timeout=WAIT_S)
        assert isinstance(data, bytes), data
        if data[0] == 2:
            (clock_ns,) = struct.unpack("<xQ", data)
        else:
            own, time_ns = struct.unpack_from("<xIQ", data)
            found.append((own, time_ns, data[13:], clock_ns))
    return found


# --- the handshake -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", SUBPROTOCOLS)
def test_either_name_of_the_protocol_is_accepted(server: FoxgloveServer, protocol: str) -> None:
    with _client(server, ("other", protocol)) as line:
        assert line.subprotocol == protocol
        assert {"laser/x", "events"} <= set(_begun(line))


def test_of_both_names_the_older_is_chosen(server: FoxgloveServer) -> None:
    with _client(server, ("foxglove.sdk.v1", "foxglove.websocket.v1")) as line:
        assert line.subprotocol == "foxglove.websocket.v1"


@pytest.mark.parametrize("protocols", [(), ("foxglove.websocket.v2",)])
def test_another_protocol_is_refused(server: FoxgloveServer, protocols: tuple[str, ...]) -> None:
    with pytest.raises(InvalidStatus) as refused, _client(server, protocols):
        pass
    assert refused.value.response.status_code == 400


@pytest.mark.parametrize("origin", [None, "file://", ALLOWED])
def test_programs_and_allowed_pages_get_in(server: FoxgloveServer, origin: str | None) -> None:
    with _client(server, origin=origin) as line:
        assert "motor" in _begun(line)
    assert REFUSED == []


FOREIGN = [
    "https://evil.example",
    "null",
    "",
    "http://app.foxglove.dev",
    "https://app.foxglove.dev.evil.example",
    "https://app.foxglove.dev:444",
    "https://studio.foxglove.dev",
    "file://evil",
    "http://127.0.0.1:8765",
]


@pytest.mark.parametrize("origin", FOREIGN)
def test_pages_of_foreign_origin_are_refused_and_reported(server: FoxgloveServer, origin: str) -> None:
    with pytest.raises(InvalidStatus) as refused, _client(server, additional_headers={"Origin": origin}):
        pass
    assert refused.value.response.status_code == 403
    assert [*REFUSED] == [origin]


def test_two_origins_are_refused(server: FoxgloveServer) -> None:
    headers = [("Origin", ALLOWED), ("Origin", ALLOWED)]
    with pytest.raises(InvalidStatus) as refused, _client(server, additional_headers=headers):
        pass
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil.example:{port}"])
def test_a_foreign_host_is_refused(server: FoxgloveServer, host: str) -> None:
    port = int(server.url.rpartition(":")[2])
    address, ours = f"ws://{host.format(port=port)}", [Subprotocol(SUBPROTOCOLS[0])]
    with (
        socket.create_connection(("127.0.0.1", port)) as line,
        pytest.raises(InvalidStatus) as refused,
        connect(address, sock=line, subprotocols=ours),
    ):
        pass
    assert refused.value.response.status_code == 400


def test_a_browsers_page_gets_nothing(server: FoxgloveServer, browser: Browser, tmp_path: Path) -> None:
    """What a real browser sends from a file and from another page is refused."""
    page = tmp_path / "hostile.html"
    page.write_text(
        f"""<script>
        const line = new WebSocket("{server.url}", {json.dumps(list(SUBPROTOCOLS))});
        line.onopen = () => document.title = "open"; line.onerror = () => document.title = "refused";
        </script>""",
        encoding="utf-8",
    )
    tab = browser.new_page()
    tab.goto(page.as_uri())
    tab.wait_for_function("document.title !== ''", timeout=WAIT_S * 1e3)
    title = tab.title()
    tab.close()
    assert (title, REFUSED) == ("refused", ["null"])


def test_too_many_clients_are_refused(server: FoxgloveServer) -> None:
    contexts = [_client(server) for _ in range(MOST_CLIENTS)]
    for context in contexts:
        _begun(context.__enter__())
        _ = context
    _wait(lambda: len(server.clients) == MOST_CLIENTS)
    with pytest.raises(InvalidStatus) as refused, _client(server):
        pass
    assert refused.value.response.status_code == 503
    for context in contexts:
        context.__exit__(None, None, None)


def test_a_port_that_cannot_be_had_is_named(server: FoxgloveServer) -> None:
    taken = int(server.url.rpartition(":")[2])
    for port in (taken, 65536, -1):
        with pytest.raises(PortTaken, match=f"127.0.0.1:{port}.*another port"):
            FoxgloveServer("b", [], {}, (), port)


def _wait(condition: Any) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "it did not come true"
        time.sleep(0.01)


# --- what comes ----------------------------------------------------------------------------------------------------


def _class_of(channel: dict[str, Any]) -> Any:
    """The message class that a program makes of what was advertised."""
    pool = descriptor_pool.DescriptorPool()
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


def test_protobuf_gives_the_numbers_of_the_log(server: FoxgloveServer, played: LogMessages, log: Log) -> None:
    start_ns = int(log["motor"].time_ns[50])
    end_ns = start_ns + 2 * 10**9
    with _client(server) as line:
        classes = {topic: _class_of(c) for topic, c in _begun(line).items() if c["encoding"] == "protobuf"}
    with _client(server) as line:
        topics = _subscribed(line, "laser/x", "pendulums", "motor", "tacho", "events", "health")
        server.show(played.turn(start_ns, end_ns))
        came = _messages(line, end_ns)
    assert [clock for *_, clock in came] == [time_ns for _, time_ns, *_ in came] == sorted(m[1] for m in came)
    for own, topic in topics.items():
        ours = [(time_ns, data) for number, time_ns, data, _ in came if number == own]
        if topic in ("events", "health"):
            logged = [n for n in (log.events if topic == "events" else log.health) if start_ns < n["time_ns"] <= end_ns]
            assert [json.loads(data) for _, data in ours] == logged
            assert len(ours) >= (2 if topic == "health" else 0)
            continue
        samples = log[topic]
        rows = np.flatnonzero((samples.time_ns > start_ns) & (samples.time_ns <= end_ns))
        assert len(rows) == len(ours) > 0, topic
        for row, (time_ns, data) in zip(rows, ours, strict=True):
            message = classes[topic].FromString(data)
            assert time_ns == samples.time_ns[row]
            for field in samples:
                np.testing.assert_equal(getattr(message, field), samples[field][row].item())


def test_what_is_no_more_wanted_does_not_come(server: FoxgloveServer, played: LogMessages, log: Log) -> None:
    start_ns = int(log["motor"].time_ns[50])
    with _client(server) as line, _client(server) as other:
        topics = _subscribed(line, "motor", "pendulums")
        _subscribed(other, "motor")
        line.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [101]}))
        _synced(line)
        server.show(played.turn(start_ns, start_ns + 10**9))
        came, others = (_messages(each, start_ns + 10**9) for each in (line, other))
    assert {topics[own] for own, *_ in came} == {"motor"}
    assert [m[1:3] for m in came] == [m[1:3] for m in others]


def test_the_clock_goes_back_only_after_a_seek(server: FoxgloveServer, played: LogMessages, log: Log) -> None:
    start_ns = int(log["motor"].time_ns[50])
    with _client(server) as line:
        _subscribed(line, "motor")
        server.show(Turn([], start_ns + 10**9))
        late = played.turn(start_ns, start_ns + 10**8)
        server.show(Turn(late.blocks, start_ns + 10**9))
        server.show(Turn(late.blocks, start_ns + 10**8, restarted=True))
        server.show(Turn([], start_ns + 2 * 10**9))
        came = _messages(line, start_ns + 2 * 10**9)
    half = len(came) // 2
    assert half > 0
    assert all(clock == start_ns + 10**9 > time_ns for _, time_ns, _, clock in came[:half]), "late, and not put right"
    assert all(clock == time_ns for _, time_ns, _, clock in came[half:])


def test_a_log_is_given_as_it_is_played_and_sought(server: FoxgloveServer, played: LogMessages, log: Log) -> None:
    origin_ns = int(log["motor"].time_ns[0])
    clock_s = [0.0]
    transport = Transport(0.0, 60.0, 1.0, lambda: clock_s[0])
    transport.await_viewer()  # a subscriber counts as a viewer
    with _client(server) as line:
        _subscribed(line, "motor")
        with LogSender(played, transport, origin_ns, server):
            _messages(line, origin_ns)  # it has begun
            clock_s[0] = 0.5
            first = _messages(line, origin_ns + 5 * 10**8)
            transport.seek(40.0)
            _messages(line, origin_ns + 40 * 10**9)
            transport.seek(10.0)
            while (data := line.recv(timeout=WAIT_S)) != time_data(origin_ns + 10 * 10**9):
                assert isinstance(data, bytes)
            clock_s[0] = 1.0
            back = _messages(line, origin_ns + 105 * 10**8)
    times = log["motor"].time_ns
    assert [t for _, t, *_ in first] == times[times <= origin_ns + 5 * 10**8].tolist()
    begun, ended = origin_ns + 10 * 10**9, origin_ns + 105 * 10**8
    assert [t for _, t, *_ in back] == times[(times > begun) & (times <= ended)].tolist()


# --- hostile, slow and dead ones -----------------------------------------------------------------------------------


def test_publishing_is_refused_with_a_status(server: FoxgloveServer) -> None:
    with _client(server) as line:
        _begun(line)
        line.send('{"op": "advertise", "channels": [{"id": 1, "topic": "motor", "encoding": "json"}]}')
        first = _next_text(line)
        line.send(b"\x01\x01\x00\x00\x00{}")
        second = _next_text(line)
    assert (
        first
        == second
        == {
            "op": "status",
            "level": 2,
            "message": "publishing: refused, this connection is read-only",
        }
    )


def test_who_is_refused_too_often_is_shown_out_and_others_stay(server: FoxgloveServer, played: LogMessages) -> None:
    with _client(server) as bad, _client(server) as good:
        _begun(bad)
        _begun(good)
        for _ in range(MOST_REFUSED + 1):
            bad.send("nonsense")
            assert "expected JSON" in _next_text(bad)["message"]
        with pytest.raises(ConnectionClosed) as closed:
            bad.recv(timeout=WAIT_S)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        _synced(good)


@pytest.mark.parametrize(("data", "code"), [("x" * 70_000, 1009), (b"\xff" * 70_000, 1009)])
def test_a_huge_message_ends_its_own_line_only(server: FoxgloveServer, data: str | bytes, code: int) -> None:
    with _client(server) as bad, _client(server) as good:
        _begun(bad)
        bad.send(data)
        with pytest.raises(ConnectionClosed) as closed:
            _next_text(bad)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == code
        _begun(good)
        _synced(good)


def test_a_client_that_reads_nothing_costs_bounded_memory_and_others_nothing(
    server: FoxgloveServer, played: LogMessages, log: Log
) -> None:
    start_ns = int(log["laser/x"].time_ns[0])
    second, turns = 10**9, 30
    end_ns = start_ns + turns * second
    with (
        _little_line(server, 16 * 2**10) as little,
        _client(server, sock=little, max_queue=1) as asleep,
        _client(server) as awake,
    ):
        lasers = _subscribed(asleep, "laser/x", "laser/y")
        _subscribed(awake, "motor")
        _wait(lambda: len(server.clients) == 2)
        sleeper = server.clients[0]
        offered = offered_bytes = 0
        came: list[Any] = []
        for number in range(turns):
            turn = played.turn(start_ns + number * second, start_ns + (number + 1) * second)
            wanted = [block for block in turn.blocks if block.number in sleeper.subscriptions.by_channel]
            offered += sum(len(block.time_ns) for block in wanted)
            offered_bytes += sum(len(block.data) for block in wanted)
            server.show(turn)
            assert sleeper.waiting_bytes <= MOST_BYTES
            came += _messages(awake, turn.until_ns)
        times = log["motor"].time_ns
        expected = times[(times > start_ns) & (times <= end_ns)]
        assert [time_ns for _, time_ns, *_ in came] == expected.tolist()
        assert sleeper.waiting_bytes > MOST_BYTES / 2, "it is asleep, and as much as is allowed waits for it"
        kept = MOST_BYTES + 2**20  # with what the system holds back, and the turn that is being sent
        assert sleeper.left_out > offered * (1 - kept / offered_bytes) > offered / 4
        assert server.left_out == sleeper.left_out
        left_out, texts, messages = sleeper.left_out, list[str](), 0
        clock_ns = 0
        while clock_ns < end_ns:
            data = asleep.recv(timeout=WAIT_S)
            if isinstance(data, str):
                texts.append(json.loads(data)["message"])
            elif data[0] == 2:
                (clock_ns,) = struct.unpack("<xQ", data)
            else:
                assert struct.unpack_from("<xI", data)[0] in lasers
                messages += 1
        assert texts == [LEFT_OUT]
        assert messages + left_out == offered, "each message is either sent or counted"
    assert server.left_out == left_out, "counted after it is gone, too"


@contextmanager
def _little_line(server: FoxgloveServer, bytes_held: int) -> Iterator[socket.socket]:
    """A line whose receiving end holds back no more than this, on any machine."""
    with socket.socket() as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, bytes_held)
        host, _, port = server.url.removeprefix("ws://").partition(":")
        line.connect((host, int(port)))
        yield line


def test_the_end_is_sent_and_does_not_wait_for_the_dead(played: LogMessages, log: Log) -> None:
    start_ns = int(log["laser/x"].time_ns[0])
    with FoxgloveServer("a", played.offered, {}, (), 0) as server:
        dead, fine = _client(server, max_queue=1), _client(server)
        sleeping, line = dead.__enter__(), fine.__enter__()
        _subscribed(sleeping, "laser/x", "laser/y")
        _begun(line)
        server.show(played.turn(start_ns, start_ns + 60 * 10**9))
        begun = time.monotonic()
    assert time.monotonic() - begun < 4.9
    assert [data for data in line if isinstance(data, str)] == [], "it ends as it should"
    assert line.close_code == 1001
    fine.__exit__(None, None, None)
    sleeping.socket.close()
