"""Playback of a log's bytes: nothing is dropped or reordered, and a recording of it gives the same samples."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.channels import CHANNELS
from daq.drivers.can_lines import BothWays
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.devices import make_pipelines
from daq.errors import LinkLost, LogError
from daq.items import RX, TX, Batch
from daq.log import Log, open_log
from daq.log.file import LogFile
from daq.log.samples import RawChunk
from daq.playback import BACKLOG_BYTES, LinkOutlet, Outlet, Playback, PlayedDevice, open_outlets, played_devices
from daq.transports import HostClock, Link, open_link
from daq.transports.can_frames import CanFrame, FrameDecoder, decode, encode
from daq.transports.wires import PtyWire, TcpWire
from rig_configs import load_rig
from tests.daq.playback.fake_ports import FakeClock, FakePort
from tests.daq.replayed_log import IDENTITIES, START_NS, from_device, write_log

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="ptys need POSIX")
KINDS = [pytest.param("pty", marks=needs_pty), "tcp"]


# --- what is played ----------------------------------------------------------------------------------------------


def test_a_serial_line_carries_what_the_device_sent_and_nothing_else(log: Log) -> None:
    outlets = {device: FakePort() for device in log.devices}
    state = Playback(outlets, played_devices(log), math.inf, FakeClock()).play(log.raw_in_order())
    for device in ("laser_x", "laser_y", "encoder"):
        assert outlets[device].got == from_device(log, device)
        assert state.delivered[device] == len(outlets[device].got)
    assert state.waiting_bytes == 0
    assert not any(state.undelivered.values())
    assert state.log_ns == log.end_ns


def frames_of(data: bytes) -> list[CanFrame]:
    return decode(data).frames


def test_a_bus_carries_the_frames_of_both_each_whole(log: Log) -> None:
    outlet = FakePort()
    Playback({"drive": outlet}, played_devices(log), math.inf, FakeClock()).play(log.raw_in_order())
    found = FrameDecoder().feed(outlet.got)
    assert found.damaged == 0
    assert [f for f in found.frames if f.arbitration_id == cia301.cob_tpdo(1, 5)] == frames_of(
        from_device(log, "drive")
    )
    sent = frames_of(b"".join(chunk.data for chunk in log.raw("drive") if chunk.direction == TX))
    assert [f for f in found.frames if f.arbitration_id != cia301.cob_tpdo(1, 5)] == sent
    assert len(sent) > 10
    assert found.of_adapter == []  # the host's commands to its own adapter are not on the bus


@given(
    st.lists(st.tuples(st.booleans(), st.integers(-2000, 2000)), min_size=1, max_size=30),
    st.lists(st.integers(1, 40), min_size=1, max_size=60),
    st.integers(1, 50),
)
def test_a_listener_gets_the_target_speeds_the_host_had(
    frames: list[tuple[bool, int]], cuts: list[int], listens: int
) -> None:
    """Any order of frames, any cut into reads, and any cut at the listener."""
    drive = load_rig("virtual").devices["drive"]
    live, listener, played = DrivePipeline("drive", drive, {}), DrivePipeline("drive", drive, {}), BothWays({0x701})
    speeds: list[list[Batch]] = [[], []]
    bus = pending = b""
    cut = iter(cuts * 40)

    def take(direction: int, data: bytes) -> None:
        nonlocal bus
        bus += played.feed(direction, data)
        speeds[0] += [x for x in live.feed(direction, data, START_NS) if isinstance(x, Batch)]

    for is_host, rpm in frames:
        if is_host:
            take(TX, encode(CanFrame(cia301.cob_rpdo(1, 5), cia402.VELOCITY.pack(15, rpm))))
        else:
            pending += encode(CanFrame(cia301.cob_tpdo(1, 5), cia402.VELOCITY.pack(0x237, rpm)))
            size = next(cut)
            take(RX, pending[:size])
            pending = pending[size:]
    take(RX, pending)
    bus += played.remainder()
    for at in range(0, len(bus), listens):
        speeds[1] += [x for x in listener.feed(RX, bus[at : at + listens], START_NS) if isinstance(x, Batch)]
    for name in ("speed_rpm", "target_rpm", "statusword"):
        one, two = (np.concatenate([b.columns[name] for b in side] or [np.empty(0)]) for side in speeds)
        assert np.array_equal(one, two)
    assert listener.losses == live.losses


def test_bytes_that_are_no_frame_are_not_played_and_hold_nothing_back() -> None:
    played, frame = BothWays({0x701}), encode(CanFrame(0x181, b"12"))
    assert played.feed(RX, b"x" * 5000) == b""
    assert played.feed(RX, frame + frame[:9]) == frame
    assert played.remainder() == b""


# --- back-pressure and readers that go ---------------------------------------------------------------------------


def test_a_slow_reader_is_waited_for_and_gets_everything(log: Log) -> None:
    slow, quick = FakePort(room=7), FakePort()
    clock = FakeClock()
    state = Playback({"laser_x": slow, "laser_y": quick}, played_devices(log), 1.0, clock).play(log.raw_in_order())
    assert slow.got == from_device(log, "laser_x")
    assert quick.got == from_device(log, "laser_y")
    assert state.most_late_s > 1.0
    assert not state.gone


def test_more_than_the_backlog_is_never_held() -> None:
    slow = FakePort(room=100_000)
    playback = Playback({"laser_x": slow}, {"laser_x": PlayedDevice()}, math.inf, FakeClock())
    pieces = [("laser_x", RawChunk(START_NS + i, RX, bytes(65_536))) for i in range(3 * BACKLOG_BYTES // 65_536)]
    most = 0

    def watch() -> Iterator[tuple[str, RawChunk]]:
        nonlocal most
        for piece in pieces:
            most = max(most, playback.state.waiting_bytes)
            yield piece

    slow.room = 100
    playback.play(watch(), lambda state: setattr(slow, "room", 100_000))
    assert BACKLOG_BYTES - 65_536 < most <= BACKLOG_BYTES
    assert len(slow.got) == sum(len(chunk.data) for _, chunk in pieces)


def test_a_reader_that_goes_away_is_reported_and_the_others_are_served(log: Log) -> None:
    goes, stays = FakePort(goes_after=2000), FakePort()
    reported: set[str] = set()
    playback = Playback({"laser_x": goes, "laser_y": stays}, played_devices(log), 4.0, FakeClock())
    state = playback.play(log.raw_in_order(), lambda now: reported.update(now.gone))
    assert stays.got == from_device(log, "laser_y")
    assert state.gone.keys() == reported == {"laser_x"}
    assert START_NS < state.gone["laser_x"] < log.end_ns
    assert state.delivered["laser_x"] + state.undelivered["laser_x"] == len(from_device(log, "laser_x"))
    assert state.delivered["laser_x"] == len(goes.got)


def test_without_any_reader_left_it_ends(log: Log) -> None:
    clock = FakeClock()
    state = Playback({"laser_x": FakePort(goes_after=1)}, played_devices(log), 0.001, clock).play(log.raw_in_order())
    assert state.undelivered["laser_x"] > 0
    assert sum(clock.slept) < 100  # not the ten minutes of the whole log at this speed


def test_it_plays_at_the_logs_pace(log: Log) -> None:
    clock = FakeClock()
    started = clock.ns
    outlets = {device: FakePort() for device in log.devices}
    state = Playback(outlets, played_devices(log), 2.0, clock).play(log.raw_in_order())
    assert clock.ns - started == pytest.approx((log.end_ns - log.start_ns) / 2, abs=5e5)
    assert state.most_late_s < 1e-3


def test_it_begins_when_every_port_has_been_open_for_a_while() -> None:
    one, two = FakePort(), FakePort()
    one.open = two.open = False
    reported: list[list[str]] = []

    def does(at_s: float) -> None:
        one.open = at_s > 1
        two.open = 2 < at_s < 2.1 or at_s > 3  # for a moment, and later for good

    clock = FakeClock(does)
    silent = {"laser_x": PlayedDevice(), "laser_y": PlayedDevice()}
    Playback({"laser_x": one, "laser_y": two}, silent, 1.0, clock).wait_for_readers(reported.append)
    assert reported == [["laser_x", "laser_y"], ["laser_y"], [], ["laser_y"], []]
    assert 8.27e9 < clock.ns < 8.42e9


def test_at_the_end_ports_are_held_until_their_readers_close_them() -> None:
    outlet, clock = FakePort(), FakeClock()
    playback = Playback({"laser_x": outlet}, {"laser_x": PlayedDevice()}, 1.0, clock)
    clock.does = lambda at_s: setattr(outlet, "open", at_s < 3)
    playback.hold()
    assert clock.ns == pytest.approx(8e9, abs=0.03e9)
    outlet.open, clock.does = True, lambda at_s: None
    playback.hold(linger_s=2.0)
    assert clock.ns == pytest.approx(10e9, abs=0.06e9)


# --- real ports --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_port_reports_whether_a_program_has_it_open(kind: str) -> None:
    wire = PtyWire(notice_host=True) if kind == "pty" else TcpWire()
    assert not wire.connected()
    with pytest.raises(LinkLost):
        wire.offer(b"x")
    link = open_link(wire.port, 921_600)
    eventually(wire.connected)
    assert wire.offer(b"abc") == 3
    assert link.read(2.0) == b"abc"
    while wire.offer(bytes(65536)):
        pass  # full: nothing is accepted, nothing is lost
    assert wire.connected()
    link.close()
    eventually(lambda: wire.receive() == b"" and not wire.connected())
    wire.close()
    assert not wire.connected()


def eventually(condition: object) -> None:
    """Wait for another thread, process or the kernel."""
    assert callable(condition)
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def record_what_comes(links: dict[str, Link], path: Path, enough: dict[str, int], slow_s: float) -> None:
    """A recorder that configures nothing: it receives a given number of bytes from each device."""
    rig = load_rig("virtual")
    pipelines = make_pipelines(rig.devices, IDENTITIES)
    clock = HostClock()
    got = dict.fromkeys(links, 0)
    deadline = time.monotonic() + 30
    with LogFile(path, {}, {}, tuple(links), clock.now_ns()) as log:
        while any(got[device] < enough[device] for device in links) and time.monotonic() < deadline:
            for device, link in links.items():
                data = link.read(0.001)
                time.sleep(slow_s)
                got[device] += len(data)
                host_ns = clock.now_ns()
                if data:
                    log.raw(device, RX, data, host_ns)
                for item in pipelines[device].feed(RX, data, host_ns) if data else ():
                    if isinstance(item, Batch):
                        log.batch(item, host_ns)
                    else:
                        log.event(item, host_ns)
        log.finish({"losses": {name: pipeline.losses for name, pipeline in pipelines.items()}})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("speed", [math.inf, 8.0])
def test_played_out_and_recorded_again_the_samples_are_the_same(tmp_path: Path, kind: str, speed: float) -> None:
    path = write_log(tmp_path / "a.mcap", steps=200, lost=frozenset({50, 51}))
    with open_log(path) as log:
        measured = Playback({device: FakePort() for device in log.devices}, played_devices(log), math.inf, FakeClock())
        enough = measured.play(log.raw_in_order()).delivered
        outlets = open_outlets(log, kind)
        playback = Playback(outlets, played_devices(log), speed)
        lines = {"drive": 500_000}  # the bit rate of a bus
        links = {device: open_link(outlet.port, 921_600, lines.get(device)) for device, outlet in outlets.items()}
        again = tmp_path / "again.mcap"
        recorder = threading.Thread(target=record_what_comes, args=(links, again, dict(enough), 0.0))
        playback.wait_for_readers()
        recorder.start()
        state = playback.play(log.raw_in_order())
        recorder.join()
        for link in links.values():
            link.close()
        playback.hold()
        playback.close()
        assert state.delivered == enough
        assert not any(state.undelivered.values())
        with open_log(again) as recorded:
            for topic in CHANNELS:
                one, two = log[topic], recorded[topic]
                assert np.array_equal(one.sequence, two.sequence)
                for name in one.columns:
                    assert one[name].tobytes() == two[name].tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_existing_ports_are_written_to(log: Log, kind: str) -> None:
    far = PtyWire() if kind == "pty" else TcpWire()
    outlets = open_outlets(log, f"laser_y={far.port}")
    assert set(outlets) == {"laser_y"}
    assert isinstance(outlets["laser_y"], LinkOutlet)
    got: list[bytes] = []
    enough = len(from_device(log, "laser_y"))

    def read() -> None:
        deadline = time.monotonic() + 20
        while sum(map(len, got)) < enough and time.monotonic() < deadline:
            got.append(far.receive())
            time.sleep(0.0005)

    far.receive()
    reader = threading.Thread(target=read)
    reader.start()
    playback = Playback(outlets, played_devices(log), math.inf)
    playback.wait_for_readers()
    state = playback.play(log.raw_in_order())
    reader.join()
    playback.close()
    far.close()
    assert b"".join(got) == from_device(log, "laser_y")
    assert state.delivered == {"laser_y": enough}


@pytest.mark.parametrize(
    ("to", "words"),
    [
        ("laser_q=/dev/x", "did you mean 'laser_"),
        ("serial", "expected pty, tcp, or ports like"),
        ("laser_x=", "expected pty, tcp, or ports like"),
        ("laser_x=/dev/x,laser_x=/dev/y", "named twice"),
    ],
)
def test_a_port_that_cannot_be_meant_is_explained(log: Log, to: str, words: str) -> None:
    with pytest.raises(LogError, match=words):
        open_outlets(log, to)


def test_a_port_that_is_not_there_leaves_none_of_the_others_open(log: Log) -> None:
    far = TcpWire()
    with pytest.raises(LinkLost, match="no-such-port"):
        open_outlets(log, f"laser_x={far.port},laser_y=/dev/no-such-port")
    eventually(lambda: far.receive() == b"" and not far.connected())
    far.close()


def test_outlets_are_what_playback_takes() -> None:
    outlets: list[Outlet] = [FakePort(), TcpWire()]
    for outlet in outlets:
        outlet.close()
