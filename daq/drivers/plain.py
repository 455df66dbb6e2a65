"""Base classes with the parts that most drivers have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, SampleClock, SpeedControl, Talk
from daq.drivers.played import PlayedDevice
from daq.items import DeviceEvent
from rig_configs.device import DisplacementSettings, RotorNodeSettings


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


class DisplacementDriver(PlainDriver):
    """Driver of a sensor of the column's motion with one displacement and a counter in each sample.

    A subclass must also define `count_wrap`, the modulus of the counter. Its settings are a DisplacementSettings.
    """

    rest_s: float = 0.01
    count_wrap: int

    def channels(self, settings: DisplacementSettings) -> tuple[Channel, ...]:
        """See Driver: the channel that the settings name."""
        return (channels.displacement_channel(settings.topic),)

    def clocks(self, settings: DisplacementSettings) -> tuple[SampleClock, ...]:
        """See Driver: the sensor's clock, from the samples' own time or from their number and the sampling period."""
        (channel,) = self.channels(settings)
        tick_ns = round(channels.DEVICE_TICK_S * 1e9)
        rate, tolerance = settings.rate_Hz, settings.clock_tolerance_ppm
        return (SampleClock(channel.topic, rate, tolerance, "device_ticks", tick_ns, self.count_wrap),)


class RotorNodeDriver(PlainDriver):
    """Driver of a node on the rotor that sends pendulum angles with its own time in µs, and index marks.

    Its settings are a RotorNodeSettings.
    """

    rest_s: float = 0.01

    def channels(self, settings: RotorNodeSettings) -> tuple[Channel, ...]:
        """See Driver: the pendulums' angles, unless another device measures them for the rig."""
        return (channels.PENDULUMS,) if settings.angles else ()

    def occasional(self, settings: RotorNodeSettings) -> tuple[Channel, ...]:
        """See Driver: the index marks, unless another device marks the rotor's phase."""
        return (channels.TACHO,) if settings.index_marks else ()

    def clocks(self, settings: RotorNodeSettings) -> tuple[SampleClock, ...]:
        """See Driver: the node's clock, if its angles are recorded."""
        if not settings.angles:
            return ()
        rate, tolerance = settings.rate_Hz, settings.clock_tolerance_ppm
        return (SampleClock(channels.PENDULUMS.topic, rate, tolerance, "node_time_us", 1000, 2**32),)
