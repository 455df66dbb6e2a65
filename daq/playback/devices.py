"""What stands at the far end of a port while a log is played: the device's bytes, and answers to what it is told.

A device that a host configures first behaves as it would: a sensor is silent until ``OUTPUT RS422``, a drive until the
network's start. Whatever is asked is answered as the device of the log would answer; whatever would change its bytes
is refused, or, where there is no way to refuse, let pass and counted.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from typing import Any

from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.canopen_node import (
    NMT_RESET,
    NMT_RESET_COMMUNICATION,
    Adapter,
    NmtState,
    SdoServer,
    drive_objects,
)
from daq.drivers.optoncdt import wire as optoncdt
from daq.drivers.optoncdt.commands import SensorCommands, info_lines, outputs_of
from daq.drivers.optoncdt.stream import DEFAULT_WORDS
from daq.drivers.rotorlink import wire as rotorlink
from daq.errors import LogError
from daq.log import Log
from daq.log.snapshot import identities_of, rig_of
from daq.playback.bytes_played import BothWays, BytesFromDevice, OneWay, WholeBlocks
from daq.transports import slcan
from rig_configs.schema import Drive, Laser

_UNKNOWN = "unknown"
_WORD = re.compile(r"[A-Z0-9_]{1,40}")


class PlayedDevice:
    """One device of a log. This one needs no set-up and takes no commands; others are kinds of it.

    Attributes:
        expects: what it must be told before it sends; empty when it sends by itself.
        commands: how many it has heard.
        unfollowed: how many of them asked for what a log cannot do.
        withheld_bytes: of the log, while it was not told to send.

    Args:
        source: which bytes of the log are its.
    """

    expects = ""

    def __init__(self, source: BytesFromDevice | None = None) -> None:
        self.commands = self.unfollowed = self.withheld_bytes = 0
        self._source = source or OneWay()

    @property
    def sending(self) -> bool:
        """Whether its bytes go out."""
        return True

    def begin(self) -> None:
        """Send from now on, whatever it was told: whoever listens configures nothing."""

    def hear(self, data: bytes) -> bytes:
        """Take what the host sends; returns the answer."""
        return b""

    def play(self, direction: int, data: bytes) -> bytes:
        """What goes out now of bytes of the log; between two calls an answer may stand."""
        return self._pass(self._source.feed(direction, data))

    def rest(self) -> bytes:
        """What goes out when nothing follows."""
        return self._pass(self._source.rest())

    def _pass(self, data: bytes) -> bytes:
        if self.sending:
            return data
        self.withheld_bytes += len(data)
        return b""


class PlayedLaser(PlayedDevice):
    """An optoNCDT sensor: answers as the one of the log, its rate and output words are those of the log.

    Args:
        identity: what it said of itself; where it said nothing the rig file counts.
        config: its table of the rig file.

    Raises:
        LogError: an identity no sensor has.
    """

    expects = "OUTPUT RS422"

    def __init__(self, identity: Mapping[str, Any], config: Laser) -> None:
        words = identity.get("words", DEFAULT_WORDS)
        if not isinstance(words, list | tuple) or not words or not all(_is_word(word) for word in words):
            raise LogError(f"identities.json: expected names of output words as the sensor gives them, got {words!r}")
        super().__init__(WholeBlocks(len(words)))
        self._sensor = SensorCommands(
            info_lines(_told(identity, config)), float(config.rate_Hz), outputs_of(words), fixed=True
        )

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._sensor.streaming

    def begin(self) -> None:
        """See PlayedDevice."""
        self._sensor.streaming = True

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        answers = self._sensor.receive(data)
        self.commands += answers.count(optoncdt.PROMPT.encode())
        return answers


class PlayedNode(PlayedDevice):
    """The on-rotor node: sends by itself; a command is neither carried out nor acknowledged."""

    def __init__(self) -> None:
        super().__init__()
        self._frames = rotorlink.FrameDecoder()

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        asked = sum(isinstance(frame, rotorlink.Command) for frame in self._frames.feed(data).frames)
        self.commands += asked
        self.unfollowed += asked
        return b""


class PlayedDrive(PlayedDevice):
    """A drive behind its adapter: takes settings, follows the network's start and stop, turns as it did.

    Args:
        config: its table of the rig file.
    """

    expects = "the network's start"

    def __init__(self, config: Drive) -> None:
        super().__init__(BothWays())
        self._node = config.node_id
        self._adapter, self._nmt = Adapter(), NmtState(config.node_id)
        self._report = re.compile(f"t{cia402.cob_tpdo(1, config.node_id):03X}4([0-9A-Fa-f]{{8}})".encode())
        self._reported = bytes(4)
        objects = drive_objects()
        measured = {
            (cia402.STATUSWORD, 0): lambda: self._reported[:2],
            (cia402.ACTUAL_VELOCITY, 0): lambda: self._reported[2:],
            (cia402.MODE_DISPLAY, 0): lambda: struct.pack("<b", objects[cia402.MODE_OF_OPERATION, 0][0]),
        }
        self._sdo = SdoServer(objects, measured, self._written)

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._adapter.open and self._nmt.state == cia402.Heartbeat.OPERATIONAL

    def begin(self) -> None:
        """See PlayedDevice."""
        self._adapter.open, self._nmt.state = True, cia402.Heartbeat.OPERATIONAL

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice. What only the adapter is told configures no drive."""
        frames, answers = self._adapter.receive(data)
        self.commands += len(frames)
        sent = b"".join(slcan.encode(answer) for frame in frames if (answer := self._answer(frame)) is not None)
        return answers + sent if self._adapter.open else answers

    def _pass(self, data: bytes) -> bytes:
        if reports := self._report.findall(data):
            self._reported = bytes.fromhex(reports[-1].decode())
        return super()._pass(data)

    def _answer(self, frame: slcan.CanFrame) -> slcan.CanFrame | None:
        identifier, data = frame.arbitration_id, frame.data
        if self._nmt.heed(frame) in (NMT_RESET, NMT_RESET_COMMUNICATION):
            return slcan.CanFrame(cia402.cob_heartbeat(self._node), bytes([cia402.Heartbeat.BOOT_UP]))
        if identifier == cia402.cob_sdo_request(self._node) and len(data) == 8:
            return slcan.CanFrame(cia402.cob_sdo_answer(self._node), self._sdo.answer(data))
        if identifier == cia402.cob_rpdo(1, self._node) and len(data) == 4:
            self._turn(cia402.unpack_rpdo1(data)[0])
        return None

    def _written(self, index: int, sub: int, value: int) -> None:
        if (index, sub) == (cia402.CONTROLWORD, 0):
            self._turn(value)

    def _turn(self, controlword: int) -> None:
        """Torque and speed are as they were; that a host takes them away at its end is no wish a log refuses."""
        self.unfollowed += controlword == cia402.ENABLE_OPERATION


def played_devices(log: Log) -> dict[str, PlayedDevice]:
    """What stands in for each device of a log.

    Raises:
        LogError: the log does not say what its devices were.
    """
    devices, identities = rig_of(log).devices, identities_of(log)

    def laser(name: str, config: Laser) -> PlayedDevice:
        identity = identities.get(name, {})
        if not isinstance(identity, Mapping):
            raise LogError(f"{log.path}: identities.json: expected a table for {name}, got {identity!r:.80}")
        try:
            return PlayedLaser(identity, config)
        except LogError as fault:
            raise LogError(f"{log.path}: {name}: {fault}") from fault

    makers = {
        "laser_x": lambda: laser("laser_x", devices.laser_x),
        "laser_y": lambda: laser("laser_y", devices.laser_y),
        "encoder": PlayedNode,
        "drive": lambda: PlayedDrive(devices.drive),
    }
    return {device: makers.get(device, PlayedDevice)() for device in log.devices}


def _is_word(word: object) -> bool:
    return isinstance(word, str) and _WORD.fullmatch(word) is not None


def _told(identity: Mapping[str, Any], config: Laser) -> optoncdt.Info:
    """What the sensor said of itself when it was asked; a range corrected afterwards is not what it says."""
    range_m = identity.get("told_range_m", identity.get("range_m", config.range_m))
    if not isinstance(range_m, int | float) or not 0 < range_m < 100:
        raise LogError(f"identities.json: expected a measuring range in m, got {range_m!r}")
    name, serial, version = (str(identity.get(key, _UNKNOWN)) for key in ("name", "serial", "version"))
    return optoncdt.Info(name=name, serial=serial, range_m=float(range_m), version=version)
