"""Base class with the parts that most drivers of sensors have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, SampleClock, SpeedControl, Talk
from daq.drivers.played import PlayedDevice
from daq.items import DeviceEvent


class PlainDriver:
    """Driver of a sensor on a serial line that sends without a request. Subclasses override what differs.

    A subclass must define `name`, `settings` (with a field `baud`), `channels`, `pipeline` and `far_end`; see Driver.
    """

    rest_s: float = 0.02

    def line(self, settings: Any) -> DeviceLine:
        """See Driver: `port` and `baud` of the settings."""
        return DeviceLine(settings.port, settings.baud)

    def occasional(self, settings: Any) -> tuple[Channel, ...]:
        """See Driver: none."""
        return ()

    def clocks(self, settings: Any) -> tuple[SampleClock, ...]:
        """See Driver: none; samples get the host's time."""
        return ()

    def words(self, event: DeviceEvent) -> str:
        """See Driver: the text of the event."""
        return event.text

    def checks(
        self, settings: Any, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: no check in addition to those of every device."""
        return {}

    def played(self, settings: Any, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver: plays the bytes of the log and ignores all commands."""
        return PlayedDevice()

    def prepare(self) -> None:
        """See Driver: no module is slow to load."""

    def open(self, device: str, settings: Any, talk: Talk) -> dict[str, Any]:
        """See Driver: the device is not queried."""
        return {}

    def stop(self, talk: Talk) -> None:
        """See Driver: the device cannot be stopped; it sends as long as it has power."""
