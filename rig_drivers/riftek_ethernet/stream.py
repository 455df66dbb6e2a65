"""Pipeline of an RF60x sensor on Ethernet: packets to displacement of the disk centre.

The time of a sample is its number times the sampling period on the sensor's clock, mapped to the common clock.
Datagrams can be lost, come twice, or come late, and the sensor may start again: see daq.numbered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from typing_extensions import override

from daq import channels
from daq.clock import ClockMap, ClockSeed
from daq.drivers.contract import Pipeline, PipelineStatus
from daq.drivers.displacement import displacement_batch
from daq.items import TX, Batch, DeviceEvent
from daq.numbered.messages import Count, Stretch, chained
from daq.numbered.stream import NumberedStream
from rig_drivers.riftek.wire import readings
from rig_drivers.riftek_ethernet import wire
from rig_drivers.riftek_ethernet.identity import words_for
from rig_drivers.riftek_ethernet.settings import RiftekEthernetLaser

_LATE_PACKETS = 8
"""Packets by which a network may deliver one late, or twice: it does so within a third of a second."""
_OTHER_S, _OTHER_PACKETS = 1.0, 4  # silence of the sensor, after which packets of another one are a fault

Items = list[Batch | DeviceEvent]


class RiftekEthernetPipeline(Pipeline):
    """Decoder of one sensor's packets. Displacement is 0 in the middle of the range and grows with the distance.

    Attributes:
        losses: see Pipeline. "samples": missing by the packets' number; "bytes": skipped; "invalid": without a reading.
    """

    def __init__(self, device: str, settings: RiftekEthernetLaser, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "bytes", "invalid")
        self._complaint = ""
        self._settings = settings
        self._channel = channels.displacement_channel(settings.topic)
        known = identity.get("serial")
        self._wanted = settings.serial_number or (known if type(known) is int else 0)  # 0: the first one
        self._decoder = wire.PacketDecoder(settings.range_mm, settings.checksum, serial=self._wanted)
        self._clock = ClockMap(settings.clock_tolerance_ppm, ClockSeed.of(identity))
        self._period_ns = 1e9 / settings.rate_Hz
        count = Count(wire.NUMBERS, wire.RESULTS * self._period_ns, late_messages=_LATE_PACKETS)
        self._numbered = NumberedStream[list[wire.Packet]](count, chained)
        self._serial: int | None = None
        self._heard_ns: int | None = None  # host time of the newest packet of the expected sensor, or of the first read
        self._next = 0  # number of the next sample

    @property
    def repeated_packets(self) -> int:
        """Number of packets that came twice or too late."""
        return self._numbered.repeated

    @property
    def status(self) -> PipelineStatus:
        """See Pipeline. Every packet has the sensor's serial number."""
        learned = {} if self._serial is None else {"serial": self._serial}
        return PipelineStatus(
            self._serial is not None, self._complaint, learned=learned, clock_std_ns=self._clock.std_ns
        )

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            return []
        out: Items = []
        if not data:
            return [item for stretch in self._numbered.end() for item in self._placed(stretch)]
        self._heard_ns = host_ns if self._heard_ns is None else self._heard_ns
        found = self._decoder.feed(data)
        if found.skipped_bytes:
            is_named = not found.packets
            received = words_for(data, self._settings.range_mm, self._settings.checksum) if is_named else ""
            out.append(self._damage(found.skipped_bytes, received))
        for packet in found.packets:
            if self._is_between(packet.serial, host_ns):
                out.append(self._damage(wire.PACKET_BYTES, f"a packet of sensor {packet.serial}"))
                continue
            out += self._identified(packet.serial)
            if not self._complaint:
                self._heard_ns = host_ns
                for stretch in self._numbered.feed(np.array([packet.number]), [packet], host_ns):
                    out += self._placed(stretch)
        return out

    def _is_between(self, serial: int, host_ns: int) -> bool:
        """Return whether a packet is of another sensor, while the expected one still sends to the same port."""
        if self._heard_ns is None or serial == (self._wanted or serial):
            return False
        return host_ns - self._heard_ns < max(_OTHER_S * 1e9, _OTHER_PACKETS * wire.RESULTS * self._period_ns)

    def _damage(self, count: int, received: str) -> DeviceEvent:
        """Count skipped bytes, and complain of what was received as long as no packet was decoded."""
        range_mm = self._settings.range_mm
        if received and self._serial is None:
            self._complaint = (
                f"expected packets of a sensor with a range of {range_mm} mm, got {received}. "
                "Look at the rig file, the sensor's settings and its address"
            )
        event = self.skipped_bytes(count, f"packet of a sensor with a range of {range_mm} mm")
        return replace(event, text=f"{event.text}; received: {received}") if received else event

    def _placed(self, stretch: Stretch[list[wire.Packet]]) -> Items:
        out: Items = []
        if stretch.is_restart:
            self._clock.restart()
            self._next = 0
            out.append(DeviceEvent("restart", self._device, "its packets' number does not continue: it started again"))
        elif stretch.lost:
            lost = stretch.lost * wire.RESULTS
            self._next += lost
            out.append(self.lost_samples(lost, lost * self._period_ns * 1e-9))
        return [*out, *(self._samples(packet, stretch.host_ns) for packet in stretch.rows)]

    def _identified(self, serial: int) -> Items:
        """Compare the sensor's serial number with the expected one; no samples are taken of another sensor."""
        if serial == self._serial:
            return []
        self._serial, self._wanted = serial, self._wanted or serial
        expected = f"serial number {self._wanted}, that of the rig file or of the sensor before"
        self._complaint = (
            ""
            if serial == self._wanted
            else f"expected {expected}, got packets of sensor {serial}: look at its address"
        )
        return [DeviceEvent("fault", self._device, self._complaint, {"serial": serial})] if self._complaint else []

    def _samples(self, packet: wire.Packet, host_ns: int) -> Batch:
        number = self._next + np.arange(wire.RESULTS)
        self._next += wire.RESULTS
        device_ns = np.rint(number * self._period_ns).astype(np.int64)
        settings = self._settings
        distance = readings(packet.codes, settings.range_m, settings.no_target_codes)
        if settings.valid_status:
            distance[~np.isin(packet.status, settings.valid_status)] = np.nan
        self.losses["invalid"] += int(np.count_nonzero(np.isnan(distance)))
        displacement = (distance - 0.5 * settings.range_m) / settings.lever_ratio
        time_ns = self._clock.map(device_ns, host_ns)
        return displacement_batch(self._channel, time_ns, number, device_ns, displacement, packet.codes)
