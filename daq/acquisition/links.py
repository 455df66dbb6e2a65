"""Links of a session's devices: opening, reading, dialogues, and reopening of devices that were unplugged."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

from daq.acquisition.channel_watch import HOST
from daq.acquisition.core import Core
from daq.acquisition.edge import Edge
from daq.acquisition.effects import Effect, Note
from daq.acquisition.life import Stage
from daq.acquisition.reader import DeviceReader
from daq.acquisition.rotor_command import RotorCommand
from daq.drivers.contract import Poller
from daq.drivers.devices import Device
from daq.errors import DeviceError, LinkLost
from daq.items import DeviceEvent
from daq.transports import HostClock, Link
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_RETRY_PERIOD_S = 2.0  # of attempts to open a device that was unplugged, s
_MOST_FAILURES = 10  # different texts about failed attempts to open a device again that are reported

Taken = Callable[[str, Sequence[tuple[bytes, int]], bytes, int], None]
"""Called with a device's name, the bytes sent to it (each with its host time, ns), the bytes received, and their host
time, ns."""


class Links:
    """Opens, reads and closes the links of all devices.

    Args:
        devices: devices of the rig with their drivers.
        clock: host clock for time stamps and for the waits of dialogues.
        edge: ports and disk.
        core: holds the pipelines of the devices.
        identities: identities by device. The identity that a device reports when it is opened is added.
        take: see `Taken`.
        lost: called with the name of a device whose link failed, and the error.

    Attributes:
        refused: reason why a device was not opened, by device. It is only filled if the policy is `lenient`; otherwise
            the first such device raises.
    """

    def __init__(
        self,
        devices: Mapping[str, Device],
        clock: HostClock,
        edge: Edge,
        core: Core,
        identities: dict[str, dict[str, Any]],
        take: Taken,
        lost: Callable[[str, Exception], None],
    ) -> None:
        self._devices, self._clock, self._edge, self._core = devices, clock, edge, core
        self._identities, self._taken, self._lost = identities, take, lost
        self._reported: dict[str, frozenset[str]] = {}  # keys of the identity that a device reports when it is opened
        self._readers: dict[str, DeviceReader] = {}
        self._pollers: dict[str, Poller] = {}
        self._attending = False
        self._retry_at_s = 0.0
        self.refused: dict[str, str] = {}
        self._failures: dict[str, set[str]] = {}  # reported texts of failed attempts since the last success, by device

    # --- beginning and end ---------------------------------------------------------------------------------------

    def open(self) -> None:
        """Open the link of every device.

        Raises:
            LinkLost: a link cannot be opened. The links before it are open.
        """
        for device in self._devices.values():
            device.driver.load()
        for name, device in self._devices.items():
            with self.refusing(name, LinkLost):
                link = self._edge.connect(device.line, device.line.port)
                self._readers[name] = self._reader(name, link)
            self._core.renew(name, device.pipeline({}))

    @contextlib.contextmanager
    def refusing(self, name: str, *errors: type[Exception]) -> Generator[None]:
        """Context of the opening of a device. Its errors are raised, or kept in `refused` if the policy is lenient."""
        try:
            yield
        except errors as error:
            if not self._core.policy.lenient:
                raise
            self.refused[name] = str(error)
            if name in self._readers:
                self._readers[name].stop()

    def _reader(self, name: str, link: Link) -> DeviceReader:
        """Make a reader. It may collect bytes only if the device counts its samples and host times are not used."""
        driver = self._devices[name].driver
        counts = "counts exactly" in driver.claims
        restart = partial(self._restart_decoding, name)
        return DeviceReader(name, link, self._clock, driver.pause_s, lambda: counts and self._core.calm, restart)

    def __bool__(self) -> bool:
        return bool(self._readers)

    def read(self) -> None:
        """Start reading every device."""
        for name in self._readers:
            if name not in self.refused:
                self._read(name)

    def _read(self, name: str) -> None:
        self._readers[name].start(partial(self._take, name), partial(self._lost, name))

    def _take(self, name: str, sent: Sequence[tuple[bytes, int]], data: bytes, host_ns: int) -> None:
        self._taken(name, sent, data, host_ns)
        if data and (poller := self._pollers.get(name)) is not None:
            poller.heard(data)

    def start_streams(self) -> None:
        """Query the identity of every device and start its stream.

        Raises:
            DeviceError: a device does not answer as expected.
            LinkLost: the link of a device is lost.
        """
        for name, device in self._devices.items():
            if name not in self.refused:
                with self.refusing(name, DeviceError, LinkLost):
                    self._start_stream(name, device)

    def _start_stream(self, name: str, device: Device) -> None:
        found = device.driver.open(name, device.settings, self._readers[name])
        self._identities[name] = {"driver": device.driver.name, "port": device.line.port, **found}
        self._check_serial(name, device)
        self._reported[name] = frozenset(found)
        if device.driver.poller is not None:
            self._pollers[name] = device.driver.poller(device.settings, partial(self.send, name), self._clock)
            self._pollers[name].start()

    def _check_serial(self, name: str, device: Device) -> None:
        """Compare the serial number that a device reported when it was opened with that of the rig file.

        Raises:
            DeviceError: they differ, or the device reports none.
        """
        wanted, identity = device.settings.serial, self._identities[name]
        found = identity.get("serial", identity.get("device_serial"))  # of the sensor, or of the device that it is on
        if not wanted or str(found) == wanted:
            return
        if found is not None:
            raise DeviceError(
                f"{name} on {device.line.port}: serial number {wanted} is expected by the rig file, and {found} was "
                f"found. Plug in the right device, or correct devices.{name}.serial"
            )
        if self._core.pipelines[name].status.learned is None:  # otherwise the pipeline compares by itself
            raise DeviceError(
                f"{name}: serial number {wanted} is expected by the rig file, but such a device reports none. Remove "
                f"devices.{name}.serial"
            )

    def stop_streams(self) -> None:
        """End the streams. A lost device does not prevent the end of the others."""
        self._stop_pollers()
        for name, device in self._devices.items():
            if name not in self._readers:
                continue
            with ignoring(_log, f"ending the stream of {name}", LinkLost, DeviceError):
                device.driver.stop(device.settings, self._readers[name])

    def _stop_pollers(self) -> None:
        for poller in self._pollers.values():
            poller.stop()

    def close(self) -> None:
        """Close every link."""
        self._stop_pollers()
        for reader in self._readers.values():
            reader.stop()

    # --- use -----------------------------------------------------------------------------------------------------

    def send(self, name: str, data: bytes) -> None:
        """Write to a device immediately, without waiting for log and decoders. The bytes are logged afterwards.

        Raises:
            LinkLost: the link of the device is lost.
        """
        if name not in self._readers:
            raise LinkLost(self.refused.get(name, f"{name}: its port is not open"))
        self._readers[name].send(data)

    def answered(self, name: str, text: str) -> None:
        """Pass a device's answer to the dialogue that waits for it."""
        self._readers[name].replies.put(text)

    def unread(self, name: str) -> contextlib.AbstractContextManager[object]:
        """Return a context in which a device is not read."""
        return self._readers[name].lock if name in self._readers else contextlib.nullcontext()

    @contextlib.contextmanager
    def between_reads(self) -> Generator[None]:
        """Context in which no device is read and all sent bytes have been taken."""
        with ExitStack() as stack:
            for name, reader in self._readers.items():
                stack.enter_context(reader.lock)
                self._taken(name, reader.sent(), b"", 0)
            yield

    def heard_s(self) -> float:
        """Return the time of the last byte of any device, s."""
        return max((reader.heard_s for reader in self._readers.values()), default=self._clock.now_s())

    def _restart_decoding(self, name: str) -> None:
        """Give a device that is started a new pipeline, after its buffered bytes, which answered an earlier program.

        The pipeline of a device that is opened again continues: it derives a new start of the stream from the bytes of
        the dialogue, as in a replay.
        """
        if self._core.life.stage is Stage.STARTING:
            with self.unread(name):
                self._core.renew(name, self._devices[name].pipeline(self._identities.get(name, {})))

    # --- devices that return -------------------------------------------------------------------------------------

    def attend(self, command: RotorCommand) -> Iterator[Effect]:
        """Try to reopen devices that were unplugged or have lost power, and set up those that have lost their settings.

        The method is called in the waits of the session, so that no second thread talks to a device. While a commanded
        rotor turns, no attempt is made, since a dialogue would delay a stop.

        Args:
            command: rotor command of the session.
        """
        core = self._core
        if self._attending or self._clock.now_s() < self._retry_at_s:
            return
        unwell = core.mute | set(core.altered) if core.policy.commands and core.life.guarding else set[str]()
        if not (core.gone or unwell) or (core.policy.commands and command.turning()):
            return
        self._attending = True
        try:
            for name in list(core.gone):
                yield from self.reopened(name, command)
            for name in sorted(unwell - self.refused.keys()):
                if (yield from self._woken(name, command)):
                    yield from core.restored(name, self._clock.now_ns())
        finally:
            self._attending = False
            self._retry_at_s = self._clock.now_s() + _RETRY_PERIOD_S

    def reopened(self, name: str, command: RotorCommand) -> Iterator[Effect]:
        """Open a lost device on the ports where it may have returned. A device with another identity is refused.

        Its pipeline continues, so that lost samples are counted as at any other gap.

        Args:
            name: name of the device with the lost link.
            command: rotor command of the session.
        """
        device, old = self._devices[name], self._readers[name]
        for port in self._edge.places(device.line.port):
            try:
                link = self._edge.connect(device.line, port)
            except LinkLost:  # usual: the device is not on this port
                continue
            old.stop()
            self._readers[name] = self._reader(name, link)
            self._read(name)
            try:
                if self._core.policy.commands:
                    self._set_up_again(name, command)
            except (DeviceError, LinkLost) as error:
                self._readers[name].stop()
                yield from self._refused(name, f"{port}: {error}")
                continue
            yield from self._core.back(name, port, self._clock.now_ns())
            return

    def _woken(self, name: str, command: RotorCommand) -> Generator[Effect, None, bool]:
        """Set up a device with an open link that sends nothing or something else, since it may have lost power.

        Another device in its place is stopped: its samples must not be recorded as those of the known one.

        Returns:
            Whether it is set up.
        """
        device, heard = self._devices[name], self._readers[name].bytes_in
        try:
            self._set_up_again(name, command)
        except LinkLost as error:
            self._lost(name, error)
        except _AnotherDevice as error:
            with ignoring(_log, f"ending the stream of {name}", LinkLost, DeviceError):
                device.driver.stop(device.settings, self._readers[name])
            yield from self._refused(name, str(error))
        except DeviceError as error:
            if self._readers[name].bytes_in != heard:  # otherwise it is still silent, which was reported
                yield from self._refused(name, str(error))
        else:
            return True
        return False

    def _set_up_again(self, name: str, command: RotorCommand) -> None:
        """Open a device again. Its poller pauses meanwhile, since the dialogue ends what the requests expect.

        After a dialogue that failed with answers, the state of the device is unknown: it is not polled, so that it is
        silent and opened again.
        """
        poller, reader = self._pollers.get(name), self._readers[name]
        if poller is None:
            self._open_again(name, command)
            return
        poller.stop()
        heard = reader.bytes_in
        try:
            self._open_again(name, command)
        except DeviceError:
            if reader.bytes_in == heard:
                poller.start()
            raise
        poller.start()

    def _open_again(self, name: str, command: RotorCommand) -> None:
        device = self._devices[name]
        drive = command.drive if name == command.drive_name else None
        if drive is not None:
            drive.pause()
        found = device.driver.open(name, device.settings, self._readers[name])
        known = self._identities.get(name, {})
        fixed = self._reported[name] - device.driver.measured
        changed = [key for key in known if key in fixed and found.get(key) != known[key]]
        if changed:
            differences = ", ".join(f"{key} {found.get(key)} instead of {known[key]}" for key in changed)
            raise _AnotherDevice(f"{name}: another device answers on this link: {differences}")
        if drive is not None:
            drive.start()
        self._failures.pop(name, None)

    def _refused(self, name: str, text: str) -> Iterator[Effect]:
        """Report a failed attempt to the operator and to the log.

        Repeated failures are not reported, and of failures with other texts, such as with numbers of bytes, the first
        `_MOST_FAILURES` until the device is set up.
        """
        reported = self._failures.setdefault(name, set())
        if len(reported) >= _MOST_FAILURES:
            return
        reported.add(text)
        if text not in self._core.notices:
            yield Note(DeviceEvent("other", HOST, text, {"of": name}), self._clock.now_ns())
        yield from self._core.warn(text)


class _AnotherDevice(DeviceError):
    """The device that answers has another identity than before."""
