"""Frequency converters by Modbus RTU as a driver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from daq import channels
from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import DeviceLine, Pipeline, RotorGuard, SpeedControl, Talk
from daq.drivers.modbus_converter.settings import ModbusConverter
from daq.drivers.plain import PlainDriver
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


class ModbusConverterDriver(PlainDriver):
    """See Driver."""

    name = "modbus_converter"
    rest_s: float = 0.005
    settings = ModbusConverter
    example: ClassVar[Mapping[str, Any]] = {"table": "generic"}
    claims: frozenset[str] = frozenset({"checksum", "falls silent"})

    def line(self, settings: ModbusConverter) -> DeviceLine:
        """See Driver."""
        return DeviceLine(settings.port, settings.baud, parity=settings.parity, stop_bits=settings.stop_bits)

    def channels(self, settings: ModbusConverter) -> tuple[Channel, ...]:
        """See Driver."""
        return (channels.MOTOR,)

    def pipeline(self, device: str, settings: ModbusConverter, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver."""
        from daq.drivers.modbus_converter.stream import ConverterPipeline

        return ConverterPipeline(device, settings)

    def words(self, event: DeviceEvent) -> str:
        """See Driver."""
        return event.text if event.facts["error_code"] or event.facts.get("restart") else ""

    def checks(
        self, settings: ModbusConverter, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
    ) -> Checks:
        """See Driver: the converter's state, its faults, and requests that it refused."""
        from daq.drivers.modbus_converter.status_checks import converter_checks

        return converter_checks(pipeline, control, events)

    def far_end(self, device: str, settings: ModbusConverter, world: Any) -> FarEnd:
        """See Driver."""
        from daq.drivers.modbus_converter.far_end import SimulatedConverter

        return SimulatedConverter.of(settings, world)

    def played(self, settings: ModbusConverter, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        from daq.drivers.modbus_converter.played import PlayedConverter

        return PlayedConverter(settings)

    def open(self, device: str, settings: ModbusConverter, talk: Talk) -> dict[str, Any]:
        """See Driver. The converter is polled by its command (`control`)."""
        from daq.drivers.modbus_converter.dialogue import identify

        return {"driver": self.name, **identify(device, settings, talk)}

    def stop(self, talk: Talk) -> None:
        """See Driver; the converter's command (`control`) has stopped it."""

    def speed_source(
        self, settings: ModbusConverter, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
    ) -> SpeedControl:
        """See TurnsRotor."""
        from daq.drivers.modbus_converter.control import ConverterControl

        return ConverterControl(settings, send, clock, guard)


DRIVER = ModbusConverterDriver()
