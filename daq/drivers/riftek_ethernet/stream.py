"""Pipeline of an RF60x sensor on Ethernet: packets to displacement of the disk centre.

The time of a sample is its number times the sampling period on the sensor's clock, mapped to the common clock.
Datagrams can be lost, come twice, or come late; the packets' number shows it, and the host's time how often the number
wrapped.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.clock import ClockMap, ClockSeed, clock_rules
from daq.drivers.riftek.wire import FULL_SCALE, metres
from daq.drivers.riftek_ethernet import wire
from daq.drivers.riftek_ethernet.settings import RiftekEthernetLaser
from daq.items import TX, Batch, DeviceEvent

_TICK_NS = round(channels.DEVICE_TICK_S * 1e9)
_MAX_OFF_S = 1.0  # difference of the numbers' time from the host's that shows a restart
_MAX_LATE = 3  # consecutive packets that come twice or late; more show a restart
_COUNTER_WRAP = 2**32

Items = list[Batch | DeviceEvent]


class RiftekEthernetPipeline:
    """Decoder of one sensor's packets. Displacement is 0 in the middle of the range and grows with the distance.

    Attributes:
        losses: see Pipeline. "samples": missing by the packets' number; "bytes": skipped; "invalid": without a reading.
        has_reported, complaint: see DescribesItself; every packet has the sensor's serial number.
        repeated_packets: number of packets that came twice or too late.
    """

    def __init__(
        self, device: str, settings: RiftekEthernetLaser, channel: channels.Channel, identity: Mapping[str, Any]
    ) -> None:
        self.losses: dict[str, int] = {"samples": 0, "bytes": 0, "invalid": 0}
        self.has_reported: bool = False
        self.complaint: str = ""
        self.repeated_packets: int = 0
        self._device, self._settings, self._channel = device, settings, channel
        self._decoder = wire.PacketDecoder(settings.range_mm, settings.checksum)
        self._rules = clock_rules(identity)
        self._clock = ClockMap(settings.clock_tolerance_ppm, self._rules, ClockSeed.of(identity))
        self._period_ns = 1e9 / settings.rate_Hz
        self._packet_s = wire.RESULTS / settings.rate_Hz
        known = identity.get("serial")
        self._wanted = settings.serial_number or (known if type(known) is int else 0)  # 0: the first one
        self._serial: int | None = None
        self._newest: tuple[int, int] | None = None  # number of the newest packet; its host time, ns
        self._late = 0  # number of consecutive packets that came twice or late
        self._next = 0  # number of the next sample

    @property
    def learned(self) -> dict[str, int]:
        """See ObservesIdentity."""
        return {} if self._serial is None else {"serial": self._serial}

    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        """See Pipeline."""
        if direction == TX:
            return []
        found = self._decoder.feed(data)
        out: Items = []
        if found.skipped_bytes:
            self.losses["bytes"] += found.skipped_bytes
            text = (
                f"{found.skipped_bytes} bytes skipped that belong to no packet of a sensor with a range of "
                f"{self._settings.range_mm} mm"
            )
            out.append(DeviceEvent("damage", self._device, text, {"bytes": found.skipped_bytes}))
        for packet in found.packets:
            out += self._packet(packet, host_ns)
        return out

    def _packet(self, packet: wire.Packet, host_ns: int) -> Items:
        out = self._identified(packet.serial)
        if self.complaint:
            return out
        steps, is_restart = self._steps(packet.number, host_ns)
        if steps <= 0 and not is_restart and self._late < _MAX_LATE:
            self._late += 1
            self.repeated_packets += 1
            return out
        is_restart |= steps <= 0
        self._late = 0
        self._newest = packet.number, host_ns
        if is_restart:
            self._clock, self._next = ClockMap(self._settings.clock_tolerance_ppm, self._rules), 0
            out.append(DeviceEvent("restart", self._device, "its packets' number does not continue: it started again"))
        elif steps > 1:
            lost = (steps - 1) * wire.RESULTS
            self.losses["samples"] += lost
            self._next += lost
            span_s = lost * self._period_ns * 1e-9
            facts = {"samples": lost, "span_s": span_s}
            out.append(DeviceEvent("gap", self._device, f"{lost} samples lost ({span_s * 1e3:.2f} ms)", facts))
        return [*out, self._samples(packet, host_ns)]

    def _identified(self, serial: int) -> Items:
        """Compare the sensor's serial number with the expected one; no samples are taken of another sensor."""
        if serial == self._serial:
            return []
        self._serial, self.has_reported, self._wanted = serial, True, self._wanted or serial
        expected = f"serial number {self._wanted}, that of the rig file or of the sensor before"
        self.complaint = (
            ""
            if serial == self._wanted
            else f"expected {expected}, got packets of sensor {serial}: look at its address"
        )
        return [DeviceEvent("fault", self._device, self.complaint, {"serial": serial})] if self.complaint else []

    def _steps(self, number: int, host_ns: int) -> tuple[int, bool]:
        """Return the number of packets since the newest one, and whether the sensor started again."""
        if self._newest is None:
            return 1, False
        newest, newest_ns = self._newest
        passed = (host_ns - newest_ns) * 1e-9 / self._packet_s
        ahead = (number - newest + wire.NUMBERS // 2) % wire.NUMBERS - wire.NUMBERS // 2
        steps = ahead + wire.NUMBERS * round((passed - ahead) / wire.NUMBERS)
        return steps, abs(steps - passed) * self._packet_s > max(_MAX_OFF_S, 4 * self._packet_s)

    def _samples(self, packet: wire.Packet, host_ns: int) -> Batch:
        number = self._next + np.arange(wire.RESULTS)
        self._next += wire.RESULTS
        device_ns = np.rint(number * self._period_ns).astype(np.int64)
        settings, counter = self._settings, (number % _COUNTER_WRAP).astype(np.uint32)
        distance = metres(packet.codes, settings.range_m)
        wrong = (packet.codes > FULL_SCALE) | np.isin(packet.codes, settings.no_target_codes)
        if settings.valid_status:
            wrong |= ~np.isin(packet.status, settings.valid_status)
        distance[wrong] = np.nan
        self.losses["invalid"] += int(np.count_nonzero(wrong))
        columns: dict[str, NDArray[Any]] = {
            "code": packet.codes.astype(np.uint32),
            "displacement_m": (distance - 0.5 * settings.range_m) / settings.lever_ratio,
            "flags": np.zeros(wire.RESULTS, np.uint32),
            "device_ticks": (device_ns // _TICK_NS).astype(np.uint64),
            "counter": counter,
        }
        return Batch(self._channel, self._clock.map(device_ns, host_ns), counter, columns)
