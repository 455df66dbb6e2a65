"""Simulated CANopen encoders behind an slcan adapter: objects, network commands, SYNC, own timers, heartbeats.

The positions are formed from the profile's objects (6000h … 6004h), not by the pipeline's code.

Stand-in for CANopen encoders of a log while the log is played.

The objects of an encoder at the far end: of the simulated one, and of the stand-in for one of a log.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from daq.drivers.can_lines import Adapter, PlayedOnBus
from daq.drivers.canopen import cia301
from daq.drivers.canopen.changes import PDO_OFF
from daq.drivers.canopen.node import NMT_STOP, RESETS, Node, Objects
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.errors import LogError
from daq.transports.can_frames import CanFrame, encode
from daq.virtual_rig.world import DeviceClock, World
from rig_basics.texts import number_of
from rig_drivers.cia406 import wire
from rig_drivers.cia406.settings import FAULT_KEYS, Encoder, EncoderBus

TURNS = 4096
"""Number of distinguishable revolutions of the simulated encoders."""


def encoder_objects(node: int, serial: int, per_turn: int, positions: int, parameters: int) -> Objects:
    """Return the objects of a multi-turn encoder as delivered: reports by its own timer, which is off, and at SYNC.

    Args:
        node: node number.
        serial: serial number.
        per_turn, positions: its scaling, counts per revolution and in all.
        parameters: its operating parameters (6000h).
    """
    kind = 0x0002_0196 if positions > per_turn else 0x0001_0196
    objects: Objects = {
        (cia301.DEVICE_TYPE, 0): (kind, "<I"),
        (cia301.ERROR_REGISTER, 0): (0, "<B"),
        (cia301.PREDEFINED_ERROR_FIELD, 0): (0, "<B"),
        (cia301.PREDEFINED_ERROR_FIELD, 1): (0, "<I"),
        (cia301.SYNC_IDENTIFIER, 0): (cia301.COB_SYNC, "<I"),
        (cia301.PRODUCER_HEARTBEAT, 0): (0, "<H"),
        (cia301.IDENTITY, 1): (0x0000_0D0C, "<I"),
        (cia301.IDENTITY, 2): (0x0000_3643, "<I"),
        (cia301.IDENTITY, 3): (0x0001_0002, "<I"),
        (cia301.IDENTITY, 4): (serial, "<I"),
        (0x6000, 0): (parameters, "<H"),
        (0x6001, 0): (per_turn, "<I"),
        (0x6002, 0): (positions, "<I"),
        (0x6003, 0): (0, "<I"),
        (0x6200, 0): (0, "<H"),
        (0x6501, 0): (per_turn, "<I"),
        (0x6502, 0): (max(1, positions // per_turn), "<H"),
        (0x6503, 0): (0, "<H"),
        (0x6505, 0): (0, "<H"),
    }
    for number, kind in ((0, 254), (1, 1)):
        objects[cia301.TPDO1 + number, 1] = (cia301.cob_tpdo(number + 1, node), "<I")
        objects[cia301.TPDO1 + number, 2] = (kind, "<B")
        objects[cia301.TPDO1 + number, 3] = (0, "<H")
        objects[cia301.TPDO1 + number, 5] = (0, "<H")
        objects[cia301.TPDO1_MAPPING + number, 0] = (1, "<B")
        objects[cia301.TPDO1_MAPPING + number, 1] = (0x6004_0020, "<I")
    return objects


_LATEST_REPORTS_S = 0.05  # longest pause of the simulation after which reports are sent afterwards, s
_COLUMNS = {"a": (2, 6), "b": (3, 7), "shaft": (8, 9)}  # of the motion: angle and its rate


class SimulatedEncoder:
    """One encoder on the bus.

    Args:
        encoder: the encoder in the rig file.
        settings: table of the encoders in the rig file.
        serial: serial number, if the rig file states none.
        zero_error_rad: angle that it reads in addition to the true one, rad.
        noise_counts: standard deviation of the noise before quantisation, counts.
        clock: clock of its own timer.
        rng: source of the noise.

    Attributes:
        dead: whether it neither sends nor receives.
        frozen: whether its position no longer follows the angle.
        deaf_to_sync: number of SYNCs that it will not answer.
        out: frames that wait to be sent.
    """

    def __init__(
        self,
        encoder: Encoder,
        settings: EncoderBus,
        serial: int,
        zero_error_rad: float,
        noise_counts: float,
        clock: DeviceClock,
        rng: np.random.Generator,
    ) -> None:
        self.name: str = encoder.name
        self.dead: bool = False
        self.frozen: bool = False
        self.deaf_to_sync: int = 0
        self.out: list[CanFrame] = []
        self._encoder, self._settings = encoder, settings
        self._zero_error_rad, self._noise = zero_error_rad, noise_counts
        self._clock, self._rng = clock, rng
        self._serial = encoder.serial or serial
        self._syncs = 0  # SYNCs that came since the last interval of motion
        self._position = 0
        self.start()

    def start(self) -> None:
        """Begin with the settings as delivered, and the boot-up message."""
        per_turn = self._settings.counts_per_revolution
        number = self._encoder.node
        self._node = Node(
            number,
            encoder_objects(number, self._serial, per_turn, per_turn * TURNS, 0x4),
            {(0x6004, 0): lambda: struct.pack("<I", self._position)},
            self._written,
        )
        self._sync_count = 0
        self._next: int | None = None
        self._syncs = 0
        self.out.append(self._node.boot_up())

    @property
    def objects(self) -> Objects:
        """Its objects, which a test may change."""
        return self._node.sdo.objects

    @property
    def fixed(self) -> set[tuple[int, int]]:
        """Objects that it refuses to change, until its next start."""
        return self._node.sdo.fixed

    def emergency(self, code: int) -> None:
        """Send an emergency with an error code; 0: the error has ended."""
        register = 0x21 if code else 0  # bit 0 generic, bit 5 device profile
        self.objects[cia301.ERROR_REGISTER, 0] = (register, "<B")
        self.objects[cia301.PREDEFINED_ERROR_FIELD, 0] = (int(code > 0), "<B")
        self.objects[cia301.PREDEFINED_ERROR_FIELD, 1] = (code, "<I")
        self.out.append(self._node.emergency(code, register))

    def _written(self, index: int, sub: int, value: int) -> None:
        if (index, sub) == (0x6200, 0):  # the same timer
            self.objects[0x1800, 5] = (value, "<H")
        if (index, sub) == (0x1800, 5):
            self.objects[0x6200, 0] = (value, "<H")

    def take(self, frame: CanFrame) -> None:
        """Take a frame of the bus."""
        if self.dead:
            return
        if self._node.command(frame) in RESETS:
            self.start()
        elif frame.arbitration_id != self.objects[0x1005, 0][0] & 0x7FF:
            self.out += self._node.answers(frame)
        else:
            missed = self.deaf_to_sync > 0
            self.deaf_to_sync -= missed
            self._syncs += not missed

    def stop(self) -> None:
        """Leave network operation."""
        self.take(CanFrame(cia301.COB_NMT, bytes((NMT_STOP, self._node.number))))

    def beat(self, now_s: float) -> None:
        """Send the heartbeat if it is due."""
        if not self.dead:
            self.out += self._node.heartbeat(now_s)

    def due(self, motion: MotionInterval) -> list[tuple[float, CanFrame]]:
        """Return the reports of an interval of motion with their instants, s.

        The rig passes the host's bytes on at the end of the interval in which they came.
        """
        syncs, self._syncs = self._syncs, 0
        out: list[tuple[float, CanFrame]] = []
        own = self._own_instants(motion)
        if self.dead or not self._node.operational:
            return out
        for number, by_timer in ((0, own), (1, list[float]())):
            if (0x1800 + number, 1) not in self.objects:
                continue
            identifier, kind = (self.objects[0x1800 + number, sub][0] for sub in (1, 2))
            if identifier & PDO_OFF:
                continue
            numbers = range(self._sync_count + 1, self._sync_count + syncs + 1)
            at_syncs = [float(motion.time_s[-1]) for i in numbers if i % max(1, kind) == 0]
            instants = at_syncs if 1 <= kind <= 240 else by_timer
            out += [(at_s, self._report(number, identifier, motion, at_s)) for at_s in instants]
        self._sync_count += syncs
        return out

    def _own_instants(self, motion: MotionInterval) -> list[float]:
        """Return the instants of the own timer in the interval, s."""
        period_s = self.objects[0x1800, 5][0] * 1e-3
        if not period_s or self.objects[0x1800, 2][0] < 254:
            self._next = None
            return []
        first, last = (math.floor(float(self._clock.device_s(float(motion.time_s[i]))) / period_s) for i in (0, -1))
        begin = first + 1 if self._next is None else self._next
        begin = max(begin, last - math.floor(_LATEST_REPORTS_S / period_s))
        self._next = last + 1
        numbers = np.arange(begin, last + 1)
        return [float(at_s) for at_s in self._clock.rig_s(numbers * period_s)]

    def _report(self, number: int, identifier: int, motion: MotionInterval, at_s: float) -> CanFrame:
        if not self.frozen:
            self._position = self._read(motion, at_s)
        mapped = [self.objects[0x1A00 + number, 1 + i][0] for i in range(self.objects[0x1A00 + number, 0][0])]
        data = b"".join(self._mapped(entry) for entry in mapped)
        return CanFrame(identifier & 0x7FF, data)

    def _mapped(self, entry: int) -> bytes:
        answer = self._node.sdo.answer(struct.pack("<BHBI", 0x40, entry >> 16, entry >> 8 & 0xFF, 0))
        return answer[4 : 4 + (entry & 0xFF) // 8]

    def _read(self, motion: MotionInterval, at_s: float) -> int:
        """Return the position at an instant, as 6000h … 6002h define it."""
        at = np.clip(np.array([at_s]), motion.time_s[0], motion.time_s[-1])
        angle = float(motion.at(at, *_COLUMNS[self.name])[0]) + self._zero_error_rad
        if self.name == "shaft":
            angle -= math.radians(self._settings.index_angle_deg)
        per_turn, total = self.objects[0x6001, 0][0], self.objects[0x6002, 0][0]
        clockwise = angle if self._encoder.positive == "cw" else -angle
        grows = -clockwise if self.objects[0x6000, 0][0] & 1 else clockwise
        exact = self._encoder.zero_counts + grows * per_turn / (2 * math.pi)
        return math.floor(exact + self._noise * float(self._rng.standard_normal()) + 0.5) % total


class SimulatedEncoders(FarEnd):
    """Encoders and adapter behind one port.

    Args:
        encoders: the encoders.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "dead": FaultKind("one encoder neither sends nor receives", 1, 0, "1 A, 2 B, 3 shaft", (0, 3)),
        "frozen": FaultKind("one encoder repeats its position", 1, 0, "1 A, 2 B, 3 shaft", (0, 3)),
        "restart": FaultKind("one encoder starts again: its set-up is gone", 1, None, "1 A, 2 B, 3 shaft", (1, 3)),
        "stopped": FaultKind("one encoder leaves network operation", 1, None, "1 A, 2 B, 3 shaft", (1, 3)),
        "missed": FaultKind("encoder A does not answer some SYNCs", 1, None, "number of SYNCs", (1, 1000)),
        "emergency": FaultKind("encoder A reports an error", 0x5000, 0, "the error code", (0, 0xFFFF)),
        "second master": FaultKind("another node sends SYNC, one for each of this host's, between them"),
    }

    def __init__(self, encoders: list[SimulatedEncoder]) -> None:
        self.encoders: list[SimulatedEncoder] = encoders
        self._adapter = Adapter()
        self._without_supply = self._second_master = False
        self._foreign: list[CanFrame] = []

    @classmethod
    def of(cls, device: str, settings: EncoderBus, world: World) -> SimulatedEncoders:
        """Make the encoders of a simulated rig; the zero errors of A and B are drawn."""
        zero = world.spread * math.radians(settings.zero_std_deg) * world.calibration.standard_normal(2)
        errors = {"a": float(zero[0]), "b": float(zero[1]), "shaft": 0.0}
        noise = world.virtual.sensors.encoder_noise_counts
        made = [
            SimulatedEncoder(
                encoder,
                settings,
                1000 + encoder.node,
                errors[encoder.name],
                noise,
                world.clock(f"{device} {encoder.name}"),
                world.rng(f"noise {device} {encoder.name}"),
            )
            for encoder in settings.encoders
        ]
        return cls(made)

    @override
    def receive(self, data: bytes, now_s: float) -> bytes:
        frames = self._adapter.receive(data)
        for frame in [] if self._without_supply else frames:
            for encoder in self.encoders:
                encoder.take(frame)
            if self._second_master and frame.arbitration_id == cia301.COB_SYNC:
                self._foreign.append(frame)
        return self._take()

    def _take(self) -> bytes:
        for encoder in self.encoders:
            self._adapter.out += encoder.out
            encoder.out.clear()
        return self._adapter.pass_on()

    def step(self, now_s: float) -> bytes:
        """See FarEnd: heartbeats that are due."""
        if self._without_supply:
            return b""
        for encoder in self.encoders:
            encoder.beat(now_s)
        return self._take()

    def sample(self, motion: MotionInterval) -> bytes:
        """See FarEnd: reports in order of time; of one instant in order of their identifiers, as the bus sends them."""
        due = [entry for encoder in self.encoders for entry in encoder.due(motion)]
        if self._without_supply or not self._adapter.open:
            return b""
        foreign, self._foreign = self._foreign, []
        for frame in foreign:  # they are answered in the next interval
            for encoder in self.encoders:
                encoder.take(frame)
        reports = sorted(due, key=lambda entry: (entry[0], entry[1].arbitration_id))
        return encode(*(frame for frame in (*(frame for _, frame in reports), *foreign)))

    @override
    def fail(self, what: str, value: Any = 1) -> None:
        number = int(value)
        match what:
            case "dead" | "frozen":
                for place, encoder in enumerate(self.encoders, 1):
                    setattr(encoder, what, place == number)
            case "restart":
                self._of_number(number).start()
            case "stopped":
                self._of_number(number).stop()
            case "missed":
                self.encoders[0].deaf_to_sync = number
            case "emergency":
                self.encoders[0].emergency(number)
            case "second master":
                self._second_master = bool(number)
            case _:
                super().fail(what, value)

    def _of_number(self, number: int) -> SimulatedEncoder:
        if number > len(self.encoders):
            raise ValueError(f"this device has {number_of(len(self.encoders), 'encoder')}, no number {number}")
        return self.encoders[number - 1]

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. The supply is that of the encoders; the adapter is supplied by the host and continues."""
        self._without_supply = not on
        self._adapter.repeated.clear()
        if on:
            for encoder in self.encoders:
                encoder.start()


_OTHER_OBJECT = 0x2000_0000  # entry of a PDO's mapping for a manufacturer-specific object, without its bits


class PlayedEncoders(PlayedOnBus):
    """Encoders that answer the opening and follow network commands; their positions come at the times of the log.

    The recorded SYNCs are played until a host sends its own ones. A position then counts as sampled at the newest SYNC
    of that host, up to one period away from its own time.

    Args:
        settings: table of the encoders in the rig file.
        identity: identity of the encoders from their opening.

    Raises:
        LogError: the identity is impossible.
    """

    expects = "the network's start"

    def __init__(self, settings: EncoderBus, identity: Mapping[str, Any]) -> None:
        super().__init__({cia301.COB_SYNC})
        self._nodes = [_node(encoder, settings, identity) for encoder in settings.encoders]

    @property
    @override
    def sending(self) -> bool:
        return super().sending and all(node.operational for node in self._nodes)

    @override
    def begin(self) -> None:
        super().begin()
        for node in self._nodes:
            node.state = cia301.Heartbeat.OPERATIONAL

    @override
    def is_command(self, frame: CanFrame) -> bool:
        return not self.is_host(frame)

    @override
    def is_host(self, frame: CanFrame) -> bool:
        return frame.arbitration_id == cia301.COB_SYNC

    @override
    def answers(self, frame: CanFrame) -> list[CanFrame]:
        return [answer for node in self._nodes for answer in node.answers(frame)]


def _node(encoder: Encoder, settings: EncoderBus, identity: Mapping[str, Any]) -> Node:
    """Return an encoder of the log."""
    per_turn = settings.counts_per_revolution
    name = encoder.name
    defaults = {"serial": encoder.serial, "positions": per_turn, "counter_clockwise": 0, "maker": 0, "product": 0}
    defaults |= dict.fromkeys((*FAULT_KEYS, "offset"), 0)
    known = {key: identity.get(f"{name}_{key}", value) for key, value in defaults.items()}
    if not all(type(value) is int and 0 <= value < 2**32 for value in known.values()):
        raise LogError(f"identity of encoder {name}: expected numbers of 32 bits, got {known!r:.200}")
    parameters = 0x4 | (known["counter_clockwise"] & 1)
    objects = encoder_objects(encoder.node, known["serial"], per_turn, known["positions"], parameters)
    objects[cia301.IDENTITY, 1], objects[cia301.IDENTITY, 2] = (known["maker"], "<I"), (known["product"], "<I")
    register, code, alarms, warnings = (known[key] for key in FAULT_KEYS)
    objects[cia301.ERROR_REGISTER, 0] = (register & 0xFF, "<B")
    objects[cia301.PREDEFINED_ERROR_FIELD, 1] = (code, "<I")
    objects[wire.ALARMS, 0], objects[wire.WARNINGS, 0] = (alarms & 0xFFFF, "<H"), (warnings & 0xFFFF, "<H")
    node = Node(encoder.node, objects)
    if offset := known["offset"]:  # its reports in the log contain something else before the position
        objects[cia301.TPDO1_MAPPING, 0] = (2, "<B")
        objects[cia301.TPDO1_MAPPING, 1] = (_OTHER_OBJECT | 8 * offset & 0xFF, "<I")
        objects[cia301.TPDO1_MAPPING, 2] = (wire.POSITION_MAPPED, "<I")
        node.sdo.fixed.add((cia301.TPDO1_MAPPING, 0))
    return node
