"""Simulated devices of a log: bytes in whole blocks and lines, answers like those of the devices."""

from __future__ import annotations

import queue
import struct

import canopen
import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.control import DriveControl
from daq.drivers.cia402.far_end import PlayedDrive
from daq.drivers.optoncdt import dialogue as lasers, sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.far_end import PlayedLaser, WholeBlocks
from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.played import PlayedNode
from daq.errors import DeviceError, LogError
from daq.items import RX, TX
from daq.log import Log
from daq.playback import PlayedDevice, played_devices
from daq.transports import HostClock
from daq.transports.can_frames import CanFrame, FrameDecoder, decode, encode
from rig_configs import load_rig
from tests.daq.can_text import tx
from tests.daq.replayed_log import IDENTITIES

RIG = load_rig("virtual")
LASER = RIG.devices["laser_x"]
IDENTITY = IDENTITIES["laser_x"]


def blocks(count: int, words: int = 4) -> bytes:
    rng = np.random.default_rng(1)
    return optoncdt.encode_block(rng.integers(0, 2**18, (count, words), dtype=np.uint32))


class Asking:
    """A host's line to a device and back, through the decoder that reads it."""

    def __init__(self, device: PlayedDevice) -> None:
        self.clock = HostClock()
        self.replies: queue.Queue[str] = self.clock.queue()
        self.bytes_in = 0
        self._device = device
        self._decoder = optoncdt.BlockDecoder(("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"))

    def send(self, data: bytes) -> None:
        answer = self._device.hear(data)
        self.bytes_in += len(answer)
        for text in self._decoder.feed(answer).text:
            self.replies.put(text)

    def restart_decoding(self) -> None:
        pass


# --- a sensor ----------------------------------------------------------------------------------------------------


@given(
    st.integers(1, 5),
    st.lists(st.integers(1, 40), min_size=1, max_size=40),
    st.integers(0, 11),
    st.lists(st.sampled_from([b"", b"OUTPUT NONE ok\r\n->", b"->", b"E200 Unknown command X\r\n->"]), min_size=1),
)
def test_an_answer_never_falls_into_a_block(words: int, cuts: list[int], start: int, answers: list[bytes]) -> None:
    """Any number of words, any cut into reads, a stream that begins anywhere, and answers between any two reads."""
    stream = blocks(60, words)[start:]
    names = ("DIST", "A", "B", "C", "D")[:words]
    alone = optoncdt.BlockDecoder(names).feed(stream)
    source, decoder = WholeBlocks(words), optoncdt.BlockDecoder(names)
    rows, text, skipped, remainder, played = [], [], 0, stream, b""
    for number, cut in enumerate(cuts * len(stream)):
        data = source.feed(RX, remainder[:cut]) if remainder else source.remainder()
        answer = answers[number % len(answers)]
        for part in (data, answer):
            found = decoder.feed(part)
            rows.append(found.values)
            text += found.text
            skipped += found.skipped_bytes
        played += data
        if not remainder:
            break
        remainder = remainder[cut:]
    assert played == stream
    assert np.array_equal(np.concatenate(rows), alone.values)
    assert skipped <= alone.skipped_bytes  # the end of a block whose start is missing may look like text
    assert skipped == 0 or start > 0
    assert text.count("->") == sum(answer.endswith(b"->") for answer in (answers * (number + 1))[: number + 1])


def test_bytes_that_are_no_blocks_are_not_held_back_for_ever() -> None:
    source = WholeBlocks(4)
    assert source.feed(RX, b"OUTPUT NONE ok\r\n->") == b"OUTPUT NONE ok\r\n->"
    assert source.feed(RX, b"abc") == b""
    assert source.feed(TX, b"OUTPUT NONE\n") == b""
    assert source.remainder() == b"abc"
    assert source.feed(RX, b"\xff" * 100) == b"\xff" * 100


def test_our_own_set_up_finds_the_sensor_of_the_log() -> None:
    laser = PlayedLaser(LASER, IDENTITY)
    talk = Asking(laser)
    assert not laser.sending
    assert lasers.configure("laser_x", LASER, talk) == {**IDENTITY, "scaling": "ILD1420"}
    assert laser.sending
    assert laser.commands == 13
    assert laser.unfollowed == 0


def test_a_corrected_range_is_not_the_reported_one() -> None:
    laser = PlayedLaser(LASER, {**IDENTITY, "range_m": 0.02503, "told_range_m": 0.025})
    assert b"Measuring range: 25.00mm\r\n" in laser.hear(b"GETINFO\n")


def test_the_rig_file_replaces_a_missing_identity() -> None:
    laser = PlayedLaser(LASER, {})
    talk = Asking(laser)
    identity = lasers.configure("laser_x", LASER, talk)
    assert identity == {
        "name": "ILD1420",
        "scaling": "ILD1420",
        "serial": "unknown",
        "version": "unknown",
        "range_m": LASER.range_m,
        "words": list(sensor_answers.parse_outinfo("GETOUTINFO_RS422 DIST COUNTER TIMESTAMP")),
    }


def test_a_log_has_no_other_rate() -> None:
    slow = LASER.model_copy(update={"rate_Hz": 1000})
    talk = Asking(PlayedLaser(slow, IDENTITY))
    with pytest.raises(DeviceError, match="Rate 4 kHz not possible, only 1"):
        lasers.configure("laser_x", LASER, talk)


def test_it_sends_between_two_commands_and_resets_no_counter() -> None:
    laser = PlayedLaser(LASER, IDENTITY)
    stream = blocks(40)
    assert laser.play(RX, stream[:125]) == b""
    laser.hear(b"RESETCNT MEASCNT\nOUTPUT RS422\n")
    assert laser.play(RX, stream[125:250]) == stream[120:240]  # from the start of a block to the end of one
    laser.hear(b"OUTPUT NONE\n")
    assert laser.play(RX, stream[250:370]) == b""
    laser.hear(b"OUTPUT RS422\n")
    assert laser.play(RX, stream[370:]) == stream[360:]
    assert laser.withheld_bytes == 120 + 120
    assert laser.remainder() == b""


@pytest.mark.parametrize(
    ("identity", "words"),
    [
        ({"words": []}, "names of output words"),
        ({"words": "DIST"}, "names of output words"),
        ({"words": ["DIST", "X\r\n->"]}, "names of output words"),
        ({"words": [1, 2]}, "names of output words"),
        ({"range_m": -1}, "a measuring range in m"),
        ({"range_m": "25"}, "a measuring range in m"),
        ({"range_m": float("nan")}, "a measuring range in m"),
    ],
)
def test_an_identity_no_sensor_has_is_refused(identity: dict, words: str) -> None:
    with pytest.raises(LogError, match=words):
        PlayedLaser(LASER, identity)


# --- the node and the drive --------------------------------------------------------------------------------------


def test_a_node_lets_commands_pass_and_counts_them() -> None:
    node = PlayedNode(RIG.devices["encoder"], {})
    frame = rotorlink.wire(rotorlink.NodeCommand(1, 7, rotorlink.ACTIONS["release both"]).pack())
    assert node.hear(frame[:3]) == b""
    assert node.hear(frame[3:] + frame + b"noise") == b""
    assert (node.commands, node.unfollowed, node.sending) == (2, 2, True)
    assert node.play(RX, b"\0abc\0") == b"\0abc\0"


class Bus:
    """The package's own drive control with a simulated drive, whose answers are returned at once."""

    def __init__(self, drive: PlayedDrive) -> None:
        self.drive = drive
        self.control = DriveControl(RIG.devices["drive"], self.send, HostClock())
        self._lines = FrameDecoder()

    def send(self, data: bytes) -> None:
        self.bring(self.drive.hear(data))

    def bring(self, data: bytes) -> None:
        self.control.take_frames(self._lines.feed(data).frames)


def report(status: int, rpm: int) -> bytes:
    return encode(CanFrame(cia301.cob_tpdo(1, RIG.devices["drive"].node_id), cia402.VELOCITY.pack(status, rpm)))


def test_our_own_control_starts_and_stops_a_played_drive() -> None:
    drive = PlayedDrive(RIG.devices["drive"], {})
    bus = Bus(drive)
    assert drive.play(RX, report(0x237, 100)) == b""
    bus.control.start()
    assert drive.sending
    bus.bring(drive.play(RX, report(0x237, 300)))
    assert (bus.control.actual_rpm, bus.control.state) == (300, cia402.OPERATION_ENABLED)
    bus.control.enable()
    bus.control.set_speed(500)
    bus.bring(drive.play(RX, report(0x240, 0)))
    bus.control.stop()
    assert not drive.sending
    assert drive.play(RX, report(0x237, 100)) == b""
    assert drive.unfollowed == 2  # torque and speed; the stop at the end can be followed


def test_it_reports_the_newest_values_of_the_log() -> None:
    drive = PlayedDrive(RIG.devices["drive"], {})
    bus = Bus(drive)
    bus.control.start()
    line = report(0x237, -300)
    drive.play(RX, report(0x240, 1))
    drive.play(RX, line)
    node = canopen.RemoteNode(RIG.devices["drive"].node_id, canopen.ObjectDictionary())
    network = canopen.Network()
    network.add_node(node)

    def answered(identifier: int, data: bytes, remote: bool = False) -> None:
        request = encode(CanFrame(identifier, bytes(data).ljust(8, b"\0")))
        for frame in decode(drive.hear(request)).frames:
            network.notify(frame.arbitration_id, bytearray(frame.data), 0.0)

    network.send_message = answered  # a hook of this test
    assert node.sdo.upload(cia402.STATUSWORD, 0) == struct.pack("<H", 0x237)
    assert node.sdo.upload(cia402.ACTUAL_VELOCITY, 0) == struct.pack("<h", -300)
    assert node.sdo.upload(cia402.MODE_DISPLAY, 0) == bytes([cia402.MODE_VELOCITY])
    bus.control.stop()


def test_an_answer_stands_between_two_lines_of_the_bus() -> None:
    drive = PlayedDrive(RIG.devices["drive"], {})
    drive.hear(tx(b"O\rt00020105\r"))
    line = report(0x237, 300)
    request = encode(CanFrame(cia301.cob_sdo_request(5), b"\x40\x41\x60\0\0\0\0\0"))
    bus = drive.play(RX, line) + drive.hear(request) + drive.play(RX, line)
    found = FrameDecoder().feed(bus)
    assert found.damaged == 0
    assert [frame.arbitration_id for frame in found.frames] == [0x185, cia301.cob_sdo_answer(5), 0x185]


@given(st.lists(st.binary(max_size=60), max_size=10))
def test_any_bytes_of_a_host_are_handled(pieces: list[bytes]) -> None:
    for device in (
        PlayedLaser(LASER, IDENTITY),
        PlayedNode(RIG.devices["encoder"], {}),
        PlayedDrive(RIG.devices["drive"], {}),
        PlayedDevice(),
    ):
        for piece in pieces:
            assert isinstance(device.hear(piece), bytes)
        assert device.remainder() == b""


# --- devices of a log --------------------------------------------------------------------------------------------


def test_every_device_of_a_log_has_its_stand_in(log: Log) -> None:
    devices = played_devices(log)
    assert {name: type(device) for name, device in devices.items()} == {
        "laser_x": PlayedLaser,
        "laser_y": PlayedLaser,
        "encoder": PlayedNode,
        "drive": PlayedDrive,
    }
    assert b"Serial: 1\r\n" in devices["laser_x"].hear(b"GETINFO\n")
    assert b"Serial: 2\r\n" in devices["laser_y"].hear(b"GETINFO\n")


def test_an_impossible_identity_is_reported_with_log_and_device(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daq.playback.outlets.identities_of", lambda _: {"laser_y": {"words": []}})
    with pytest.raises(LogError, match=r"a.mcap: .*laser_y: .*output words"):
        played_devices(log)
