# pyright: strict
"""The virtual rig's edge: wires, wall clock and control port around a simulated rig."""

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

from daq.transports.host_clock import HostClock
from daq.transports.paced_clock import PacedClock
from daq.transports.wires import Wire, make_wire
from daq.virtual_rig.control import ControlServer
from daq.virtual_rig.rig import SimulatedRig
from daq.virtual_rig.running import Running, leave_note
from rig_configs.schema import Rig

_TICK_S = 0.002  # wall time between two looks at the world
_LOOK_S = 0.0005  # the same while time stands
_FAREWELL_S = 0.2  # wall time for the last answer to be fetched


class VirtualRig:
    """A simulated rig whose devices are on wires and whose time passes by itself.

    Args:
        rig: a rig file with a [virtual] table.
        time_scale: seconds of rig time per wall second.
        link: "pty", "tcp" or "auto".
        pace: file of a clock that the host shares; time stands then while either is late. None: it never does.

    Attributes:
        moved: called when a device has got another port.
    """

    def __init__(self, rig: Rig, time_scale: float = 1.0, link: str = "auto", pace: Path | None = None) -> None:
        self._name, self._link = rig.name, link
        self._clock = PacedClock(time_scale, pace) if pace is not None else HostClock(time_scale)
        self._t0_ns = self._clock.now_ns()
        self.rig = SimulatedRig(rig, self._clock.patience)
        self.rig.motion.advance(0.001)  # compile before anyone connects
        self.wires: dict[str, Wire] = {name: make_wire(link) for name in self.rig.far_ends}
        self._pulled: set[str] = set()
        self.token = secrets.token_urlsafe(16)
        self.control = ControlServer(self.token)
        self.moved: Callable[[], object] = lambda: None
        self._running = True

    @property
    def zero_ns(self) -> int:
        """The beginning of the rig's time, ns since 1970."""
        return self._t0_ns

    def running(self) -> Running:
        """What the hands need of it."""
        return Running(self._name, os.getpid(), self.control.port, self.token, self._clock.rate, self.ports())

    def ports(self) -> dict[str, str]:
        """Port of each device, by its name in the rig file."""
        return {name: wire.port for name, wire in self.wires.items()}

    def quit_at_end_of_input(self) -> None:
        """Wait for standard input to close, then end."""
        sys.stdin.read()
        self._running = False

    def run(self) -> None:
        """Until it is asked to quit."""
        self._t0_ns = self._clock.now_ns() - int(self.rig.motion.time_s * 1e9)  # what compiling took is not rig time
        due = time.monotonic()
        while self._running:
            self.step()
            due = max(due + (_TICK_S if self._passes() else _LOOK_S), time.monotonic())
            self._wait(due)

    def _passes(self) -> bool:
        """Whether time passes, or stands until the host has fetched what is in the cables."""
        if not isinstance(self._clock, PacedClock):
            return True
        return self._clock.go_on(self._held_up)

    def _held_up(self) -> bool:
        held_up = [wire.held_up() for wire in self.wires.values()]  # each looks
        return any(held_up)

    def close(self) -> None:
        """Pull every cable and end the control port; the answer to the last request is still delivered."""
        self.control.close(_FAREWELL_S)
        for wire in self.wires.values():
            wire.close()

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
        """Plug a device in again, as the system does: perhaps under another name."""
        if device not in self._pulled:
            raise ValueError(f"{device} is plugged in, at {self.wires[device].port}")
        self.wires[device].close()
        wire = make_wire(self._link)
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
    """Run a virtual rig until it is asked to quit, or interrupted.

    Args:
        virtual: the rig; it is closed at the end.
        ready: called with the note's path before the rig runs.
        note: where the hands find it; None: in their usual place.
        leaves_note: whether they shall find it.
        until_eof: end, too, when standard input closes: whoever started it is gone.

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
        with contextlib.suppress(KeyboardInterrupt):
            virtual.run()
    finally:
        if path is not None:
            path.unlink(missing_ok=True)
        virtual.close()
