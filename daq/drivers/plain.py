# pyright: strict
"""What most drivers of sensors say alike, so that a driver's own file holds what is its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import Line, SampleClock, SpeedSource, Talk
from daq.drivers.items import Event
from daq.drivers.played import PlayedDevice


class PlainDriver:
    """A driver of a sensor on a serial line that sends by itself; whatever is otherwise is overridden.

    To be added: `name`, `settings` (with a field `baud`), `channels`, `pipeline` and `far_end`; see Driver.
    """

    rest_s = 0.02

    def line(self, settings: Any) -> Line:
        """See Driver: the settings' port and baud."""
        return Line(settings.port, settings.baud)

    def occasional(self, settings: Any) -> tuple[Channel, ...]:
        """See Driver: none."""
        return ()

    def clocks(self, settings: Any) -> tuple[SampleClock, ...]:
        """See Driver: none, the host's time counts."""
        return ()

    def words(self, event: Event) -> str:
        """See Driver: the event's own."""
        return event.text

    def checks(self, settings: Any, pipeline: Any, control: SpeedSource | None, events: Sequence[Event]) -> Checks:
        """See Driver: nothing beside what every device is looked at for."""
        return {}

    def played(self, settings: Any, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver: its bytes, whatever it is told."""
        return PlayedDevice()

    def prepare(self) -> None:
        """See Driver: nothing takes long to load."""

    def open(self, device: str, settings: Any, talk: Talk) -> dict[str, Any]:
        """See Driver: nothing is asked."""
        return {}

    def stop(self, talk: Talk) -> None:
        """See Driver: it goes on for as long as it has power."""
