"""The simulated rig without I/O and clock: it converts bytes from the host to bytes for the host at a given time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from daq.drivers.devices import devices_of
from daq.drivers.simulated import FarEnd
from daq.virtual_rig.faults import FaultInjector, listed, number
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import World
from rig_basics.units import RPM
from rig_configs.device import DisplacementSettings
from rig_configs.errors import RigConfigError
from rig_configs.load import with_truth
from rig_configs.schema import Rig

_MAX_PLUCK_MM = 50.0
_MAX_SPEED_RPM = 20_000.0  # and rpm per s


class SimulatedRig:
    """All simulated devices with a common motion. It has no threads, no I/O and no clock.

    The same rig file, seed, times, bytes and requests yield the same bytes.

    Args:
        rig: a rig file with a [virtual] table.

    Attributes:
        motion: motion of rotor, column and pendulums.
        far_ends: simulated devices by their names in the rig file.

    Raises:
        RigConfigError: the rig file has no [virtual] table.
    """

    def __init__(self, rig: Rig) -> None:
        if rig.virtual is None:
            raise RigConfigError(
                f"the rig file of {rig.name} has no [virtual] table, which the simulation needs: give a shipped "
                "rig, as virtual, or a copy of its file"
            )
        self._rig = rig
        drive = rig.virtual.drive
        self.motion: SimulatedMotion = SimulatedMotion(rig.true_physics, drive.slip, drive.lag_s)
        world = self._world = World(rig.virtual, self.motion)
        self.far_ends: dict[str, FarEnd] = {
            name: device.far_end(world) for name, device in devices_of(rig.devices).items()
        }
        self._faults = FaultInjector(self.far_ends, world.rng)
        self._hold_ends_s: float | None = None

    def step(self, now_s: float, received: Mapping[str, bytes]) -> dict[str, bytes]:
        """Answer the host, then advance the motion to the present time.

        Args:
            now_s: rig time, s; not before that of the last step.
            received: bytes of the host since the last step, by device; devices without bytes may be missing.

        Returns:
            Bytes of every device, by its name in the rig file.
        """
        motion, faults, before_s = self.motion, self._faults, self.motion.time_s
        faults.end_in_time(now_s)
        heard = {name: faults.heard(name, received.get(name, b"")) for name in self.far_ends}
        sent = {
            name: far_end.receive(heard[name], before_s) if heard[name] else b""
            for name, far_end in self.far_ends.items()
        }
        if self._hold_ends_s is not None and now_s >= self._hold_ends_s:
            motion.release_column()
            self._hold_ends_s = None
        for name, far_end in self.far_ends.items():
            sent[name] += far_end.step(before_s)
        stretch = motion.advance(now_s)
        if stretch is not None:
            for name, far_end in self.far_ends.items():
                sent[name] += far_end.sample(stretch)
        return {name: faults.arrives(name, data, motion.time_s - before_s) for name, data in sent.items()}

    def do(self, request: Mapping[str, Any], now_s: float) -> dict[str, Any]:
        """Carry out a request of the control port: a manual action, a fault, or a query (`daq.virtual_rig.control`).

        Args:
            request: "do" and its arguments.
            now_s: rig time, s.

        Returns:
            The answer; {"ok": True} for actions.

        Raises:
            KeyError, TypeError, ValueError: the request is unknown, incomplete or cannot be carried out.
        """
        match request.get("do"):
            case "pluck" | "flick" | "lock" | "release" | "turn" as act:
                self._by_hand(act, request, now_s)
            case "place":
                self._place(str(request["device"]), request.get("mm"))
            case "set":
                self._set(str(request["key"]), request["value"])
            case "truth":
                return {"truth": self.motion.physics.identified()}
            case "state":
                return self._state()
            case "faults":
                return {"devices": {name: listed(self._faults.kinds(name)) for name in self.far_ends}}
            case "fail":
                self._faults.place(request, now_s)
            case other:
                raise ValueError(f"unknown request {other!r}")
        return {"ok": True}

    def _state(self) -> dict[str, Any]:
        motion = self.motion
        facts: dict[str, Any] = {
            "time_s": motion.time_s,
            "speed_rpm": motion.speed_rad_s / RPM,
            "displacement_mm": [1e3 * each for each in motion.displacement_m],
            "pendulums_deg": [math.degrees(each) for each in motion.angles_rad],
            "pendulums_held": [motion.held(pendulum) for pendulum in (0, 1)],
        }
        own = {name: dict(far_end.facts()) for name, far_end in self.far_ends.items()}
        for each in own.values():
            facts |= each
        devices = {name: {"faults": self._faults.standing(name), "facts": own[name]} for name in self.far_ends}
        return {**facts, "devices": devices}

    def _by_hand(self, act: str, request: Mapping[str, Any], now_s: float) -> None:
        """Carry out a manual action. Actions that a device of the rig carries out are refused."""
        roles, motion = self._rig.roles, self.motion
        holder = roles.locks if act in ("lock", "release") else roles.speed if act == "turn" else None
        if holder is not None:
            raise ValueError(f"{holder.device} carries out this action, it cannot be done by hand")
        match act:
            case "pluck":
                x_mm, y_mm = number(request, "x_mm", 0.0), number(request, "y_mm", 0.0)
                if math.hypot(x_mm, y_mm) > _MAX_PLUCK_MM:
                    raise ValueError(f"the column takes at most {_MAX_PLUCK_MM:g} mm, got {x_mm:g} and {y_mm:g} mm")
                self._hold_ends_s = now_s + number(request, "hold_s", 0.5)
                motion.hold(1e-3 * x_mm, 1e-3 * y_mm)
            case "flick":
                pendulum = request["pendulum"]
                if pendulum not in (0, 1):
                    raise ValueError(f"expected pendulum 0 (A) or 1 (B), got {pendulum!r}")
                if not motion.flick(pendulum, number(request, "speed_rad_s")):
                    raise ValueError(f"pendulum {'AB'[pendulum]} is held: release it first")
            case "turn":
                rpm, ramp = number(request, "rpm"), number(request, "ramp_rpm_per_s")
                if not (abs(rpm) <= _MAX_SPEED_RPM and 0 < ramp <= _MAX_SPEED_RPM):
                    raise ValueError(
                        f"expected at most {_MAX_SPEED_RPM:g} rpm and a ramp above 0, got {rpm:g}, {ramp:g}"
                    )
                motion.target_rad_s, motion.ramp_rad_s2 = rpm * RPM, ramp * RPM
            case _:
                for pendulum in (0, 1):
                    motion.lock(pendulum, 0.0) if act == "lock" else motion.release(pendulum)

    def _place(self, device: str, mm: object) -> None:
        """Hold the column so that the target of a sensor is displaced along its beam; None: release the column."""
        self._hold_ends_s = None
        if mm is None:
            self.motion.release_column()
            return
        sensor = self._rig.devices.get(device)
        if not isinstance(sensor, DisplacementSettings):
            raise ValueError(f"expected a displacement sensor of the rig, got {device!r}")
        if not isinstance(mm, int | float) or not abs(mm) <= _MAX_PLUCK_MM:
            raise ValueError(f"expected at most {_MAX_PLUCK_MM:g} mm, got {mm!r}")
        along = self._world.direction(sensor.axis, sensor.direction_deg)
        x_m, y_m = (1e-3 * mm / sensor.lever_ratio * along).tolist()
        self.motion.hold(x_m, y_m)

    def _set(self, key: str, value: Any) -> None:
        """Change the true parameters from now on (a clamp has moved, a magnet pack was replaced)."""
        self._rig = with_truth(self._rig, key, value)
        self.motion.physics = self._rig.true_physics
