"""The page's own process for a session: its cost for the recorder, and its behaviour when dead or refused."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import time
from http.client import HTTPConnection
from multiprocessing import Pipe
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import anyio.to_thread
import pytest
from websockets.sync.client import connect
from websockets.typing import Origin

from daq.acquisition.session import Session
from daq.errors import OperatorStop
from daq.guided_tests.controls import Controls
from daq.guided_tests.procedure import Procedures
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.virtual_rig.simulated_operator import SimulatedOperator
from live import watched
from live.errors import LiveError
from live.model import LiveModel
from live.port import bound
from live.serving import Serving
from live.session_page import Asking, LivePage
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig
from rig_configs.schema import Rig

WAIT_S = 30.0


def _state(page: LivePage, until: Any) -> dict[str, Any]:
    """The first state that is as wanted."""
    parts = urlsplit(page.url)
    with connect(f"ws://{parts.netloc}/data?{parts.query}", origin=Origin(f"http://{parts.netloc}")) as line:
        deadline = time.monotonic() + WAIT_S
        last: dict[str, Any] = {}
        while time.monotonic() < deadline:
            data = line.recv(timeout=WAIT_S)
            line.send(json.dumps({"seen": 10**9}))
            if isinstance(data, str) and until(last := json.loads(data)):
                return last
    raise AssertionError(f"never so within {WAIT_S:g} s; last: {last}")


def _ask(page: LivePage, path: str, **body: Any) -> tuple[int, dict[str, Any]]:
    parts = urlsplit(page.url)
    connection = HTTPConnection(parts.netloc, timeout=WAIT_S)
    connection.request("POST", f"{path}?{parts.query}", json.dumps(body), {"Origin": f"http://{parts.netloc}"})
    answer = connection.getresponse()
    found = answer.status, json.loads(answer.read())
    connection.close()
    return found


def _page(rig: Rig) -> LivePage:
    return LivePage(rig, None, "rig file", rig.name)


def test_a_session_is_shown_stopped_and_its_log_whole(
    virtual_rig: VirtualRigProcess, plugged: Rig, tmp_path: Path
) -> None:
    def broken() -> None:
        raise ZeroDivisionError("unforeseen")

    page = LivePage(plugged, None, "rig file", "here")
    with page, Session(plugged, virtual_rig.clock) as session:
        assert _ask(page, "/stop") == (409, {"error": "stop: the rig is not open yet"})
        session.start_recording(tmp_path / "a.mcap", {"test": "record", "rig": "virtual"})
        page.follow(session, Asking(confirmed=broken), session.stop, {"words": "recording"})
        seen = _state(page, lambda state: len(state["limits"]) > 5 and state["disk"])
        assert seen["words"] == "recording"
        assert set(seen["losses"]) == {"laser_x", "laser_y", "encoder", "drive"}
        assert "stop" in seen["can"]
        assert _ask(page, "/act", verb="note", text="by hand")[0] == 200
        assert _ask(page, "/act", verb="pause")[0] == 409
        _state(page, lambda state: any(event["text"] == "by hand" for event in state["events"]))
        assert _ask(page, "/act", verb="confirm") == (409, {"error": "ZeroDivisionError: unforeseen"})
        status, answer = _ask(page, "/stop")  # heard all the same
        assert (status, answer["done"]) == (200, True)
        with pytest.raises(OperatorStop, match="button of the live page"):
            session.check()
        _state(page, lambda state: "live page" in state["trouble"])
        path = session.stop_recording({})
    with open_log(path) as log:
        assert [event["text"] for event in log.events if event["kind"] == "note"] == ["by hand"]
        assert log.metadata["foxglove"] == {"deviceName": "virtual", "deviceId": "virtual"}


def test_a_session_that_has_ended_is_shown_as_ended_and_takes_nothing_more(
    virtual_rig: VirtualRigProcess, plugged: Rig, tmp_path: Path
) -> None:
    with LivePage(plugged, None, "rig file", "here") as page:
        with Session(plugged, virtual_rig.clock) as session:
            session.start_recording(tmp_path / "a.mcap", {"test": "record", "rig": "virtual"})
            page.follow(session, Asking(), session.stop, {})
            assert not _state(page, lambda state: "stop" in state["can"] and "note" in state["can"])["ended"]
        seen = _state(page, lambda state: state["ended"])
        later = _state(page, lambda state: True)
        assert Path(seen["log"]).name == "a.mcap"
        assert seen["can"] == []
        assert later["now_s"] == seen["now_s"], "it stands at its last sample"
        assert _ask(page, "/act", verb="note", text="late") == (409, {"error": "note: the run has ended"})


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGSTOP")
def test_a_dead_page_costs_the_recorder_nothing(tmp_path: Path) -> None:
    """Stopped in the middle, its pipe full: the session records on, bit for bit as without a page."""
    recorded: list[bytes] = []
    for dead in (False, True):
        sim = LockstepRig(load_rig("virtual", settings=["virtual.seed=3"]))
        rig = load_rig("virtual", settings=["virtual.seed=3", *sim.port_settings()])
        page = _page(rig)
        with page, Session(rig, sim.clock, edge=sim.edge) as session:
            page.follow(session, Asking(Controls()), None, {})
            assert page._process.pid is not None
            if dead:
                os.kill(page._process.pid, signal.SIGSTOP)
            folder = tmp_path / str(dead)
            done = Procedures(session, SimulatedOperator(sim), folder, lambda text, share: None).run("spin-down")
            losses = session.recording.losses()
            if dead:
                os.kill(page._process.pid, signal.SIGCONT)
        with open_log(done.log) as log:
            recorded.append(b"".join(chunk.data for name in log.devices for chunk in log.raw(name)))
            assert log.complete
        assert losses["laser_x"]["samples"] == 0
    assert recorded[0] == recorded[1]


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_page_that_was_killed_does_not_end_the_session(
    virtual_rig: VirtualRigProcess, plugged: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "live")
    with _page(plugged) as page, Session(plugged, virtual_rig.clock) as session:
        page.follow(session, Asking(), session.stop, {})
        assert page._process.pid is not None
        os.kill(page._process.pid, signal.SIGKILL)
        page._feeding.join(WAIT_S)
        assert not page._feeding.is_alive(), "the feed ends with its page"
        assert any("the session continues" in text for text in caplog.messages)
        session.check()
        session.wait_for(lambda: len(session.channels.newest("laser/x", (), 0.5)[0]) > 100, 5.0, "samples")


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGSTOP")
def test_a_stop_passes_a_page_s_process_that_stands_still(virtual_rig: VirtualRigProcess, plugged: Rig) -> None:
    stops: list[str] = []
    page = LivePage(plugged, None, "rig file", "here")
    with page, Session(plugged, virtual_rig.clock) as session:
        page.follow(session, Asking(), stops.append, {})
        assert page._process.pid is not None
        os.kill(page._process.pid, signal.SIGSTOP)
        try:
            assert _ask(page, "/stop")[0] == 200
        finally:
            os.kill(page._process.pid, signal.SIGCONT)
        assert stops == ["stopped by the button of the live page"]


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_page_whose_stop_has_failed_shows_it(virtual_rig: VirtualRigProcess, plugged: Rig) -> None:
    page = LivePage(plugged, None, "rig file", "here")
    with page, Session(plugged, virtual_rig.clock) as session:
        page.follow(session, Asking(), session.stop, {})
        parts = urlsplit(page.url)
        with connect(f"ws://{parts.netloc}/data?{parts.query}", origin=Origin(f"http://{parts.netloc}")) as line:
            assert page._stop_path is not None
            page._stop_path._process.kill()
            state: dict[str, Any] = {"trouble": ""}
            deadline = time.monotonic() + WAIT_S
            while "emergency stop" not in state["trouble"] and time.monotonic() < deadline:
                data = line.recv(timeout=WAIT_S)
                line.send(json.dumps({"seen": 10**9}))
                state = json.loads(data) if isinstance(data, str) else state
        assert "use the emergency stop at the rig" in state["trouble"]
        session.check()


def test_a_port_that_is_taken_is_reported_before_a_device_is_opened() -> None:
    with bound("", 0) as taken, pytest.raises(LiveError, match=r"the live page: .*another port"):
        LivePage(load_rig("virtual"), None, "", "", "", taken.getsockname()[1]).__enter__()


def test_all_is_compiled_before_the_page_is_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiler would take the processor from the recorder while a rotor turns."""
    ours, theirs = Pipe()
    accepted, given = Pipe()
    sent_before: list[bool] = []
    monkeypatch.setattr(watched, "compile_followers", lambda rig, model: sent_before.append(ours.poll()))
    monkeypatch.setattr(signal, "signal", lambda number, how: None)
    with ours, theirs, accepted, given:
        ours.send({"end": True})
        watched.run_page(theirs, load_rig("virtual"), None, "rig file", "virtual", "token", [], given)
        assert sent_before == [False]
        assert ours.recv() == {"ready": True}


def test_what_is_asked_waits_for_no_other_thread_of_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    async def busy(*_: object, **__: object) -> None:
        raise AssertionError("no thread is free")

    monkeypatch.setattr(anyio.to_thread, "run_sync", busy)
    ours, theirs = Pipe()
    source = watched.Watched(load_rig("virtual"), theirs, "virtual")
    with ours, theirs, Serving(source, LiveModel(source.signals.rig)) as serving:
        parts = urlsplit(serving.url)
        connection = HTTPConnection(parts.netloc, timeout=WAIT_S)
        connection.request("POST", f"/stop?{parts.query}", "{}", {"Origin": f"http://{parts.netloc}"})
        assert ours.poll(WAIT_S), "the stop was passed on"
        request = ours.recv()
        assert request["act"] == "stop"
        source._take({"answer": {"done": True}, "to": request["number"]})
        assert json.loads(connection.getresponse().read()) == {"done": True}
        connection.request("POST", f"/stop?{parts.query}", "{}", {"Origin": f"http://{parts.netloc}"})
        answer = connection.getresponse()  # this request is never answered
        assert (answer.status, json.loads(answer.read())) == (
            409,
            {"error": "stop: no answer from the recorder within 2 s"},
        )
        assert ours.recv()["act"] == "stop"
        source._take({"answer": {"done": True}, "to": 2})  # too late, and no harm
        assert source._waiting == {}
        connection.close()


def test_a_prompt_is_shown_until_the_test_goes_on() -> None:
    controls = Controls()
    asking = Asking(controls, lambda: None)
    assert asking.can() == []
    controls.status = type(controls.status)("spin-down", "flick", "waiting")
    asking.prompt("flick both pendulums")
    assert asking.facts()["prompt"] == "flick both pendulums"
    assert asking.can() == ["pause", "resume", "abort", "confirm"]
    controls.status = type(controls.status)("spin-down", "record", "recording")
    assert asking.facts()["prompt"] == ""
