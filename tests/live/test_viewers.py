"""Several viewers; a sleeping or dead one receives few frames and delays no other."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from daq.log import open_log
from daq.log.snapshot import rig_of
from live.errors import PortTaken
from live.frames import decode
from live.model import LiveModel
from live.picture import Pictures
from live.port import bound
from live.replayed import Replayed
from live.server import MOST_MESSAGES_PER_S, MOST_UNANSWERED, MOST_VIEWERS, Allowance, pause_s
from live.serving import Serving

WAIT_S = 20.0


@contextmanager
def _viewer(serving: Serving) -> Iterator[ClientConnection]:
    parts = urlsplit(serving.url)
    origin = Origin(f"http://{parts.netloc}")
    with connect(f"ws://{parts.netloc}/data?{parts.query}", origin=origin, compression=None) as line:
        yield line


def _frames(line: ClientConnection, count: int) -> list[dict[str, Any]]:
    """So many frames, each answered."""
    found: list[dict[str, Any]] = []
    while len(found) < count:
        data = line.recv(timeout=WAIT_S)
        if isinstance(data, bytes):
            header, columns = decode(data)
            if header["kind"] == "frame":
                line.send(json.dumps({"seen": header["number"]}))
                found.append({**header, "columns": columns})
    return found


def test_a_viewer_that_answers_nothing_gets_no_more_than_a_few(serving: Serving) -> None:
    with _viewer(serving), _viewer(serving) as awake:
        _frames(awake, 40)
        asleep = serving.page._viewers[0]
        assert serving.page.viewers == 2
        assert asleep.sent == MOST_UNANSWERED
        assert serving.page._viewers[1].sent >= 40


def test_a_viewer_that_answers_nothing_is_sent_the_last_state(serving: Serving) -> None:
    with _viewer(serving) as asleep, _viewer(serving) as awake:
        _frames(awake, 10)
        begun_s = time.monotonic()
        serving.page.flush_state(WAIT_S)
        assert time.monotonic() - begun_s < WAIT_S
        last_state_s = serving.page._viewers[0].state_sent_s
        assert last_state_s >= begun_s
        _frames(awake, 10)
        states = [viewer.state_sent_s for viewer in serving.page._viewers]
        assert states[0] == last_state_s < states[1]  # one state, and it waits again
        assert serving.page._viewers[0].sent == MOST_UNANSWERED
        frames = 0
        while frames < MOST_UNANSWERED:
            data = asleep.recv(timeout=WAIT_S)
            frames += isinstance(data, bytes) and decode(data)[0]["kind"] == "frame"
        assert isinstance(asleep.recv(timeout=WAIT_S), str)


def test_a_replay_waits_at_its_beginning_until_a_viewer_looks(point_log: Path) -> None:
    with open_log(point_log) as log:
        source = Replayed(log, rig_of(log))
    with Serving(source, LiveModel(source.signals.rig)) as serving:
        with _viewer(serving) as asleep:  # it gets what it may be sent, and answers nothing
            for _ in range(MOST_UNANSWERED):
                while not isinstance(data := asleep.recv(timeout=WAIT_S), bytes) or decode(data)[0]["kind"] != "frame":
                    pass
                assert decode(data)[0]["now_s"] == 0.0
            assert not source.transport.playing
        with _viewer(serving) as awake:
            times = [frame["now_s"] for frame in _frames(awake, 10)]
    assert times[0] == 0.0
    assert 0 < times[-1] < 5
    assert source.transport.playing


def test_one_that_wakes_up_sees_the_newest_picture(serving: Serving, replayed: Replayed) -> None:
    replayed.transport.seek(5.0)
    with _viewer(serving) as sleepy, _viewer(serving) as awake:
        _frames(awake, 15)
        replayed.transport.seek(30.0)
        _frames(awake, 15)
        seen = _frames(sleepy, MOST_UNANSWERED + 1)
        assert [frame["now_s"] for frame in seen] == [5.0] * MOST_UNANSWERED + [30.0]


def test_a_viewer_that_is_gone_is_dropped(serving: Serving) -> None:
    with _viewer(serving) as line:
        _frames(line, 2)
    deadline = time.monotonic() + WAIT_S
    while serving.page.viewers and time.monotonic() < deadline:
        time.sleep(0.01)
    assert serving.page.viewers == 0


def test_each_viewer_has_its_own_window(serving: Serving, replayed: Replayed) -> None:
    replayed.transport.seek(30.0)
    with _viewer(serving) as one, _viewer(serving) as two:
        one.send(json.dumps({"view": {"window_s": 0.1, "end_s": None, "pixels": 500}}))
        two.send(json.dumps({"view": {"window_s": 20, "end_s": 25.0, "pixels": 200}}))
        close, far = _frames(one, 8)[-1], _frames(two, 8)[-1]
    assert close["buckets"]["x"] == 0
    assert len(close["columns"]["x.t"]) == pytest.approx(400, abs=2)
    assert (far["start_s"], far["end_s"]) == (5.0, 25.0)
    assert far["buckets"]["x"] == pytest.approx(0.1)
    assert len(far["columns"]["x.t"]) == pytest.approx(201, abs=2)
    assert "x.high" in far["columns"]
    assert "x.high" not in close["columns"]


NONSENSE = (
    "",
    "[]",
    "{",
    '{"view": {}}',
    '{"view": {"window_s": "x", "pixels": 1}}',
    '{"seen": "all"}',
    "x" * 5000,
    '{"view": {"window_s": NaN, "pixels": 1}}',
)


@pytest.mark.parametrize("nonsense", NONSENSE, ids=range(len(NONSENSE)))
def test_a_viewer_that_talks_nonsense_is_shown_out_and_others_stay(serving: Serving, nonsense: str) -> None:
    with _viewer(serving) as good, _viewer(serving) as bad:
        _frames(good, 1)
        bad.send(nonsense)
        deadline = time.monotonic() + WAIT_S
        while serving.page.viewers > 1 and time.monotonic() < deadline:
            _frames(good, 1)
        assert serving.page.viewers == 1
        _frames(good, 3)


def test_too_many_viewers_are_refused(serving: Serving) -> None:
    lines: list[Any] = []
    try:
        for _ in range(MOST_VIEWERS):
            context = _viewer(serving)
            context.__enter__()
            lines.append(context)
        with pytest.raises(InvalidStatus) as refused, _viewer(serving):
            pass
        assert refused.value.response.status_code == 503
    finally:
        for context in lines:
            context.__exit__(None, None, None)


def _post(serving: Serving, path: str, body: Any) -> tuple[int, dict[str, Any]]:
    parts = urlsplit(serving.url)
    connection = HTTPConnection(parts.netloc, timeout=WAIT_S)
    text = body if isinstance(body, str) else json.dumps(body)
    connection.request("POST", f"{path}?{parts.query}", text, {"Origin": f"http://{parts.netloc}"})
    answer = connection.getresponse()
    found = answer.status, json.loads(answer.read())
    connection.close()
    return found


def test_what_a_log_cannot_do_is_refused_with_a_reason(serving: Serving, replayed: Replayed) -> None:
    assert _post(serving, "/stop", {}) == (409, {"error": "stop: not possible for a log"})
    assert _post(serving, "/act", {"verb": "speed", "speed": 1e9})[0] == 409
    assert _post(serving, "/act", {"verb": "seek", "to_s": "there"})[0] == 409
    for body in ("", "[]", "{}", "null"):
        assert _post(serving, "/act", body)[0] == 400
    assert _post(serving, "/act", {"verb": "note", "text": "x" * 3000})[0] == 413
    assert _post(serving, "/act", "x" * 10_000)[0] == 413
    assert _post(serving, "/act", {"verb": "seek", "to_s": 7.0}) == (200, {"done": True, "at_s": 7.0})
    assert replayed.transport.at() == 7.0


def test_files_next_to_the_page_are_not_served(serving: Serving) -> None:
    parts = urlsplit(serving.url)
    for path in ("/page/../server.py", "/page/%2e%2e/server.py", "/page/index.html", "/page/nothing.js", "/nothing"):
        connection = HTTPConnection(parts.netloc, timeout=WAIT_S)
        connection.request("GET", f"{path}?{parts.query}")
        status = connection.getresponse().status
        connection.close()
        assert status == 404


def test_a_port_that_is_taken_or_a_host_that_is_all_is_refused() -> None:
    with bound("", 0) as first, pytest.raises(PortTaken, match="another port"):
        bound("", first.getsockname()[1])
    for host in ("0.0.0.0", "::", " "):
        with pytest.raises(PortTaken, match="not all of them"):
            bound(host, 0)
    with pytest.raises(PortTaken, match="no address of this machine"):
        bound("no.such.name.invalid", 0)


DEEP = "[" * 2000 + "]" * 2000


@pytest.mark.parametrize(
    "body",
    [
        DEEP,
        '{"verb": "seek", "to_s": ' + DEEP + "}",
        '{"verb": "\\ud800"}',
        '{"verb": "note", "text": "\\udfff"}',
        '{"verb": "seek", "to_s": 1e999}',
        '{"verb": "seek", "to_s": ' + "9" * 400 + "}",
        '{"verb": "seek", "to_s": NaN}',
    ],
)
def test_a_command_that_is_no_usable_object_is_refused(serving: Serving, body: str) -> None:
    assert _post(serving, "/act", body)[0] == 400


def test_a_viewer_that_floods_is_disconnected_and_counted(serving: Serving) -> None:
    with _viewer(serving) as good, _viewer(serving) as bad:
        _frames(good, 1)
        with pytest.raises(ConnectionClosed):
            _flood(bad)
        while not (state := json.loads(_text(good)))["dropped_viewers"]:
            pass
    assert state["viewers"] == 1


def _flood(line: ClientConnection) -> None:
    for _ in range(20 * int(MOST_MESSAGES_PER_S)):
        line.send('{"seen": 0}')
    while True:
        line.recv(timeout=WAIT_S)


def _text(line: ClientConnection) -> str:
    """The next state; frames before it are answered."""
    while not isinstance(data := line.recv(timeout=WAIT_S), str):
        header = decode(data)[0]
        if header["kind"] == "frame":
            line.send(json.dumps({"seen": header["number"]}))
    return data


def test_an_allowance_refills_with_time() -> None:
    now = [0.0]
    allowance = Allowance(lambda: now[0])
    most = int(MOST_MESSAGES_PER_S)
    assert [allowance.take() for _ in range(most + 1)] == [True] * most + [False]
    now[0] += 10.0
    assert [allowance.take() for _ in range(most + 1)] == [True] * most + [False]


def test_pictures_take_no_more_than_their_share_of_the_time() -> None:
    for viewers in (1, 8, MOST_VIEWERS):
        assert viewers * 2e-3 / pause_s(2e-3, viewers) == pytest.approx(0.5)


def test_a_stop_passes_a_page_whose_drawing_is_blocked(replayed: Replayed, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked, freed = threading.Event(), threading.Event()

    def stands_still(*_: object) -> bytes:
        blocked.set()
        freed.wait(WAIT_S)
        return b""

    monkeypatch.setattr(Pictures, "frame", stands_still)
    with Serving(replayed, LiveModel(replayed.signals.rig)) as serving, _viewer(serving):
        assert blocked.wait(WAIT_S)
        try:
            assert _post(serving, "/stop", {}) == (409, {"error": "stop: not possible for a log"})
            assert not freed.is_set()
        finally:
            freed.set()


def test_counts_of_connections_are_shown(serving: Serving) -> None:
    parts = urlsplit(serving.url)
    connection = HTTPConnection(parts.netloc, timeout=WAIT_S)
    connection.request("GET", "/")  # without the token
    assert connection.getresponse().status == 403
    connection.close()
    with _viewer(serving) as line:
        while "connections" not in (state := json.loads(_text(line))):
            pass
    assert state["connections"]["127.0.0.1"] == {"refused": 1}
