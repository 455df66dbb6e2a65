"""Settings of a RotorLink node in a rig file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from rig_configs.device import RotorNodeSettings


class EncoderNode(RotorNodeSettings):
    """The on-rotor node behind a radio dongle on a serial port.

    Attributes:
        baud: line rate of the dongle, baud.
    """

    baud: Annotated[int, Field(ge=230_400)] = 921_600
