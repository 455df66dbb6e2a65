"""Playback to a host that configures its devices first: its start, its end, and its errors."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator

import pytest

from daq.drivers.optoncdt import wire as optoncdt
from daq.drivers.rotorlink import wire as rotorlink
from daq.errors import DeviceError
from daq.log import Log
from daq.playback import Playback, PlaybackState, played_devices
from daq.transports.can_frames import CLOSE_BUS, CanFrame, encode, open_bus
from tests.daq.playback.fake_ports import FakeClock, FakePort
from tests.daq.replayed_log import from_device

LASERS = (b"OUTPUT NONE\n", b"GETINFO\n", b"OUTPUT RS422\n")
START = open_bus(500_000) + encode(CanFrame(0, b"\x01\x05"))
STOP = encode(CanFrame(0, b"\x80\x05")) + CLOSE_BUS


@pytest.fixture
def hosts(log: Log) -> dict[str, FakePort]:
    return {device: FakePort() for device in log.devices}


def set_up(hosts: dict[str, FakePort], log: Log, speed: float = math.inf) -> tuple[Playback, FakeClock]:
    """A playback whose host has configured every device, and its clock."""
    clock = FakeClock()
    playback = Playback(hosts, played_devices(log), speed, clock)
    for name in ("laser_x", "laser_y"):
        hosts[name].next_bytes = b"".join(LASERS)
    hosts["drive"].next_bytes = START
    playback.wait_for_readers()
    playback.wait_for_setup()
    return playback, clock


def test_nothing_is_played_before_every_device_is_commanded_and_then_everything(
    log: Log, hosts: dict[str, FakePort]
) -> None:
    waited: list[set[str]] = []

    def does(at_s: float) -> None:
        for name, when_s, word in (("laser_x", 1, LASERS[2]), ("laser_y", 2, LASERS[2]), ("drive", 3, START)):
            if when_s <= at_s < when_s + 0.019:
                assert hosts["encoder"].got == b""
                hosts[name].next_bytes = word

    playback = Playback(hosts, played_devices(log), math.inf, clock := FakeClock(does))
    hosts["laser_x"].next_bytes = LASERS[0] + LASERS[1]
    playback.wait_for_readers()
    assert playback.configured
    assert clock.ns == pytest.approx(5.0e9, abs=0.05e9)  # a command is decisive at once, without the settling time
    playback.wait_for_setup(lambda waiting: waited.append(set(waiting)))
    assert waited == [{"laser_x", "laser_y", "drive"}, {"laser_y", "drive"}, {"drive"}, set()]
    assert clock.ns == pytest.approx(8.0e9, abs=0.1e9)
    state = playback.play(log.raw_in_order())
    for name in ("laser_x", "laser_y"):
        _, _, stream = hosts[name].got.rpartition(b"OUTPUT RS422 ok\r\n->")
        assert stream == from_device(log, name)
        assert state.delivered[name] == len(stream)  # answers are not part of the log's bytes
    assert b"Serial: 1\r\n" in hosts["laser_x"].got
    assert hosts["encoder"].got == from_device(log, "encoder")
    assert not any(state.withheld.values())
    assert not state.cut_short


def test_a_host_that_sends_nothing_is_a_listener(log: Log, hosts: dict[str, FakePort]) -> None:
    playback = Playback(hosts, played_devices(log), math.inf, clock := FakeClock())
    playback.wait_for_readers()
    playback.wait_for_setup(lambda waiting: pytest.fail("nothing is waited for"))
    assert not playback.configured
    assert clock.ns == pytest.approx(5.3e9, abs=0.05e9)
    playback.play(log.raw_in_order())
    assert hosts["laser_x"].got == from_device(log, "laser_x")


def test_who_opens_its_adapter_only_is_a_listener(log: Log, hosts: dict[str, FakePort]) -> None:
    playback = Playback(hosts, played_devices(log), math.inf, FakeClock())
    hosts["drive"].next_bytes = open_bus(500_000)
    playback.wait_for_readers()
    assert not playback.configured
    assert hosts["drive"].got == b""


def test_commands_of_a_host_that_left_before_all_ports_were_open_do_not_count(
    log: Log, hosts: dict[str, FakePort]
) -> None:
    hosts["encoder"].open = False
    hosts["laser_x"].next_bytes = b"GETINFO\n"

    def does(at_s: float) -> None:
        hosts["laser_x"].open = not 1 < at_s < 2
        hosts["encoder"].open = at_s > 3

    playback = Playback(hosts, played_devices(log), math.inf, clock := FakeClock(does))
    playback.wait_for_readers()
    assert not playback.configured
    assert clock.ns == pytest.approx(8.3e9, abs=0.1e9)


def test_a_host_that_never_gets_that_far_raises_an_error_with_what_was_expected(
    log: Log, hosts: dict[str, FakePort]
) -> None:
    playback = Playback(hosts, played_devices(log), 1.0, clock := FakeClock())
    hosts["laser_x"].next_bytes = LASERS[2]
    hosts["drive"].next_bytes = START
    playback.wait_for_readers()
    with pytest.raises(DeviceError, match=r"60 s later still expected: OUTPUT RS422 at laser_y\. A program"):
        playback.wait_for_setup()
    assert clock.ns == pytest.approx(65e9, abs=0.1e9)


def test_a_host_that_leaves_before_raises_an_error_at_once(log: Log, hosts: dict[str, FakePort]) -> None:
    def does(at_s: float) -> None:
        for host in hosts.values():
            host.open = at_s < 1

    playback = Playback(hosts, played_devices(log), 1.0, clock := FakeClock(does))
    hosts["laser_x"].next_bytes = LASERS[0]
    playback.wait_for_readers()
    expected = "OUTPUT RS422 at laser_x, OUTPUT RS422 at laser_y"
    with pytest.raises(DeviceError, match=re.escape(expected)) as refused:
        playback.wait_for_setup()
    assert "closed its ports before" in str(refused.value)
    assert "the network's start at drive" in str(refused.value)
    assert clock.ns == pytest.approx(6e9, abs=0.05e9)


def leaving(hosts: dict[str, FakePort], at: float, politely: bool) -> Callable[[float], None]:
    """A host that stops its devices, or not, and closes its ports a little later."""
    stopped = not politely

    def does(at_s: float) -> None:
        nonlocal stopped
        if not stopped and at_s >= at:
            stopped = True
            hosts["laser_x"].next_bytes = hosts["laser_y"].next_bytes = LASERS[0]
            hosts["drive"].next_bytes = STOP
        for host in hosts.values():
            host.open = at_s < at + 0.1

    return does


@pytest.mark.parametrize("politely", [True, False])
def test_a_host_that_leaves_ends_it_and_whether_it_stopped_its_devices_is_known(
    log: Log, hosts: dict[str, FakePort], politely: bool
) -> None:
    playback, clock = set_up(hosts, log, speed=1.0)
    began_s = clock.ns * 1e-9 - 5
    clock.does = leaving(hosts, began_s + 0.25, politely)
    states: list[PlaybackState] = []
    state = playback.play(log.raw_in_order(), states.append)
    assert state.cut_short
    assert state.stopped == politely
    assert state.gone.keys() == set(hosts)
    played_s = (state.log_ns - log.start_ns) * 1e-9
    assert played_s == pytest.approx(0.35, abs=0.04)
    for name in ("laser_x", "laser_y"):
        stream = hosts[name].got.partition(b"OUTPUT RS422 ok\r\n->")[2]
        played, _, after = stream.partition(b"OUTPUT NONE ok\r\n->")
        assert from_device(log, name).startswith(played)
        assert after == b""
        assert (state.withheld[name] > 0) == politely
        seconds = len(played) / len(optoncdt.encode_block([[0, 0, 0, 0]])) / 4000
        assert seconds == pytest.approx(0.25 if politely else 0.35, abs=0.05)


def test_last_words_of_a_host_count_even_when_its_ports_are_closed_with_them(
    log: Log, hosts: dict[str, FakePort]
) -> None:
    playback, _ = set_up(hosts, log)

    def chunks() -> Iterator:
        for number, chunk in enumerate(log.raw_in_order()):
            if number == 100:
                hosts["laser_x"].next_bytes = hosts["laser_y"].next_bytes = LASERS[0]
                hosts["drive"].next_bytes = STOP
                for host in hosts.values():
                    host.open = False
            yield chunk

    state = playback.play(chunks())
    assert state.stopped


def test_stopped_and_started_again_it_goes_on_where_the_log_is_by_then(log: Log, hosts: dict[str, FakePort]) -> None:
    playback, clock = set_up(hosts, log, speed=1.0)
    began_s = clock.ns * 1e-9
    words = [(0.2, LASERS[0]), (0.4, LASERS[2])]

    def respond(_: PlaybackState) -> None:
        if words and clock.ns * 1e-9 - began_s >= words[0][0]:
            hosts["laser_x"].next_bytes = words.pop(0)[1]

    state = playback.play(log.raw_in_order(), respond)
    assert not state.stopped
    whole = from_device(log, "laser_x")
    stream = hosts["laser_x"].got.partition(b"OUTPUT RS422 ok\r\n->")[2]
    first, last = stream.split(b"OUTPUT NONE ok\r\n->OUTPUT RS422 ok\r\n->")
    assert whole.startswith(first)
    assert whole.endswith(last)
    assert len(first) % 12 == len(last) % 12 == 0
    assert len(whole) - len(first) - len(last) == state.withheld["laser_x"] == pytest.approx(0.2 * 48_000, rel=0.2)


def test_a_late_command_is_answered_between_two_blocks(log: Log, hosts: dict[str, FakePort]) -> None:
    clock = FakeClock()
    playback = Playback(hosts, played_devices(log), 1.0, clock)

    def respond(state: PlaybackState) -> None:
        if state.log_ns > log.start_ns + 200_000_000 and b"Serial" not in hosts["laser_y"].got:
            hosts["laser_y"].next_bytes = LASERS[1]

    playback.wait_for_readers()
    playback.play(log.raw_in_order(), respond)
    before, name, _ = hosts["laser_y"].got.partition(b"Name: ")
    assert name
    assert len(before) % 12 == 0
    found = optoncdt.BlockDecoder(("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")).feed(hosts["laser_y"].got)
    assert found.skipped_bytes == 0
    assert len(found.values) == len(log["laser/y"].time_ns)


def test_what_a_log_cannot_do_is_counted(log: Log, hosts: dict[str, FakePort]) -> None:
    playback, _ = set_up(hosts, log)
    hosts["encoder"].next_bytes = rotorlink.wire(rotorlink.NodeCommand(1, 3, rotorlink.ACTIONS["release both"]).pack())
    state = playback.play(log.raw_in_order())
    assert state.unfollowed == {"laser_x": 0, "laser_y": 0, "encoder": 1, "drive": 0}
    assert hosts["encoder"].got == from_device(log, "encoder")


def test_questions_are_answered_while_the_ports_are_held_at_the_end(log: Log, hosts: dict[str, FakePort]) -> None:
    playback, _ = set_up(hosts, log)
    playback.play(log.raw_in_order())
    hosts["laser_x"].next_bytes = LASERS[0]
    playback.hold(linger_s=0.1)
    assert hosts["laser_x"].got.endswith(b"OUTPUT NONE ok\r\n->")


def test_as_fast_as_it_is_read_commands_are_heard_all_the_same(log: Log, hosts: dict[str, FakePort]) -> None:
    playback, clock = set_up(hosts, log)
    counted: list[int] = []

    def chunks() -> Iterator:
        for number, chunk in enumerate(log.raw_in_order()):
            clock.ns += 3_000_000  # handing over takes time too
            if number == 100:
                hosts["laser_x"].next_bytes = LASERS[0]
            counted.append(len(hosts["laser_x"].got))
            yield chunk

    state = playback.play(chunks())
    assert state.withheld["laser_x"] > 0
    assert counted[110] == counted[-1] < len(from_device(log, "laser_x"))
