"""A simulated converter: registers behind Modbus RTU, ramps, and a watchdog that stops the motor.

Stand-in for a converter of a log while the log is played.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from typing_extensions import override

from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FaultKind
from daq.drivers.simulated_motor import COAST_RPM_S, QUICK_RPM_S, SimulatedMotor
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import World
from rig_basics.units import RPM
from rig_drivers.modbus_converter import wire
from rig_drivers.modbus_converter.registers import Registers
from rig_drivers.modbus_converter.settings import ModbusConverter

_ANSWER_S = 0.005  # from the request to the answer, s
_SILENCE_S = 0.02  # s after which received bytes are the beginning of another frame
_MOST_REGISTERS = 16
_NO_FUNCTION, _NO_REGISTER, _BAD_VALUE, _FAILED = 1, 2, 3, 4
"""Exception codes."""


class RegisterServer:
    """A converter's end of the line: it takes request frames and makes the answers.

    Args:
        settings: table of the converter in the rig file.
        words: its registers by number, changed in place.
        written: called with register and value before each write; returns an exception code, or 0 to accept it.
        readable: whether a read of a number of registers from one on is answered at all.

    Attributes:
        requests: number of intact requests so far.
    """

    def __init__(
        self,
        settings: ModbusConverter,
        words: dict[int, int],
        written: Callable[[int, int], int],
        readable: Callable[[int, int], bool] = lambda register, count: True,
    ) -> None:
        self.words: dict[int, int] = words
        self.requests: int = 0
        self._settings, self._written, self._readable = settings, written, readable
        self._frame = bytearray()

    def silence(self) -> None:
        """Take a pause of the line: the next byte begins a frame."""
        self._frame.clear()

    def receive(self, data: bytes) -> bytes:
        """Take bytes of a frame; return the answer with its last byte, if the frame is for this converter."""
        self._frame += data
        request = wire.parse_request(bytes(self._frame))
        if request is None:
            del self._frame[: -wire.LONGEST_FRAME_BYTES]
            return b""
        self._frame.clear()
        if request.address != self._settings.address:
            return b""
        self.requests += 1
        answer = self._answer(request)
        return b"" if answer is None else wire.encode_answer(answer)

    def _answer(self, request: wire.Request) -> wire.Answer | None:
        r, first = self._settings.registers, request.register
        if request.function not in (r.read_function, r.write_function):
            return wire.Answer(request, exception=_NO_FUNCTION)
        if request.function == r.write_function:
            return wire.Answer(request, exception=self._write(first, request.values))
        if not self._readable(first, request.count):
            return None
        if request.count > _MOST_REGISTERS:
            return wire.Answer(request, exception=_BAD_VALUE)
        values = tuple(self.words[number] for number in range(first, first + request.count) if number in self.words)
        if len(values) < request.count:
            return wire.Answer(request, exception=_NO_REGISTER)
        return wire.Answer(request, values)

    def _write(self, first: int, values: tuple[int, ...]) -> int:
        """Execute a write; return the exception code of a refusal, or 0."""
        for register, value in enumerate(values, first):
            kept = register if register in self.words else register - self._settings.registers.write_offset
            code = self._written(kept, value) if kept in self.words else _NO_REGISTER
            if code:
                return code
            self.words[kept] = value
        return 0


def initial_words(settings: ModbusConverter) -> dict[int, int]:
    """Return the registers of a converter that has just got its supply."""
    r = settings.registers
    words = {first + k: 0 for first, count in settings.blocks for k in range(count)}
    words |= {r.control: r.stop, r.reference: 0, r.acceleration: 100, r.deceleration: 100}
    for register in (r.watchdog, r.watchdog_action):
        if register is not None:
            words[register] = 0
    words[r.status] = _status(r, running=False, reverse=False, fault=False)
    return words


def _status(r: Registers, *, running: bool, reverse: bool, fault: bool) -> int:
    """Return the status word; a later state replaces the bits of an earlier one."""
    word = 0
    for active, mask, values in (
        (not fault, r.ready_mask, r.ready_values[-1:]),
        (running, r.running_mask, r.running_values[:1]),
        (running and reverse, r.reverse_mask, r.reverse_values),
        (fault, r.fault_mask, r.fault_values),
    ):
        if active and values:
            word = word & ~mask | values[0]
    return word


class SimulatedConverter(SimulatedMotor):
    """Converter with an induction motor that turns the rotor as commanded; the rotor is slower than the field.

    Args:
        settings: table of the converter in the rig file; the simulated converter has these values.
        motion: motion of the rotor.
        slip: share by which the rotor is slower than the field.

    Attributes:
        collisions: number of requests that came before the last answer had gone out.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        **SimulatedMotor.fault_kinds,
        "fault": FaultKind(
            "it has a fault: no torque, until it is reset", 3, end=None, meaning="the fault code", limits=(1, 255)
        ),
        "mute": FaultKind("it does not answer, and goes on executing requests"),
        "deaf": FaultKind("no request reaches it"),
        "late": FaultKind("it answers late", 0.15, meaning="by this time, s", limits=(0, 10)),
        "refuses": FaultKind("it refuses every write", 4, meaning="the exception code", limits=(0, 255)),
        "damage": FaultKind("its answers are damaged on the line"),
        "time-out": FaultKind(
            "its communication timeout is not the one in its register",
            3.0,
            end=1,
            meaning="ratio to it",
            limits=(0.01, 1e3),
        ),
    }

    def __init__(self, settings: ModbusConverter, motion: SimulatedMotion, slip: float = 0.0) -> None:
        super().__init__(motion)
        self._settings, self._slip = settings, slip
        self.collisions: int = 0
        self._received_s = -1.0
        self._server = RegisterServer(settings, {}, self._written)
        self._restart()

    @classmethod
    def of(cls, device: str, settings: ModbusConverter, world: World) -> SimulatedConverter:
        """Make the converter of a simulated rig."""
        return cls(settings, world.motion, world.virtual.drive.slip)

    @override
    def _restart(self) -> None:
        self._server.words.clear()
        self._server.words.update(initial_words(self._settings))
        self._server.silence()
        self._answers: list[tuple[float, bytes]] = []  # due times, s, and answers
        self.state: str = "off"  # or "run", "stop" along the ramp, "quick" stop
        self._direction, self._fault, self._timed_out = 1, 0, False
        self._heard_s: float | None = None
        self._runaway_rpm = None

    @override
    def facts(self) -> dict[str, Any]:
        more = {"drive": self.state, "collisions": self.collisions, "requests": self._server.requests}
        return {**super().facts(), **more}

    @override
    def fail(self, what: str, value: Any) -> None:
        if what == "fault":
            self._trip(int(value))
        else:
            super().fail(what, value)

    def _trip(self, code: int) -> None:
        self._fault, self.state = code, "off"
        self.emergencies.append(code)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. Without supply the torque is 0; after power-up the registers have their initial values."""
        super().power(on, now_s)
        self._restart()

    @property
    @override
    def watchdog_ms(self) -> int:
        """Communication timeout, ms; 0 if it is off or cannot be set."""
        r = self._settings.registers
        return 0 if r.watchdog is None else round(1e3 * self._server.words[r.watchdog] * r.watchdog_step_s)

    # --- the line ----------------------------------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host; the answer follows with a later step."""
        self._passed_s(now_s)
        if self._now_s - self._received_s > _SILENCE_S:
            self._server.silence()
        self._received_s = self._now_s
        if self._faults["deaf"]:
            return b""
        if any(due_s <= self._now_s + _ANSWER_S for due_s, _ in self._answers):
            self.collisions += 1  # both drive the same two wires: neither frame is intact
            self._answers.clear()
            return b""
        before = self._server.requests
        self._measure()
        answer = self._server.receive(data)
        if self._server.requests > before:
            self._heard_s = self._now_s
        if answer and not self._faults["mute"]:
            damaged = bytes([answer[0], answer[1] ^ 0x10, *answer[2:]]) if self._faults["damage"] else answer
            free_s = self._answers[-1][0] if self._answers else self._now_s  # it answers in order
            self._answers.append((max(free_s, self._now_s + self._faults["late"]) + _ANSWER_S, damaged))
        return b""

    def _measure(self) -> None:
        """Update the registers that are only read."""
        s, words = self._settings, self._server.words
        r, running = s.registers, self.state != "off"
        words[r.status] = _status(r, running=running, reverse=self._direction < 0, fault=bool(self._fault))
        if r.fault_code is not None:
            words[r.fault_code] = self._fault
        reported_rpm = self._reported_rpm if running else 0.0
        field_Hz = reported_rpm / (1 - self._slip) * s.gear * s.pole_pairs / 60
        shown = {"Hz": field_Hz, "rpm": 60 * field_Hz / s.pole_pairs, "%": 100 * field_Hz / s.max_Hz}[r.speed_unit]
        counts = round(shown / r.speed_step)
        words[r.speed] = counts & 0xFFFF if r.speed_signed else min(abs(counts), 0xFFFF)

    def _written(self, register: int, value: int) -> int:
        r = self._settings.registers
        if self._faults["refuses"]:
            return int(self._faults["refuses"])
        if register in (r.status, r.speed, r.fault_code):
            return _NO_REGISTER
        if register == r.control:
            return self._command(value)
        return 0

    def _command(self, word: int) -> int:
        r = self._settings.registers
        if word == r.reset:
            self._fault, self._timed_out = 0, False
        elif word == r.stop:
            self.state = "off" if self.state == "off" else "stop"
        elif word == r.quick_stop:
            self.state = "off" if self.state == "off" else "quick"
            self._runaway_rpm = None
        elif word in (r.run, r.run_reverse):
            if self._fault:
                return _FAILED
            self.state, self._direction = "run", -1 if word == r.run_reverse else 1
        elif word not in r.before_run:
            return _BAD_VALUE
        return 0

    def step(self, now_s: float) -> bytes:
        """Update watchdog, ramps and state up to `now_s`; return the answers that are due."""
        self._passed_s(now_s)
        if not self.line_alive:
            self._drive(0.0, COAST_RPM_S)
            return b""
        self._watch()
        s, words = self._settings, self._server.words
        r = s.registers
        target = self._reference_rpm() if self._runaway_rpm is None else self._runaway_rpm
        faster = abs(target) * RPM >= abs(self._motion.speed_rad_s)
        counts = max(1, words[r.acceleration if self.state == "run" and faster else r.deceleration])
        ramp = s.max_Hz * 60 / s.pole_pairs / s.gear / (counts * r.ramp_step_s)
        if self.state in ("stop", "quick") and abs(self._motion.speed_rad_s) < 0.01:
            self._end()
        match self.state:
            case "run":
                self._drive(target, ramp)
            case "stop":
                self._drive(0.0, ramp)
            case "quick":
                self._drive(0.0, QUICK_RPM_S, braking=True)
            case _:
                self._drive(0.0, COAST_RPM_S)
        due = [answer for due_s, answer in self._answers if due_s <= self._now_s]
        self._answers = [(due_s, answer) for due_s, answer in self._answers if due_s > self._now_s]
        return b"".join(due)

    def _reference_rpm(self) -> float:
        """Speed of the field at the rotor for the reference, rpm."""
        s, r = self._settings, self._settings.registers
        word = self._server.words[r.reference]
        shown = r.reference_step * (word - 0x10000 if r.reference_signed and word >= 0x8000 else word)
        field_Hz = {"Hz": shown, "rpm": shown * s.pole_pairs / 60, "%": shown * s.max_Hz / 100}[r.reference_unit]
        return self._direction * max(-s.max_Hz, min(field_Hz, s.max_Hz)) * 60 / s.pole_pairs / s.gear

    def _watch(self) -> None:
        """Stop along the ramp if no request has come within the timeout; at rest there is a fault."""
        limit_ms = self.watchdog_ms * self._faults["time-out"]
        if not limit_ms or self._heard_s is None or (self._now_s - self._heard_s) * 1e3 <= limit_ms:
            return
        self._heard_s = None  # the watch begins again with the next request
        self._timed_out = True
        if self.state == "run":
            self.state = "stop"
        elif self.state == "off":
            self._end()

    def _end(self) -> None:
        """Switch the output off at rest; after a timeout with a fault, if the converter has a code for it."""
        self.state = "off"
        code = self._settings.registers.watchdog_fault
        if self._timed_out and code and not self._fault:
            self._trip(code)
        self._timed_out = False


class PlayedConverter(PlayedDevice):
    """A converter that answers the opening dialogue and all writes; its speed is that of the log.

    Its reports are those of the log: the reads of state and speed are answered only before the first byte is played.

    Args:
        settings: table of the converter in the rig file.
        identity: of the converter; it is not needed.
    """

    def __init__(self, settings: ModbusConverter, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._settings = settings
        self._began = False
        self._server = RegisterServer(settings, initial_words(settings), self._written, self._reads)

    @override
    def hear(self, data: bytes) -> bytes:
        answers = self._server.receive(data)
        self.commands: int = self._server.requests
        return answers

    def _reads(self, register: int, count: int) -> bool:
        return not (self._began and (register, count) in self._settings.blocks)

    def _written(self, register: int, value: int) -> int:
        r = self._settings.registers
        self.unfollowed += register == r.control and value in (r.run, r.run_reverse)
        return 0

    @override
    def play(self, direction: int, data: bytes) -> bytes:
        self._began = True
        return super().play(direction, data)
