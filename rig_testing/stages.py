"""Execution of a schedule of faults: on simulated time in one thread, or in real time on ptys.

Both keep the whole true motion of the simulated rig, with which the log is compared.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.edge import Edge, real_edge
from daq.lockstep.clock import SimulatedClock
from daq.lockstep.rig import LockstepRig
from daq.transports import HostClock
from daq.virtual_rig.control import OperatorLine
from daq.virtual_rig.motion import SimulatedMotion, StepTrajectory
from daq.virtual_rig.run import VirtualRig
from rig_basics.worker_processes import WORKERS
from rig_configs.schema import Rig

Array = NDArray[np.floating[Any]]

AFTER_S = 15.0
"""Duration of the simulation after the session's end; in real time it ends when the rotor is at rest."""
_COARSE_S = (0.04, 0.06)
_READY_S, _GONE_S = 60.0, 20.0


@dataclass(frozen=True)
class TrueMotion:
    """True motion of the simulated rig.

    Attributes:
        time_s: shape (n,), rig time.
        rows: shape (n, 10), see `daq.virtual_rig.motion.StepTrajectory`.
        zero_ns: start of the rig's time on the host's clock.
        target_rad_s: last target of the drive.
    """

    time_s: Array
    rows: Array
    zero_ns: int
    target_rad_s: float


class Stage(Protocol):
    """A simulated rig, and a clock and ports to run a session on it."""

    @property
    def clock(self) -> HostClock:
        """Clock of the session."""
        ...

    @property
    def edge(self) -> Edge:
        """Edge of the session."""
        ...

    def port_settings(self) -> list[str]:
        """Settings that point a rig file's devices at this rig."""
        ...

    def after(self, seconds: float, do: Callable[[], object]) -> None:
        """Call a function after so many seconds of the simulated rig's time."""

    def ask(self, do: str, **what: Any) -> object:
        """Send a request to the rig, see `daq.virtual_rig.control`.

        Raises:
            ValueError: the rig rejected it.
        """
        ...

    def busy(self, seconds: float) -> None:
        """Suspend the host for so long."""

    def end(self) -> TrueMotion:
        """Continue the simulation for a while and return the truth."""
        ...

    def close(self) -> None:
        """Release all resources."""


class _Kept:
    """Keeps the whole motion of a simulated rig."""

    def __init__(self, motion: SimulatedMotion) -> None:
        self._stretches: list[StepTrajectory] = []
        advance = motion.advance

        def kept(until_s: float) -> StepTrajectory | None:
            stretch = advance(until_s)
            if stretch is not None:
                self._stretches.append(stretch)
            return stretch

        motion.advance = kept

    def arrays(self) -> tuple[Array, Array]:
        """Return times and rows."""
        return (
            np.concatenate([stretch.time_s[1:] for stretch in self._stretches]),
            np.concatenate([stretch.rows[1:] for stretch in self._stretches]),
        )


class LockstepStage:
    """See Stage: on simulated time.

    Args:
        rig: with a [virtual] table.
        turn_s: range of the random intervals at which the adapters deliver received data, s.
    """

    def __init__(self, rig: Rig, step_s: tuple[float, float]) -> None:
        self._sim = LockstepRig(rig)
        self._kept = _Kept(self._sim.far.motion)
        self._sim.step_s = step_s
        self.clock: SimulatedClock = self._sim.clock
        self.edge: Edge = self._sim.edge

    def port_settings(self) -> list[str]:
        """See Stage."""
        return self._sim.port_settings()

    def after(self, seconds: float, do: Callable[[], object]) -> None:
        """See Stage."""
        self.clock.after(seconds, do, world=True)

    def ask(self, do: str, **what: Any) -> object:
        """See Stage."""
        return self._sim.ask(do, **what)

    def busy(self, seconds: float) -> None:
        """See Stage."""
        self.clock.busy(seconds)

    def end(self) -> TrueMotion:
        """See Stage."""
        self._sim.step_s = _COARSE_S
        self.clock.wait(AFTER_S)
        time_s, rows = self._kept.arrays()
        zero_ns = self.clock.now_ns() - round(self.clock.now_s() * 1e9)
        return TrueMotion(time_s, rows, zero_ns, float(self._sim.far.motion.target_rad_s))

    def close(self) -> None:
        """See Stage."""


class RealTimeStage:
    """See Stage: the simulated rig in a process of its own, on the wires of `rig virtual`.

    A busy host is simulated by stopping this process.

    Args:
        rig: with a [virtual] table.

    Raises:
        RuntimeError: the rig did not start.
        OSError: the system cannot stop and continue processes.
    """

    def __init__(self, rig: Rig) -> None:
        if sys.platform == "win32":
            raise OSError("faults in real time need a POSIX system: its signals stop and continue a process")
        self._folder = tempfile.TemporaryDirectory()
        self._truth = Path(self._folder.name, "truth.npz")
        ours, theirs = WORKERS.Pipe()
        self._process = WORKERS.Process(target=_serve, args=(rig, self._truth, theirs), daemon=True)
        self._process.start()
        theirs.close()
        if not ours.poll(_READY_S):
            raise RuntimeError(f"the simulated rig did not start within {_READY_S:g} s")
        self._ports, port, token = ours.recv()
        self._line = OperatorLine(port, token)
        self._timers: list[threading.Timer] = []
        self.clock: HostClock = HostClock()
        self.edge: Edge = Edge(real_edge().connect, self._places, real_edge().disk)

    def _places(self, port: str) -> tuple[str, ...]:
        """Return the present port of a device by its first one, as an adapter's serial number does on real ports."""
        now: Mapping[str, Any] = self._line.ask("state")["devices"]
        return tuple(now[name]["port"] for name, first in self._ports.items() if first == port and now[name]["plugged"])

    def port_settings(self) -> list[str]:
        """See Stage."""
        return [f"devices.{name}.port={json.dumps(port)}" for name, port in self._ports.items()]

    def after(self, seconds: float, do: Callable[[], object]) -> None:
        """See Stage. The timer is a thread of the host: a stopped host delays it."""
        timer = threading.Timer(seconds, do)
        timer.daemon = True
        self._timers.append(timer)
        timer.start()

    def ask(self, do: str, **what: Any) -> object:
        """See Stage."""
        return self._line.ask(do, **what)

    def busy(self, seconds: float) -> None:
        """See Stage: another process stops this one and continues it."""
        own = os.getpid()
        subprocess.run(["/bin/sh", "-c", f"kill -STOP {own}; sleep {seconds:.3f}; kill -CONT {own}"], check=True)

    def end(self) -> TrueMotion:
        """See Stage."""
        for timer in self._timers:
            timer.cancel()
        for _ in range(int(AFTER_S / 0.1)):
            if abs(self._line.ask("state")["speed_rpm"]) < 1.0:
                break
            self.clock.wait(0.1)
        with contextlib.suppress(ConnectionError):  # usual: the rig may end before its answer is sent
            self._line.ask("quit")
        self._process.join(_GONE_S)
        with np.load(self._truth) as kept:
            return TrueMotion(kept["time_s"], kept["rows"], int(kept["zero_ns"]), float(kept["target_rad_s"]))

    def close(self) -> None:
        """See Stage."""
        for timer in self._timers:
            timer.cancel()
        self._line.close()
        self._process.kill()
        self._process.join()
        self._folder.cleanup()


def _serve(rig: Rig, path: Path, ready: Connection) -> None:  # pragma: no cover - in a process of its own
    """Run a simulated rig until the request to quit, then write its truth."""
    virtual = VirtualRig(rig, link="pty")
    kept = _Kept(virtual.rig.motion)
    ready.send((virtual.ports(), virtual.control.port, virtual.token))
    virtual.run()
    virtual.close()
    time_s, rows = kept.arrays()
    target = virtual.rig.motion.target_rad_s
    np.savez(path, time_s=time_s, rows=rows, zero_ns=np.int64(virtual.zero_ns), target_rad_s=target)
