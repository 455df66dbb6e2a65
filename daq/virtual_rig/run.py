"""The virtual rig's loop: time passes, things move, devices talk."""

from __future__ import annotations

import contextlib
import json
import math
import queue
import secrets
import select
import sys
import threading
import time
import zlib
from typing import Any

import numpy as np

from daq.drivers.cia402.far_end import SimulatedDrive
from daq.drivers.optoncdt.far_end import DeviceClock, SimulatedLaser
from daq.drivers.rotorlink.far_end import Air, SimulatedNode
from daq.transports.host_clock import HostClock
from daq.transports.wires import Wire, make_wire
from daq.virtual_rig.control import ControlServer
from daq.virtual_rig.motion import Motion
from rig_configs.errors import RigConfigError
from rig_configs.load import with_truth
from rig_configs.schema import Rig, Virtual

_TICK_S = 0.002  # wall time between two looks at the world


class VirtualRig:
    """All simulated devices around one motion.

    Args:
        rig: a rig file with a [virtual] table.
        time_scale: seconds of rig time per wall second.
        link: "pty", "tcp" or "auto".
    """

    def __init__(self, rig: Rig, time_scale: float = 1.0, link: str = "auto") -> None:
        if rig.virtual is None:
            raise RigConfigError(f"rig {rig.name} has no [virtual] table: there is nothing to simulate")
        self._rig = rig
        virtual = rig.virtual
        self._clock = HostClock(time_scale)
        self._t0_ns = self._clock.now_ns()
        self._virtual = virtual
        self.motion = Motion(rig.true_physics, virtual.drive.slip, virtual.drive.lag_s)
        self._make_devices(rig, virtual)
        self.wires: dict[str, Wire] = {name: make_wire(link) for name in ("laser_x", "laser_y", "encoder", "drive")}
        self.token = secrets.token_urlsafe(16)
        self.control = ControlServer(self.token)
        self._release_hold_s: float | None = None
        self._running = True

    def _rng(self, name: str) -> np.random.Generator:
        """An own stream of random numbers for each purpose: one more draw here moves nothing there."""
        return np.random.default_rng([self._virtual.seed, zlib.crc32(name.encode())])

    def _device_clock(self, name: str) -> DeviceClock:
        rng, sensors = self._rng(f"clock {name}"), self._virtual.sensors
        return DeviceClock(
            rng.uniform(0, sensors.clock_offset_s), 1e-6 * sensors.clock_drift_ppm * rng.standard_normal()
        )

    def _make_devices(self, rig: Rig, virtual: Virtual) -> None:
        sensors = virtual.sensors
        draws = self._rng("calibration")
        spread = 1.0 if sensors.draw_calibration else 0.0
        beta = math.radians(sensors.axis_angle_deg)
        directions = {"laser_x": (math.cos(beta), math.sin(beta)), "laser_y": (-math.sin(beta), math.cos(beta))}
        self.lasers = {}
        for i, (name, config) in enumerate((("laser_x", rig.devices.laser_x), ("laser_y", rig.devices.laser_y))):
            gain = config.lever_ratio * (1 + spread * config.gain_std * draws.standard_normal())
            self.lasers[name] = SimulatedLaser(
                config, gain * np.array(directions[name]), 5e-5 * draws.standard_normal(), sensors.laser_noise_m,
                self._device_clock(name), self._rng(f"noise {name}"), serial=f"{1420_0001 + i}",
            )  # fmt: skip
        encoder = rig.devices.encoder
        zero = spread * math.radians(encoder.zero_std_deg) * draws.standard_normal(2)
        self._air = Air(virtual.radio, self._rng("radio"))
        self.node = SimulatedNode(
            encoder, self.motion, zero, sensors.encoder_noise_counts, math.radians(virtual.lock_play_deg),
            self._device_clock("encoder"), self._air, self._rng("node"),
        )  # fmt: skip
        self.drive = SimulatedDrive(rig.devices.drive, self.motion, virtual.drive.report_s)

    def ports(self) -> dict[str, str]:
        """Port of each device, by its name in the rig file."""
        return {name: wire.port for name, wire in self.wires.items()}

    def quit_at_end_of_input(self) -> None:
        """Wait for standard input to close, then end."""
        sys.stdin.read()
        self._running = False

    def run(self) -> None:
        """Until told to quit."""
        self._t0_ns = self._clock.now_ns() - int(self.motion.time_s * 1e9)  # what compiling took is not rig time
        due = time.monotonic()
        while self._running:
            self.step()
            due = max(due + _TICK_S, time.monotonic())
            self._wait(due)
        for wire in self.wires.values():
            wire.close()
        self.control.close()

    def _wait(self, due: float) -> None:
        """Sleep until the next tick; a host's bytes end the sleep."""
        descriptors = [d for w in self.wires.values() if (d := w.descriptor()) is not None]
        timeout = max(0.0, due - time.monotonic())
        if sys.platform == "win32":
            time.sleep(timeout)
        else:
            select.select(descriptors, [], [], timeout)

    def step(self) -> None:
        """One look at the world: operator, incoming bytes, motion, outgoing bytes."""
        now = (self._clock.now_ns() - self._t0_ns) * 1e-9
        self._operator(now)
        for name, wire in self.wires.items():
            if data := wire.receive():
                self._deliver(name, wire, data)
        if self._release_hold_s is not None and now >= self._release_hold_s:
            self.motion.let_go()
            self._release_hold_s = None
        self.node.mechanisms(self.motion.time_s)
        self.wires["drive"].send(self.drive.step(self.motion.time_s))
        stretch = self.motion.advance(now)
        if stretch is None:
            return
        for name, laser in self.lasers.items():
            self.wires[name].send(laser.sample(stretch))
        self.node.sample(stretch)
        self.wires["encoder"].send(self.node.dongle(self.motion.time_s))

    def _deliver(self, name: str, wire: Wire, data: bytes) -> None:
        now = self.motion.time_s
        if name == "drive":
            wire.send(self.drive.receive(data, now))
        elif name == "encoder":
            self.node.receive(data, now)
        else:
            wire.send(self.lasers[name].receive(data))

    def _operator(self, now: float) -> None:
        while True:
            try:
                request, answer = self.control.requests.get_nowait()
            except queue.Empty:
                return
            try:
                answer.put(self._do(request, now))
            except (KeyError, TypeError, ValueError) as error:
                answer.put({"error": f"{request.get('do')}: {error!s}"})

    def _do(self, request: dict[str, Any], now: float) -> dict[str, Any]:
        match request.get("do"):
            case "pluck":
                self.motion.hold(request.get("x_mm", 0.0) * 1e-3, request.get("y_mm", 0.0) * 1e-3)
                self._release_hold_s = now + request.get("hold_s", 0.5)
            case "flick":
                if not self.motion.flick(int(request["pendulum"]), float(request["speed_rad_s"])):
                    raise ValueError("this pendulum is locked")
            case "set":
                self._set(str(request["key"]), request["value"])
            case "truth":
                return {"truth": self.motion.physics.identified()}
            case "radio":
                air = self._air
                return {"sent": air.sent, "dropped": air.dropped, "last_delivered": air.last_delivered,
                        "overrun_bytes": {n: w.overrun_bytes for n, w in self.wires.items()}}  # fmt: skip
            case "state":
                return {
                    "time_s": self.motion.time_s,
                    "speed_rpm": self.drive.speed_rpm,
                    "drive": self.drive.state,
                    "can_frames": self.drive.frames_sent,
                    "emergencies": self.drive.emergencies,
                    "watchdog_ms": self.drive.watchdog_ms,
                }
            case "fail":
                self._fail(str(request["device"]), str(request["what"]), request.get("value", 1))
            case "unplug":
                self.wires[str(request["device"])].close()
            case "quit":
                self._running = False
            case other:
                raise ValueError(f"unknown request {other!r}")
        return {"ok": True}

    def _fail(self, device: str, what: str, value: Any) -> None:
        """A device fails: laser_x "code" (0 ends it); encoder "dead", "flags", "marks lost", "locks stuck"; drive
        "emergency", "fault", "restart", "network", "silent reports", "reported share", "speed"."""
        match device, what:
            case (("laser_x" | "laser_y"), "code"):
                self.lasers[device].fault_code = int(value) or None
            case "encoder", "dead":
                self.node.dead = bool(value)
            case "encoder", "flags":
                self.node.fault_flags = int(value)
            case "encoder", "marks lost":
                self.node.marks_lost = bool(value)
            case "encoder", "locks stuck":
                self.node.locks_stuck = bool(value)
            case "drive", _:
                self.drive.fail(what, float(value))
            case _:
                raise ValueError(f"{device} knows no fault {what!r}")

    def _set(self, key: str, value: Any) -> None:
        """Change the truth from now on (a clamp has moved, a magnet pack was replaced)."""
        self._rig = with_truth(self._rig, key, value)
        self.motion.physics = self._rig.true_physics


def serve(rig: Rig, time_scale: float, link: str, while_stdin_open: bool = False) -> None:
    """Run a virtual rig until it is told to quit; prints one JSON line with its ports when it is ready.

    Args:
        while_stdin_open: end, too, when standard input closes: whoever started it is gone.
    """
    virtual = VirtualRig(rig, time_scale, link)
    virtual.motion.advance(0.001)  # compile before anyone connects
    ready = {"ports": virtual.ports(), "control_port": virtual.control.port, "token": virtual.token,
             "time_scale": time_scale}  # fmt: skip
    print(json.dumps(ready), flush=True)
    if while_stdin_open:
        threading.Thread(target=virtual.quit_at_end_of_input, daemon=True).start()
    else:
        ports = " ".join(f"--set devices.{name}.port={port}" for name, port in virtual.ports().items())
        print(f"for example: rig check {rig.name} --time-scale {time_scale:g} {ports}", file=sys.stderr, flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        virtual.run()
