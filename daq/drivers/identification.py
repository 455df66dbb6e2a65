"""Search for devices: optional members of a driver that `daq.discovery` uses to recognise a device on an unknown port.

A driver without them is still recognised if its example's settings decode the device's bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from daq.drivers.contract import Driver, example_of
from rig_configs.device import DeviceSettings

LOSSES_OF_READINGS = frozenset({"invalid", "suspect"})
"""Kinds of `Pipeline.losses` that count samples without a valid reading, as without a target: the line is intact."""


@dataclass(frozen=True)
class FoundDevice:
    """A device that was recognised.

    Attributes:
        settings: settings of its table in the rig file, by name, as far as its bytes contain them.
        identity: name, serial number, firmware and the like, for the operator.
    """

    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    identity: Mapping[str, str | int | float] = field(default_factory=dict[str, str | int | float])


@dataclass(frozen=True)
class IdentityRequest:
    """A request for identification, or a pause without one.

    Attributes:
        data: bytes to send; none to only receive.
        is_answered: whether the bytes received since the request contain its answer.
        wait_s: longest wait for the answer, wall s.
    """

    data: bytes
    is_answered: Callable[[bytes], bool]
    wait_s: float = 0.3


IdentityTurns = Generator[IdentityRequest, bytes, FoundDevice | None]
"""Dialogue without I/O. It yields requests, receives the bytes that arrived after each, and returns the device."""


@runtime_checkable
class RecognisesBytes(Protocol):
    """A driver that reads settings from bytes which a device sends without a request."""

    def recognise(self, settings: Any, data: bytes) -> FoundDevice | None:
        """Return the settings that the bytes contain; the pipeline is then tried with them.

        Args:
            settings: settings of the trial.
            data: all bytes received on the port so far. They may begin and end anywhere, or be of any other device.

        Returns:
            The device; None if the bytes are not of such a device.
        """
        ...


@runtime_checkable
class AnswersIdentityRequest(Protocol):
    """A driver of devices that answer a request for their identity."""

    def identity_request(self, settings: Any) -> IdentityTurns:
        """Return the dialogue that identifies a device with these settings.

        It only reads: it does not configure or enable the device, and does not start or stop its stream. The port may
        belong to any other device, and the device may be streaming.
        """
        ...


@dataclass(frozen=True)
class NetworkDevice:
    """A device that announced itself on the network.

    Attributes:
        port: its port in the notation of a rig file, `socket://HOST:PORT`.
        found: the device.
    """

    port: str
    found: FoundDevice


@dataclass(frozen=True)
class Announcement:
    """Datagrams (UDP) by which devices announce themselves.

    Attributes:
        port: port on which the announcements or answers arrive; 0: answers return to the port of the request.
        read: returns the device of a datagram and its sender's address; None if it is another one.
        request: datagram that is broadcast; none if devices announce themselves without one.
        request_port: port to which it is broadcast.
        wait_s: time to wait for announcements, wall s.
    """

    port: int
    read: Callable[[bytes, str], NetworkDevice | None]
    request: bytes = b""
    request_port: int = 0
    wait_s: float = 2.5


@runtime_checkable
class AnnouncesItself(Protocol):
    """A driver of devices that announce themselves on the network."""

    @property
    def announcement(self) -> Announcement:
        """See Announcement."""
        ...


def usual_of(driver: Driver) -> tuple[Mapping[str, Any], ...]:
    """Return the optional attribute `usual`: settings with which such devices are usual, the most frequent first.

    Each is a table by name, in addition to that of `example_of`; by default only the example's settings are tried.
    """
    usual: Sequence[Mapping[str, Any]] = getattr(driver, "usual", ({},))
    return tuple(usual)


def trial_settings(driver: Driver, port: str) -> list[DeviceSettings]:
    """Return the settings with which a device of a driver is looked for on a port, the most frequent first.

    Raises:
        ValueError: an example or a usual setting of the driver is not valid.
    """
    base = {"driver": driver.name, "port": port, **example_of(driver)}
    return [driver.settings.model_validate({**base, **usual}) for usual in usual_of(driver)]
