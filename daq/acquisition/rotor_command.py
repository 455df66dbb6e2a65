# pyright: strict
"""What an open session commands: the speed source, the pendulum locks, and the stop of the rotor at its end."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from functools import partial

from daq.acquisition.core import Core, DriveSeen
from daq.drivers.contract import MovesLocks, PendulumLocks, Pipeline, RotorGuard, SpeedSource, TurnsRotor
from daq.drivers.devices import Device
from daq.drivers.items import Event
from daq.errors import DeviceError, LinkLost
from daq.transports import HostClock

_REACH_S = 0.5  # wall seconds between two attempts to reach it again
_BY_ITSELF_S = 8.0  # wall seconds for a drive out of reach to stop by itself, and for the index marks to show it


class RotorCommand:
    """See the module.

    Args:
        core: asked for permission, and whether the rotor stands.
        devices: of the rig, with their drivers.
        send: writes bytes to a device, by its name.
        clock: for the waits.
        check: raises the first trouble.

    Attributes:
        drive: what turns the rotor; None where nothing does.
        drive_name: its device.
        locks: what holds the pendulums; None where nothing does.
    """

    def __init__(
        self,
        core: Core,
        devices: Mapping[str, Device],
        send: Callable[[str, bytes], None],
        clock: HostClock,
        check: Callable[[], None],
    ) -> None:
        self._core, self._clock, self._check = core, clock, check
        self.drive: SpeedSource | None = None
        self.drive_name = ""
        self.locks: PendulumLocks | None = None
        guard = RotorGuard(self.permit, self.at_rest, lambda: core.interlocks.speed_rpm(clock.now_ns()))
        for name, device in devices.items():
            if isinstance(device.driver, TurnsRotor):
                self.drive_name = name
                self.drive = device.driver.speed_source(device.settings, partial(send, name), clock, guard)
            if isinstance(device.driver, MovesLocks):
                self.locks = device.driver.locks(device.settings, partial(send, name), clock)

    def permit(self, rpm: float | None) -> None:
        """Ask before the drive is enabled (None) or ordered to turn, or the operator is asked to turn the rotor.

        Raises:
            DeviceError, ProcedureError: it must not turn so.
        """
        self._check()
        self._core.permit(rpm, self._clock.now_ns())

    def at_rest(self) -> bool | None:
        """Whether the rotor stands, by the drive's fresh word and the index marks; None when neither is there."""
        return self._core.interlocks.at_rest(self._clock.now_ns())

    def turning(self) -> bool:
        """Whether the rotor turns, or may."""
        return self._core.interlocks.turning(self._clock.now_ns())

    @property
    def dropped_out(self) -> bool:
        """Whether the drive left operation by itself."""
        return self.drive is not None and self.drive.dropped_out is not None

    def seen(self) -> DriveSeen | None:
        """How the drive stands; None where there is none."""
        drive = self.drive
        return None if drive is None else DriveSeen(drive.enabled, drive.dropped_out, drive.why())

    def notice(self, device: str, pipeline: Pipeline) -> None:
        """A device's pipeline has just been fed."""
        if self.drive is not None and device == self.drive_name:
            self.drive.notice(pipeline)

    def acknowledged(self, event: Event) -> None:
        """A device acknowledged a command."""
        if self.locks is not None:
            self.locks.heard(event)

    def quick_stop(self) -> None:
        """Have the drive stop; where it is out of reach, its own watch over our heartbeat does."""
        if self.drive is not None:
            with contextlib.suppress(Exception):
                self.drive.quick_stop()

    def bring_to_rest(self, say: Callable[[str], None], opened: bool, reach: Callable[[], bool]) -> bool:
        """At the end of a session: stop the rotor and let go of the drive; whether both are known to have happened.

        Args:
            say: is told what is being waited for.
            opened: whether all devices had been opened.
            reach: opens the drive's line again where it was lost; whether it is there.
        """
        if self.drive is None:
            return not self.turning()
        try:
            return self.drive.stop(say)
        except (LinkLost, DeviceError):  # its own watchdog stops it now; the index marks show it
            end = self._clock.wall_s() + _BY_ITSELF_S
            again_s = 0.0
            while opened and self.at_rest() is False and self._clock.wall_s() < end:
                if self._clock.wall_s() >= again_s:  # one that turns by itself heeds no watchdog
                    with contextlib.suppress(LinkLost, DeviceError):
                        if reach():
                            self.drive.quick_stop()
                            return self.drive.stop(say)
                    again_s = self._clock.wall_s() + _REACH_S
                self._clock.wait(0.02)
            return False
