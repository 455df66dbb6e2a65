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
from typing import Any

from daq.drivers.devices import devices_of
from daq.drivers.simulated import FarEnd
from daq.transports.host_clock import HostClock
from daq.transports.wires import Wire, make_wire
from daq.virtual_rig.control import ControlServer
from daq.virtual_rig.motion import Motion
from daq.virtual_rig.world import World
from rig_configs.errors import RigConfigError
from rig_configs.load import with_truth
from rig_configs.schema import Rig

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
        self.motion = Motion(rig.true_physics, virtual.drive.slip, virtual.drive.lag_s)
        world = World(virtual, self.motion, self._clock.patience)
        self.far_ends: dict[str, FarEnd] = {
            name: device.far_end(world) for name, device in devices_of(rig.devices).items()
        }
        self.wires: dict[str, Wire] = {name: make_wire(link) for name in self.far_ends}
        self.token = secrets.token_urlsafe(16)
        self.control = ControlServer(self.token)
        self._release_hold_s: float | None = None
        self._running = True

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
                wire.send(self.far_ends[name].receive(data, self.motion.time_s))
        if self._release_hold_s is not None and now >= self._release_hold_s:
            self.motion.let_go()
            self._release_hold_s = None
        for name, far_end in self.far_ends.items():
            self.wires[name].send(far_end.step(self.motion.time_s))
        stretch = self.motion.advance(now)
        if stretch is None:
            return
        for name, far_end in self.far_ends.items():
            self.wires[name].send(far_end.sample(stretch))

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
            case "pluck" | "flick" | "lock" | "release" | "turn" as act:
                self._by_hand(act, request, now)
            case "set":
                self._set(str(request["key"]), request["value"])
            case "truth":
                return {"truth": self.motion.physics.identified()}
            case "state":
                facts: dict[str, Any] = {"time_s": self.motion.time_s}
                for far_end in self.far_ends.values():
                    facts |= far_end.facts()
                return {**facts, "overrun_bytes": {n: w.overrun_bytes for n, w in self.wires.items()}}
            case "fail":
                self.far_ends[str(request["device"])].fail(str(request["what"]), request.get("value", 1))
            case "unplug":
                self.wires[str(request["device"])].close()
            case "quit":
                self._running = False
            case other:
                raise ValueError(f"unknown request {other!r}")
        return {"ok": True}

    def _by_hand(self, act: str, request: dict[str, Any], now: float) -> None:
        """What a person does at the rig; what a device holds is not the hand's."""
        roles, motion = self._rig.roles, self.motion
        holder = roles.locks if act in ("lock", "release") else roles.speed if act == "turn" else None
        if holder is not None:
            raise ValueError(f"that is {holder.device}'s to do")
        match act:
            case "pluck":
                motion.hold(request.get("x_mm", 0.0) * 1e-3, request.get("y_mm", 0.0) * 1e-3)
                self._release_hold_s = now + request.get("hold_s", 0.5)
            case "flick":
                if not motion.flick(int(request["pendulum"]), float(request["speed_rad_s"])):
                    raise ValueError("this pendulum is locked")
            case "turn":
                motion.target_rad_s = float(request["rpm"]) * math.pi / 30
                motion.ramp_rad_s2 = float(request["ramp_rpm_per_s"]) * math.pi / 30
            case _:
                for pendulum in (0, 1):
                    motion.lock(pendulum, 0.0) if act == "lock" else motion.release(pendulum)

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
