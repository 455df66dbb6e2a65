"""The simulated on-rotor encoder node, the air between it and its dongle, and the dongle."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.drivers.rotorlink import wire as rotorlink
from daq.drivers.rotorlink.line import FrameDecoder
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import DeviceClock, World
from rig_configs.device import RotorNodeSettings
from rig_configs.schema import Radio

_NODE = 1
_MECHANISM_S = 0.05  # time from a release command to the open lock
_MAX_LOCKING_RAD_S = 0.5  # locking is refused above this speed
_NONE = np.empty(0, np.int64), np.empty((0, 2), np.int32)  # numbers and counts of no samples


class Air:
    """The radio: it loses frames in bursts, delays them with jitter, and keeps their order.

    Attributes:
        silent: whether all frames are lost in both directions.
        delay_s: delay of a frame without jitter, s.
        sent: number of node frames sent so far.
        dropped: indices, from 0, of the node frames that were lost.
        last_delivered: index of the last node frame that reached the dongle; -1 before the first.
    """

    def __init__(self, config: Radio, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        self._bad = self.silent = False
        self._flying: deque[tuple[float, int, bytes]] = deque()
        self._busy_until = 0.0
        self.sent: int = 0
        self.dropped: list[int] = []
        self.last_delivered: int = -1

    @property
    def delay_s(self) -> float:
        """See above."""
        return self._config.delay_s

    def _lost(self) -> bool:
        if self.silent:
            return True
        change = self._config.burst_stop if self._bad else self._config.burst_start
        if self._rng.random() < change:
            self._bad = not self._bad
        return self._bad and self._rng.random() < self._config.loss_in_burst

    def uplink(self, time_s: float, payload: bytes) -> None:
        """Send a node frame on air."""
        number, self.sent = self.sent, self.sent + 1
        if self._lost():
            self.dropped.append(number)
            return
        arrival = time_s + self._config.delay_s + self._config.jitter_s * float(self._rng.exponential())
        self._busy_until = max(self._busy_until, arrival)
        self._flying.append((self._busy_until, number, payload))

    def downlink(self) -> bool:
        """Whether a host frame reaches the node."""
        return not self._lost()

    def lose_flying(self) -> None:
        """Lose all frames that are on air now."""
        self.dropped += [number for _, number, _ in self._flying]
        self._flying.clear()

    def landed(self, now_s: float) -> list[tuple[float, bytes]]:
        """Return the frames that have reached the dongle, with their arrival times, s."""
        out: list[tuple[float, bytes]] = []
        while self._flying and self._flying[0][0] <= now_s:
            arrival, number, payload = self._flying.popleft()
            self.last_delivered = number
            out.append((arrival, payload))
        return out


class SimulatedNode(FarEnd):
    """Node, air and dongle behind one serial line.

    Attributes:
        dead: whether the node sends nothing any more; its dongle continues.
        fault_flags: encoder faults that the node reports (bit 0 A, bit 1 B).
        marks_lost: whether the index sensor detects no mark.
        locks_stuck: whether a lock that is commanded to move reports a fault.
        air: the radio.
        samples_per_block: number of samples in an encoder block.

    Args:
        config: table of the node in the rig file.
        motion: motion of the rig.
        zero_error_rad: zero error of each encoder, rad, shape (2,).
        noise_counts: standard deviation of the noise before quantisation, counts.
        play_rad: largest offset of a closed lock, rad.
        clock: clock of the node.
        air: the radio.
        rng: source of the noise.
    """

    samples_per_block: ClassVar[int] = 20
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "dead": FaultKind("the node sends nothing any more; the receiver continues"),
        "radio": FaultKind("all frames on air are lost in both directions; the node continues to count"),
        "flags": FaultKind("the node reports a fault of its encoders", meaning="bit 0: A, bit 1: B", limits=(0, 3)),
        "marks lost": FaultKind("its index sensor detects no mark"),
        "locks stuck": FaultKind("a lock that is commanded to move reports a fault"),
    }

    def __init__(
        self,
        config: RotorNodeSettings,
        motion: SimulatedMotion,
        zero_error_rad: NDArray[np.floating],
        noise_counts: float,
        play_rad: float,
        clock: DeviceClock,
        air: Air,
        rng: np.random.Generator,
    ) -> None:
        self._config, self._motion, self._zero, self._noise = config, motion, zero_error_rad, noise_counts
        self.air: Air = air
        self._play, self._clock, self._rng = play_rad, clock, rng
        self.dead: bool = False
        self.marks_lost: bool = False
        self.locks_stuck: bool = False
        self._without_supply = False
        self.fault_flags: int = 0
        self._period = 1.0 / config.rate_Hz
        self._next = 0
        self._index = 0
        self._pending: tuple[NDArray[np.int64], NDArray[np.int32]] = _NONE  # numbers and counts before the next block
        self._seq = 0
        self._dongle_seq = 0
        self._status_due = self._dongle_due = 0.0
        self._run = bytearray()
        self._acted: deque[tuple[int, bytes]] = deque(maxlen=32)
        self._due: list[tuple[float, int, Callable[[], None], int]] = []  # lock mechanisms that are moving
        self._closing: dict[int, int] = {}
        self._offset_counts = np.zeros(2)
        self._closed = [True, True]

    def _us(self, time_s: float) -> int:
        return int(float(self._clock.device_s(time_s)) * 1e6) % 2**32

    def _send(self, time_s: float, build: Callable[[int], bytes]) -> None:
        if self.dead or self._without_supply:
            return
        payload = build(self._seq)
        self._seq = (self._seq + 1) & 0xFFFF
        self.air.uplink(time_s, payload)

    @classmethod
    def of(cls, device: str, config: Any, world: World) -> Self:
        """Make the node of a simulated rig."""
        virtual = world.virtual
        zero = world.spread * math.radians(config.zero_std_deg) * world.calibration.standard_normal(2)
        return cls(
            config,
            world.motion,
            zero,
            virtual.sensors.encoder_noise_counts,
            math.radians(virtual.lock_play_deg),
            world.clock(device),
            Air(virtual.radio, world.rng("radio")),
            world.rng("node"),
        )

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes the host sent to the dongle."""
        for run in data.split(b"\x00")[:-1] if not self._run else (bytes(self._run) + data).split(b"\x00")[:-1]:
            decoded = FrameDecoder().feed(run + b"\x00")
            for frame in decoded.frames:
                self.hear(frame, now_s)
        tail = (bytes(self._run) + data).split(b"\x00")[-1]
        self._run = bytearray(tail[-300:])
        return b""

    def hear(self, frame: rotorlink.Frame, now_s: float, tries: int = 1) -> bool:
        """Take a host's frame from the air, which may lose it; return whether one of the tries was received."""
        if self._without_supply:
            return False
        received = any(self.air.downlink() for _ in range(tries))
        if received:
            self._host_frame(frame, now_s + self.air.delay_s)
        return received

    def _host_frame(self, frame: rotorlink.Frame, now_s: float) -> None:
        if isinstance(frame, rotorlink.Ping):
            us = self._us(now_s)
            self._send(now_s, lambda seq: rotorlink.Pong(_NODE, seq, us, us + 40, frame.seq).pack())
        elif isinstance(frame, rotorlink.NodeCommand):
            known = next((result for seq, result in self._acted if seq == frame.seq), None)
            result = self._command(frame, now_s) if known is None else known[0]
            if known is None:
                self._acted.append((frame.seq, bytes([result])))
            self._send(now_s, lambda seq: rotorlink.Acknowledge(_NODE, seq, frame.seq, result).pack())

    def _command(self, frame: rotorlink.NodeCommand, now_s: float) -> int:
        """Execute a command; return the result code of its acknowledgement."""
        names = {v: k for k, v in rotorlink.ACTIONS.items()}
        action = names.get(frame.action)
        if action is None or (action != "zero" and not self._config.locks):
            return 2
        if action == "zero":
            # zero is A's locked position for both pendulums: that of B is half a revolution away
            at_locks = np.array([0.0, self._config.counts_per_revolution / 2])
            self._offset_counts = self._counts_exact() - at_locks
            return 0
        verb, which = action.split()
        pendulums = {"A": [0], "B": [1], "both": [0, 1]}[which]
        if verb == "lock" and abs(self._motion.speed_rad_s) > _MAX_LOCKING_RAD_S:
            return 1
        wanted = verb == "lock"
        pendulums = [i for i in pendulums if self._closed[i] != wanted]
        if not pendulums:
            return 4
        if self.locks_stuck:
            for i in pendulums:
                self._lock_event(now_s, i, 3, frame.seq)
            return 0
        for i in pendulums:
            if wanted:
                self._motion.lock(i, float(self._rng.uniform(-self._play, self._play)))
                self._closing[i] = frame.seq
                self._lock_event(now_s, i, 2, frame.seq)
            else:
                self._due.append((now_s + _MECHANISM_S, i, lambda i=i: self._motion.release(i), frame.seq))
        return 0

    def _lock_event(self, time_s: float, pendulum: int, state: int, command: int) -> None:
        us = self._us(time_s)
        self._send(time_s, lambda seq: rotorlink.LockEvent(_NODE, seq, us, pendulum, state, command).pack())

    def step(self, now_s: float) -> bytes:
        """See FarEnd: finish the movements of lock mechanisms that are due."""
        for entry in [e for e in self._due if e[0] <= now_s]:
            self._due.remove(entry)
            _, pendulum, act, command = entry
            act()
            self._closed[pendulum] = False
            self._lock_event(now_s, pendulum, 1, command)
        for pendulum in [i for i in self._closing if self._motion.locked_in(i)]:
            self._closed[pendulum] = True
            self._lock_event(now_s, pendulum, 0, self._closing.pop(pendulum))
        return b""

    def _counts_exact(self) -> NDArray[np.floating]:
        return (self._motion.angles_rad + self._zero) * self._config.counts_per_revolution / (2 * math.pi)

    @override
    def sample(self, motion: MotionInterval) -> bytes:
        self.put_on_air(motion)
        return self.dongle(float(motion.time_s[-1]))

    def fail(self, what: str, value: Any) -> None:
        """See FarEnd and `fault_kinds`; the value 0 ends each fault."""
        match what:
            case "radio":
                self.air.silent = bool(value)
            case "dead":
                self.dead = bool(value)
            case "flags":
                self.fault_flags = int(value)
            case "marks lost":
                self.marks_lost = bool(value)
            case "locks stuck":
                self.locks_stuck = bool(value)
            case _:
                super().fail(what, value)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. The supply is the node's battery; the dongle at the host keeps its supply.

        Time, index and seq start at 0. The counters keep their zero and the locks their positions.
        """
        self._without_supply = not on
        if on:
            self._clock.reset(now_s)
            self._next = self._index = self._seq = 0
            self._pending = _NONE
            self._acted.clear()
            self._due.clear()

    def facts(self) -> dict[str, Any]:
        """See FarEnd: the radio's counts of sent, dropped and delivered frames."""
        return {"sent": self.air.sent, "dropped": self.air.dropped, "last_delivered": self.air.last_delivered}

    def put_on_air(self, motion: MotionInterval) -> None:
        """Send the frames of an interval of motion on air, in order of time."""
        queue: list[tuple[float, Callable[[], None]]] = []
        queue += self._index_marks(motion)
        queue += self._blocks(motion)
        end = float(motion.time_s[-1])
        if end >= self._status_due:
            self._status_due = end + 1.0
            queue.append((end, lambda: self._status(end)))
        for _, act in sorted(queue, key=lambda q: q[0]):
            act()

    def _status(self, now_s: float) -> None:
        per_turn = self._config.counts_per_revolution
        sent, us = self.air.sent, self._us(now_s)
        self._send(now_s, lambda seq: rotorlink.NodeStatus(_NODE, seq, us, 3712, 315, sent, 0, 1, 4, per_turn).pack())

    def _index_marks(self, motion: MotionInterval) -> list[tuple[float, Callable[[], None]]]:
        index = math.radians(self._config.index_angle_deg)
        turns = np.floor((motion.rows[:, 8] - index) / (2 * math.pi))
        out: list[tuple[float, Callable[[], None]]] = []
        for i in np.flatnonzero(np.diff(turns) > 0):
            phase = 2 * math.pi * turns[i + 1] + index
            a, b = motion.rows[i, 8], motion.rows[i + 1, 8]
            wa, wb = motion.rows[i, 9], motion.rows[i + 1, 9]
            step = motion.time_s[i + 1] - motion.time_s[i]
            u = (phase - a) / (b - a)
            for _ in range(3):  # Newton's method; ψ within a grid step is approximated by a parabola
                slope = (wa + (wb - wa) * u) * step
                u -= (a + (wa + 0.5 * (wb - wa) * u) * u * step - phase) / slope
            t = float(motion.time_s[i] + min(max(u, 0.0), 1.0) * step)
            out.append((t, lambda t=t, n=int(turns[i + 1]): self._mark(t, n)))
        return out

    def _mark(self, time_s: float, revolutions: int) -> None:
        if self.marks_lost:
            return
        us = self._us(time_s)
        self._send(time_s, lambda seq: rotorlink.IndexMark(_NODE, seq, us, revolutions % 2**32).pack())

    def _blocks(self, motion: MotionInterval) -> list[tuple[float, Callable[[], None]]]:
        if self._next == 0:
            self._next = math.floor(float(self._clock.device_s(motion.time_s[0])) / self._period) + 1
        last = math.floor(float(self._clock.device_s(motion.time_s[-1])) / self._period)
        numbers = np.arange(self._next, last + 1)
        self._next = max(self._next, last + 1)
        if not len(numbers):
            return []
        times = np.clip(self._clock.rig_s(numbers * self._period), motion.time_s[0], motion.time_s[-1])
        angles = np.column_stack([motion.at(times, 2, 6), motion.at(times, 3, 7)]) + self._zero
        exact = angles * self._config.counts_per_revolution / (2 * math.pi) - self._offset_counts
        exact += self._noise * self._rng.standard_normal(exact.shape)
        counts = np.floor(exact + 0.5).astype(np.int64).astype(np.int32)
        before, size = len(self._pending[0]), self.samples_per_block
        numbers, counts = np.concatenate([self._pending[0], numbers]), np.concatenate([self._pending[1], counts])
        whole = len(numbers) - len(numbers) % size
        self._pending = numbers[whole:], counts[whole:]
        out: list[tuple[float, Callable[[], None]]] = []
        for first in range(0, whole, size):
            block, first_s = counts[first : first + size], float(numbers[first] * self._period)
            sent_s = float(times[first + size - 1 - before])
            out.append((sent_s, lambda t=sent_s, f=first_s, b=block: self._block(t, f, b)))
        return out

    def _block(self, time_s: float, first_s: float, counts: NDArray[np.int32]) -> None:
        closed = self._closed if self._config.locks else (False, False)
        flags = (32 if closed[0] else 0) | (64 if closed[1] else 0) | self.fault_flags
        index, self._index = self._index, self._index + len(counts)
        us, period = round(first_s * 1e6) % 2**32, round(self._period * 1e6)
        self._send(
            time_s,
            lambda seq: rotorlink.EncoderBlock(_NODE, seq, index % 2**32, us, period, flags, counts).pack(),
        )

    def dongle(self, now_s: float) -> bytes:
        """Return the bytes from the dongle to the host: received node frames, each wrapped, and its own status."""
        out = b""
        for arrival, payload in self.air.landed(now_s):
            frame = rotorlink.Wrapped(
                _NODE, self._dongle_seq, int(arrival * 1e6) % 2**32, -58, rotorlink.parse_node(payload)
            )
            self._dongle_seq = (self._dongle_seq + 1) & 0xFFFF
            out += rotorlink.wire(frame.pack())
        if now_s >= self._dongle_due:
            self._dongle_due = now_s + 1.0
            received = self.air.sent - len(self.air.dropped)
            status = rotorlink.DongleStatus(_NODE, self._dongle_seq, int(now_s * 1e6) % 2**32, received, 0, -58)
            self._dongle_seq = (self._dongle_seq + 1) & 0xFFFF
            out += rotorlink.wire(status.pack())
        return out
