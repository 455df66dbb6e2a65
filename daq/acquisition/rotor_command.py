"""Commands of an open session: speed source, pendulum locks, and the stop of the rotor at the end of the session."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial

from daq.acquisition.core import Core, DriveState
from daq.drivers.contract import (
    LockControl,
    Pipeline,
    RotorGuard,
    SpeedControl,
)
from daq.drivers.devices import Device
from daq.errors import DeviceError, LinkLost
from daq.items import DeviceEvent
from daq.transports import HostClock
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_RETRY_PERIOD_S = 0.5  # of attempts to reopen the link of the drive, s
_MAX_WATCHDOG_STOP_S = 8.0  # for an unreachable drive to stop the rotor by its watchdog, s


class RotorCommand:
    """Commands the rotor and the locks of an open session.

    Args:
        core: permits commands and holds the state of the rotor.
        devices: devices of the rig with their drivers.
        send: writes bytes to a device, by its name.
        clock: host clock for the waits.
        check: raises the error that ended the run, if any.

    Attributes:
        drive: speed source; None if the rig has none, or if the session only receives.
        drive_name: name of the speed source's device; empty without one.
        locks: pendulum locks; None if the rig has none that can be commanded, or if the session only receives.
        locks_name: name of the locks' device; empty without one.
        started: whether the drive was commanded, so that it must be stopped.
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
        self.drive: SpeedControl | None = None
        self.drive_name: str = ""
        self.locks: LockControl | None = None
        self.locks_name: str = ""
        self.started: bool = False
        guard = RotorGuard(self.permit, self.at_rest, lambda: core.interlocks.speed_rpm(clock.now_ns()))
        for name, device in devices.items() if core.policy.commands else ():
            if device.driver.speed_source is not None:
                self.drive_name = name
                self.drive = device.driver.speed_source(device.settings, partial(send, name), clock, guard)
            if device.driver.locks is not None:
                self.locks_name = name
                self.locks = device.driver.locks(device.settings, partial(send, name), clock)

    def permit(self, rpm: float | None) -> None:
        """Permit that the drive is enabled (`rpm` is None), or that drive or operator turn the rotor at a speed.

        Raises:
            DeviceError: a device that guards the rotor is missing or has failed.
            ProcedureError: the speed exceeds the limit.
        """
        self._check()
        self._core.permit(rpm, self._clock.now_ns())

    def at_rest(self) -> bool | None:
        """Return whether the rotor is at rest, from the drive's newest report and the index marks; None if unknown."""
        return self._core.interlocks.at_rest(self._clock.now_ns())

    def turning(self) -> bool:
        """Return whether the rotor turns, or its state is unknown."""
        return self._core.interlocks.turning(self._clock.now_ns())

    def rpm(self) -> float:
        """Return the measured speed, rpm: by the index marks if the rig has them, else by the drive; NaN if unknown."""
        return self._core.interlocks.measured_rpm(self._clock.now_ns())

    def words(self, after: str = "") -> str:
        """Return the state of a rotor that is not at rest, for a message; `after` is the time that it had."""
        state = "the state of the rotor is unknown" if self.at_rest() is None else "the rotor still turns"
        return f"{state}{after} ({self._core.interlocks.rotor_words(self._clock.now_ns())})"

    def wait_for_rest(self, seconds: float) -> None:
        """Wait until the rotor is at rest.

        Args:
            seconds: timeout, s.

        Raises:
            DeviceError: at the timeout the rotor turns, or its state is unknown.
        """
        deadline = self._clock.now_s() + seconds
        while not self.at_rest():
            self._check()
            if self._clock.now_s() > deadline:
                advice = self._core.host.words(self._clock.now_ns()) or "Look at drive and rotor"
                raise DeviceError(f"{self.words(f' after {seconds:g} s')}. {advice}")
            self._clock.wait(0.003)

    @property
    def dropped_out(self) -> bool:
        """Whether the drive left operation without a command."""
        return self.drive is not None and self.drive.dropped_out is not None

    def drive_state(self) -> DriveState | None:
        """Return the state of the drive, or None if the rig has no drive."""
        drive = self.drive
        return None if drive is None else DriveState(drive.enabled, drive.dropped_out, drive.why())

    def notice(self, device: str, pipeline: Pipeline) -> None:
        """Update the drive from the pipeline of a device that has just been fed."""
        if self.drive is not None and device == self.drive_name:
            self.drive.notice(pipeline)

    def acknowledged(self, event: DeviceEvent) -> None:
        """Pass an acknowledgement of a device to the locks."""
        if self.locks is not None:
            self.locks.heard(event)

    def start(self) -> None:
        """Set up the drive for commands."""
        if self.drive is not None:
            self.started = True
            self.drive.start()

    def command_locks(self, action: str) -> None:
        """Send a command for the pendulum locks and wait for its acknowledgement.

        Raises:
            DeviceError: the command was refused (with the reason) or not acknowledged, or the rig has no such locks.
        """
        if self.locks is None or self._core.rig.roles.locks is None:
            raise DeviceError(f"rig {self._core.rig.name} has no locks that can be commanded: {action} by hand")
        self._core.interlocks.counters_set()
        self.locks.command(action, self._check)
        self._core.interlocks.counters_set()  # an angle between the two may still be the old one

    def measure_round_trip(self, device: str) -> float | None:
        """Return the result of `LockControl.measure_round_trip`, s; None if a device does not answer or has none.

        Raises:
            LinkLost: the connection to the device is lost.
        """
        return None if self.locks is None or self.locks_name != device else self.locks.measure_round_trip()

    def quick_stop(self) -> None:
        """Stop the drive. If its link is lost, its heartbeat watchdog stops it."""
        if self.drive is not None:
            try:
                self.drive.quick_stop()
            except Exception as error:
                _log.warning("%s: no quick stop was sent, its watchdog stops the rotor: %s", self.drive_name, error)

    def bring_to_rest(self, notify: Callable[[str], None], opened: bool, reach: Callable[[], bool]) -> bool:
        """Stop the rotor and release the drive at the end of a session.

        Args:
            notify: called with one line of text for each wait.
            opened: whether all devices had been opened.
            reach: reopens the link of the drive if it was lost, and returns whether it is open again.

        Returns:
            Whether the drive confirmed rest and release.
        """
        if self.drive is None:
            return not self.turning()
        try:
            return self.drive.stop(notify)
        except (LinkLost, DeviceError) as error:  # the drive's watchdog stops the rotor; the index marks show when
            _log.info("%s: the drive did not confirm its stop, its watchdog stops it: %s", self.drive_name, error)
            end = self._clock.now_s() + _MAX_WATCHDOG_STOP_S
            retry_at_s = 0.0
            while opened and not self.at_rest() and self._clock.now_s() < end:  # also if nothing else measures it
                if self._clock.now_s() >= retry_at_s:  # the watchdog may have failed
                    with ignoring(_log, "stopping the drive again", LinkLost, DeviceError):
                        if reach():
                            self.drive.quick_stop()
                            return self.drive.stop(notify)
                    retry_at_s = self._clock.now_s() + _RETRY_PERIOD_S
                self._clock.wait(0.02)
            return False
