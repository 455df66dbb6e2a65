"""Settings of a MicroStrain wireless node in a rig file."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from daq.channels import Channel
from rig_configs.device import DeviceSettings
from rig_configs.roles import USUAL_ZERO_STD_DEG, OtherQuantity, PendulumAngles, Role
from rig_configs.table import Finite, NotNegative, Positive
from rig_drivers.microstrain.rates import BASE_ADDRESS, RATES_HZ

_CODES = 65_536  # values of an unsigned word of 16 bits, the usual data type
_ChannelNumber = Annotated[int, Field(ge=1, le=16)]
_QuantityName = Annotated[str, Field(pattern=r"^[a-z][A-Za-z0-9_]{0,40}$")]


class MicroStrainNode(DeviceSettings):
    """A node on the rotor with an angle sensor of each pendulum on two of its channels; it has no index mark.

    Attributes:
        baud: line rate of the base station's serial port, baud; unverified for old models.
        aspp: version of the base station's packets: 1 (sum of 16 bits, which does not detect exchanged bytes) or 3
            (CRC-32).
        node_address: address of the node. Packets of other nodes are ignored.
        serial: serial number of the node: model-option-number, for example "6305-1000-12345"; any other node is
            refused. "": any.
        rate_Hz: sample rate to which the node is set, Hz.
        channel_a, channel_b: the node's channels with the angle sensors of pendulum A and B.
        slope_a_rad, slope_b_rad: angle of one unit of the channel's value, rad; negative if the value decreases with
            the angle. The unit is a bit, or that of the node's own calibration if it sends such values.
        offset_a_rad, offset_b_rad: angle at the value 0, rad.
        counts_per_revolution: resolution of the angle sensors, steps of a revolution.
        turns: whether the sensors' output repeats with each revolution; angles then continue over the jump.
        zero_std_deg: standard uncertainty of each sensor's zero against the imbalance direction, degrees.
        clock_tolerance_ppm: standard uncertainty of the rate of the base station's clock, ppm.
        beacon_status_s: time between two queries of the beacon's time, s.
        quantities: further recorded channels of the node: number of the channel by the name of the field, with unit.
    """

    calibration: ClassVar[tuple[str, ...]] = (
        "slope_a_rad",
        "slope_b_rad",
        "offset_a_rad",
        "offset_b_rad",
        "counts_per_revolution",
        "zero_std_deg",
        "clock_tolerance_ppm",
    )

    baud: Annotated[int, Field(ge=9600, le=3_000_000)] = 921_600
    aspp: Literal[1, 3] = 3
    node_address: Annotated[int, Field(ge=1, le=0xFFFF_FFFE)]
    serial: Annotated[str, Field(pattern=r"^([0-9]{1,5}-[0-9]{1,5}-[0-9]{1,10})?$")] = ""
    rate_Hz: int = 256
    channel_a: _ChannelNumber = 1
    channel_b: _ChannelNumber = 2
    slope_a_rad: Finite = 2 * math.pi / _CODES
    slope_b_rad: Finite = 2 * math.pi / _CODES
    offset_a_rad: Finite = 0.0
    offset_b_rad: Finite = 0.0
    counts_per_revolution: Annotated[int, Field(ge=64)] = _CODES
    turns: bool = True
    zero_std_deg: NotNegative = USUAL_ZERO_STD_DEG
    clock_tolerance_ppm: Positive = 30.0
    beacon_status_s: Annotated[float, Field(ge=0.1, le=30)] = 1.0
    quantities: dict[_QuantityName, _ChannelNumber] = Field(default={}, max_length=14)

    @field_validator("rate_Hz")
    @classmethod
    def _rate_of_a_node(cls, rate_Hz: int) -> int:
        if rate_Hz not in RATES_HZ.values():
            near = sorted(RATES_HZ.values(), key=lambda known: abs(known - rate_Hz))[:3]
            raise ValueError(f"nodes have no sample rate of {rate_Hz} Hz; the nearest are {', '.join(map(str, near))}")
        return rate_Hz

    @field_validator("serial")
    @classmethod
    def _as_reported(cls, serial: str) -> str:
        model, option, number = (int(part) for part in serial.split("-")) if serial else (0, 0, 0)
        return f"{model:04d}-{option:04d}-{number:05d}" if serial else ""

    @field_validator("slope_a_rad", "slope_b_rad")
    @classmethod
    def _measures(cls, slope: float) -> float:
        if slope == 0.0:
            raise ValueError("expected a slope other than 0: every angle would be the same")
        return slope

    @model_validator(mode="after")
    def _has_distinct_channels(self) -> MicroStrainNode:
        if self.channel_a == self.channel_b:
            raise ValueError(f"channel_a and channel_b are both {self.channel_a}: each pendulum has its own sensor")
        if self.node_address == BASE_ADDRESS:
            raise ValueError(f"node_address = {BASE_ADDRESS} is that of every base station")
        if self.aspp == 1 and self.node_address > 0xFFFE:
            raise ValueError(f"node_address = {self.node_address}: expected at most {0xFFFE} with aspp = 1")
        return self

    @property
    def used_channels(self) -> tuple[int, ...]:
        """Numbers of the node's channels that are recorded: both angles, then the further quantities."""
        return (self.channel_a, self.channel_b, *self.quantities.values())

    def roles(self, device: str) -> tuple[Role, ...]:
        """Return the roles; see DeviceSettings."""
        angles = PendulumAngles(
            device=device,
            topic="pendulums",
            rate_Hz=float(self.rate_Hz),
            zero_std_deg=self.zero_std_deg,
            counts_per_revolution=self.counts_per_revolution,
            clock_tolerance_ppm=self.clock_tolerance_ppm,
        )
        if not self.quantities:
            return (angles,)
        return angles, OtherQuantity(device=device, topic="node", fields=tuple(self.quantities))


def quantity_channel(settings: MicroStrainNode) -> Channel | None:
    """Return the channel of the further quantities; None without any."""
    fields = tuple((name, "double") for name in settings.quantities)
    return Channel("node", "rig.NodeSample", fields) if fields else None
