"""Pipeline of an optoNCDT 2300 on Ethernet: packets to displacement of the disk centre.

The time of a sample is its number times the sampling period on the sensor's clock, mapped to the common clock. TCP
loses nothing; what the sensor drops because the network is slow, and what is missed while the connection is closed, is
seen in the counter.

Recognition of an optoNCDT 2300 on Ethernet by its packets, which contain its serial number. Nothing is sent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq import channels
from daq.clock import ClockMap, ClockSeed
from daq.drivers.contract import Pipeline, PipelineStatus
from daq.drivers.displacement import displacement_batch
from daq.drivers.identification import FoundDevice
from daq.items import TX, Batch, DeviceEvent
from daq.numbered.messages import Count, Stretch
from daq.numbered.stream import NumberedStream
from rig_drivers.optoncdt_ethernet import distances, wire
from rig_drivers.optoncdt_ethernet.frame_numbers import FrameNumbers
from rig_drivers.optoncdt_ethernet.settings import EthernetLaser

_OTHER_RATE = 0.1
"""Deviation of a rate that was changed: the rates of the sensor differ by a factor of 1.5 or more."""
_SETTLES_NS = 1_000_000_000  # after its begin, the due line has the sensor's rate

Items = list[Batch | DeviceEvent]


class EthernetPipeline(Pipeline):
    """Decoder of one sensor's packets. Displacement is 0 in the middle of the range and grows with the distance.

    Attributes:
        losses: see Pipeline. "samples": missing by the counter; "bytes": skipped; "invalid": error codes.
        doubt: what the flags of the packets contradict, a clause; empty without a contradiction.
    """

    def __init__(self, device: str, settings: EthernetLaser, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "bytes", "invalid")
        self._has_reported = False
        self._complaint = ""
        self.doubt: str = ""
        self._settings = settings
        self._channel = channels.displacement_channel(settings.topic)
        self._place = settings.words.index("DIST")
        self._period_ns = 1e9 / settings.rate_Hz
        self._decoder = wire.PacketDecoder(len(settings.words))
        self._clock = ClockMap(settings.clock_tolerance_ppm, ClockSeed.of(identity))
        known = identity.get("serial")
        self._wanted = settings.serial_number or (
            known if isinstance(known, int) else 0
        )  # serial number; 0: the first one
        self._serial: tuple[int, int] | None = None  # order and serial number
        self._flags: list[tuple[int, int]] = []  # of the first and of the newest packet of the wanted sensor
        self._frame_size = wire.FrameSize()
        self._counter = FrameNumbers(settings.counts)
        self._order = NumberedStream[NDArray[np.uint32]](Count(wire.COUNTER_WRAP, self._period_ns), np.concatenate)
        self._begun_ns: int | None = None  # host time from which on the rate is that of the due line
        self._was_right = self._is_changed = False  # whether the rate was that of the rig file, and is another one
        self._refused = 0  # samples that were not taken, since their rate is another one
        self._joined = self._misfits = False
        self._skips = False  # whether packets are skipped because of the complaint
        self._watch = distances.ScalingWatch(settings.scaling, settings.range_m)

    @property
    def status(self) -> PipelineStatus:
        """See Pipeline.

        The packets have the sensor's serial number, the size of a frame, and flags that depend on the selected values.
        """
        # The counter of the next log's first packet may not give the number of its first sample.
        is_counted = self._settings.counts == "frames" and not self._counter.of_end
        return PipelineStatus(
            self._has_reported,
            self._complaint,
            clock_seed=self._clock.seed(round(wire.COUNTER_WRAP * self._period_ns)) if is_counted else None,
            clock_std_ns=self._clock.std_ns,
            learned={} if self._serial is None else {"order": self._serial[0], "serial": self._serial[1]},
        )

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            return []
        if not data:
            return self._placed(self._order.end())
        found = self._decoder.feed(data)
        out: Items = self._skipped(found)
        numbers: list[NDArray[np.int64]] = []
        words: list[NDArray[np.uint32]] = []
        for packet in found.packets:
            self._joined = True
            out += self._identified(packet)
            if self._skips:
                continue
            numbers.append(self._counter.first(packet.counter, len(packet.frames)) + np.arange(len(packet.frames)))
            words.append(packet.frames[:, self._place])
            out += self._doubted(words[-1])
            if self._skips:
                numbers.pop()
                words.pop()
        if words:
            number = np.concatenate(numbers) % wire.COUNTER_WRAP
            out += self._placed(self._order.feed(number, np.concatenate(words), host_ns))
            out += self._rated(host_ns)
        return out

    def _placed(self, stretches: Sequence[Stretch[NDArray[np.uint32]]]) -> Items:
        """Return the samples that have a place in the sensor's count, and the events about them."""
        out: Items = []
        for stretch in stretches:
            if stretch.is_restart:
                out += self._restarted("its counter does not continue: the sensor started again")
            elif stretch.lost:
                uncertain = 0 if self._settings.counts == "frames" else max(1, stretch.lost // self._counter.frames)
                out.append(self._lost(stretch.lost, uncertain))
            if self._is_changed:
                self._refused += len(stretch.rows)
            else:
                out.append(self._batch(stretch.numbers, stretch.rows, stretch.host_ns))
        return out

    def _skipped(self, found: wire.DecodedPackets) -> Items:
        """Report bytes that belong to no packet, and once a sensor whose frames have another size than `words`."""
        out: Items = []
        if found.skipped_bytes and self._joined:
            event = self.skipped_bytes(found.skipped_bytes, "packet")
            out += [] if self._misfits else [event]
        if found.packets:
            self._frame_size.clear()
        elif not self._misfits and (size := self._frame_size.feed(found.misfits)) is not None:
            self._misfits = True
            names = ", ".join(self._settings.words)
            text = (
                f"its frames have {size / 4:g} values, expected {len(self._settings.words)} (words = {names}): name "
                "all values that are selected on the sensor's web page in their order, or select these alone"
            )
            out += self._complain(text, {"frame_bytes": size})
        return out

    def _complain(self, text: str, facts: dict[str, Any]) -> Items:
        self._has_reported, self._complaint, self._skips = True, text, True
        self._begun_ns, self._was_right = None, False
        return [DeviceEvent("fault", self._device, text, facts)]

    def _identified(self, packet: wire.Packet) -> Items:
        """Compare the sensor's serial number with the rig file's, and its flags with those of its first packet.

        No samples are taken of another sensor, nor after other values were selected, since the distance may have
        another place in the frame.
        """
        own = packet.order, packet.serial
        if own == self._serial and not self._misfits and packet.flags == self._flags[-1]:
            return []
        self._misfits = False
        self._serial, self._has_reported = own, True
        self._flags = [*self._flags[:1], packet.flags]
        self._wanted = self._wanted or packet.serial
        self._complaint, self._skips = "", False
        if packet.serial != self._wanted:
            self._flags = [packet.flags]
            return self._complain(
                f"the sensor has serial number {packet.serial}, expected {self._wanted}, that of the rig file or of "
                "the sensor before: look at its port",
                {"serial": packet.serial},
            )
        if packet.flags != self._flags[0]:
            return self._complain(
                f"the sensor's settings were changed: its packets have the flags {_hex(packet.flags)}, expected "
                f"{_hex(self._flags[0])}, those of its first packet. Select the values and the rate as before, or "
                "correct the rig file and begin again",
                {"flags_1": packet.flags[0], "flags_2": packet.flags[1]},
            )
        return [] if self.doubt else self._named(packet.flags)

    def _named(self, flags: tuple[int, int]) -> Items:
        """Report once that the flags name other values than the rig file. The samples are taken all the same."""
        words = self._settings.words
        if self._settings.scaling != distances.NANOMETRES or not wire.contradicts(flags, words):
            return []
        self.doubt = (
            f"by its flags the sensor sends {', '.join(wire.values_named(flags))}, expected words = {', '.join(words)}"
            ": compare with its web page, since another value may be recorded as distance"
        )
        return [DeviceEvent("doubt", self._device, self.doubt, {"flags_1": flags[0], "flags_2": flags[1]})]

    def _doubted(self, words: NDArray[np.uint32]) -> Items:
        """Take no samples whose scaling is wrong, by a factor of some hundred, or whose counter counts otherwise."""
        if found := self._watch.contradiction(words):
            return self._complain(found, {"scaling": self._settings.scaling})
        if (found := self._counter.contradiction) and not self._complaint:
            return self._complain(found, {"counts": self._settings.counts})
        return []

    def _restarted(self, text: str) -> Items:
        self._clock.restart()
        self._begun_ns = None
        return [DeviceEvent("restart", self._device, text)]

    def _lost(self, lost: int, uncertain: int, why: str = "lost") -> DeviceEvent:
        """Count samples that are missing before the next one."""
        facts = {"uncertain_samples": uncertain} if uncertain else {}
        event = self.lost_samples(lost, lost * self._period_ns * 1e-9, **facts)
        return replace(event, text=("about " if uncertain else "") + event.text.replace("lost", why))

    def _rated(self, host_ns: int) -> Items:
        """Take no samples while the sensor measures at another rate than before, since their times would be wrong.

        A rate that is wrong from the beginning is not judged here: the host compares each device's rate with the rig
        file.
        """
        self._begun_ns = host_ns if self._begun_ns is None else self._begun_ns
        is_other = abs(1.0 / self._order.pace - 1.0) > _OTHER_RATE
        self._was_right = self._was_right or (not is_other and host_ns - self._begun_ns > _SETTLES_NS)
        if is_other == self._is_changed or not self._was_right:
            return []
        self._is_changed = is_other
        if is_other:
            rate_Hz = self._settings.rate_Hz / self._order.pace
            text = (
                f"its measuring rate was changed some seconds ago: about {rate_Hz:.0f} Hz, expected "
                f"{self._settings.rate_Hz:g} Hz. Set the rate as before, or correct rate_Hz and begin again"
            )
            self._has_reported, self._complaint = True, text
            facts = {"rate_Hz": rate_Hz, "nominal_Hz": self._settings.rate_Hz}
            return [DeviceEvent("fault", self._device, text, facts)]
        self._complaint = ""
        refused, self._refused = self._refused, 0
        gap = self._lost(refused, 0, "not taken, since their rate was another one")
        return [gap, *self._restarted("it measures at the rate of the rig file again")]

    def _batch(self, number: NDArray[np.int64], code: NDArray[np.uint32], host_ns: int) -> Batch:
        device_ns = np.rint(number * self._period_ns).astype(np.int64)
        time_ns = self._clock.map(device_ns, host_ns)
        range_m = self._settings.range_m
        distance = distances.metres(code, range_m, self._settings.scaling)
        self.losses["invalid"] += int(np.count_nonzero(np.isnan(distance)))
        displacement = (distance - 0.5 * range_m) / self._settings.lever_ratio
        return displacement_batch(self._channel, time_ns, number, device_ns, displacement, code)


def _hex(flags: tuple[int, int]) -> str:
    return " ".join(f"{word:08X}h" for word in flags)


def recognise(settings: EthernetLaser, data: bytes) -> FoundDevice | None:
    """Return the serial number of the first packet, and the values of its frames; see `Driver.recognise`.

    The values are those of the settings if these fit the frames, otherwise those that the packet's flags name.
    """
    words = settings.words
    decoded = wire.PacketDecoder(len(words)).feed(data)
    if not decoded.packets and (words := _named_values(decoded.misfits)):
        decoded = wire.PacketDecoder(len(words)).feed(data)
    if not decoded.packets:
        return None
    first = decoded.packets[0]
    identity: dict[str, int] = {"order": first.order, "serial": first.serial}
    return FoundDevice({"serial": first.serial} | ({"words": list(words)} if len(words) > 1 else {}), identity)


def _named_values(misfits: Sequence[wire.Misfit]) -> tuple[str, ...]:
    """Return the values that the flags of the headers name, if the frames have so many, otherwise none."""
    size = wire.FrameSize().feed(misfits)
    words = wire.values_named(misfits[-1].flags) if misfits else ()
    return words if size == 4 * len(words) else ()
