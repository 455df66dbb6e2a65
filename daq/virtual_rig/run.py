"""I/O of the virtual rig: wires, wall clock and control port of a simulated rig."""

from __future__ import annotations

import contextlib
import os
import queue
import secrets
import select
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from daq.drivers.devices import devices_of
from daq.transports.host_clock import HostClock
from daq.transports.wires import Wire, make_wire
from daq.virtual_rig.control import ControlServer
from daq.virtual_rig.rig import SimulatedRig
from daq.virtual_rig.running import Running, leave_note
from rig_configs.schema import Rig

_TICK_S = 0.002  # period of the steps, s
_MAX_LAST_ANSWER_S = 0.2  # wait until the last answer has been sent, s


class VirtualRig:
    """A simulated rig with devices on wires and a running clock.

    Args:
        rig: a rig file with a [virtual] table.
        link: "pty", "tcp" or "auto".

    Attributes:
        rig: the simulated rig.
        wires: wires by device.
        token: token of the control port.
        control: the control port.
        moved: called when a device has a new port.
    """

    def __init__(self, rig: Rig, link: str = "auto") -> None:
        self._name, self._link = rig.name, link
        self._clock = HostClock()
        self._t0_ns = self._clock.now_ns()
        self.rig: SimulatedRig = SimulatedRig(rig)
        self.rig.motion.advance(0.001)  # compile before the first connection
        self._lines = {name: device.line for name, device in devices_of(rig.devices).items()}
        self.wires: dict[str, Wire] = {name: self._wire(name) for name in self.rig.far_ends}
        self._pulled: set[str] = set()
        self.token: str = secrets.token_urlsafe(16)
        self.control: ControlServer = ControlServer(self.token)
        self.moved: Callable[[], object] = lambda: None
        self._running = True

    def _wire(self, device: str) -> Wire:
        return make_wire(self._link, adapter=self._lines[device].bitrate is not None)

    @property
    def zero_ns(self) -> int:
        """Start of the rig's time, ns since 1970."""
        return self._t0_ns

    def running(self) -> Running:
        """Return the data that a simulated operator needs to connect."""
        return Running(self._name, os.getpid(), self.control.port, self.token, self.ports())

    def ports(self) -> dict[str, str]:
        """Return the port of each device, by its name in the rig file."""
        return {name: wire.port for name, wire in self.wires.items()}

    def quit_at_end_of_input(self) -> None:
        """Wait until standard input is closed, then end the rig."""
        sys.stdin.read()
        self._running = False

    def run(self) -> None:
        """Run until the request "quit"."""
        self._t0_ns = self._clock.now_ns() - int(self.rig.motion.time_s * 1e9)  # the compilation is not rig time
        due = time.monotonic()
        while self._running:
            self.step()
            due = max(due + _TICK_S, time.monotonic())
            self._wait(due)

    def close(self) -> None:
        """Close every wire and the control port. The answer to the last request is still sent."""
        self.control.close(_MAX_LAST_ANSWER_S)
        for wire in self.wires.values():
            wire.close()

    def _wait(self, due: float) -> None:
        """Sleep until the next tick. Bytes of the host end the sleep."""
        descriptors = [d for w in self.wires.values() if (d := w.descriptor()) is not None]
        timeout = max(0.0, due - time.monotonic())
        if sys.platform == "win32":
            time.sleep(timeout)
        else:
            select.select(descriptors, [], [], timeout)

    def step(self) -> None:
        """Process requests of the operator, received bytes, motion and bytes to send."""
        now_s = (self._clock.now_ns() - self._t0_ns) * 1e-9
        self._operator(now_s)
        sent = self.rig.step(now_s, {name: wire.receive() for name, wire in self.wires.items()})
        for name, wire in self.wires.items():
            wire.send(sent[name])

    def _operator(self, now_s: float) -> None:
        while True:
            try:
                request, answer = self.control.requests.get_nowait()
            except queue.Empty:  # usual: no request waits
                return
            try:
                answer.put(self._do(request, now_s))
            except KeyError as error:
                answer.put({"error": f"{request.get('do')}: expected {error!s}, which is missing"})
            except (TypeError, ValueError, ArithmeticError, OSError) as error:
                answer.put({"error": f"{request.get('do')}: {error!s}"})

    def _do(self, request: dict[str, Any], now_s: float) -> dict[str, Any]:
        match request.get("do"):
            case "unplug":
                device = self._device(request)
                self.wires[device].pull()
                self._pulled.add(device)
            case "plug":
                return {"ok": True, "port": self._plug(self._device(request))}
            case "quit":
                self._running = False
            case "state":
                return self._state(self.rig.do(request, now_s))
            case _:
                return self.rig.do(request, now_s)
        return {"ok": True}

    def _device(self, request: dict[str, Any]) -> str:
        device = str(request["device"])
        if device not in self.wires:
            raise ValueError(f"no device {device!r}; this rig has {', '.join(self.wires)}")
        return device

    def _plug(self, device: str) -> str:
        """Plug a device in again and return its port, which may have a new name as on a real system."""
        if device not in self._pulled:
            raise ValueError(f"{device} is plugged in, at {self.wires[device].port}")
        self.wires[device].close()
        wire = self._wire(device)
        wire.overrun_bytes = self.wires[device].overrun_bytes
        self.wires[device] = wire
        self._pulled.discard(device)
        self.moved()
        return wire.port

    def _state(self, facts: dict[str, Any]) -> dict[str, Any]:
        for name, device in facts["devices"].items():
            device |= {"port": self.wires[name].port, "plugged": name not in self._pulled}
        return {**facts, "overrun_bytes": {name: wire.overrun_bytes for name, wire in self.wires.items()}}


def serve(
    virtual: VirtualRig, ready: Callable[[Path | None], None], note: Path | None, leaves_note: bool, until_eof: bool
) -> None:
    """Run a virtual rig until the request "quit" or an interrupt.

    Args:
        virtual: the rig; it is closed at the end.
        ready: called with the path of the note before the rig runs.
        note: path of the note for the simulated operator; None for the default path.
        leaves_note: whether to write the note.
        until_eof: whether to end the rig also when standard input is closed, which shows that its parent has ended.

    Raises:
        OSError: the note cannot be written.
    """
    path = None
    try:
        if leaves_note:
            path = leave_note(virtual.running(), note)
            virtual.moved = lambda: leave_note(virtual.running(), path)
        ready(path)
        if until_eof:
            threading.Thread(target=virtual.quit_at_end_of_input, daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):  # usual: the operator ends the rig
            virtual.run()
    finally:
        if path is not None:
            path.unlink(missing_ok=True)
        virtual.close()
