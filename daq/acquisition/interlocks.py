"""Evaluation of the interlocks: decisions to stop the rotor, and events of the channels for the log.

The session supplies samples, events and ticks; the module has no I/O and no clock. While the rotor turns, or its state
is unknown, every channel that guards it is due in every test: all displacements with valid samples, pendulum angles
without encoder faults, one index mark per revolution of the drive, and the drive's actual speed. At rest only the
channels that the test requires are due. The module depends on roles and on the fields of their channels, not on the
type of a device: a sample is invalid if its displacement is NaN, an encoder is faulty if the sample's flags are set.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.channel_watch import HOST, ChannelWatch
from daq.acquisition.exceedance import Exceedance
from daq.acquisition.interlock_table import (
    ANGLES_S,
    AT_REST_S,
    BLIND_S,
    DISPLACEMENT_S,
    FAULTY_S,
    GONE_SAMPLES,
    HOST_S,
    LARGE,
    SPEED_S,
)
from daq.acquisition.least_motion import LeastMotion
from daq.acquisition.locked_watch import LockedWatch
from daq.acquisition.motion_watch import MotionWatch
from daq.acquisition.rotor_watch import RotorWatch, Stop
from daq.channels import ENCODER_FAULT_A, ENCODER_FAULT_B
from daq.items import Batch, DeviceEvent
from rig_configs.roles import Roles
from rig_configs.schema import Limits

_FAULTS = {ENCODER_FAULT_A: "encoder A", ENCODER_FAULT_B: "encoder B"}


class Share:
    """Share of bad samples among the newest samples of a channel.

    Args:
        stretch_s: length of the evaluated stretch in the time of the samples, s.

    Attributes:
        in_a_row: number of bad samples after the last good one.
        mostly_bad: whether more than half of the samples are bad, over at least 80 % of the stretch.
    """

    def __init__(self, stretch_s: float) -> None:
        self._stretch_ns = int(stretch_s * 1e9)
        self._reads: deque[tuple[int, int, int, int]] = (
            deque()
        )  # first and last time, ns; number of samples, of bad ones
        self._samples = self._bad = 0
        self.in_a_row: int = 0
        self.mostly_bad: bool = False

    def add(self, time_ns: NDArray[np.int64], bad: NDArray[np.bool_]) -> bool:
        """Add the samples of one read. Return whether they have changed `mostly_bad`.

        Args:
            time_ns: times, ns, shape (n,), n ≥ 1.
            bad: mask of the bad samples, shape (n,).
        """
        count = int(np.count_nonzero(bad))
        self.in_a_row = self.in_a_row + count if count == len(bad) else int(np.argmin(bad[::-1]))
        self._reads.append((int(time_ns[0]), int(time_ns[-1]), len(bad), count))
        self._samples += len(bad)
        self._bad += count
        while self._reads[0][1] < self._reads[-1][1] - self._stretch_ns:
            _, _, old_samples, old_bad = self._reads.popleft()
            self._samples -= old_samples
            self._bad -= old_bad
        before, stretch_ns = self.mostly_bad, self._reads[-1][1] - self._reads[0][0]
        self.mostly_bad = 2 * self._bad > self._samples and stretch_ns >= 0.8 * self._stretch_ns
        return self.mostly_bad != before


class Interlocks:
    """Monitors every channel of a rig; thread-safe.

    Args:
        limits: limits of the rig file.
        roles: roles of the rig's devices. Interlocks of missing roles are inactive.
        least: least motion of the turning rotor by the rig file's numbers.
        driving: whether this session may turn the rotor. Sessions that only receive stop nothing.

    Attributes:
        channels: silences of the channels.
        rotor: speed of the rotor.
        resting: whether the rotor was at rest at the last tick and no speed has been commanded since.
    """

    def __init__(self, limits: Limits, roles: Roles, least: LeastMotion, *, driving: bool) -> None:
        self._limits, self._driving = limits, driving
        self._device_of = roles.device_of
        self._lasers = tuple(sensor.topic for sensor in roles.displacements)
        self._angles, self._marks, self._speed = (
            role and role.topic for role in (roles.angles, roles.phase, roles.speed)
        )
        due = [(topic, DISPLACEMENT_S, "silent displacement") for topic in self._lasers]
        others = ((self._angles, ANGLES_S, "silent angles"), (self._speed, SPEED_S, "silent speed"))
        due += [(topic, limit_s, name) for topic, limit_s, name in others if topic]
        self._silences = {topic: name for topic, _, name in due}
        deadlines = {t: (self._device_of[t], (s if driving else AT_REST_S) + HOST_S) for t, s, _ in due}
        self._node_s = deadlines[self._angles][1] if self._angles else math.inf
        if self._marks:
            deadlines[self._marks] = (self._device_of[self._marks], math.inf)
        self.channels: ChannelWatch = ChannelWatch(deadlines)
        self._rest_rpm = roles.rest_rpm
        driven = self._speed is not None
        self.rotor: RotorWatch = RotorWatch(limits.speed_rpm, driven=driven, rest_rpm=self._rest_rpm)
        self._sight = {topic: Share(BLIND_S) for topic in self._lasers}
        self._exceedances = {topic: Exceedance(limits.amplitude_m) for topic in self._lasers}
        self._motion = MotionWatch(roles.displacements, least)
        self._locked = LockedWatch(roles.zero_std_deg)
        self._seen_m = dict.fromkeys(self._lasers, 0.0)
        self._code = dict.fromkeys(self._lasers, 0)
        self._sound = {bit: Share(FAULTY_S) for bit in _FAULTS}
        self._faulty_samples = 0
        self._needed: frozenset[str] = frozenset()
        self._commanded = False  # a speed was commanded, and the rotor has not come to rest since
        self.resting: bool = False
        self._lock = threading.RLock()

    # --- input ---------------------------------------------------------------------------------------------------

    def begin(self, now_ns: int) -> None:
        """Begin a log: reset the counts of silences and bad samples."""
        with self._lock:
            self.channels.begin(now_ns, expected=self._driving)
            self._faulty_samples = 0
            self._sight = {topic: Share(BLIND_S) for topic in self._lasers}
            self._sound = {bit: Share(FAULTY_S) for bit in _FAULTS}

    def end(self, now_ns: int) -> list[DeviceEvent]:
        """End the log and return its last events."""
        with self._lock:
            return self.channels.end(now_ns)

    def need(self, topics: Iterable[str]) -> None:
        """Set the channels that the running test needs even at rest."""
        with self._lock:
            self._needed = frozenset(topics)

    def counters_set(self) -> None:
        """Register that the pendulums' counters are being set, so that their angles may jump."""
        with self._lock:
            self._locked.restart()

    def commanded(self, rpm: float) -> None:
        """Register a commanded speed, of the drive or of the operator's hand."""
        with self._lock:
            self._commanded = self._commanded or rpm != 0
            self.resting = self.resting and rpm == 0
            self.rotor.commanded(rpm)

    def feed(self, batch: Batch, host_ns: int) -> list[DeviceEvent | Stop]:
        """Evaluate samples. Return events for the log and findings that stop the rotor."""
        with self._lock:
            topic = batch.channel.topic
            back = self.channels.heard(topic, host_ns)
            out: list[DeviceEvent | Stop] = [] if back is None else [back]
            if topic in self._lasers:
                out += self._look(topic, batch, host_ns)
            elif topic == self._angles:
                out += self._pendulums(batch, host_ns)
            elif topic == self._marks:
                node_ns = batch.columns["node_time_us"].astype(np.int64) * 1000
                marks = batch.columns["revolutions"]
                out += self._wrong(self.rotor.marks_received(host_ns, batch.time_ns, node_ns, marks))
            elif topic == self._speed:
                out += self._wrong(self.rotor.drive_reported(host_ns, batch.columns["speed_rpm"]))
            return out

    def happened(self, event: DeviceEvent) -> list[Stop]:
        """Evaluate an event of a device. Return findings that stop the rotor."""
        with self._lock:
            if event.kind in ("fault", "restart"):
                if event.device == self._device_of.get(self._speed or ""):
                    self.rotor.discard_drive()
                elif event.kind == "restart" and self.resting and event.device not in self._needed_devices():
                    return []  # a sensor that lost power at rest causes a gap, not a stop
                return [Stop("device", f"{event.device}: {event.text}", event.kind)]
            if event.kind == "network" and event.facts.get("operational") is False:
                self.rotor.discard_drive()
                return [Stop("device", f"{event.device}: {event.text}", "left operation")]
            if event.kind == "lock" and event.facts.get("state") == "fault":
                text = f"{event.device}: {event.text}: the lock did not carry out its command. Look at its mechanism"
                return [Stop("device", text, "lock fault")]
            return []

    def tick(self, now_ns: int) -> list[DeviceEvent | Stop]:
        """Check the deadlines. Return events for the log and findings that stop the rotor."""
        with self._lock:
            if self.rotor.at_rest(now_ns) and not self.rotor.target_rpm:
                self._commanded = False
            turning = self.turning(now_ns)
            self.resting = not turning
            out: list[DeviceEvent | Stop] = [*self.channels.tick(now_ns)]
            if self._marks is None:
                pass
            elif turning and (why := self.rotor.unseen(now_ns)) is not None:
                out += self.channels.miss(self._marks, now_ns, why.removeprefix("tacho: "))
                if not self._node_late(now_ns):  # a silent node is reported as silent angles, not as a missing mark
                    out.append(Stop("device", why, "no index mark"))
            elif not turning:
                out += self.channels.excuse(self._marks, now_ns)
                self.rotor.reset_turns()
            if not turning:
                self._motion.clear()
            elif (found := self._motion.tick(now_ns, self.measured_rpm(now_ns))) is not None:
                out.append(found)
            if not self._driving:
                return [item for item in out if isinstance(item, DeviceEvent)]
            out += self._silent(now_ns, turning)
            if turning:
                out += self._unguarded()
            elif self._angles in self._needed:
                out += self._unsound()
            return out

    # --- state ---------------------------------------------------------------------------------------------------

    def turning(self, now_ns: int) -> bool:
        """Return whether the rotor turns, or its state is unknown.

        A rotor that is turned by hand while the drive is at rest is not monitored and does not count as turning.
        """
        with self._lock:
            if self._speed is None:  # without a drive: the test commands a hand, or the index marks show rotation
                rest = self.rotor.at_rest(now_ns)
                return rest is False or (self._commanded and rest is not True)
            by_hand = not self._commanded and abs(self.rotor.drive_rpm(now_ns)) <= self._rest_rpm
            return not by_hand and self.rotor.at_rest(now_ns) is not True

    def at_rest(self, now_ns: int) -> bool | None:
        """Return whether the rotor is at rest; see RotorWatch."""
        with self._lock:
            return self.rotor.at_rest(now_ns)

    def speed_rpm(self, now_ns: int) -> float:
        """Return the speed of the rotor, rpm; see RotorWatch."""
        with self._lock:
            return self.rotor.speed_rpm(now_ns)

    def measured_rpm(self, now_ns: int) -> float:
        """Return the measured speed, rpm: by the index marks if the rig has them, else by the drive; NaN if unknown."""
        with self._lock:
            return self.rotor.measured_rpm(now_ns) if self._marks else abs(self.rotor.drive_rpm(now_ns))

    def rotor_words(self, now_ns: int) -> str:
        """Return the state of the rotor's speed as text; see RotorWatch."""
        with self._lock:
            return self.rotor.words(now_ns)

    def obstacles(self, now_ns: int) -> list[str]:
        """Return the reasons why the rotor must not be turned now; empty if all guards are working."""
        with self._lock:
            return [stop.text for stop in (*self._silent(now_ns, turning=True), *self._unguarded())]

    def losses(self, now_ns: int) -> dict[str, dict[str, int]]:
        """Return by device the silences of this log, ms, and the number of pendulum samples with an encoder fault."""
        with self._lock:
            out = self.channels.losses(now_ns)
            if self._faulty_samples:
                out.setdefault(self._device_of[self._angles or ""], {})["faulty"] = self._faulty_samples
            return out

    def _needed_devices(self) -> set[str]:
        return {self._device_of[topic] for topic in self._needed if topic in self._device_of}

    # --- parts ---------------------------------------------------------------------------------------------------

    def _node_late(self, now_ns: int) -> bool:
        return self._angles is not None and 2 * self.channels.silent_s(self._angles, now_ns) > self._node_s

    def _silent(self, now_ns: int, turning: bool) -> list[Stop]:
        least_s = 0.0 if turning else AT_REST_S + HOST_S
        return [
            Stop(
                "device",
                f"{topic}: silent for {self.channels.sampleless_s(topic, now_ns):.1f} s. Look at the device, its "
                "cable, its power or battery, its radio",
                name,
            )
            for topic, name in self._silences.items()
            if (turning or topic in self._needed)
            and self.channels.silent(topic)
            and self.channels.silent_s(topic, now_ns) >= least_s
        ]

    def _unguarded(self) -> list[Stop]:
        return [self._is_blind(topic) for topic in self._lasers if self._sight[topic].mostly_bad] + self._unsound()

    def _unsound(self) -> list[Stop]:
        return [
            Stop(
                "device",
                f"pendulums: the node reports a fault of {_FAULTS[bit]}. "
                "Look at the encoder and its cable on the rotor",
                "encoder fault",
            )
            for bit, share in self._sound.items()
            if share.mostly_bad
        ]

    def _is_blind(self, topic: str) -> Stop:
        text = (
            f"{topic}: most samples of the last {BLIND_S:g} s are invalid (code {self._code[topic]}): the amplitude is "
            "not monitored. Check the sensor's window, its target and the space between them"
        )
        return Stop("device", text, "blind sensor")

    def _look(self, topic: str, batch: Batch, host_ns: int) -> list[DeviceEvent | Stop]:
        """Evaluate a displacement: amplitude, out of sight, blind sensor; keep it for the watch of its motion."""
        share, displacement = self._sight[topic], batch.columns["displacement_m"]
        invalid, beyond_m = np.isnan(displacement), self._exceedances[topic].feed(displacement)
        has_changed = share.add(batch.time_ns, invalid)
        if share.in_a_row:
            self._code[topic] = int(batch.columns["code"][-1])
        if share.in_a_row < len(invalid):
            self._seen_m[topic] = abs(float(displacement[-1 - share.in_a_row]))
        blind, limit = share.mostly_bad, self._limits.amplitude_m
        out: list[DeviceEvent | Stop] = []
        if has_changed:
            facts = {"of": self._device_of[topic], "channel": topic, "code": self._code[topic]}
            words = f"no valid sample, code {self._code[topic]}" if blind else "valid samples again"
            out.append(DeviceEvent("blind", HOST, f"{topic}: {words}", facts))
        gone = share.in_a_row >= GONE_SAMPLES and self._seen_m[topic] > LARGE * limit
        self._motion.feed(topic, host_ns, displacement)
        if not (blind or gone or beyond_m is not None) or not self._driving or not self.turning(host_ns):
            return out
        if beyond_m is None and not gone:
            return [*out, self._is_blind(topic)]
        name, seen = "out of sight", f"out of sight at {self._seen_m[topic] * 1e3:.1f} mm"
        if beyond_m is not None:
            name, seen = "amplitude", f"{beyond_m * 1e3:.1f} mm"
        return [*out, Stop("procedure", f"{topic}: {seen}, limits.amplitude_m is {limit * 1e3:g} mm", name)]

    def _pendulums(self, batch: Batch, host_ns: int) -> list[DeviceEvent | Stop]:
        """Evaluate pendulum angles: encoder faults, and where the pendulums stand for the least motion."""
        self.rotor.node_heard(host_ns)
        self._motion.angles(float(batch.columns["theta3_rad"][-1]), float(batch.columns["theta4_rad"][-1]))
        flags = batch.columns["flags"]
        out: list[DeviceEvent | Stop] = [*self._slips(batch)]
        self._faulty_samples += int(np.count_nonzero(flags & sum(_FAULTS)))
        for bit, share in self._sound.items():
            if share.add(batch.time_ns, (flags & bit) != 0):
                words = "reports a fault" if share.mostly_bad else "is sound again"
                facts = {"of": self._device_of[batch.channel.topic], "channel": batch.channel.topic, "flag": bit}
                out.append(DeviceEvent("encoder", HOST, f"pendulums: {_FAULTS[bit]} {words}", facts))
        return out

    def _slips(self, batch: Batch) -> Iterator[DeviceEvent | Stop]:
        """Evaluate the angles of pendulums in closed locks."""
        angles = (batch.columns["theta3_rad"], batch.columns["theta4_rad"])
        for pendulum, text in self._locked.feed(batch.time_ns, angles, batch.columns["flags"]):
            device = self._device_of[batch.channel.topic]
            facts = {"of": device, "channel": batch.channel.topic, "pendulum": pendulum}
            yield DeviceEvent("encoder", HOST, f"pendulums: {text}", facts)
            if self._driving:
                yield Stop("device", f"{device}: {text}", "loose lock")

    def _wrong(self, why: Stop | None) -> list[Stop]:
        return [why] if why is not None and self._driving else []
