"""A simulated rig and its cables on a simulated clock, for a session and a simulated operator."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from daq.acquisition.edge import Edge
from daq.acquisition.recorder import Disk
from daq.drivers.contract import DeviceLine
from daq.errors import LinkLost
from daq.lockstep.cable import Cable, LockstepLink
from daq.lockstep.clock import SimulatedClock
from daq.log.file import LogFile
from daq.virtual_rig.rig import SimulatedRig
from rig_configs.schema import Rig

STEP_S = (0.016, 0.032)
"""Range of the random time for which an adapter collects bytes before it passes them to the host, s.

Common USB adapters deliver every 16 ms; a busy host takes every second delivery. With a constant period the adapter and
the device clocks would beat: the delay of the bytes would grow slowly, which looks like a wrong clock rate.
"""
_LINE_DELAY_S = 0.3e-3  # of the host's bytes on their way to a device


class SimulatedDisk(Disk):
    """A simulated disk without delay; implements Disk.

    Attributes:
        room_bytes: free space.
    """

    room_bytes: int = 100 * 2**30

    @override
    def free_bytes(self, folder: Path) -> int:
        return self.room_bytes

    def sync(self, log: LogFile) -> None:
        """See Disk. It returns immediately."""


class LockstepRig:
    """A simulated rig with cables, disk and clock.

    Args:
        rig: a rig file with a [virtual] table. All random numbers come from its seed.

    Attributes:
        clock: clock for the session.
        edge: ports and disk for the session.
        disk: the simulated disk.
        cables: cables by device.
        far: the simulated rig.
        step_s: see STEP_S.
    """

    def __init__(self, rig: Rig) -> None:
        self.clock: SimulatedClock = SimulatedClock()
        self.disk: SimulatedDisk = SimulatedDisk()
        self.far: SimulatedRig = SimulatedRig(rig)
        assert rig.virtual is not None, "SimulatedRig refuses rigs without [virtual]"
        seed = rig.virtual.seed
        self.cables: dict[str, Cable] = {
            name: Cable(name, self.clock, np.random.default_rng([seed, 77, number]))
            for number, name in enumerate(self.far.far_ends)
        }
        self.edge: Edge = Edge(self._connect, self._places, self.disk)
        self.step_s = STEP_S
        self._pace = np.random.default_rng([seed, 78])
        self._answer_is_due = False
        for cable in self.cables.values():
            cable.on_write = self._answer_soon
        self._step()

    def __enter__(self) -> LockstepRig:
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing: the rig holds no resources."""

    def port_settings(self) -> list[str]:
        """Return the settings KEY=VALUE that connect the devices of a rig file to this rig."""
        return [f"devices.{name}.port={json.dumps(cable.port)}" for name, cable in self.cables.items()]

    def _connect(self, line: DeviceLine, port: str) -> LockstepLink:
        cable = self.cables.get(_device_of(port))
        if cable is None:
            raise LinkLost(f"{port}: no such port; this simulated rig has cables of {', '.join(self.cables)}")
        return cable.open(port)

    def _places(self, port: str) -> Sequence[str]:
        cable = self.cables.get(_device_of(port))
        return () if cable is None else (cable.port,)

    def _step(self) -> None:
        self._exchange(list(self.cables.values()))
        self.clock.after(self._pace.uniform(*self.step_s), self._step, world=True)

    def _answer_soon(self) -> None:
        """Schedule an exchange after a write of the host, so that answers do not wait for the next regular one."""
        if not self._answer_is_due:
            self._answer_is_due = True
            self.clock.after(_LINE_DELAY_S, self._answer, world=True)

    def _answer(self) -> None:
        """Exchange bytes; only adapters from which the host expects an answer pass theirs on, others collect more."""
        self._answer_is_due = False
        self._exchange([cable for cable in self.cables.values() if cable.asked])

    def _exchange(self, delivering: Sequence[Cable]) -> None:
        """Exchange bytes with the simulated rig and advance its motion; some adapters pass theirs to the host."""
        received = {name: bytes(cable.sent) for name, cable in self.cables.items() if cable.sent}
        for name in received:
            self.cables[name].sent.clear()
        for name, data in self.far.step(self.clock.now_s(), received).items():
            self.cables[name].collected += data
        for cable in delivering:
            cable.deliver()

    def ask(self, do: str, **what: Any) -> dict[str, Any]:
        """Carry out a request of the control port (see `daq.virtual_rig.control`) and return the answer.

        Raises:
            ValueError: the rig refused the request; the message contains the reason.
        """
        match do:
            case "unplug":
                self.cables[what["device"]].cut()
                return {"ok": True}
            case "plug":
                return {"port": self.cables[what["device"]].plug()}
            case _:
                try:
                    return self.far.do({"do": do, **what}, self.clock.now_s())
                except (KeyError, TypeError, ValueError) as error:
                    raise ValueError(f"virtual rig: {do}: {error}") from error


def _device_of(port: str) -> str:
    return port.removeprefix("lockstep:").partition("#")[0]
