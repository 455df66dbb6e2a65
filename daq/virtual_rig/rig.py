# pyright: strict
"""The simulated rig without wires and clock: bytes from the host in, bytes to the host out, on a time that is given."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from daq.drivers.devices import devices_of
from daq.drivers.simulated import FarEnd
from daq.virtual_rig.motion import Motion
from daq.virtual_rig.world import World
from rig_configs.errors import RigConfigError
from rig_configs.load import with_truth
from rig_configs.schema import Rig

_RPM = math.pi / 30


class SimulatedRig:
    """All simulated devices around one motion. It has no threads, opens nothing and reads no clock.

    The same rig file, seed, times, bytes and requests yield the same bytes.

    Args:
        rig: a rig file with a [virtual] table.
        patience: rig seconds of a time-out given in wall seconds (`HostClock.patience`).

    Attributes:
        motion: of rotor, column and pendulums.
        far_ends: the simulated device of each name in the rig file.

    Raises:
        RigConfigError: the rig file has no [virtual] table.
    """

    def __init__(self, rig: Rig, patience: Callable[[float], float] = float) -> None:
        if rig.virtual is None:
            raise RigConfigError(f"rig {rig.name} has no [virtual] table: there is nothing to simulate")
        self._rig = rig
        self.motion = Motion(rig.true_physics, rig.virtual.drive.slip, rig.virtual.drive.lag_s)
        world = World(rig.virtual, self.motion, patience)
        self.far_ends: dict[str, FarEnd] = {
            name: device.far_end(world) for name, device in devices_of(rig.devices).items()
        }
        self._let_go_s: float | None = None

    def step(self, now_s: float, received: Mapping[str, bytes]) -> dict[str, bytes]:
        """Answer the host, then let the rig move up to now.

        Args:
            now_s: rig time, s; not before that of the last step.
            received: what the host has sent to each device since the last step; a device may be missing.

        Returns:
            What each device sends, by its name in the rig file; every device is there.
        """
        motion, before_s = self.motion, self.motion.time_s
        sent = {
            name: far_end.receive(data, before_s) if (data := received.get(name, b"")) else b""
            for name, far_end in self.far_ends.items()
        }
        if self._let_go_s is not None and now_s >= self._let_go_s:
            motion.let_go()
            self._let_go_s = None
        for name, far_end in self.far_ends.items():
            sent[name] += far_end.step(before_s)
        stretch = motion.advance(now_s)
        if stretch is not None:
            for name, far_end in self.far_ends.items():
                sent[name] += far_end.sample(stretch)
        return sent

    def do(self, request: Mapping[str, Any], now_s: float) -> dict[str, Any]:
        """Carry out what a hand does at the rig, a fault, or an onlooker's question (see `daq.virtual_rig.control`).

        Args:
            request: "do" and what belongs to it.
            now_s: rig time, s.

        Returns:
            The answer; {"ok": True} where nothing was asked.

        Raises:
            KeyError, TypeError, ValueError: no such request, or one that is incomplete or cannot be carried out.
        """
        match request.get("do"):
            case "pluck" | "flick" | "lock" | "release" | "turn" as act:
                self._by_hand(act, request, now_s)
            case "set":
                self._set(str(request["key"]), request["value"])
            case "truth":
                return {"truth": self.motion.physics.identified()}
            case "state":
                facts: dict[str, Any] = {"time_s": self.motion.time_s}
                for far_end in self.far_ends.values():
                    facts |= far_end.facts()
                return facts
            case "fail":
                self.far_ends[str(request["device"])].fail(str(request["what"]), request.get("value", 1))
            case other:
                raise ValueError(f"unknown request {other!r}")
        return {"ok": True}

    def _by_hand(self, act: str, request: Mapping[str, Any], now_s: float) -> None:
        """What a person does at the rig; what a device holds is not the hand's."""
        roles, motion = self._rig.roles, self.motion
        holder = roles.locks if act in ("lock", "release") else roles.speed if act == "turn" else None
        if holder is not None:
            raise ValueError(f"that is {holder.device}'s to do")
        match act:
            case "pluck":
                motion.hold(request.get("x_mm", 0.0) * 1e-3, request.get("y_mm", 0.0) * 1e-3)
                self._let_go_s = now_s + request.get("hold_s", 0.5)
            case "flick":
                if not motion.flick(int(request["pendulum"]), float(request["speed_rad_s"])):
                    raise ValueError("this pendulum is locked")
            case "turn":
                motion.target_rad_s = float(request["rpm"]) * _RPM
                motion.ramp_rad_s2 = float(request["ramp_rpm_per_s"]) * _RPM
            case _:
                for pendulum in (0, 1):
                    motion.lock(pendulum, 0.0) if act == "lock" else motion.release(pendulum)

    def _set(self, key: str, value: Any) -> None:
        """Change the truth from now on (a clamp has moved, a magnet pack was replaced)."""
        self._rig = with_truth(self._rig, key, value)
        self.motion.physics = self._rig.true_physics
