"""Pipeline of an optoNCDT 2300 on Ethernet: packets to displacement of the disk centre.

The time of a sample is its number times the sampling period on the sensor's clock, mapped to the common clock. TCP
loses nothing; what the sensor drops because the network is slow, and what is missed while the connection is closed, is
seen in the counter.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.clock import ClockMap, ClockSeed, clock_rules
from daq.drivers.optoncdt_ethernet import distances, wire
from daq.drivers.optoncdt_ethernet.settings import EthernetLaser
from daq.items import TX, Batch, DeviceEvent

_TICK_NS = round(channels.DEVICE_TICK_S * 1e9)
_RESTART_FRAMES = 2**31  # a larger step of the counter is one backwards: the sensor started again

Items = list[Batch | DeviceEvent]


class EthernetPipeline:
    """Decoder of one sensor's packets. Displacement is 0 in the middle of the range and grows with the distance.

    Attributes:
        losses: see Pipeline. "samples": missing by the counter; "bytes": skipped; "invalid": error codes.
        has_reported, complaint: see DescribesItself; the packets have the sensor's serial number.
    """

    def __init__(
        self, device: str, settings: EthernetLaser, channel: channels.Channel, identity: Mapping[str, Any]
    ) -> None:
        self.losses: dict[str, int] = {"samples": 0, "bytes": 0, "invalid": 0}
        self.has_reported: bool = False
        self.complaint: str = ""
        self._device, self._channel, self._settings = device, channel, settings
        self._place = settings.words.index("DIST")
        self._period_ns = 1e9 / settings.rate_Hz
        self._decoder = wire.PacketDecoder(len(settings.words))
        self._rules = clock_rules(identity)
        self._clock = ClockMap(settings.clock_tolerance_ppm, self._rules, ClockSeed.of(identity))
        known = identity.get("serial")
        self._wanted = settings.serial_number or (
            known if isinstance(known, int) else 0
        )  # serial number; 0: the first one
        self._serial: tuple[int, int] | None = None  # order and serial number
        self._counter: int | None = None  # counter of the newest packet
        self._previous = 0  # number of its frames
        self._next = 0  # number of the next sample
        self._joined = False
        self._watch = distances.ScalingWatch(settings.scaling, settings.range_m)

    @property
    def learned(self) -> dict[str, int]:
        """See ObservesIdentity."""
        return {} if self._serial is None else {"order": self._serial[0], "serial": self._serial[1]}

    @property
    def clock_std_ns(self) -> float:
        """See StatesClockError."""
        return self._clock.std_ns

    @property
    def clock_seed(self) -> ClockSeed | None:
        """See HasClockSeed."""
        return (
            None if self._settings.counts == "packets" else self._clock.seed(round(wire.COUNTER_WRAP * self._period_ns))
        )

    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        """See Pipeline."""
        if direction == TX:
            return []
        found = self._decoder.feed(data)
        out: Items = []
        if found.skipped_bytes and self._joined:
            self.losses["bytes"] += found.skipped_bytes
            text = f"{found.skipped_bytes} bytes skipped that do not belong to a packet"
            out.append(DeviceEvent("damage", self._device, text, {"bytes": found.skipped_bytes}))
        numbers: list[NDArray[np.int64]] = []
        words: list[NDArray[np.uint32]] = []
        for packet in found.packets:
            self._joined = True
            out += self._identified(packet)
            if self.complaint:
                continue
            gap = self._gap(packet)
            if gap and words:
                out.append(self._batch(np.concatenate(numbers), np.concatenate(words), host_ns))
                numbers, words = [], []
            out += gap
            out += self._doubted(packet)
            if self.complaint:
                continue
            count = len(packet.frames)
            numbers.append(np.arange(self._next, self._next + count))
            words.append(packet.frames[:, self._place])
            self._next += count
        if words:
            out.append(self._batch(np.concatenate(numbers), np.concatenate(words), host_ns))
        return out

    def _identified(self, packet: wire.Packet) -> Items:
        """Compare the sensor's serial number with the rig file's; no samples are taken of another sensor."""
        own = packet.order, packet.serial
        if own == self._serial:
            return []
        self._serial, self.has_reported = own, True
        self._wanted = self._wanted or packet.serial
        self.complaint = (
            f"the sensor has serial number {packet.serial}, expected {self._wanted}, that of the rig file or of the "
            "sensor before: look at its port"
            if packet.serial != self._wanted
            else ""
        )
        if not self.complaint:
            return []
        return [DeviceEvent("fault", self._device, self.complaint, {"serial": packet.serial})]

    def _doubted(self, packet: wire.Packet) -> Items:
        """Take no samples whose scaling is wrong: the amplitude would be too small by a factor of some hundred."""
        found = self._watch.contradiction(packet.frames[:, self._place])
        if not found:
            return []
        self.has_reported, self.complaint = True, found
        return [DeviceEvent("fault", self._device, found, {"scaling": self._settings.scaling})]

    def _gap(self, packet: wire.Packet) -> Items:
        """Return the event about samples missing before a packet, and set the number of its first sample."""
        before, self._counter = self._counter, packet.counter
        of_frames = self._settings.counts == "frames"
        expected, self._previous = (self._previous if of_frames else 1), len(packet.frames)
        if before is None:
            self._next = packet.counter if of_frames else 0  # the clock continues from one log to the next
            return []
        missing = (packet.counter - before) % wire.COUNTER_WRAP - expected
        if missing == 0:
            return []
        if missing < 0 or missing >= _RESTART_FRAMES:
            self._clock = ClockMap(self._settings.clock_tolerance_ppm, self._rules)
            self._next = packet.counter if of_frames else self._next
            return [DeviceEvent("restart", self._device, "its counter does not continue: the sensor started again")]
        lost = missing if of_frames else missing * self._previous
        self.losses["samples"] += lost
        self._next += lost
        span = lost * self._period_ns * 1e-9
        about = "" if of_frames else "about "
        text = f"{about}{lost} samples lost ({span * 1e3:.2f} ms)"
        facts: dict[str, Any] = {"samples": lost, "span_s": span}
        if not of_frames:
            facts["uncertain_samples"] = missing
        return [DeviceEvent("gap", self._device, text, facts)]

    def _batch(self, number: NDArray[np.int64], code: NDArray[np.uint32], host_ns: int) -> Batch:
        device_ns = np.rint(number * self._period_ns).astype(np.int64)
        time_ns = self._clock.map(device_ns, host_ns)
        range_m = self._settings.range_m
        distance = distances.metres(code, range_m, self._settings.scaling)
        self.losses["invalid"] += int(np.count_nonzero(np.isnan(distance)))
        counter = (number % wire.COUNTER_WRAP).astype(np.uint32)
        columns: dict[str, NDArray[Any]] = {
            "displacement_m": (distance - 0.5 * range_m) / self._settings.lever_ratio,
            "code": code,
            "counter": counter,
            "device_ticks": (device_ns // _TICK_NS).astype(np.uint64),
            "flags": np.zeros(len(code), np.uint32),
        }
        return Batch(self._channel, time_ns, counter, columns)
