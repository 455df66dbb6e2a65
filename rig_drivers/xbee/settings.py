"""Settings of a RotorLink node behind XBee modules in a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from rig_configs.device import RotorNodeSettings

_BITS_PER_SAMPLE = 80  # two counts of four bytes, ten bits a byte on the line; without the heads of frames
_UNUSABLE = {"000000000000FFFF": "broadcast", "FFFFFFFFFFFFFFFF": "unknown", "FFFF": "broadcast", "FFFE": "unknown"}


class XBeeNode(RotorNodeSettings):
    """The on-rotor node behind an XBee module at the host, in API mode.

    Attributes:
        baud: line rate of the host's module (its BD), baud.
        api_mode: AP of the host's module: 1 without, 2 with escaped characters.
        node_address: address of the node's module: 16 hex digits (its SH and SL), or 4 hex digits (its MY) in a network
            of 16-bit addresses. Frames from other addresses are ignored.
        legacy_transmit: whether requests 0x00 and 0x01 are sent, the only ones that first-generation 802.15.4 modules
            accept (unverified); otherwise 0x10.
        rate_Hz: sample rate of the node, Hz. The radio may carry far less than the serial line: about 27 kbit/s are
            published for DigiMesh at 2.4 GHz, which is about 300 samples a second.
        index_angle_deg: ψ (imbalance direction from +x) at the index mark, degrees.
        zero_std_deg: standard uncertainty of each encoder's zero against the imbalance direction, degrees.
    """

    baud: Annotated[int, Field(ge=9600, le=1_000_000)] = 115_200
    api_mode: Literal[1, 2] = 2
    node_address: Annotated[str, Field(pattern=r"^([0-9A-Fa-f]{16}|[0-9A-Fa-f]{4})$")]
    legacy_transmit: bool = False
    rate_Hz: Annotated[int, Field(ge=10, le=5000)] = 250

    @field_validator("node_address")
    @classmethod
    def _one_node(cls, text: str) -> str:
        if text.upper() in _UNUSABLE:
            raise ValueError(
                f"node_address = {text!r} is the {_UNUSABLE[text.upper()]} address, expected one module's own"
            )
        return text.upper()

    @model_validator(mode="after")
    def _line_carries_samples(self) -> XBeeNode:
        if self.rate_Hz * _BITS_PER_SAMPLE > self.baud:
            raise ValueError(
                f"rate_Hz = {self.rate_Hz} needs more than {self.rate_Hz * _BITS_PER_SAMPLE} baud, baud = {self.baud}"
            )
        return self
