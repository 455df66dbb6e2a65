"""Settings of CANopen encoders (CiA 406) in a rig file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, model_validator

from rig_basics.texts import number_of
from rig_configs.device import RotorNodeSettings
from rig_configs.roles import Role, RotorPhase

Node = Annotated[int, Field(ge=1, le=127)]
Serial = Annotated[int, Field(ge=0, lt=2**32)]
Counts = Annotated[int, Field(ge=0, lt=2**31)]
Positive = Literal["cw", "ccw"]

LATEST_S = 0.1
"""Latest report after its SYNC, s. The host waits twice as long for the first report; see `SyncSender`."""

FAULT_KEYS = ("error_register", "error_code", "alarms", "warnings")
"""Keys of an encoder's faults in the identity, after its name: 1001h, newest of 1003h, 6503h, 6505h."""

_SYNC_BITS, _REPORT_BITS = 67, 117  # longest frames of 0 and 4 bytes, with stuffing and the space between frames
_LINE_BITS = 150  # text of a report: 14 characters and CR, 10 bits each
_MOST_OF_LINE = 0.9  # answers to the host's frames and heartbeats need the rest


@dataclass(frozen=True)
class Encoder:
    """One encoder of the device.

    Attributes:
        name: "a", "b" or "shaft".
        node: CANopen node number.
        serial: serial number (1018h sub 4); 0: any.
        positive: sense of rotation, seen on its shaft, in which the rig's angle grows.
        zero_counts: its position at the angle 0; of the shaft: at `index_angle_deg`.
    """

    name: str
    node: int
    serial: int
    positive: Positive
    zero_counts: int


class EncoderBus(RotorNodeSettings):
    """CANopen encoders on one bus behind an adapter: those of pendulums A and B, and optionally that of the shaft.

    Attributes:
        baud: line rate of the adapter's serial port, baud.
        bitrate: bit rate of the CAN bus, bit/s.
        a_node, b_node, shaft_node: node numbers; without `shaft_node` the device gives no index marks.
        a_serial, b_serial, shaft_serial: serial numbers (1018h sub 4); another encoder is refused. 0: any.
        a_positive, b_positive, shaft_positive: sense of rotation, seen on the encoder's shaft, in which the angle
            grows.
        a_zero_counts, b_zero_counts, shaft_zero_counts: position at the angle 0; of the shaft: at `index_angle_deg`.
        sync: whether the host sends SYNC, and all encoders sample at that instant; otherwise each sends by its own
            timer.
        sync_delay_s: time from the host's write of a SYNC to the sampling, s; without SYNC: from the sampling to the
            host's read. Not verified: measure it.
        max_lateness_s: a SYNC whose first report comes later than usual by more than this may have left late, s. If the
            shaft has turned further by more than this too, it did, and the samples count as missing.
        heartbeat_ms: period of the encoders' heartbeats, ms.
        rate_Hz: samples per second; without SYNC its period must be whole milliseconds.
    """

    baud: Annotated[int, Field(ge=9600, le=3_000_000)] = 115_200
    bitrate: Literal[125_000, 250_000, 500_000, 1_000_000] = 500_000
    a_node: Node
    b_node: Node
    shaft_node: Node | None = None
    a_serial: Serial = 0
    b_serial: Serial = 0
    shaft_serial: Serial = 0
    a_positive: Positive = "ccw"
    b_positive: Positive = "ccw"
    shaft_positive: Positive = "ccw"
    a_zero_counts: Counts = 0
    b_zero_counts: Counts = 0
    shaft_zero_counts: Counts = 0
    sync: bool = True
    sync_delay_s: Annotated[float, Field(ge=0, le=0.05)] = 0.0
    max_lateness_s: Annotated[float, Field(ge=0.0005, le=LATEST_S)] = 0.003
    heartbeat_ms: Annotated[int, Field(ge=50, le=5000)] = 200
    rate_Hz: Annotated[int, Field(ge=10, le=1000)] = 200
    locks: bool = False

    @property
    def encoders(self) -> tuple[Encoder, ...]:
        """The encoders: A, B, and the shaft's if there is one."""
        both = (
            Encoder("a", self.a_node, self.a_serial, self.a_positive, self.a_zero_counts),
            Encoder("b", self.b_node, self.b_serial, self.b_positive, self.b_zero_counts),
        )
        if self.shaft_node is None:
            return both
        return (
            *both,
            Encoder("shaft", self.shaft_node, self.shaft_serial, self.shaft_positive, self.shaft_zero_counts),
        )

    @property
    def period_ms(self) -> int:
        """Period of the encoders' own timer without SYNC, ms."""
        return 1000 // self.rate_Hz

    def roles(self, device: str) -> tuple[Role, ...]:
        """See DeviceSettings: without an encoder on the shaft there is no rotor phase."""
        has_phase = self.shaft_node is not None
        return tuple(role for role in super().roles(device) if has_phase or not isinstance(role, RotorPhase))

    @model_validator(mode="after")
    def _possible(self) -> EncoderBus:
        if self.locks:
            raise ValueError("locks = true: encoders command no locks; lock and release by hand, or by another device")
        nodes = [encoder.node for encoder in self.encoders]
        if len(set(nodes)) < len(nodes):
            raise ValueError(f"expected a node number of its own for each encoder, got {nodes}")
        for encoder in self.encoders:
            if encoder.zero_counts >= self.counts_per_revolution:
                raise ValueError(
                    f"{encoder.name}_zero_counts = {encoder.zero_counts}: expected less than a revolution, "
                    f"{number_of(self.counts_per_revolution, 'count')}"
                )
        if not self.sync and 1000 % self.rate_Hz:
            raise ValueError(f"rate_Hz = {self.rate_Hz}: without sync its period must be whole milliseconds")
        line = int(_MOST_OF_LINE * self.baud / (_LINE_BITS * len(nodes)))
        bus = int(_MOST_OF_LINE * self.bitrate / (_SYNC_BITS + _REPORT_BITS * len(nodes)))
        if self.rate_Hz > min(line, bus):
            what = f"baud = {self.baud}" if line < bus else f"bitrate = {self.bitrate}"
            raise ValueError(
                f"rate_Hz = {self.rate_Hz}: {what} carries {number_of(min(line, bus), 'sample')} a second of "
                f"{number_of(len(nodes), 'encoder')}"
            )
        return self
