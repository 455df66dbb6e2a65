"""Pipeline of a MicroStrain node: packets of synchronized sampling to pendulum angles and further quantities.

Samples have the time of the beacon, which the base station sends. The base station answers a periodic query with the
beacon's time. This answer is on the line immediately, while sweeps wait in the node until a packet is full and until
its turn on air has come. The lag of the newest answer is therefore the lag of the samples in the clock map. Packets
that come after a gap wait for those that fill it. Tick and time of a sweep contradict one another after a new start of
the node or of the beacon.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq import channels
from daq.clock import ClockMap, ClockSeed
from daq.drivers.contract import Pipeline, PipelineStatus
from daq.drivers.sparing import Foreign
from daq.items import TX, Batch, DeviceEvent
from daq.numbered.messages import Count, Stretch
from daq.numbered.stream import NumberedStream
from rig_drivers.microstrain import wire
from rig_drivers.microstrain.framing import Answer, PacketSearch, beacon_of
from rig_drivers.microstrain.rates import BASE_ADDRESS, RATES_HZ
from rig_drivers.microstrain.settings import MicroStrainNode, quantity_channel

BEACON_LAG = "beacon_lag_ns"
"""Key of the identity: host time minus the beacon's time at the opening, ns."""
_LAG_VALID_NS = 60_000_000_000
_START_NS = 5_000_000_000  # after it was switched on, a node that samples by itself has sent sweeps; unverified
_CONTRADICTIONS = 3  # consecutive packets with other channels or another rate than the rig file's
_WRAP_NS = 2**32 * 10**9  # the beacon's seconds have 32 bits
_TICKS = 65_536
_LOOK_AHEAD_NS, _MAX_LATE_S = 2e9, 10.0
"""Longest wait for a repeated packet, and age of one that is no new start; the maker states none."""
_MAX_HOST_LATE_NS = 120_000_000_000  # largest lateness of a host
_MAX_ANGLE_RAD = 1e6
_TURN_RAD = 2 * math.pi
_LOCKS_RAD = (0.0, math.pi)  # angles of the closed locks, around which the angles begin
_FAULTS = (channels.ENCODER_FAULT_A, channels.ENCODER_FAULT_B)

Items = list[Batch | DeviceEvent]
Rows = NDArray[np.void]
"""Sweeps: time of the beacon, `ns`, and `values` of the used channels, shape (n,)."""


class MicroStrainPipeline(Pipeline):
    """Decoder of a node's packets behind a base station.

    Attributes:
        losses: see Pipeline. "samples": missing by tick and time; "damaged_packets": intact packets with impossible
            content; "bytes": skipped; "foreign_packets": of other nodes.
        base_rssi_dBm, node_rssi_dBm: signal strength of the newest packet, dBm; None if unknown.
    """

    def __init__(self, device: str, settings: MicroStrainNode, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "samples", "damaged_packets", "bytes", "foreign_packets")
        self._has_reported = False
        self._complaint = ""
        self._set_up_lost = ""  # the command that sets the beacon resets it
        self.base_rssi_dBm: int | None = None
        self.node_rssi_dBm: int | None = None
        self._settings, self._quantities = settings, quantity_channel(settings)
        self._search = PacketSearch(settings.aspp)
        self._period_ns = 1e9 / settings.rate_Hz
        clock = (wire.MAX_TIME_NS, self._period_ns, round(_MAX_LATE_S * settings.rate_Hz))
        count = Count(_TICKS, self._period_ns, 1.0, *clock, look_ahead_ns=_LOOK_AHEAD_NS)
        self._numbered = NumberedStream[Rows](count, np.concatenate)
        self._newest: tuple[int, int] | None = None  # time of the beacon, and arrival, of the newest sample, ns
        self._clock = ClockMap(settings.clock_tolerance_ppm, ClockSeed.of(identity))
        known = identity.get(BEACON_LAG)
        self._lag: tuple[int, int | None] | None = (known, None) if type(known) is int else None
        self._index = 0  # number of the next sample
        self._run: list[Stretch[Rows]] = []  # consecutive packets
        self._missing = 0  # number of samples missing before them
        self._angles = [
            ContinuedAngle(settings.slope_a_rad, settings.offset_a_rad, _LOCKS_RAD[0] if settings.turns else None),
            ContinuedAngle(settings.slope_b_rad, settings.offset_b_rad, _LOCKS_RAD[1] if settings.turns else None),
        ]
        self._contradictions = self._others = 0
        self._switched_on_ns: int | None = None  # host time, until samples of the node follow
        self._is_timed_by_arrival = False  # which was reported
        self._is_beacon_new = False  # the host has set the beacon after samples had come
        self._foreign = Foreign(device)
        self._status_reported = self._is_off = False

    @property
    def status(self) -> PipelineStatus:
        """See Pipeline. Every packet has the node's channels and rate."""
        seed = self._clock.seed(_WRAP_NS)
        return PipelineStatus(self._has_reported, self._complaint, self._set_up_lost, seed)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        if direction == TX:
            return []
        found = self._search.feed(data)
        out: Items = []
        if found.skipped_bytes:
            out.append(self.skipped_bytes(found.skipped_bytes, "intact packet"))
        for packet in found.packets:
            out += self._packet(packet, host_ns)
        out += self._placed(self._numbered.at(host_ns) if data else self._numbered.end())
        if self._switched_on_ns is not None and host_ns - self._switched_on_ns > _START_NS:
            self._set_up_lost = "the node was switched on and does not sample"
        return out + self._run_ended()

    def _packet(self, packet: wire.Packet, host_ns: int) -> Items:
        if packet.address == BASE_ADDRESS and packet.kind in wire.REPLIES:
            return self._answered(packet, host_ns)
        if packet.kind == wire.BEACON_ECHO and not packet.address:
            return []
        if packet.address != self._settings.node_address:
            return self._foreign_packet(packet.address)
        return self._node_packet(packet, host_ns)

    def _node_packet(self, packet: wire.Packet, host_ns: int) -> Items:
        if wire.is_discovery(packet):
            self._switched_on_ns = host_ns
            kind = "restart" if self._has_reported else "status"  # before its first sample nothing of it is lost
            return [DeviceEvent(kind, self._device, "the node reports that it was switched on")]
        if packet.kind in wire.REPLIES:
            return self._answered(packet, host_ns)
        version = self._settings.aspp
        try:
            payload = wire.sweeps_of(packet, version)
            found = None if payload is None else wire.parse_sweeps(payload, version)
        except ValueError as fault:  # usual: a damaged packet that the check let pass
            return [self._damaged(str(fault))]
        return self._other_samples(packet.kind) if found is None else self._samples(found, packet, host_ns)

    def _other_samples(self, kind: int) -> Items:
        """Return the events of a packet with samples of another kind: a complaint if the node sends only such packets.

        A node may send them in addition.
        """
        if self._has_reported or kind not in wire.OTHER_SAMPLES:
            return []
        self._others += 1
        if self._others < _CONTRADICTIONS:
            return []
        name = wire.OTHER_SAMPLES[kind]
        self._has_reported = True
        self._complaint = (
            f"the node sends packets of type {kind:02X}h ({name}), not of synchronized sampling. "
            "Set up its sampling mode and its channels"
        )
        return [DeviceEvent("fault", self._device, self._complaint)]

    def _foreign_packet(self, address: int) -> Items:
        self.losses["foreign_packets"] += 1
        text = f"packets of node {address} ignored: the rig file states node_address = {self._settings.node_address}"
        return [*self._foreign.event(text, {"node": address})]

    # --- answers -------------------------------------------------------------------------------------------------

    def _answered(self, packet: wire.Packet, host_ns: int) -> Items:
        command = packet.payload[:2]
        beacon = beacon_of(packet)
        out: Items = []
        if packet.kind == wire.BASE_SUCCESS and command == wire.SET_BEACON.to_bytes(2, "big"):
            # The host switches the beacon off and on when it opens the device, also again during a recording: this is
            # no fault, and the next state of the beacon is a reply that the dialogue waits for.
            self._status_reported = False
            self._set_up_lost, self._switched_on_ns = "", None
            self._is_beacon_new = self._index > 0
        is_status = beacon is not None
        if beacon is not None:
            if beacon.is_on:
                self._lag, self._is_timed_by_arrival = (host_ns - beacon.time_ns, host_ns), False
                if self._is_off and self._switched_on_ns is None:
                    self._set_up_lost = ""
            elif not self._is_off and self._status_reported:
                out.append(self._beacon_is_off())
            self._is_off = not beacon.is_on
        elif packet.kind == wire.BASE_ERROR and command == wire.BEACON_STATUS.to_bytes(2, "big"):
            is_status = True
            if self._status_reported:
                out += self._timed_by_arrival(f"the base station refuses the query with code {packet.payload[-1]}")
        if is_status:
            if self._status_reported:
                return out
            self._status_reported = True
        text = Answer(packet.kind, packet.address, packet.payload, host_ns).text
        return [*out, DeviceEvent("reply", self._device, text)]

    def _beacon_is_off(self) -> DeviceEvent:
        self._set_up_lost = "the base station's beacon is off"
        text = (
            f"{self._set_up_lost}: it has started again, or another program uses it. Look at its power. Until the "
            "beacon is set, the node has times of its own clock, and it stops sampling after its own timeout"
        )
        return DeviceEvent("restart", self._device, text)

    def _timed_by_arrival(self, reason: str) -> Items:
        """Return the event that samples have the time of their arrival, once until the beacon's time is known again."""
        if self._is_timed_by_arrival:
            return []
        self._is_timed_by_arrival = True
        text = (
            f"the beacon's time is unknown: {reason}. Samples have the time of their arrival, which is later by the "
            "delay of their packet: its duration and that of the radio"
        )
        return [DeviceEvent("doubt", self._device, text)]

    # --- samples -------------------------------------------------------------------------------------------------

    def _samples(self, sweeps: wire.Sweeps, packet: wire.Packet, host_ns: int) -> Items:
        wrong = self._contradiction(sweeps)
        if wrong is not None:
            return wrong
        self._has_reported, self._switched_on_ns = True, None
        self.base_rssi_dBm, self.node_rssi_dBm = packet.base_rssi_dBm, packet.node_rssi_dBm
        columns = [sweeps.channels.index(number) for number in self._settings.used_channels]
        rows = np.empty(len(sweeps.values), [("ns", np.int64), ("values", np.float64, len(columns))])
        rows["ns"] = sweeps.time_ns + np.rint(np.arange(len(rows)) * self._period_ns).astype(np.int64)
        rows["values"] = sweeps.values[:, columns]
        numbers = (sweeps.tick + np.arange(len(rows))) % _TICKS
        return self._placed(self._numbered.feed(numbers, rows, host_ns, rows["ns"]))

    def _placed(self, stretches: Sequence[Stretch[Rows]]) -> Items:
        return [item for stretch in stretches for item in self._stretch(stretch)]

    def _stretch(self, stretch: Stretch[Rows]) -> Items:
        """Add a stretch to the consecutive packets, or return those so far and the event of a new start."""
        first_ns, host_ns = int(stretch.rows["ns"][0]), stretch.host_ns
        why = self._restart(first_ns, stretch)
        out = self._run_ended() if why or stretch.lost else []
        if why:
            out.append(DeviceEvent("restart", self._device, why))
        self._missing = 0 if stretch.is_restart else self._missing + stretch.lost
        self._newest = int(stretch.rows["ns"][-1]), host_ns
        self._run.append(stretch)
        return out

    def _restart(self, first_ns: int, stretch: Stretch[Rows]) -> str:
        """Return why numbers or times do not continue in a stretch; empty if they do."""
        newest_ns, heard_ns = self._newest or (first_ns - round(self._period_ns), stretch.host_ns)
        passed_ns = first_ns - newest_ns
        off_ns = passed_ns - (stretch.lost + 1) * self._period_ns
        is_ahead = passed_ns > stretch.host_ns - heard_ns + _MAX_HOST_LATE_NS
        if passed_ns <= 0 or is_ahead or (not stretch.is_restart and abs(off_ns) > self._period_ns / 2):
            self._clock.restart()
            self._lag = None
            return "the beacon's time was set: the clock restarts"
        if stretch.is_restart and self._is_beacon_new:
            self._clock.restart()
            self._is_beacon_new = False
        return "the node started to sample again: its ticks restart" if stretch.is_restart else ""

    def _run_ended(self) -> Items:
        """Return the samples of the consecutive packets so far, after the event about the samples missing before."""
        if not self._run:
            return []
        rows, host_ns = np.concatenate([each.rows for each in self._run]), self._run[-1].host_ns
        device_ns, used = rows["ns"], rows["values"]
        missing, self._missing = self._missing, 0
        self._run.clear()
        time_ns = self._clock.map(device_ns, self._arrival_ns(int(device_ns[-1]), host_ns))
        self._index += missing
        sequence = (self._index + np.arange(len(used))).astype(np.uint32)
        self._index += len(used)
        out: Items = []
        if self._lag is not None and self._lag[1] is not None and host_ns - self._lag[1] > _LAG_VALID_NS:
            out += self._timed_by_arrival(f"the base station answers no query for {_LAG_VALID_NS / 1e9:.0f} s")
        if missing:
            signal = {} if self.base_rssi_dBm is None else {"rssi_dBm": self.base_rssi_dBm}
            span_s = missing / self._settings.rate_Hz
            out.append(self.lost_samples(missing, span_s, time_ns=int(time_ns[0]), **signal))
        out.append(Batch(channels.PENDULUMS, time_ns, sequence, self._angle_columns(used, sequence, device_ns)))
        if self._quantities is not None:
            columns = {name: used[:, 2 + k].copy() for k, name in enumerate(self._settings.quantities)}
            out.append(Batch(self._quantities, time_ns, sequence, columns))
        return out

    def _angle_columns(
        self, values: NDArray[np.float64], sequence: NDArray[np.uint32], device_ns: NDArray[np.int64]
    ) -> dict[str, NDArray[Any]]:
        thetas = [angle.of(values[:, k]) for k, angle in enumerate(self._angles)]
        flags = np.zeros(len(sequence), np.uint32)
        for theta, fault in zip(thetas, _FAULTS, strict=True):
            flags[~np.isfinite(theta)] |= fault
        step = _TURN_RAD / self._settings.counts_per_revolution
        limit = float(2**31 - 1)
        count_a, count_b = (np.clip(np.rint(np.nan_to_num(t) / step), -limit, limit).astype(np.int32) for t in thetas)
        return {
            "theta3_rad": thetas[0],
            "theta4_rad": thetas[1],
            "count_a": count_a,
            "count_b": count_b,
            "index": sequence,
            "node_time_us": (device_ns // 1000).astype(np.uint64),
            "flags": flags,
        }

    def _arrival_ns(self, device_ns: int, host_ns: int) -> int:
        """Return the host time at which a sample would have arrived without delay; without an answer, its arrival."""
        if self._lag is None:
            return host_ns
        lag, at_ns = self._lag
        if at_ns is None:
            self._lag = lag, host_ns
        elif host_ns - at_ns > _LAG_VALID_NS:
            return host_ns
        return min(device_ns + lag, host_ns)

    def _contradiction(self, sweeps: wire.Sweeps) -> Items | None:
        """Return the events of a packet whose channels or rate contradict the rig file; None without a contradiction.

        Several such packets are a complaint.
        """
        settings = self._settings
        missing = [number for number in settings.used_channels if number not in sweeps.channels]
        rate = RATES_HZ.get(sweeps.rate_code)
        if not missing and rate == settings.rate_Hz:
            self._contradictions, self._complaint = 0, ""
            return None
        self._contradictions += 1
        words = (
            f"the node does not send channel {', '.join(map(str, missing))}, only {sweeps.channels}"
            if missing
            else f"the node samples with {rate or f'rate code {sweeps.rate_code}'} Hz, the rig file states "
            f"rate_Hz = {settings.rate_Hz}"
        )
        if self._contradictions < _CONTRADICTIONS:
            return [self._damaged(words)]
        self.losses["damaged_packets"] += 1
        if self._complaint:
            return []
        self._has_reported, self._complaint = True, f"{words}. Correct the rig file or set up the node"
        return [DeviceEvent("fault", self._device, self._complaint)]

    def _damaged(self, reason: str) -> DeviceEvent:
        return self.damage("damaged_packets", f"packet dropped: {reason}", reason=reason)


class ContinuedAngle:
    """Angles of a sensor from the values of its channel.

    Args:
        slope_rad: angle of one unit of the value, rad.
        offset_rad: angle at the value 0, rad.
        near_rad: angle from which the first one is less than half a turn away, if the output repeats with each
            revolution; each further angle is the nearest one to that before it. None: the output does not repeat.
    """

    def __init__(self, slope_rad: float, offset_rad: float, near_rad: float | None) -> None:
        self._slope, self._offset, self._last = slope_rad, offset_rad, near_rad

    def of(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the angles of consecutive values, rad, shape (n,); NaN for values that are not a reading."""
        with np.errstate(invalid="ignore", over="ignore"):
            angles = values * self._slope + self._offset
            valid = np.abs(angles) < _MAX_ANGLE_RAD
        angles[~valid] = np.nan
        if self._last is None or not valid.any():
            return angles
        angles[valid] = np.unwrap(np.concatenate([[self._last], angles[valid]]))[1:]
        self._last = float(angles[valid][-1])
        return angles
