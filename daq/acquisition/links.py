# pyright: strict
"""The lines of a session's devices: opened, read, talked over, and opened again where a device comes back."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

from daq.acquisition.channel_watch import HOST
from daq.acquisition.core import Core, Note, Order
from daq.acquisition.edge import Edge
from daq.acquisition.reader import DeviceReader, OpenDevice
from daq.acquisition.rotor_command import RotorCommand
from daq.drivers.contract import claims_of
from daq.drivers.devices import Device
from daq.drivers.items import Event
from daq.errors import DeviceError, LinkLost
from daq.transports import HostClock, Link

_AGAIN_S = 2.0  # wall seconds between two attempts to open a device that was unplugged

Taken = Callable[[str, Sequence[tuple[bytes, int]], bytes, int], None]
"""Is given a device's name, what went to it (each with its host time, ns), what came from it, and when, host ns."""


class Links:
    """See the module.

    Args:
        devices: of the rig, with their drivers.
        clock: stamps arrivals; what a dialogue waits by.
        edge: the ports.
        core: holds the devices' pipelines.
        identities: what each device is known to be; what it says when it is opened is put in.
        take: see Taken.
        lost: is told of a device whose line has failed.
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
        self._asked: dict[str, frozenset[str]] = {}  # what of an identity a device says when it is asked
        self._readers: dict[str, DeviceReader] = {}
        self._attending = False
        self._again_s = 0.0

    # --- beginning and end ---------------------------------------------------------------------------------------

    def open(self) -> None:
        """Open every device's line.

        Raises:
            LinkLost: one cannot be opened; those before it are open.
        """
        for device in self._devices.values():
            device.driver.prepare()
        for name, device in self._devices.items():
            link = self._edge.connect(device.line, device.line.port)
            self._readers[name] = self._reader(name, link)
            self._core.renew(name, device.pipeline({}))

    def _reader(self, name: str, link: Link) -> DeviceReader:
        """Of a device that counts its own samples bytes may gather; where the host's time counts they may not."""
        driver = self._devices[name].driver
        counts = "counts exactly" in claims_of(driver)
        return DeviceReader(name, link, self._clock, driver.rest_s, lambda: counts and self._core.calm)

    def __bool__(self) -> bool:
        return bool(self._readers)

    def read(self) -> None:
        """Begin to read every device."""
        for name in self._readers:
            self._read(name)

    def _read(self, name: str) -> None:
        self._readers[name].start(partial(self._taken, name), partial(self._lost, name))

    def start_streams(self) -> None:
        """Have every device say what it is, and start its stream.

        Raises:
            DeviceError: one does not answer as it should.
            LinkLost: a device is gone.
        """
        for name, device in self._devices.items():
            self._identities[name] = device.driver.open(name, device.settings, self._talk(name))
            self._asked[name] = frozenset(self._identities[name]) - {"port"}

    def stop_streams(self) -> None:
        """End the streams; a device that is gone does not keep the others from being stopped."""
        for name, device in self._devices.items():
            with contextlib.suppress(LinkLost, DeviceError):
                device.driver.stop(self._talk(name))

    def close(self) -> None:
        """Let go of every line."""
        for reader in self._readers.values():
            reader.stop()

    # --- use -----------------------------------------------------------------------------------------------------

    def send(self, name: str, data: bytes) -> None:
        """Write to a device at once, whatever log and decoders are busy with; the log gets the bytes afterwards.

        Raises:
            LinkLost: the device is gone.
        """
        self._readers[name].send(data)

    def answered(self, name: str, text: str) -> None:
        """A device's answer, for the dialogue that waits for it."""
        self._readers[name].replies.put(text)

    def unread(self, name: str) -> contextlib.AbstractContextManager[object]:
        """A device is not being read meanwhile."""
        return self._readers[name].lock

    @contextlib.contextmanager
    def between_reads(self) -> Generator[None]:
        """No device is being read; what has gone out to them is in the log."""
        with ExitStack() as stack:
            for name, reader in self._readers.items():
                stack.enter_context(reader.lock)
                self._taken(name, reader.sent(), b"", 0)
            yield

    def heard_s(self) -> float:
        """When any device has sent something last, wall s."""
        return max(reader.heard_s for reader in self._readers.values())

    def _talk(self, name: str) -> OpenDevice:
        return OpenDevice(self._readers[name], self._clock, partial(self._forget, name))

    def _forget(self, name: str) -> None:
        """A fresh pipeline for a device whose line has just run dry: what it sent before was an answer to another."""
        with self.unread(name):
            self._core.renew(name, self._devices[name].pipeline(self._identities.get(name, {})))

    # --- devices that come back ----------------------------------------------------------------------------------

    def attend(self, command: RotorCommand | None) -> Iterator[Order]:
        """Look for devices that were unplugged, or have lost power; called by whoever waits for something.

        So no other thread talks to a device. A device that streams anew by itself is only waited for. While a rotor
        that we command turns, nothing is looked for: a dialogue would keep the stop waiting.

        Args:
            command: what the session commands; None where it only listens.
        """
        core = self._core
        mute = core.mute if command is not None else ()
        if not (core.gone or mute) or self._attending or self._clock.wall_s() < self._again_s:
            return
        if command is not None and command.turning():
            return
        self._attending = True
        try:
            for name in list(core.gone):
                yield from self.reopened(name, command)
            for name in sorted(mute):
                if command is not None:
                    yield from self._woken(name, command)
        finally:
            self._attending = False
            self._again_s = self._clock.wall_s() + _AGAIN_S

    def reopened(self, name: str, command: RotorCommand | None) -> Iterator[Order]:
        """Open a device where it may have come back; one that is another than the log's is left alone.

        Its pipeline goes on: the samples that the gap has cost are counted as at any other gap.

        Args:
            name: of one whose line is lost.
            command: what the session commands; None where it only listens.
        """
        device, old = self._devices[name], self._readers[name]
        for port in self._edge.places(device.line.port):
            try:
                link = self._edge.connect(device.line, port)
            except LinkLost:
                continue
            old.stop()
            self._readers[name] = self._reader(name, link)
            self._read(name)
            try:
                if command is not None:
                    self._set_up_again(name, command)
            except (DeviceError, LinkLost) as error:
                self._readers[name].stop()
                yield from self._refused(name, f"{port}: {error}")
                continue
            yield from self._core.back(name, port, self._clock.now_ns())
            return

    def _woken(self, name: str, command: RotorCommand) -> Iterator[Order]:
        """Set a device up again whose line is there and which sends nothing: it may have lost power."""
        try:
            self._set_up_again(name, command)
        except LinkLost as error:
            self._lost(name, error)
        except _AnotherDevice as error:
            yield from self._refused(name, str(error))
        except DeviceError:
            return  # it is silent still

    def _set_up_again(self, name: str, command: RotorCommand) -> None:
        device = self._devices[name]
        talk = OpenDevice(self._readers[name], self._clock, lambda: None)
        found, known = device.driver.open(name, device.settings, talk), self._identities.get(name, {})
        changed = [what for what in known if what in self._asked[name] and found.get(what) != known[what]]
        if changed:
            differences = ", ".join(f"{what} {found.get(what)} instead of {known[what]}" for what in changed)
            raise _AnotherDevice(f"{name}: another device answers there: {differences}")
        if name == command.drive_name and command.drive is not None:
            command.drive.start()

    def _refused(self, name: str, text: str) -> Iterator[Order]:
        """The operator learns it, and the log: once, not with every attempt."""
        if text not in self._core.notices:
            yield Note(Event("other", HOST, text, {"of": name}), self._clock.now_ns())
        yield from self._core.warn(text)


class _AnotherDevice(DeviceError):
    """What answers is not what it was."""
