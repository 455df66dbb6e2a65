"""A simulated device: its far end on a moving rig, its pipeline, and all data on its line."""

from __future__ import annotations

import queue
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.drivers.contract import LockControl, Pipeline, Poller, RotorGuard, SpeedControl
from daq.drivers.driver import Driver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.errors import LinkLost
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.clock import SimulatedClock
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import DeviceClock, World
from rig_basics.units import TO_RPM
from rig_configs import load_rig
from rig_configs.device import DeviceSettings
from rig_configs.schema import Radio, SimulatedSensors, Virtual

NAME = "device"
NOISE_M = 4e-6
PLUCK_M = (3e-3, 2e-3)
"""Displacement of the column before it is released, x and y, m."""
STEP_S = 0.01
"""Period at which the rig moves and passes its bytes to the host, s."""
_ANSWERS_S = (0.3e-3, *(0.5e-3 * k for k in range(1, 9)))  # after a request: an answer does not wait for the next step
_HOLD_S, _TURN_RAD_S, _RAMP_RAD_S2, _FLICK_RAD_S = 0.3, 20.0, 40.0, 4.0

Items = list[Batch | DeviceEvent]


def settings_for(driver: Driver) -> DeviceSettings:
    """Return the settings of the driver's example.

    Raises:
        pydantic.ValidationError: the example is not valid.
    """
    return driver.example_at("simulated")


class SetClockWorld(World):
    """A world in which the device clocks start at a given time."""

    clock_at_s: float = 0.0

    def clock(self, device: str) -> DeviceClock:
        """See World."""
        return DeviceClock(self.clock_at_s, 2e-5)


@dataclass
class Tape:
    """Data on a line, and what a fresh pipeline decoded from them.

    Attributes:
        identity: of the device.
        reads: direction, bytes and host time, ns, in order.
        items: decoded batches and events.
        losses: counted by the pipeline at the end.
        motion_s, motion: the rig's motion, rows as in `daq.drivers.simulated.MotionInterval`.
    """

    identity: Mapping[str, Any]
    reads: list[tuple[int, bytes, int]] = field(default_factory=list[tuple[int, bytes, int]])
    items: Items = field(default_factory=list["Batch | DeviceEvent"])
    losses: dict[str, int] = field(default_factory=dict[str, int])
    motion_s: NDArray[np.floating[Any]] = field(default_factory=lambda: np.zeros(0))
    motion: NDArray[np.floating[Any]] = field(default_factory=lambda: np.zeros((0, 10)))


class DriverBench:
    """One device on its line, the rig that moves in front of it, and the host's side of the line (see Talk).

    Args:
        driver: of the device.
        seed: of all that is random.
        clock_at_s: time of the device's clock at the start, s; None: drawn from the seed.

    Attributes:
        clock: simulated clock; the rig moves during its waits, in one thread.
        gone: whether the link is lost.
        items: output of the pipeline since its start.
        control: the command of the rotor, if the driver has one and `begin` was called.
        permitted: requests of `control` for permission.
        refuse: raised in place of a permission.
    """

    def __init__(self, driver: Driver, seed: int = 1, clock_at_s: float | None = None) -> None:
        sensors = SimulatedSensors(laser_noise_m=NOISE_M, axis_angle_deg=0.0, draw_calibration=False)
        virtual = Virtual(seed=seed, lock_play_deg=0.0, sensors=sensors, radio=Radio(burst_start=0.0))
        self.driver: Driver = driver
        self.settings: DeviceSettings = settings_for(driver)
        self.clock: SimulatedClock = SimulatedClock()
        physics = load_rig("virtual").true_physics
        self.motion: SimulatedMotion = SimulatedMotion(physics, virtual.drive.slip, virtual.drive.lag_s)
        world = SetClockWorld if clock_at_s is not None else World
        self.world: SetClockWorld | World = world(virtual, self.motion)
        if isinstance(self.world, SetClockWorld) and clock_at_s is not None:
            self.world.clock_at_s = clock_at_s
        self.far: FarEnd = driver.far_end(NAME, self.settings, self.world)
        self.replies: queue.Queue[str] = self.clock.queue()
        self.gone = False
        self.control: SpeedControl | None = None
        self.locks: LockControl | None = None
        self.poller: Poller | None = None
        self.permitted: list[float | None] = []
        self.refuse: Exception | None = None
        self.identity: dict[str, Any] = {}
        self._bytes_in = 0
        self._stretches: list[tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]]] = []
        self.restart_decoding()
        self.clock.after(STEP_S, self._step, world=True)

    # --- Talk --------------------------------------------------------------------------------------------------

    @property
    def bytes_in(self) -> int:
        """See Talk."""
        return self._bytes_in

    def send(self, data: bytes) -> None:
        """See Talk. The device answers during the next wait."""
        if self.gone:
            raise LinkLost(f"{NAME}: the link is gone")
        self._feed(TX, data)
        self.clock.after(0.0, lambda: self._reach(data), world=True)

    def restart_decoding(self) -> None:
        """See Talk."""
        self.pipeline: Pipeline = self.driver.pipeline(NAME, self.settings, self.identity)
        self.items: Items = []
        self.reads: list[tuple[int, bytes, int]] = []

    # --- the line ----------------------------------------------------------------------------------------------

    def _came(self, data: bytes) -> None:
        if data and not self.gone:
            self._bytes_in += len(data)
            self._feed(RX, data)
            if self.poller is not None:
                self.poller.heard(data)

    def _feed(self, direction: int, data: bytes) -> None:
        host_ns = self.clock.now_ns()
        self.reads.append((direction, data, host_ns))
        found = self.pipeline.feed(direction, data, host_ns)
        self.items += found
        if self.control is not None and direction == RX:
            self.control.notice(self.pipeline)
        for item in found:
            if isinstance(item, DeviceEvent) and item.kind == "reply":
                self.replies.put(item.text)
            elif isinstance(item, DeviceEvent) and item.kind == "acknowledge" and self.locks is not None:
                self.locks.heard(item)

    def _reach(self, data: bytes) -> None:
        """Pass bytes of the host to the device, on a rig that has moved until now."""
        self._move()
        self._came(self.far.receive(data, self.motion.time_s))
        for seconds in _ANSWERS_S:
            self.clock.after(seconds, self._move, world=True)

    def _step(self) -> None:
        self._move()
        self.clock.after(STEP_S, self._step, world=True)

    def _move(self) -> None:
        self._came(self.far.step(self.motion.time_s))
        stretch = self.motion.advance(self.clock.now_s())
        if stretch is not None:
            self._stretches.append((stretch.time_s[1:], stretch.rows[1:]))
            self._came(self.far.sample(stretch))

    # --- actions ------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Open the device as a session does, and start a recording with a fresh pipeline that has its identity."""
        self.driver.load()
        self.identity = self.driver.open(NAME, self.settings, self)
        if self.driver.speed_source is not None:
            self.control = self.driver.speed_source(self.settings, self.send, self.clock, self.guard)
            self.control.start()
        if self.driver.locks is not None:
            self.locks = self.driver.locks(self.settings, self.send, self.clock)
        self.restart_decoding()
        if self.driver.poller is not None:
            self.poller = self.driver.poller(self.settings, self.send, self.clock)
            self.poller.start()

    def end(self) -> None:
        """Stop the device as a session does: first its requests.

        Raises:
            LinkLost, DeviceError: the device is disconnected.
        """
        if self.poller is not None:
            self.poller.stop()
        self.driver.stop(self.settings, self)

    @property
    def guard(self) -> RotorGuard:
        """Guard of a speed source: permission by the test, state of the simulated rotor."""
        return RotorGuard(self._permit, self._at_rest, lambda: abs(self.motion.speed_rad_s) * TO_RPM)

    def _permit(self, rpm: float | None) -> None:
        self.permitted.append(rpm)
        if self.refuse is not None:
            raise self.refuse

    def _at_rest(self) -> bool | None:
        return abs(self.motion.speed_rad_s) < 0.05

    def stir(self) -> None:
        """Move the rig: pluck the column, release and flick the pendulums, turn the rotor.

        The rotor is not turned if the driver turns it.
        """
        self.motion.hold(*PLUCK_M)
        self.clock.after(_HOLD_S, self._release, world=True)
        if self.control is None:
            self.motion.target_rad_s, self.motion.ramp_rad_s2 = _TURN_RAD_S, _RAMP_RAD_S2

    def _release(self) -> None:
        self.motion.release_column()
        for pendulum in (0, 1):
            self.motion.release(pendulum)
            self.motion.flick(pendulum, _FLICK_RAD_S)

    def cut_tape(self) -> Tape:
        """Return all data since the recording began."""
        times = [part for part, _ in self._stretches] or [np.zeros(0)]
        rows = [part for _, part in self._stretches] or [np.zeros((0, 10))]
        return Tape(
            self.identity,
            list(self.reads),
            list(self.items),
            dict(self.pipeline.losses),
            np.concatenate(times),
            np.concatenate(rows),
        )


class PlayedTalk:
    """Line to the stand-in for a device of a log (see Talk)."""

    def __init__(self, bench: DriverBench, played: PlayedDevice) -> None:
        self._bench, self._played = bench, played
        self.clock: SimulatedClock = bench.clock
        self.replies: queue.Queue[str] = bench.clock.queue()
        self.bytes_in: int = 0
        self.control: SpeedControl | None = None
        self.restart_decoding()

    def send(self, data: bytes) -> None:
        """See Talk."""
        self._pipeline.feed(TX, data, self._bench.clock.now_ns())
        answer = self._played.hear(data)
        if not answer:
            return
        self.bytes_in += len(answer)
        for item in self._pipeline.feed(RX, answer, self._bench.clock.now_ns()):
            if isinstance(item, DeviceEvent) and item.kind == "reply":
                self.replies.put(item.text)
        if self.control is not None:
            self.control.notice(self._pipeline)

    def restart_decoding(self) -> None:
        """See Talk."""
        self._pipeline = self._bench.driver.pipeline(NAME, self._bench.settings, {})


def decoded(
    driver: Driver, settings: DeviceSettings, identity: Mapping[str, Any], reads: Sequence[tuple[int, bytes, int]]
) -> tuple[Items, Pipeline]:
    """Decode reads by a fresh pipeline."""
    pipeline = driver.pipeline(NAME, settings, identity)
    out: Items = []
    for direction, data, host_ns in reads:
        out += pipeline.feed(direction, data, host_ns)
    return out, pipeline
