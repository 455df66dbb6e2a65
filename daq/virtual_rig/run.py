"""The virtual rig's edge: wires, wall clock and control port around a simulated rig."""

from __future__ import annotations

import contextlib
import json
import queue
import secrets
import select
import sys
import threading
import time
from typing import Any

from daq.transports.host_clock import HostClock
from daq.transports.wires import Wire, make_wire
from daq.virtual_rig.control import ControlServer
from daq.virtual_rig.rig import SimulatedRig
from rig_configs.schema import Rig

_TICK_S = 0.002  # wall time between two looks at the world


class VirtualRig:
    """A simulated rig whose devices are on wires and whose time passes by itself.

    Args:
        rig: a rig file with a [virtual] table.
        time_scale: seconds of rig time per wall second.
        link: "pty", "tcp" or "auto".
    """

    def __init__(self, rig: Rig, time_scale: float = 1.0, link: str = "auto") -> None:
        self._clock = HostClock(time_scale)
        self._t0_ns = self._clock.now_ns()
        self.rig = SimulatedRig(rig, self._clock.patience)
        self.wires: dict[str, Wire] = {name: make_wire(link) for name in self.rig.far_ends}
        self.token = secrets.token_urlsafe(16)
        self.control = ControlServer(self.token)
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
        self._t0_ns = self._clock.now_ns() - int(self.rig.motion.time_s * 1e9)  # what compiling took is not rig time
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
        now_s = (self._clock.now_ns() - self._t0_ns) * 1e-9
        self._operator(now_s)
        sent = self.rig.step(now_s, {name: wire.receive() for name, wire in self.wires.items()})
        for name, wire in self.wires.items():
            wire.send(sent[name])

    def _operator(self, now_s: float) -> None:
        while True:
            try:
                request, answer = self.control.requests.get_nowait()
            except queue.Empty:
                return
            try:
                answer.put(self._do(request, now_s))
            except (KeyError, TypeError, ValueError) as error:
                answer.put({"error": f"{request.get('do')}: {error!s}"})

    def _do(self, request: dict[str, Any], now_s: float) -> dict[str, Any]:
        match request.get("do"):
            case "unplug":
                self.wires[str(request["device"])].close()
            case "quit":
                self._running = False
            case "state":
                facts = self.rig.do(request, now_s)
                return {**facts, "overrun_bytes": {n: w.overrun_bytes for n, w in self.wires.items()}}
            case _:
                return self.rig.do(request, now_s)
        return {"ok": True}


def serve(rig: Rig, time_scale: float, link: str, while_stdin_open: bool = False) -> None:
    """Run a virtual rig until it is told to quit; prints one JSON line with its ports when it is ready.

    Args:
        while_stdin_open: end, too, when standard input closes: whoever started it is gone.
    """
    virtual = VirtualRig(rig, time_scale, link)
    virtual.rig.motion.advance(0.001)  # compile before anyone connects
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
