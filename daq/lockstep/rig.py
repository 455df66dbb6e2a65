# pyright: strict
"""A simulated rig and its cables on a simulated clock: what a session opens, and what an operator's hands reach."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from daq.acquisition.edge import Edge
from daq.drivers.contract import Line
from daq.errors import LinkLost
from daq.lockstep.cable import Cable, LockstepLink
from daq.lockstep.clock import SimulatedClock
from daq.log.file import LogFile
from daq.virtual_rig.rig import SimulatedRig
from rig_configs.schema import Rig

STEP_S = (0.002, 0.008)
"""What an adapter gathers before it hands bytes to the host, s: at random between these, as real ones and their hosts.

At a fixed rate its turns and the devices' clocks would beat: bytes that wait for the next turn, a little longer each
time, look like a clock that is off.
"""
_LINE_S = 0.3e-3  # for the host's bytes to reach a device


class SimulatedDisk:
    """See Disk: as much room as it is given, and as quick.

    Attributes:
        room_bytes: what is left.
    """

    def __init__(self, room_bytes: int = 100 * 2**30) -> None:
        self.room_bytes = room_bytes

    def free_bytes(self, folder: Path) -> int:
        """See Disk."""
        return self.room_bytes

    def sync(self, log: LogFile) -> None:
        """See Disk: at once."""


class LockstepRig:
    """See the module.

    Args:
        rig: a rig file with a [virtual] table; its seed is that of all that is random here too.

    Attributes:
        clock: of whoever runs the rig.
        edge: ports and disk of whoever runs the rig.
        disk: the simulated one.
        cables: by device.
        far: the simulated rig.
        turn_s: see STEP_S.
    """

    def __init__(self, rig: Rig) -> None:
        self.clock, self.disk = SimulatedClock(), SimulatedDisk()
        self.far = SimulatedRig(rig, self.clock.patience)
        assert rig.virtual is not None, "SimulatedRig refuses a rig without it"
        seed = rig.virtual.seed
        self.cables = {
            name: Cable(name, self.clock, np.random.default_rng([seed, 77, number]))
            for number, name in enumerate(self.far.far_ends)
        }
        self.edge = Edge(self._connect, self._places, self.disk)
        self.turn_s = STEP_S
        self._pace = np.random.default_rng([seed, 78])
        self._asked = False
        for cable in self.cables.values():
            cable.asked = self._look_soon
        self._step()

    def __enter__(self) -> LockstepRig:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held that has to be given back."""

    def port_settings(self) -> list[str]:
        """Settings that point a rig file's devices at this rig."""
        return [f"devices.{name}.port={json.dumps(cable.port)}" for name, cable in self.cables.items()]

    def _connect(self, line: Line, port: str) -> LockstepLink:
        cable = self.cables.get(_device_of(port))
        if cable is None:
            raise LinkLost(f"{port}: no cable of this simulated rig: {', '.join(self.cables)}")
        return cable.open(port)

    def _places(self, port: str) -> Sequence[str]:
        cable = self.cables.get(_device_of(port))
        return () if cable is None else (cable.port,)

    def _step(self) -> None:
        self._look()
        self.clock.after(self._pace.uniform(*self.turn_s), self._step, world=True)

    def _look_soon(self) -> None:
        """The host has written: devices that answer do not wait for the next regular look."""
        if not self._asked:
            self._asked = True
            self.clock.after(_LINE_S, self._look, world=True)

    def _look(self) -> None:
        """The world looks at its cables and moves on."""
        self._asked = False
        received = {name: bytes(cable.sent) for name, cable in self.cables.items() if cable.sent}
        for name in received:
            self.cables[name].sent.clear()
        sent = self.far.step(self.clock.wall_s(), received)
        for name, data in sent.items():
            if data:
                self.cables[name].arrive(data)

    def ask(self, do: str, **what: Any) -> dict[str, Any]:
        """What a hand does at the rig, or an onlooker asks (see `daq.virtual_rig.control`).

        Raises:
            ValueError: the rig refused; the message says why.
        """
        match do:
            case "unplug":
                self.cables[what["device"]].cut()
                return {"ok": True}
            case "plug":
                return {"port": self.cables[what["device"]].plug()}
            case _:
                try:
                    return self.far.do({"do": do, **what}, self.clock.wall_s())
                except (KeyError, TypeError, ValueError) as error:
                    raise ValueError(f"virtual rig: {do}: {error}") from error


def _device_of(port: str) -> str:
    return port.removeprefix("lockstep:").partition("#")[0]
