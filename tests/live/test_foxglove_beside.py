"""The Foxglove connection of a session: sent data equal recorded data; its cost for the recorder."""

from __future__ import annotations

import json
import os
import signal
import struct
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from daq.acquisition.recent import Recent
from daq.acquisition.session import Session
from daq.channels import LASER_X, TACHO
from daq.guided_tests.procedure import Procedures
from daq.items import Batch, DeviceEvent
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.virtual_rig.simulated_operator import SimulatedOperator
from live.errors import LiveError
from live.foxglove.protocol import SUBPROTOCOLS
from live.foxglove.served import Packing, Refusals
from live.foxglove.session_connection import FoxgloveConnection
from live.newest import MOST_S, Newest
from live.port import bound
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig
from rig_configs.schema import Rig

WAIT_S = 30.0


def _connection(rig: Rig) -> FoxgloveConnection:
    return FoxgloveConnection(rig, 0, (), lambda text: None)


def _line(connection: FoxgloveConnection) -> ClientConnection:
    return connect(connection.url, subprotocols=[Subprotocol(SUBPROTOCOLS[0])], compression=None)


def _subscribe(line: ClientConnection, *topics: str) -> dict[int, str]:
    line.recv(timeout=WAIT_S)
    channels = {each["topic"]: each["id"] for each in json.loads(line.recv(timeout=WAIT_S))["channels"]}
    pairs = [{"id": channels[topic], "channelId": channels[topic]} for topic in topics]
    line.send(json.dumps({"op": "subscribe", "subscriptions": pairs}))
    return {channels[topic]: topic for topic in topics}


def test_a_session_gives_what_its_log_will_have(virtual_rig: VirtualRigProcess, plugged: Rig, tmp_path: Path) -> None:
    connection = _connection(plugged)
    came: list[tuple[str, int, bytes]] = []
    clocks: list[int] = []
    with connection, _line(connection) as line:
        topics = _subscribe(line, "pendulums", "motor", "events", "health")
        with Session(plugged, virtual_rig.clock) as session:
            session.start_recording(tmp_path / "a.mcap", {"test": "record", "rig": "virtual"})
            connection.follow(session)
            session.note(DeviceEvent("note", "host", "by hand", {"time_ns": session.clock.now_ns()}))
            deadline = time.monotonic() + WAIT_S
            while not ({topic for topic, *_ in came} >= set(topics.values()) and len(came) > 1500):
                assert time.monotonic() < deadline, {topic for topic, *_ in came}
                data = line.recv(timeout=WAIT_S)
                assert isinstance(data, bytes)
                if data[0] == 2:
                    clocks.append(struct.unpack("<xQ", data)[0])
                else:
                    own, time_ns = struct.unpack_from("<xIQ", data)
                    came.append((topics[own], time_ns, data[13:]))
            path = session.stop_recording({})
    assert clocks == sorted(clocks)
    with open_log(path) as log:
        for topic in ("pendulums", "motor"):
            channel, samples = log.channel(topic), log[topic]
            ours = [(time_ns, data) for name, time_ns, data in came if name == topic and time_ns >= samples.time_ns[0]]
            first = int(np.searchsorted(samples.time_ns, ours[0][0]))
            logged = channel.pack(samples.columns)[first : first + len(ours)]
            assert [time_ns for time_ns, _ in ours] == samples.time_ns[first : first + len(ours)].tolist()
            assert b"".join(data for _, data in ours) == logged.tobytes()
        notes = [json.loads(data) for topic, _, data in came if topic == "events"]
        assert [note["text"] for note in notes if note["kind"] == "note"] == ["by hand"]
        health = [json.loads(data) for topic, _, data in came if topic == "health"]
        assert all("losses" in report for report in health)
        assert {json.dumps(report["bytes"]) for report in health} <= {json.dumps(each["bytes"]) for each in log.health}


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGSTOP")
def test_a_dead_connection_costs_the_recorder_nothing(tmp_path: Path) -> None:
    """Stopped in the middle, its pipe full: the session records on, bit for bit as without it."""
    recorded: list[bytes] = []
    for dead in (False, True):
        sim = LockstepRig(load_rig("virtual", settings=["virtual.seed=3"]))
        rig = load_rig("virtual", settings=["virtual.seed=3", *sim.port_settings()])
        connection = _connection(rig)
        with connection, Session(rig, sim.clock, edge=sim.edge) as session:
            connection.follow(session)
            assert connection._process.pid is not None
            if dead:
                os.kill(connection._process.pid, signal.SIGSTOP)
            folder = tmp_path / str(dead)
            done = Procedures(session, SimulatedOperator(sim), folder, lambda text, share: None).run("spin-down")
            if dead:
                os.kill(connection._process.pid, signal.SIGCONT)
        with open_log(done.log) as log:
            recorded.append(b"".join(chunk.data for name in log.devices for chunk in log.raw(name)))
            assert log.complete
    assert recorded[0] == recorded[1]


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_connection_that_was_killed_does_not_end_the_session(virtual_rig: VirtualRigProcess, plugged: Rig) -> None:
    with _connection(plugged) as connection, Session(plugged, virtual_rig.clock) as session:
        connection.follow(session)
        assert connection._process.pid is not None
        os.kill(connection._process.pid, signal.SIGKILL)
        connection._feeding.join(WAIT_S)
        assert not connection._feeding.is_alive(), "the feed ends with its process"
        session.check()
        session.wait_for(lambda: len(session.channels.newest("laser/x", (), 0.5)[0]) > 100, 5.0, "samples")


def test_a_port_that_is_taken_is_reported_before_a_device_is_opened() -> None:
    with bound("", 0) as taken, pytest.raises(LiveError, match=r"connection for Foxglove: .*another port"):
        FoxgloveConnection(load_rig("virtual"), taken.getsockname()[1], (), print).__enter__()


def _batch(times: list[int]) -> Batch:
    time_ns = np.array(times, np.int64)
    values = (time_ns % 1000).astype(np.uint32)
    return Batch(TACHO, time_ns, values, {"revolutions": values, "node_time_us": values.astype(np.uint64)})


def test_every_sample_is_handed_over_once_and_new_ones_are_kept_back() -> None:
    recent, newest = Recent(100.0), Newest({"tacho": ("revolutions",), "laser/x": LASER_X.names})
    assert newest.take(recent, 1000) == []
    recent.add(_batch([10, 20, 30]))
    ((topic, time_ns, columns),) = newest.take(recent, 1000, 20)
    assert (topic, time_ns.tolist(), columns["revolutions"].tolist()) == ("tacho", [10, 20], [10, 20])
    assert newest.take(recent, 1000, 20) == []
    recent.add(_batch([40]))
    assert newest.take(recent, 1000)[0][1].tolist() == [30, 40]
    assert newest.left_out == 0


def test_what_no_viewer_took_for_long_is_left_out_and_counted() -> None:
    recent, newest = Recent(1e3), Newest({"tacho": ("revolutions",)})
    most = int(MOST_S * 1e9)
    recent.add(_batch([10]))
    newest.take(recent, 10)
    recent.add(_batch([20, 30, most, most + 50]))
    assert newest.take(recent, most + 40)[0][1].tolist() == [most, most + 50]
    assert newest.left_out == 2


def test_events_wait_for_the_samples_of_their_time() -> None:
    packing = Packing({"tacho": TACHO})
    note: dict[str, Any] = {"kind": "note", "device": "host", "text": "now"}
    both = [("events", 90, note), ("events", 150, note)]
    early = packing.turn({"until_ns": 100, "rows": [], "notes": both}, {1, 2, 3})
    assert [block.time_ns.tolist() for block in early.blocks] == [[90]]
    late = packing.turn({"until_ns": 200, "rows": [], "notes": []}, {1, 2, 3})
    assert [(block.time_ns.tolist(), json.loads(block.data)) for block in late.blocks] == [([150], note)]


def test_only_subscribed_channels_are_packed() -> None:
    packing = Packing({"tacho": TACHO})
    batch = _batch([10, 20])
    note = ("events", 15, {"kind": "note"})
    handed = {"until_ns": 100, "rows": [("tacho", batch.time_ns, batch.columns)], "notes": [note]}
    numbers = {each.topic: each.number for each in packing.offered}
    for topic in ("tacho", "events"):
        (block,) = packing.turn(handed, {numbers[topic]}).blocks
        assert block.number == numbers[topic]
    assert packing.turn(handed, ()).blocks == []


def test_the_operator_hears_of_refused_pages_once_and_in_letters_that_do_nothing() -> None:
    origins: list[str] = []
    refusals = Refusals(origins.append)
    for origin in ("https://app.foxglove.dev", "https://app.foxglove.dev", "\x1b[2Jhttps://evil", "x" * 1000):
        refusals(origin)
    assert len(origins) == 3
    assert origins[0] == "https://app.foxglove.dev"
    assert all(text.isprintable() and len(text) < 150 for text in origins)
    for number in range(100):
        refusals(str(number))
    assert len(origins) == 5
